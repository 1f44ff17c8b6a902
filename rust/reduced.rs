//! Lights with the materials of the pixels solved for: the Schur complement of the normal equations.
//!
//! The normal matrix of materials and lights is an arrow (see [`normal_matrix`](crate::normal_matrix)):
//! pixels touch the lights only. So each pixel's unknowns are eliminated by themselves, and what is
//! left is a system of the lights' size, however many pixels there are:
//!
//! ```text
//! S = G − Σ_p B_pᵀ A_p⁻¹ B_p              s = g_L − Σ_p B_pᵀ A_p⁻¹ g_p
//! S δL = −s                               δθ_p = −A_p⁻¹ (g_p + B_p δL)
//! ```
//!
//! With U_p A_p U_pᵀ = 1, the inverse of Cholesky's factor, A⁻¹ = Uᵀ U, and B = Jᵀ Ω W splits into
//! rows R = U Jᵀ Ω, a number for each unknown and sample, times the weights w_ck of the pixel. Then
//!
//! ```text
//! S v = Σ_p Wᵀ (Ω − Rᵀ R) W v             s = Σ_p Wᵀ (Ω (I − T) − Rᵀ U g)
//! ```
//!
//! which needs no matrix, and costs about what an evaluation does; or, for some pixels, S itself as
//! products of R W. The row of an albedo has entries in its own channel alone, so of five rows three
//! cost a ninth. Where normals are free two more rows are dense, those of the tilts.
//!
//! Damping adds a share of its diagonal to A. An unknown on a bound that its slope pushes against is
//! held: its row is 0, and it does not move. So is one on which no radiance depends. Tilts have no
//! bounds; they move no further than 0.3 at once. They are the last unknowns, and U is
//! triangular, so what the tilts do is Uᵀ of their own rows: with these scaled down, −Uᵀ (U g + …)
//! is the step that is best for the other unknowns with the shorter tilts.

use ndarray::linalg::general_mat_mul;
use ndarray::{ArrayView2, ArrayViewMut2};
use std::marker::PhantomData;

use crate::block::{BLOCK, Plane, Radiance};
use crate::normal_matrix::zeros;
use crate::problem::{Problem, add};
use crate::samples::{
    AddSample, Block, DERIVATIVES, Sums, by_kind, handed_out, unknowns_of_channel,
};
use crate::sh::COEFFICIENTS;
use crate::shade::Reflection;
use crate::simd::{Instructions, Isa, Kernel, Vectors};
use crate::tilted::{TILTS, within_reach};
use crate::{Error, Result, check, pool};

/// Added to the unit diagonal of scaled matrices: far below what data can tell.
const RIDGE: f64 = 1e-12;
/// Blocks in a piece of work of a product.
const CHUNK: usize = 8;
/// Blocks whose rows are held at once while S is built.
const BLOCKS_AT_ONCE: usize = 8;
/// Rows and columns of S in a piece of work.
const TILE: usize = 128;
/// Numbers that are summed side by side.
const LANES: usize = 8;

type Doubles = Plane<f64>;

/// How the pixels are solved for.
#[derive(Clone, Copy, Debug, Default)]
pub struct Elimination<'a> {
    /// Added to each A, as a share of its diagonal.
    pub damping: f64,
    /// Whether all channels have the same light.
    pub mono: bool,
    /// What pulls at roughness, at metallic unless it is known, and at free tilts.
    pub pull: Option<Pull<'a>>,
}

/// Σ a (v − c)² beside the squares of the data.
#[derive(Clone, Copy, Debug)]
pub struct Pull<'a> {
    /// a: (pixel, F), for the F unknowns that are not albedo.
    pub precision: &'a [f64],
    /// v − c: (pixel, F)
    pub off: &'a [f64],
}

/// What is left for the lights, M unknowns (light channel, picture, coefficient).
#[derive(Clone, Debug)]
pub struct Reduced {
    /// S: (M, M).
    pub matrix: Vec<f64>,
    /// s: (M).
    pub gradient: Vec<f64>,
}

/// The same without a matrix.
#[derive(Clone, Debug)]
pub struct ReducedProduct {
    /// S v: (M).
    pub product: Vec<f64>,
    /// s: (M).
    pub gradient: Vec<f64>,
}

impl Problem {
    /// S and s of some pixels at x.
    pub fn reduced(&self, x: &[f64], pixels: &[usize], how: &Elimination) -> Result<Reduced> {
        by_kind!(self, reduced(self, x, pixels, how))
    }

    /// S v and s of some pixels at x, for v (light channel, picture, coefficient).
    pub fn reduced_product(
        &self,
        x: &[f64],
        pixels: &[usize],
        v: &[f64],
        how: &Elimination,
    ) -> Result<ReducedProduct> {
        by_kind!(self, reduced_product(self, x, pixels, v, how))
    }

    /// Where the unknowns of some pixels go when the lights move by v (light channel, picture,
    /// coefficient): (pixel, D). Materials are clipped to \[0, 1\]; tilts move by 0.3 at most, and
    /// grow no longer than tan 60°.
    pub fn follow_lights(
        &self,
        x: &[f64],
        pixels: &[usize],
        v: &[f64],
        how: &Elimination,
    ) -> Result<Vec<f64>> {
        by_kind!(self, follow_lights(self, x, pixels, v, how))
    }
}

fn reduced<M: Reflection, const C: usize, const D: usize, const U: usize>(
    problem: &Problem,
    x: &[f64],
    pixels: &[usize],
    how: &Elimination,
) -> Result<Reduced> {
    Lights::<M, C, D, U>::new(problem, x, pixels, how)?.reduced()
}

fn reduced_product<M: Reflection, const C: usize, const D: usize, const U: usize>(
    problem: &Problem,
    x: &[f64],
    pixels: &[usize],
    v: &[f64],
    how: &Elimination,
) -> Result<ReducedProduct> {
    Lights::<M, C, D, U>::new(problem, x, pixels, how)?.product(v)
}

fn follow_lights<M: Reflection, const C: usize, const D: usize, const U: usize>(
    problem: &Problem,
    x: &[f64],
    pixels: &[usize],
    v: &[f64],
    how: &Elimination,
) -> Result<Vec<f64>> {
    Lights::<M, C, D, U>::new(problem, x, pixels, how)?.follow(v)
}

/// A call: the problem, where it stands, and which pixels take part.
struct Lights<'a, M: Reflection, const C: usize, const D: usize, const U: usize> {
    problem: &'a Problem,
    maps: &'a [f64],
    /// (channel, picture)
    lights: Vec<[f64; COEFFICIENTS]>,
    pixels: &'a [usize],
    how: &'a Elimination<'a>,
    pictures: usize,
    coefficients: usize,
    /// Of the unknown lights: C, or 1 where all have the same.
    channels: usize,
    model: PhantomData<M>,
}

impl<'a, M: Reflection, const C: usize, const D: usize, const U: usize> Lights<'a, M, C, D, U> {
    fn new(
        problem: &'a Problem,
        x: &'a [f64],
        pixels: &'a [usize],
        how: &'a Elimination<'a>,
    ) -> Result<Self> {
        let (maps, lights) = problem.at(x, pixels)?;
        if !(0.0..f64::INFINITY).contains(&how.damping) {
            return Err(Error::argument(
                "damping",
                "a share, 0 or more",
                how.damping,
            ));
        }
        if let Some(pull) = how.pull {
            let expected = pixels.len() * (problem.unknowns_of_pixel() - C);
            check::length("precision", expected, pull.precision.len())?;
            check::length("off", expected, pull.off.len())?;
            check::moderate("precision", pull.precision, check::LARGEST_F64)?;
            check::not_negative("precision", pull.precision)?;
            check::moderate("off", pull.off, check::LARGEST_F64)?;
        }
        Ok(Self {
            problem,
            maps,
            lights,
            pixels,
            how,
            pictures: problem.pictures(),
            coefficients: problem.coefficients(),
            channels: if how.mono { 1 } else { C },
            model: PhantomData,
        })
    }

    /// M
    fn size(&self) -> usize {
        self.channels * self.of_channel()
    }

    /// Unknowns of a light channel.
    fn of_channel(&self) -> usize {
        self.pictures * self.coefficients
    }

    /// v as (channel, picture), zeros where a band is left out; of all C channels.
    fn padded(&self, v: &[f64]) -> Result<Vec<[f64; COEFFICIENTS]>> {
        check::length("v", self.size(), v.len())?;
        check::moderate("v", v, check::LARGEST_F64)?;
        Ok((0..C * self.pictures)
            .map(|i| {
                let first = i % (self.channels * self.pictures) * self.coefficients;
                let mut light = [0.0; COEFFICIENTS];
                light[..self.coefficients].copy_from_slice(&v[first..][..self.coefficients]);
                light
            })
            .collect())
    }

    /// Takes up a block of pixels, the `block`th of the call, and solves for them.
    fn eliminate(&self, block: usize, solved: &mut Solved<'a, M, C, D, U>) {
        let first = block * BLOCK;
        let pixels = &self.pixels[first..self.pixels.len().min(first + BLOCK)];
        let finish = self.problem.unknowns_of_pixel() - C;
        let pull = self.how.pull.map(|pull| {
            [pull.precision, pull.off]
                .map(|of_all| &of_all[first * finish..][..pixels.len() * finish])
        });
        solved.take(self.maps, &self.lights, pixels, pull, self.how.damping);
    }

    fn blocks(&self) -> usize {
        self.pixels.len().div_ceil(BLOCK)
    }

    fn reduced(&self) -> Result<Reduced> {
        let size = self.size();
        let mut found = Reduced {
            matrix: zeros(size * size)?,
            gradient: zeros(size)?,
        };
        for first in (0..self.blocks()).step_by(BLOCKS_AT_ONCE) {
            let last = self.blocks().min(first + BLOCKS_AT_ONCE);
            let wide = pool::map(self.problem.threads(), (first..last).collect(), |block| {
                let mut solved = Solved::new(self.problem);
                self.eliminate(block, &mut solved);
                Wide::of(self, &mut solved)
            });
            for wide in &wide {
                add(&mut found.gradient, &wide.gradient);
                self.add_grams(&wide.grams, &mut found.matrix);
            }
            let tiles = pool::map(self.problem.threads(), self.tiles(), |tile| {
                let mut values = vec![0.0; tile.rows.1 * tile.columns.1];
                for wide in &wide {
                    wide.subtract(self, &tile, &mut values);
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

    /// Pieces of the lower triangle of S; none crosses a border of channels.
    fn tiles(&self) -> Vec<Tile> {
        let of_channel = self.of_channel();
        let pieces: Vec<_> = (0..self.channels)
            .flat_map(|c| (0..of_channel).step_by(TILE).map(move |first| (c, first)))
            .map(|(c, first)| (c, c * of_channel + first, TILE.min(of_channel - first)))
            .collect();
        let mut tiles = Vec::new();
        for (i, &(channel, row, rows)) in pieces.iter().enumerate() {
            for &(other, column, columns) in &pieces[..=i] {
                tiles.push(Tile {
                    rows: (row, rows),
                    columns: (column, columns),
                    channel: (channel == other).then_some(channel),
                });
            }
        }
        tiles
    }

    /// G of a block: one Gram matrix a channel, or one a channel and picture.
    fn add_grams(&self, grams: &[f64], matrix: &mut [f64]) {
        let (k, size) = (self.coefficients, self.size());
        let grams: Vec<_> = grams.chunks(k * k).collect();
        for light in 0..self.channels * self.pictures {
            let each = grams.len() / C;
            for c in (light / self.pictures..C).step_by(self.channels) {
                let gram = grams[c * each + light % self.pictures % each];
                for (i, row) in gram.chunks(k).enumerate() {
                    let start = (light * k + i) * size + light * k;
                    add(&mut matrix[start..][..k], row);
                }
            }
        }
    }

    fn product(&self, v: &[f64]) -> Result<ReducedProduct> {
        let moves = self.padded(v)?;
        let pieces = (0..self.blocks()).step_by(CHUNK).collect();
        let parts = pool::map(self.problem.threads(), pieces, |first: usize| {
            let mut solved = Solved::new(self.problem);
            let mut product = vec![Lanes::default(); C * self.pictures];
            let mut gradient = product.clone();
            for block in first..self.blocks().min(first + CHUNK) {
                self.eliminate(block, &mut solved);
                solved.add_gradient(&mut gradient);
                solved.add_product(&moves, &mut product);
            }
            [self.collected(&product), self.collected(&gradient)]
        });
        let mut found = ReducedProduct {
            product: zeros(self.size())?,
            gradient: zeros(self.size())?,
        };
        for [product, gradient] in parts {
            add(&mut found.product, &product);
            add(&mut found.gradient, &gradient);
        }
        Ok(found)
    }

    /// Sums by light (channel, picture) as the unknown lights are.
    fn collected(&self, sums: &[Lanes]) -> Vec<f64> {
        let mut collected = vec![0.0; self.size()];
        for (i, lanes) in sums.iter().enumerate() {
            let first = i % (self.channels * self.pictures) * self.coefficients;
            for (to, lanes) in collected[first..][..self.coefficients]
                .iter_mut()
                .zip(&lanes.0)
            {
                *to += lanes.iter().sum::<f64>();
            }
        }
        collected
    }

    fn follow(&self, v: &[f64]) -> Result<Vec<f64>> {
        let moves = self.padded(v)?;
        let unknowns = self.problem.unknowns_of_pixel();
        let mut materials = zeros(self.pixels.len() * unknowns)?;
        let pieces = materials
            .chunks_mut(CHUNK * BLOCK * unknowns)
            .enumerate()
            .collect();
        pool::map(
            self.problem.threads(),
            pieces,
            |(piece, out): (usize, &mut [f64])| {
                let mut solved = Solved::new(self.problem);
                for (i, out) in out.chunks_mut(BLOCK * unknowns).enumerate() {
                    self.eliminate(piece * CHUNK + i, &mut solved);
                    solved.follow(&moves, out);
                }
            },
        );
        Ok(materials)
    }
}

/// A piece of S: first row and number of rows, the same of columns, and the channel if it is one.
struct Tile {
    rows: (usize, usize),
    columns: (usize, usize),
    channel: Option<usize>,
}

/// A block's rows times its weights, and its share of G and s.
struct Wide {
    /// Of all but albedo: (M, unknown, pixel).
    finish: Vec<f64>,
    /// How many these unknowns are.
    unknowns: usize,
    /// Of albedo, in its own channel: (channel, picture, coefficient, pixel).
    albedo: Vec<f64>,
    /// (channel, 1 or picture, K, K)
    grams: Vec<f64>,
    /// (M)
    gradient: Vec<f64>,
}

impl Wide {
    fn of<M: Reflection, const C: usize, const D: usize, const U: usize>(
        lights: &Lights<M, C, D, U>,
        solved: &mut Solved<M, C, D, U>,
    ) -> Self {
        let unknowns = D - 1;
        let (n, k) = (lights.pictures, lights.coefficients);
        let (size, of_channel) = (lights.size(), lights.of_channel());
        let mut finish = vec![0.0; size * unknowns * BLOCK];
        let mut albedo = vec![0.0; C * of_channel * BLOCK];
        for (sample, albedo) in albedo.chunks_mut(k * BLOCK).enumerate() {
            let (c, i) = (sample / n, sample % n);
            let first = (c % lights.channels * of_channel + i * k) * unknowns * BLOCK;
            let finish = &mut finish[first..][..k * unknowns * BLOCK];
            solved.isa().run(Widen {
                weights: &solved.block.weights[c][..k],
                rows: &solved.rows[sample],
                albedo: albedo.as_chunks_mut().0,
                finish: finish.as_chunks_mut().0,
            });
        }
        let mut gradient = vec![Lanes::default(); C * n];
        solved.add_gradient(&mut gradient);
        Self {
            finish,
            unknowns,
            albedo,
            grams: solved.grams(),
            gradient: lights.collected(&gradient),
        }
    }

    /// Subtracts this block's Bᵀ A⁻¹ B from a tile.
    fn subtract<M: Reflection, const C: usize, const D: usize, const U: usize>(
        &self,
        lights: &Lights<M, C, D, U>,
        tile: &Tile,
        values: &mut [f64],
    ) {
        let of_channel = lights.of_channel();
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
            &self.finish,
            self.unknowns * BLOCK,
            (tile.rows.0, tile.columns.0),
        );
        if let Some(channel) = tile.channel {
            let start = channel * of_channel;
            let first = (tile.rows.0 - start, tile.columns.0 - start);
            for c in (channel..C).step_by(lights.channels) {
                let rows = &self.albedo[c * of_channel * BLOCK..][..of_channel * BLOCK];
                subtract(rows, BLOCK, first);
            }
        }
    }
}

/// Sums by the coefficients of a light, in parts that add up.
#[derive(Clone, Copy, Debug, Default)]
struct Lanes([[f64; LANES]; COEFFICIENTS]);

/// A block of pixels that are solved for. Samples are (channel, picture).
struct Solved<'a, M: Reflection, const C: usize, const D: usize, const U: usize> {
    problem: &'a Problem,
    block: Block<'a, M, C, D>,
    /// Pixels in the block.
    count: usize,
    /// The unknowns that there are.
    unknowns: Vec<usize>,
    /// Ω J, by the channel's own albedo, roughness, metallic and what follows.
    weighted: Vec<[Doubles; D]>,
    /// ω (I − T)
    slopes: Vec<Doubles>,
    /// ω
    omega: Vec<Doubles>,
    sums: Sums<U>,
    /// U, lower triangular; 0 for what is held.
    whiten: [[Doubles; U]; U],
    /// U g
    whitened: [Doubles; U],
    /// R, in the same order as J.
    rows: Vec<[Doubles; D]>,
}

impl<'a, M: Reflection, const C: usize, const D: usize, const U: usize> Solved<'a, M, C, D, U> {
    fn new(problem: &'a Problem) -> Self {
        let samples = C * problem.pictures();
        Self {
            problem,
            block: Block::new(problem),
            count: 0,
            unknowns: handed_out::<C, D>(problem),
            weighted: vec![[Doubles::default(); D]; samples],
            slopes: vec![Doubles::default(); samples],
            omega: vec![Doubles::default(); samples],
            sums: Sums::default(),
            whiten: [[Doubles::default(); U]; U],
            whitened: [Doubles::default(); U],
            rows: vec![[Doubles::default(); D]; samples],
        }
    }

    fn take(
        &mut self,
        maps: &[f64],
        lights: &[[f64; COEFFICIENTS]],
        pixels: &[usize],
        pull: Option<[&[f64]; 2]>,
        damping: f64,
    ) {
        let isa = self.problem.instructions();
        let n = self.problem.pictures();
        self.count = pixels.len();
        self.block.load(maps, pixels);
        self.block.fill_weights();
        self.sums = Sums::default();
        let (weighted, slopes, omega) = (&mut self.weighted, &mut self.slopes, &mut self.omega);
        let sums = &mut self.sums;
        self.block.each_sample(lights, |c, picture, sample| {
            let i = c * n + picture;
            isa.run(AddSample {
                sample,
                unknowns: unknowns_of_channel::<C, D>(c),
                sums,
            });
            omega[i] = sample.weight;
            for x in 0..BLOCK {
                slopes[i].0[x] = sample.weight.0[x] * sample.residual.0[x];
            }
            for (to, from) in weighted[i].iter_mut().zip(&sample.derivatives) {
                for x in 0..BLOCK {
                    to.0[x] = sample.weight.0[x] * from.0[x];
                }
            }
        });
        if let Some([precision, off]) = pull {
            let finish = precision.len() / pixels.len();
            for (i, (a, off)) in precision.iter().zip(off).enumerate() {
                let (x, unknown) = (i / finish, self.unknowns[C + i % finish]);
                self.sums.matrix[unknown][unknown].0[x] += a;
                self.sums.gradient[unknown].0[x] += a * off;
            }
        }
        self.whiten(damping);
        for (sample, weighted) in self.weighted.iter().enumerate() {
            isa.run(FillRows {
                own: unknowns_of_channel::<C, D>(sample / n),
                weighted,
                whiten: &self.whiten,
                rows: &mut self.rows[sample],
            });
        }
    }

    fn isa(&self) -> Instructions {
        self.problem.instructions()
    }

    /// θ of one kind.
    fn values(&self, unknown: usize) -> &Doubles {
        let materials = &self.block.materials;
        match (unknown, &self.block.tilted) {
            (c, _) if c < C => &materials.albedo[c],
            (c, _) if c == C => &materials.roughness,
            (c, Some(tilted)) if c > C + 1 => &tilted.tilts[c - C - 2],
            _ => &materials.metallic,
        }
    }

    /// Works out U, which is 0 for unknowns that are held, and U g.
    fn whiten(&mut self, damping: f64) {
        let mut scale = [Doubles::default(); U];
        for &unknown in &self.unknowns {
            let values = self.values(unknown);
            let gradient = &self.sums.gradient[unknown];
            let diagonal = &self.sums.matrix[unknown][unknown];
            let bounded = unknown < C + 2;
            for x in 0..BLOCK {
                let (value, slope, d) = (values.0[x], gradient.0[x], diagonal.0[x]);
                let held = (value <= 0.0 && slope > 0.0) || (value >= 1.0 && slope < 0.0);
                let used = !(held && bounded) && d > f64::MIN_POSITIVE;
                scale[unknown].0[x] = if used { 1.0 / d.sqrt() } else { 0.0 };
            }
        }
        self.isa().run(Whiten {
            sums: &self.sums,
            scale: &scale,
            damping,
            whiten: &mut self.whiten,
            whitened: &mut self.whitened,
        });
    }

    /// Adds Wᵀ (Ω (I − T) − Rᵀ U g).
    fn add_gradient(&mut self, sums: &mut [Lanes]) {
        let n = self.problem.pictures();
        for (sample, sums) in sums.iter_mut().enumerate() {
            let c = sample / n;
            let mut left = self.slopes[sample];
            self.subtract_rows(sample, c, &self.whitened, &mut left);
            self.isa().run(Collect {
                weights: &self.block.weights[c],
                values: &left,
                sums,
            });
        }
    }

    /// Adds Wᵀ (Ω − Rᵀ R) W v.
    fn add_product(&mut self, moves: &[[f64; COEFFICIENTS]], sums: &mut [Lanes]) {
        let n = self.problem.pictures();
        let radiance = self.moved_radiance(moves);
        let mut projected = [Doubles::default(); U];
        self.add_rows(&radiance, &mut projected);
        for (sample, sums) in sums.iter_mut().enumerate() {
            let c = sample / n;
            let mut left = Doubles::default();
            for x in 0..BLOCK {
                left.0[x] = self.omega[sample].0[x] * radiance[sample].0[x];
            }
            self.subtract_rows(sample, c, &projected, &mut left);
            self.isa().run(Collect {
                weights: &self.block.weights[c],
                values: &left,
                sums,
            });
        }
    }

    /// θ − Uᵀ (U g + R W v), within bounds and reach: (pixel, D).
    fn follow(&mut self, moves: &[[f64; COEFFICIENTS]], out: &mut [f64]) {
        let radiance = self.moved_radiance(moves);
        let mut whitened = self.whitened;
        self.add_rows(&radiance, &mut whitened);
        let count = self.unknowns.len();
        if D > DERIVATIVES {
            let tilts = &self.unknowns[count - TILTS..];
            let before = [0, 1].map(|t| self.values(tilts[t]));
            let after = [0, 1].map(|t| self.stepped(tilts[t], &whitened));
            for (x, out) in out.chunks_mut(count).enumerate() {
                let before = before.map(|plane| plane.0[x]);
                let step = [0, 1].map(|t| after[t].0[x] - before[t]);
                let (share, tilt) = within_reach(before, step);
                for &row in tilts {
                    whitened[row].0[x] *= share;
                }
                out[count - TILTS..].copy_from_slice(&tilt);
            }
        }
        let of_material = self.unknowns.iter().filter(|&&unknown| unknown < C + 2);
        for (i, &unknown) in of_material.enumerate() {
            let after = self.stepped(unknown, &whitened);
            for (out, value) in out.chunks_mut(count).zip(after.0) {
                out[i] = value.clamp(0.0, 1.0);
            }
        }
    }

    /// θ − Uᵀ `whitened` of one kind.
    fn stepped(&self, unknown: usize, whitened: &[Doubles; U]) -> Doubles {
        let mut values = *self.values(unknown);
        for &row in self.unknowns.iter().filter(|&&row| row >= unknown) {
            let whiten = &self.whiten[row][unknown];
            for x in 0..BLOCK {
                values.0[x] -= whiten.0[x] * whitened[row].0[x];
            }
        }
        values
    }

    /// W v of every sample.
    fn moved_radiance(&self, moves: &[[f64; COEFFICIENTS]]) -> Vec<Doubles> {
        let n = self.problem.pictures();
        let mut radiance = vec![Doubles::default(); moves.len()];
        for (sample, (light, radiance)) in moves.iter().zip(&mut radiance).enumerate() {
            self.isa().run(Radiance {
                weights: &self.block.weights[sample / n],
                light,
                radiance,
            });
        }
        radiance
    }

    /// Adds R times `values`, one for each sample.
    fn add_rows(&self, values: &[Doubles], sums: &mut [Doubles; U]) {
        let n = self.problem.pictures();
        for (sample, values) in values.iter().enumerate() {
            self.isa().run(AddRows {
                own: unknowns_of_channel::<C, D>(sample / n),
                rows: &self.rows[sample],
                values,
                sums,
            });
        }
    }

    /// Subtracts the sample's Rᵀ `whitened`.
    fn subtract_rows(
        &self,
        sample: usize,
        channel: usize,
        whitened: &[Doubles; U],
        left: &mut Doubles,
    ) {
        self.isa().run(SubtractRows {
            own: unknowns_of_channel::<C, D>(channel),
            rows: &self.rows[sample],
            whitened,
            left,
        });
    }

    /// Σ ω w_ck w_cl over the pixels: (channel, 1 or picture, K, K).
    fn grams(&self) -> Vec<f64> {
        let (n, k) = (self.problem.pictures(), self.problem.coefficients());
        let each = if self.problem.weights(0, 0).is_empty() {
            1
        } else {
            n
        };
        let mut grams = vec![0.0; C * each * k * k];
        for (i, gram) in grams.chunks_mut(k * k).enumerate() {
            let (c, picture) = (i / each, i % each);
            let omega = &self.omega[c * n + picture].0;
            let weights = &self.block.weights[c];
            for row in 0..k {
                for column in 0..k {
                    let mut sum = [0.0; LANES];
                    for x in 0..BLOCK {
                        sum[x % LANES] += omega[x] * weights[row].0[x] * weights[column].0[x];
                    }
                    gram[row * k + column] = sum.iter().sum();
                }
            }
        }
        grams
    }
}

/// Inverts the scaled and damped matrices' Cholesky factors: U = L⁻¹ D with L Lᵀ = D A D + damping.
struct Whiten<'a, const U: usize> {
    sums: &'a Sums<U>,
    /// D, the root of the inverse diagonal; 0 for what is held.
    scale: &'a [Doubles; U],
    damping: f64,
    whiten: &'a mut [[Doubles; U]; U],
    whitened: &'a mut [Doubles; U],
}

impl<const U: usize> Kernel for Whiten<'_, U> {
    type Output = ();

    #[inline(always)]
    fn run<I: Isa>(self, _: I) {
        let Self {
            sums,
            scale,
            damping,
            whiten,
            whitened,
        } = self;
        // L, with the inverse of its diagonal on the diagonal.
        let mut lower = [[Doubles::default(); U]; U];
        for i in 0..U {
            for j in 0..=i {
                let mut entry = Doubles::default();
                for x in 0..BLOCK {
                    entry.0[x] = if i == j {
                        1.0 + RIDGE + damping
                    } else {
                        sums.matrix[i][j].0[x] * scale[i].0[x] * scale[j].0[x]
                    };
                }
                for k in 0..j {
                    for x in 0..BLOCK {
                        entry.0[x] -= lower[i][k].0[x] * lower[j][k].0[x];
                    }
                }
                for x in 0..BLOCK {
                    lower[i][j].0[x] = if i == j {
                        // Rounding may leave less than nothing of a pivot.
                        1.0 / entry.0[x].max(RIDGE).sqrt()
                    } else {
                        entry.0[x] * lower[j][j].0[x]
                    };
                }
            }
        }
        // Forward substitution of the unit vectors, column by column.
        for column in 0..U {
            for row in 0..U {
                let mut entry = Doubles::default();
                if row == column {
                    entry = scale[column];
                }
                for k in column..row {
                    for x in 0..BLOCK {
                        entry.0[x] -= lower[row][k].0[x] * whiten[k][column].0[x];
                    }
                }
                for x in 0..BLOCK {
                    whiten[row][column].0[x] = if row < column {
                        0.0
                    } else {
                        entry.0[x] * lower[row][row].0[x]
                    };
                }
            }
        }
        for row in 0..U {
            whitened[row] = Doubles::default();
            for column in 0..=row {
                for x in 0..BLOCK {
                    whitened[row].0[x] += whiten[row][column].0[x] * sums.gradient[column].0[x];
                }
            }
        }
    }
}

/// R = U (Ω J)ᵀ of one sample, whose derivatives are by the unknowns `own`.
struct FillRows<'a, const D: usize, const U: usize> {
    own: [usize; D],
    weighted: &'a [Doubles; D],
    whiten: &'a [[Doubles; U]; U],
    rows: &'a mut [Doubles; D],
}

impl<const D: usize, const U: usize> Kernel for FillRows<'_, D, U> {
    type Output = ();

    #[inline(always)]
    fn run<I: Isa>(self, isa: I) {
        self.all(isa);
    }
}

impl<const D: usize, const U: usize> FillRows<'_, D, U> {
    #[inline(always)]
    fn all<I: Vectors<f64>>(self, isa: I) {
        let Self {
            own,
            weighted,
            whiten,
            rows,
        } = self;
        for v in 0..BLOCK / I::LANES {
            for i in 0..D {
                let whiten = |j: usize| I::of(&whiten[own[i]][own[j]].0)[v];
                let mut sum = isa.mul(whiten(0), I::of(&weighted[0].0)[v]);
                for j in 1..=i {
                    sum = isa.add(sum, isa.mul(whiten(j), I::of(&weighted[j].0)[v]));
                }
                I::of_mut(&mut rows[i].0)[v] = sum;
            }
        }
    }
}

/// R W of one sample: its columns of the rows of a block.
struct Widen<'a, const D: usize> {
    weights: &'a [Doubles],
    rows: &'a [Doubles; D],
    albedo: &'a mut [[f64; BLOCK]],
    /// Added to: lights that all channels have collect from all.
    finish: &'a mut [[f64; BLOCK]],
}

impl<const D: usize> Kernel for Widen<'_, D> {
    type Output = ();

    #[inline(always)]
    fn run<I: Isa>(self, _: I) {
        for (k, weights) in self.weights.iter().enumerate() {
            for x in 0..BLOCK {
                self.albedo[k][x] = self.rows[0].0[x] * weights.0[x];
            }
            for (unknown, rows) in self.rows[1..].iter().enumerate() {
                for x in 0..BLOCK {
                    self.finish[(D - 1) * k + unknown][x] += rows.0[x] * weights.0[x];
                }
            }
        }
    }
}

/// Adds R times the values of one sample.
struct AddRows<'a, const D: usize, const U: usize> {
    own: [usize; D],
    rows: &'a [Doubles; D],
    values: &'a Doubles,
    sums: &'a mut [Doubles; U],
}

impl<const D: usize, const U: usize> Kernel for AddRows<'_, D, U> {
    type Output = ();

    #[inline(always)]
    fn run<I: Isa>(self, _: I) {
        for (unknown, rows) in self.own.into_iter().zip(self.rows) {
            for x in 0..BLOCK {
                self.sums[unknown].0[x] += rows.0[x] * self.values.0[x];
            }
        }
    }
}

/// Subtracts Rᵀ of one sample times values of the unknowns.
struct SubtractRows<'a, const D: usize, const U: usize> {
    own: [usize; D],
    rows: &'a [Doubles; D],
    whitened: &'a [Doubles; U],
    left: &'a mut Doubles,
}

impl<const D: usize, const U: usize> Kernel for SubtractRows<'_, D, U> {
    type Output = ();

    #[inline(always)]
    fn run<I: Isa>(self, _: I) {
        let whitened = self.own.map(|unknown| &self.whitened[unknown]);
        for x in 0..BLOCK {
            let mut sum = self.rows[0].0[x] * whitened[0].0[x];
            for j in 1..D {
                sum += self.rows[j].0[x] * whitened[j].0[x];
            }
            self.left.0[x] -= sum;
        }
    }
}

/// Adds Σ_x w_k values, in lanes.
struct Collect<'a> {
    weights: &'a [Doubles; COEFFICIENTS],
    values: &'a Doubles,
    sums: &'a mut Lanes,
}

impl Kernel for Collect<'_> {
    type Output = ();

    #[inline(always)]
    fn run<I: Isa>(self, _: I) {
        let values: &[[f64; LANES]] = self.values.0.as_chunks().0;
        for (weights, sum) in self.weights.iter().zip(&mut self.sums.0) {
            let weights: &[[f64; LANES]] = weights.0.as_chunks().0;
            let mut total = *sum;
            for (w, v) in weights.iter().zip(values) {
                for lane in 0..LANES {
                    total[lane] += w[lane] * v[lane];
                }
            }
            *sum = total;
        }
    }
}
