//! The vector work of a bounded L-BFGS, for more unknowns than fit small caches.
//!
//! The method itself is in `python/pbrfit/projected_lbfgs.py`: it deals in matrices of a few dozen
//! rows. Here is what touches vectors: kept pairs of steps s and changes of the gradient y, their
//! products, and sums of them. Pairs are kept in float32, which costs no iterations: a loss in
//! float32 does not know its gradient any better. All sums are float64, over fixed pieces in order,
//! so that every bit is the same at any number of threads.

mod bounds;
mod count;
mod vectors;

use std::iter;
use std::ops::Range;

use self::bounds::Bounds;
use self::count::{ALL, Count, Counts, FREE, GRADIENT};
use self::vectors::{Direction, Dot, Moved, PairProducts, differences};
use crate::runtime::simd::Instructions;
use crate::runtime::{Error, Result, check, pool};

/// Entries that a kernel handles at once, and that lie side by side in a column.
const BLOCK: usize = 128;
/// Cache lines of 64 bytes that a block of a column takes.
const LINES: usize = BLOCK * size_of::<f32>() / 64;
/// At most so many pieces of work. Their borders depend on the length alone.
const MAX_PIECES: usize = 64;
/// Blocks in a piece of work at least: a piece has a cost of its own.
const MIN_PIECE: usize = 16;
/// More pairs would take longer than an evaluation.
const MAX_CORRECTIONS: usize = 64;

/// Numbers of a block.
type Numbers = [f64; BLOCK];
/// A bit for each entry of a block.
type Mask = u128;

/// Products of the columns s₁ … s_k, y₁ … y_k of the kept pairs, the oldest first.
#[derive(Clone, Debug, PartialEq)]
pub struct Products {
    /// Over all entries: (2k, 2k).
    pub all: Vec<f64>,
    /// Over the free ones: (2k, 2k).
    pub free: Vec<f64>,
    /// With the gradient, over the free ones: (2k).
    pub by_gradient: Vec<f64>,
    /// Square of the gradient, over the free ones.
    pub gradient: f64,
}

/// Bounds, and the pairs of a quasi-Newton method.
///
/// An entry is free unless it is on a bound that the gradient pushes it against.
#[derive(Debug)]
pub struct Lbfgs {
    size: usize,
    bounds: Vec<Bounds>,
    corrections: usize,
    threads: usize,
    instructions: Instructions,
    /// Places of the pairs that are known, the oldest first. Columns of place i are 2i, its s, and
    /// 2i + 1, its y.
    order: Vec<usize>,
    /// (block, column), each divided by its unit. So a block of all is read in one go.
    columns: Vec<[f32; BLOCK]>,
    /// Of the columns: with it their entries are near 1, far from where float32 ends.
    units: Vec<f64>,
    /// Products of columns over all entries, (column, column).
    all: Vec<f64>,
    /// The same over those that were free when they were asked for last.
    free: Vec<f64>,
    /// Which were free then, block by block.
    masks: Vec<Mask>,
    /// Whether products of the newest pair are still missing.
    fresh: bool,
}

impl Lbfgs {
    /// With no pairs yet; at most `corrections` are kept.
    ///
    /// Entries up to the first of `ends` have the first bounds, those from there to the second the
    /// second, and so on. Bounds may be infinite.
    ///
    /// # Errors
    /// If ends do not rise, bounds are crossed or NaN, or `corrections` is not 1 to 64.
    pub fn new(
        ends: &[usize],
        lower: &[f64],
        upper: &[f64],
        corrections: usize,
        threads: usize,
    ) -> Result<Self> {
        let bounds = bounds::runs(ends, lower, upper)?;
        let size = ends[ends.len() - 1];
        if !(1..=MAX_CORRECTIONS).contains(&corrections) {
            let expected = format!("1 to {MAX_CORRECTIONS} pairs");
            return Err(Error::argument("corrections", expected, corrections));
        }
        let blocks = size.div_ceil(BLOCK);
        let width = 2 * corrections;
        Ok(Self {
            size,
            bounds,
            corrections,
            threads,
            instructions: Instructions::best(),
            order: Vec::new(),
            columns: zeros(blocks * width, [0.0; BLOCK])?,
            units: vec![0.0; width],
            all: vec![0.0; width * width],
            free: vec![0.0; width * width],
            masks: zeros(blocks, 0)?,
            fresh: false,
        })
    }

    /// Length of all vectors.
    pub fn size(&self) -> usize {
        self.size
    }

    /// Number of pairs known.
    pub fn pairs(&self) -> usize {
        self.order.len()
    }

    /// Forgets all pairs; their memory stays.
    pub fn clear_pairs(&mut self) {
        self.order.clear();
        self.fresh = false;
    }

    /// Takes s = x′ − x and y = g′ − g as the newest pair, in the oldest's place if need be.
    ///
    /// A pair is good if sᵀy > ε |s| |y| with the ε of float32, as which it is kept: so the matrix
    /// stays positive definite. Others are not taken, and false is returned.
    ///
    /// # Errors
    /// If a vector has another length, or there is no memory for one more pair.
    pub fn add_pair(&mut self, x: [&[f64]; 2], gradient: [&[f64]; 2]) -> Result<bool> {
        self.check("x", &x)?;
        self.check("gradient", &gradient)?;
        if self.fresh {
            self.count(None);
        }
        let [mut ss, mut sy, mut yy] = [0.0; 3];
        for [a, b, c] in self.map(|range| {
            let [x, new_x] = x.map(|v| &v[range.clone()]);
            let [g, new_g] = gradient.map(|v| &v[range.clone()]);
            self.instructions.run(PairProducts { x, new_x, g, new_g })
        }) {
            ss += a;
            sy += b;
            yy += c;
        }
        // Written so that NaN fails.
        let good = sy > f64::from(f32::EPSILON) * (ss * yy).sqrt() && (ss + yy).is_finite();
        if !good {
            return Ok(false);
        }
        let place = if self.order.len() == self.corrections {
            self.order.remove(0)
        } else {
            // Places are taken in turn, so those behind are not in use.
            self.order
                .last()
                .map_or(0, |last| (last + 1) % self.corrections)
        };
        let units = [ss, yy].map(|sum_sq| (sum_sq / self.size as f64).sqrt());
        self.units[2 * place..][..2].copy_from_slice(&units);
        let (piece, width) = (self.piece(), 2 * self.corrections);
        let columns = self.columns.chunks_mut(piece / BLOCK * width).enumerate();
        pool::map(
            self.threads,
            columns.collect(),
            |(i, columns): (usize, _)| {
                let blocks = <[[f32; BLOCK]]>::chunks_exact_mut(columns, width);
                for (b, columns) in blocks.enumerate() {
                    let start = i * piece + b * BLOCK;
                    let range = start..(start + BLOCK).min(self.size);
                    let [s, y] = [x, gradient].map(|v| v.map(|v| &v[range.clone()]));
                    differences(s, units[0], &mut columns[2 * place]);
                    differences(y, units[1], &mut columns[2 * place + 1]);
                }
            },
        );
        self.order.push(place);
        self.fresh = true;
        Ok(true)
    }

    /// Products of all columns, of those over what is free at x with this gradient, and with it.
    ///
    /// # Errors
    /// If a vector has another length.
    pub fn products(&mut self, x: &[f64], gradient: &[f64]) -> Result<Products> {
        self.check("x", &[x])?;
        self.check("gradient", &[gradient])?;
        let mut by_gradient = self.count(Some((x, gradient)));
        let columns = self.known();
        let width = 2 * self.corrections;
        let known = |matrix: &[f64]| {
            let rows = columns.iter().map(|i| &matrix[i * width..][..width]);
            rows.flat_map(|row| columns.iter().map(|&j| row[j]))
                .collect()
        };
        Ok(Products {
            all: known(&self.all),
            free: known(&self.free),
            gradient: by_gradient.pop().expect("its own square"),
            by_gradient,
        })
    }

    /// Writes p = clip(x + d) − x, where d = −(descent · g + Σ c_j w_j) on what is free at x and 0
    /// elsewhere; w_j are the columns, as in [`Products`]. Returns gᵀp.
    ///
    /// # Errors
    /// If a vector has another length.
    pub fn direction(
        &self,
        x: &[f64],
        gradient: &[f64],
        descent: f64,
        coefficients: &[f64],
        out: &mut [f64],
    ) -> Result<f64> {
        self.check("x", &[x])?;
        self.check("gradient", &[gradient])?;
        self.check("out", &[out])?;
        check::length("coefficients", 2 * self.order.len(), coefficients.len())?;
        let known = self.known();
        let factors = iter::zip(&known, coefficients);
        let factors: Vec<f64> = factors.map(|(&i, c)| c * self.units[i]).collect();
        let pieces = self.map_out(out, |range, out| {
            self.instructions.run(Direction {
                x: &x[range.clone()],
                gradient: &gradient[range.clone()],
                bounds: self.bounds_from(range.start),
                first: range.start,
                descent,
                columns: self.columns_of(&range),
                width: 2 * self.corrections,
                known: &known,
                factors: &factors,
                out,
            })
        });
        Ok(pieces.into_iter().sum())
    }

    /// Writes clip(x + length · p).
    ///
    /// # Errors
    /// If a vector has another length.
    pub fn moved(&self, x: &[f64], p: &[f64], length: f64, out: &mut [f64]) -> Result<()> {
        self.check("x", &[x])?;
        self.check("direction", &[p])?;
        self.check("out", &[out])?;
        self.map_out(out, |range, out| {
            let (x, p) = (&x[range.clone()], &p[range.clone()]);
            self.instructions.run(Moved {
                x,
                p,
                length,
                bounds: self.bounds_from(range.start),
                first: range.start,
                out,
            });
        });
        Ok(())
    }

    /// aᵀb
    ///
    /// # Errors
    /// If a vector has another length.
    pub fn dot(&self, a: &[f64], b: &[f64]) -> Result<f64> {
        self.check("a", &[a])?;
        self.check("b", &[b])?;
        let pieces = self.map(|range| {
            self.instructions.run(Dot {
                a: &a[range.clone()],
                b: &b[range],
            })
        });
        Ok(pieces.into_iter().sum())
    }

    fn check(&self, name: &'static str, vectors: &[&[f64]]) -> Result<()> {
        let mut lengths = vectors.iter().map(|v| v.len());
        lengths.try_for_each(|found| check::length(name, self.size, found))
    }

    /// The columns s₁ … s_k, y₁ … y_k.
    fn known(&self) -> Vec<usize> {
        let of = |part: usize| self.order.iter().map(move |place| 2 * place + part);
        of(0).chain(of(1)).collect()
    }

    /// Puts the products of the newest pair into `all` and `free`, and what has come free, or no
    /// longer is, into `free`. Returns products of the gradient with the known columns and with
    /// itself. Without a state the entries that are free stay the same.
    fn count(&mut self, state: Option<(&[f64], &[f64])>) -> Vec<f64> {
        let known = self.known();
        let k = self.order.len();
        let newest = self.fresh.then(|| [k - 1, 2 * k - 1]);
        let mut masks = std::mem::take(&mut self.masks);
        let piece = self.piece();
        let work = masks.chunks_mut(piece / BLOCK).enumerate().collect();
        let pieces = pool::map(self.threads, work, |(i, masks): (usize, &mut [Mask])| {
            let range = i * piece..(i * piece + piece).min(self.size);
            self.instructions.run(Count {
                state: state.map(|(x, g)| (&x[range.clone()], &g[range.clone()])),
                bounds: self.bounds_from(range.start),
                columns: self.columns_of(&range),
                width: 2 * self.corrections,
                known: &known,
                newest,
                masks,
                range,
            })
        });
        self.masks = masks;
        let mut counts = Counts::new(known.len());
        for of_piece in &pieces {
            counts.add(of_piece);
        }
        let width = 2 * self.corrections;
        let units: Vec<f64> = known.iter().map(|&i| self.units[i]).collect();
        for (i, &row) in known.iter().enumerate() {
            for (j, &column) in known.iter().enumerate().skip(i) {
                let change = counts.changes[i * known.len() + j] * units[i] * units[j];
                self.free[row * width + column] += change;
                self.free[column * width + row] = self.free[row * width + column];
            }
        }
        for (of_newest, &i) in newest.iter().flatten().enumerate() {
            for (j, &column) in known.iter().enumerate() {
                let unit = units[i] * units[j];
                let row = known[i];
                for (matrix, sums) in [
                    (&mut self.all, counts.rows[ALL + of_newest][j]),
                    (&mut self.free, counts.rows[FREE + of_newest][j]),
                ] {
                    matrix[row * width + column] = unit * sums;
                    matrix[column * width + row] = unit * sums;
                }
            }
        }
        self.fresh = false;
        let units = units.iter().chain([&1.0]);
        iter::zip(&counts.rows[GRADIENT], units)
            .map(|(sum, unit)| sum * unit)
            .collect()
    }

    /// Entries in a piece of work.
    fn piece(&self) -> usize {
        let blocks = self.size.div_ceil(BLOCK).div_ceil(MAX_PIECES);
        blocks.max(MIN_PIECE) * BLOCK
    }

    /// Of all pieces of work, in order.
    fn map<R: Send>(&self, f: impl Fn(Range<usize>) -> R + Send + Sync) -> Vec<R> {
        let piece = self.piece();
        let pieces = (0..self.size).step_by(piece).collect();
        pool::map(self.threads, pieces, |start: usize| {
            f(start..(start + piece).min(self.size))
        })
    }

    /// The same with each piece of a vector that is written.
    fn map_out<R: Send>(
        &self,
        out: &mut [f64],
        f: impl Fn(Range<usize>, &mut [f64]) -> R + Send + Sync,
    ) -> Vec<R> {
        let piece = self.piece();
        let pieces = out.chunks_mut(piece).enumerate().collect();
        pool::map(self.threads, pieces, |(i, out): (usize, &mut [f64])| {
            f(i * piece..i * piece + out.len(), out)
        })
    }

    /// Blocks of all columns.
    fn columns_of(&self, range: &Range<usize>) -> &[[f32; BLOCK]] {
        let width = 2 * self.corrections;
        &self.columns[range.start / BLOCK * width..range.end.div_ceil(BLOCK) * width]
    }

    /// Those that hold from an entry on.
    fn bounds_from(&self, first: usize) -> &[Bounds] {
        &self.bounds[self.bounds.partition_point(|b| b.end <= first)..]
    }
}

fn zeros<T: Copy>(count: usize, zero: T) -> Result<Vec<T>> {
    let mut made = Vec::new();
    let refused = |_| Error::Memory("pairs of steps and gradients");
    made.try_reserve_exact(count).map_err(refused)?;
    made.resize(count, zero);
    Ok(made)
}
