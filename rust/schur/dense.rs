//! The Schur complement as a matrix, as products of the rows R W.

use ndarray::linalg::general_mat_mul;
use ndarray::{ArrayView2, ArrayViewMut2};

use super::SchurComplement;
use super::eliminated_block::EliminatedBlock;
use super::kernels::fill_dense_rows;
use super::light_system::LightSystem;
use crate::problem::add;
use crate::reflectance::planes::BLOCK;
use crate::reflectance::reflection::Reflection;
use crate::runtime::memory::zeros;
use crate::runtime::simd::vectorized;
use crate::runtime::{Result, pool};

/// Blocks whose rows are held at once while S is built.
const BLOCKS_AT_ONCE: usize = 8;

/// Rows and columns of S in a piece of work.
const TILE: usize = 128;

impl<M: Reflection, const C: usize, const D: usize, const U: usize> LightSystem<'_, M, C, D, U> {
    pub(super) fn schur_complement(&self) -> Result<SchurComplement> {
        let size = self.unknown.size();
        let mut found = SchurComplement {
            matrix: zeros("normal equations", size * size)?,
            gradient: zeros("normal equations", size)?,
        };
        for first in (0..self.blocks()).step_by(BLOCKS_AT_ONCE) {
            let last = self.blocks().min(first + BLOCKS_AT_ONCE);
            let dense_rows = pool::map(
                self.problem.options.threads,
                (first..last).collect(),
                |block| {
                    let mut eliminated = EliminatedBlock::new(self.problem);
                    self.eliminate(block, &mut eliminated);
                    DenseRows::of(self, &mut eliminated)
                },
            );
            for dense_rows in &dense_rows {
                add(&mut found.gradient, &dense_rows.gradient);
                self.add_grams(&dense_rows.grams, &mut found.matrix);
                for (i, a) in dense_rows.diagonal.iter().enumerate() {
                    found.matrix[(self.unknown.of_lights() + i) * (size + 1)] += a;
                }
            }
            let tiles = pool::map(self.problem.options.threads, self.tiles(), |tile| {
                let mut values = vec![0.0; tile.rows.1 * tile.columns.1];
                for dense_rows in &dense_rows {
                    dense_rows.subtract(self, &tile, &mut values);
                }
                (tile, values)
            });
            for (tile, values) in tiles {
                for (i, row) in values.chunks(tile.columns.1).enumerate() {
                    let start = (tile.rows.0 + i) * size + tile.columns.0;
                    add(&mut found.matrix[start..][..row.len()], row);
                }
            }
        }
        for row in 0..size {
            for column in 0..row {
                found.matrix[column * size + row] = found.matrix[row * size + column];
            }
        }
        Ok(found)
    }

    /// Pieces of the lower triangle of S; none crosses a border of channels, of which offsets count
    /// as one more.
    fn tiles(&self) -> Vec<Tile> {
        let of_channel = self.unknown.of_channel();
        let mut parts = vec![of_channel; self.unknown.channels];
        parts.push(self.unknown.offsets);
        let pieces: Vec<_> = (parts.iter().enumerate())
            .flat_map(|(c, &count)| {
                (0..count)
                    .step_by(TILE)
                    .map(move |first| (c, c * of_channel + first, TILE.min(count - first)))
            })
            .collect();
        let mut tiles = Vec::new();
        for (i, &(channel, row, rows)) in pieces.iter().enumerate() {
            for &(other, column, columns) in &pieces[..=i] {
                tiles.push(Tile {
                    rows: (row, rows),
                    columns: (column, columns),
                    channel: (channel == other && channel < self.unknown.channels)
                        .then_some(channel),
                });
            }
        }
        tiles
    }

    /// G of a block: one Gram matrix a channel, or one a channel and picture.
    fn add_grams(&self, grams: &[f64], matrix: &mut [f64]) {
        let (k, size) = (self.unknown.coefficients, self.unknown.size());
        let grams: Vec<_> = grams.chunks(k * k).collect();
        for light in 0..self.unknown.channels * self.unknown.pictures {
            let each = grams.len() / C;
            for c in (light / self.unknown.pictures..C).step_by(self.unknown.channels) {
                let gram = grams[c * each + light % self.unknown.pictures % each];
                for (i, row) in gram.chunks(k).enumerate() {
                    let start = (light * k + i) * size + light * k;
                    add(&mut matrix[start..][..k], row);
                }
            }
        }
    }
}

/// A piece of S: first row and number of rows, the same of columns, and the channel if it is one.
struct Tile {
    rows: (usize, usize),
    columns: (usize, usize),
    channel: Option<usize>,
}

/// A block's rows times its weights, R W, and its share of G and s.
struct DenseRows {
    /// R W, and −U a of offsets, of the unknowns that all channels share: (M, unknown, pixel).
    shared: Vec<f64>,
    /// How many unknowns are shared.
    unknowns: usize,
    /// R W of albedo, in its own channel: (channel, picture, coefficient, pixel).
    albedo: Vec<f64>,
    /// (channel, 1 or picture, K, K)
    grams: Vec<f64>,
    /// Σ a by offset.
    diagonal: Vec<f64>,
    /// (M)
    gradient: Vec<f64>,
}

impl DenseRows {
    fn of<M: Reflection, const C: usize, const D: usize, const U: usize>(
        lights: &LightSystem<M, C, D, U>,
        eliminated: &mut EliminatedBlock<M, C, D, U>,
    ) -> Self {
        let unknowns = D - 1;
        let (isa, pixels) = (lights.problem.options.instructions, &eliminated.pixels);
        let (n, k) = (lights.unknown.pictures, lights.unknown.coefficients);
        let (size, of_channel) = (lights.unknown.size(), lights.unknown.of_channel());
        let mut shared = vec![0.0; size * unknowns * BLOCK];
        let mut albedo = vec![0.0; C * of_channel * BLOCK];
        for (sample, albedo) in albedo.chunks_mut(k * BLOCK).enumerate() {
            let (c, i) = (sample / n, sample % n);
            let first = (c % lights.unknown.channels * of_channel + i * k) * unknowns * BLOCK;
            let shared = &mut shared[first..][..k * unknowns * BLOCK];
            let (weights, rows) = (&pixels.weights[c][..k], &pixels.rows[sample]);
            let (albedo, shared) = (albedo.as_chunks_mut().0, shared.as_chunks_mut().0);
            vectorized!(isa, fill_dense_rows(weights, rows, albedo, shared));
        }
        let mut diagonal = vec![0.0; lights.unknown.offsets];
        if let Some(tied) = &eliminated.tied {
            let columns = &mut shared[lights.unknown.of_lights() * unknowns * BLOCK..];
            tied.fill(C, unknowns, columns, &mut diagonal);
        }
        let mut gradient = lights.unknown.sums();
        eliminated.add_gradient(&mut gradient);
        Self {
            shared,
            unknowns,
            albedo,
            grams: eliminated.grams(),
            diagonal,
            gradient: lights.unknown.collected(&gradient),
        }
    }

    /// Subtracts this block's Bᵀ A⁻¹ B from a tile.
    fn subtract<M: Reflection, const C: usize, const D: usize, const U: usize>(
        &self,
        lights: &LightSystem<M, C, D, U>,
        tile: &Tile,
        values: &mut [f64],
    ) {
        let of_channel = lights.unknown.of_channel();
        let shape = (tile.rows.1, tile.columns.1);
        let mut values = ArrayViewMut2::from_shape(shape, values).expect("a tile");
        let mut subtract = |rows: &[f64], width: usize, first: (usize, usize)| {
            let [left, right] = [(first.0, shape.0), (first.1, shape.1)].map(|(first, count)| {
                let rows = &rows[first * width..][..count * width];
                ArrayView2::from_shape((count, width), rows).expect("rows of equal length")
            });
            general_mat_mul(-1.0, &left, &right.t(), 1.0, &mut values);
        };
        subtract(
            &self.shared,
            self.unknowns * BLOCK,
            (tile.rows.0, tile.columns.0),
        );
        if let Some(channel) = tile.channel {
            let start = channel * of_channel;
            let first = (tile.rows.0 - start, tile.columns.0 - start);
            for c in (channel..C).step_by(lights.unknown.channels) {
                let rows = &self.albedo[c * of_channel * BLOCK..][..of_channel * BLOCK];
                subtract(rows, BLOCK, first);
            }
        }
    }
}
