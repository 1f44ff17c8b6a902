//! The vector work of a bounded L-BFGS, for more unknowns than fit small caches.
//!
//! The method itself is in `python/pbrfit/projected_lbfgs.py`: it deals in matrices of a few dozen
//! rows. Here is what touches vectors: kept pairs of steps s and changes of the gradient y, their
//! products, and sums of them. Pairs are kept in float32, which costs no iterations: a loss in
//! float32 does not know its gradient any better. All sums are float64, over fixed pieces in order,
//! so that every bit is the same at any number of threads.

use std::iter;
use std::ops::Range;

use crate::simd::{Ahead, Instructions, Isa, Kernel, Vectors};
use crate::{Error, Result, check, pool};

/// Entries that a kernel handles at once, and that lie side by side in a column.
const BLOCK: usize = 128;
/// At most so many pieces of work. Their borders depend on the length alone.
const MAX_PIECES: usize = 64;
/// Blocks in a piece of work at least: a piece has a cost of its own.
const MIN_PIECE: usize = 16;
/// Sums are kept in so many parts, which the compiler can put into vector registers.
const PARTS: usize = 8;
/// More pairs would take longer than an evaluation.
const MAX_CORRECTIONS: usize = 64;

/// Numbers of a block.
type Numbers = [f64; BLOCK];
/// A bit for each entry of a block.
type Mask = u128;

/// Equal bounds of consecutive entries.
#[derive(Clone, Copy, Debug)]
struct Bounds {
    end: usize,
    lower: f64,
    upper: f64,
}

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
        check::length("lower", ends.len(), lower.len())?;
        check::length("upper", ends.len(), upper.len())?;
        let before = iter::once(&0).chain(ends);
        if let Some((a, b)) = before.zip(ends).find(|(a, b)| a >= b) {
            let found = format!("{b} after {a}");
            return Err(Error::argument("ends", "rising numbers above 0", found));
        }
        let &size = ends
            .last()
            .ok_or_else(|| Error::argument("ends", "at least one", 0))?;
        if !(1..=MAX_CORRECTIONS).contains(&corrections) {
            let expected = format!("1 to {MAX_CORRECTIONS} pairs");
            return Err(Error::argument("corrections", expected, corrections));
        }
        let bounds = iter::zip(ends, iter::zip(lower, upper));
        let bounds = bounds.map(|(&end, (&lower, &upper))| Bounds { end, lower, upper });
        let bounds: Vec<_> = bounds.collect();
        // Written so that NaN fails.
        let possible = |b: &Bounds| {
            b.lower <= b.upper && b.lower < f64::INFINITY && b.upper > f64::NEG_INFINITY
        };
        if let Some(crossed) = bounds.iter().find(|b| !possible(b)) {
            let found = format!("{} to {}", crossed.lower, crossed.upper);
            return Err(Error::argument("bounds", "from lower to upper", found));
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
    pub fn forget(&mut self) {
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
    pub fn learn(&mut self, x: [&[f64]; 2], gradient: [&[f64]; 2]) -> Result<bool> {
        self.check("x", &x)?;
        self.check("gradient", &gradient)?;
        if self.fresh {
            self.count(None);
        }
        let [mut ss, mut sy, mut yy] = [0.0; 3];
        for [a, b, c] in self.map(|range| {
            let [x, new_x] = x.map(|v| &v[range.clone()]);
            let [g, new_g] = gradient.map(|v| &v[range.clone()]);
            self.instructions.run(Squares { x, new_x, g, new_g })
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
        let units = [ss, yy].map(|squares| (squares / self.size as f64).sqrt());
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

/// The bounds of one block after the other.
struct BlockBounds<'a> {
    left: &'a [Bounds],
    lower: Numbers,
    upper: Numbers,
    /// Those that fill both arrays.
    filled: (f64, f64),
}

impl<'a> BlockBounds<'a> {
    #[inline(always)]
    fn new(left: &'a [Bounds]) -> Self {
        Self {
            left,
            lower: [0.0; BLOCK],
            upper: [0.0; BLOCK],
            filled: (f64::NAN, f64::NAN),
        }
    }

    /// Fills both arrays for the entries from `first` on.
    #[inline(always)]
    fn fill(&mut self, first: usize, count: usize) {
        let mut done = 0;
        while done < count {
            let here = self.left[0];
            let until = (here.end - first).min(count);
            let whole = until - done == BLOCK;
            if !(whole && self.filled == (here.lower, here.upper)) {
                self.lower[done..until].fill(here.lower);
                self.upper[done..until].fill(here.upper);
                self.filled = if whole {
                    (here.lower, here.upper)
                } else {
                    (f64::NAN, f64::NAN)
                };
            }
            done = until;
            if here.end == first + until {
                self.left = &self.left[1..];
            }
        }
    }
}

/// Whether an entry may move: it is inside its bounds, or the gradient pulls it inwards.
#[inline(always)]
fn is_free(x: f64, gradient: f64, lower: f64, upper: f64) -> bool {
    !((x <= lower) & (gradient >= 0.0) | (x >= upper) & (gradient <= 0.0))
}

/// [sᵀs, sᵀy, yᵀy]
struct Squares<'a> {
    x: &'a [f64],
    new_x: &'a [f64],
    g: &'a [f64],
    new_g: &'a [f64],
}

impl Kernel for Squares<'_> {
    type Output = [f64; 3];

    #[inline(always)]
    fn run<I: Isa>(self, _isa: I) -> [f64; 3] {
        let mut sums = [[0.0; PARTS]; 3];
        let (x, x_left) = self.x.as_chunks::<PARTS>();
        let (new_x, new_x_left) = self.new_x.as_chunks::<PARTS>();
        let (g, g_left) = self.g.as_chunks::<PARTS>();
        let (new_g, new_g_left) = self.new_g.as_chunks::<PARTS>();
        let mut add = |i: usize, s: f64, y: f64| {
            sums[0][i] += s * s;
            sums[1][i] += s * y;
            sums[2][i] += y * y;
        };
        for (((x, new_x), g), new_g) in x.iter().zip(new_x).zip(g).zip(new_g) {
            for i in 0..PARTS {
                add(i, new_x[i] - x[i], new_g[i] - g[i]);
            }
        }
        for i in 0..x_left.len() {
            add(i, new_x_left[i] - x_left[i], new_g_left[i] - g_left[i]);
        }
        sums.map(|parts| parts.iter().sum())
    }
}

/// (new − old) / unit, rounded.
fn differences([old, new]: [&[f64]; 2], unit: f64, out: &mut [f32]) {
    // A vector of zeros has no unit.
    let factor = if unit > 0.0 { unit.recip() } else { 0.0 };
    for ((out, old), new) in out.iter_mut().zip(old).zip(new) {
        *out = ((new - old) * factor) as f32;
    }
}

struct Dot<'a> {
    a: &'a [f64],
    b: &'a [f64],
}

impl Kernel for Dot<'_> {
    type Output = f64;

    #[inline(always)]
    fn run<I: Isa>(self, _isa: I) -> f64 {
        let (a, a_left) = self.a.as_chunks::<PARTS>();
        let (b, b_left) = self.b.as_chunks::<PARTS>();
        let mut parts = [0.0; PARTS];
        for (a, b) in a.iter().zip(b) {
            for i in 0..PARTS {
                parts[i] += a[i] * b[i];
            }
        }
        let left = iter::zip(a_left, b_left).map(|(a, b)| a * b);
        parts.iter().sum::<f64>() + left.sum::<f64>()
    }
}

struct Moved<'a> {
    x: &'a [f64],
    p: &'a [f64],
    length: f64,
    bounds: &'a [Bounds],
    first: usize,
    out: &'a mut [f64],
}

impl Kernel for Moved<'_> {
    type Output = ();

    #[inline(always)]
    fn run<I: Isa>(self, _isa: I) {
        let mut bounds = BlockBounds::new(self.bounds);
        for (b, out) in self.out.chunks_mut(BLOCK).enumerate() {
            let (start, count) = (b * BLOCK, out.len());
            bounds.fill(self.first + start, count);
            let (x, p) = (&self.x[start..][..count], &self.p[start..][..count]);
            let (lower, upper) = (&bounds.lower[..count], &bounds.upper[..count]);
            for i in 0..count {
                out[i] = (x[i] + self.length * p[i]).max(lower[i]).min(upper[i]);
            }
        }
    }
}

struct Direction<'a> {
    x: &'a [f64],
    gradient: &'a [f64],
    bounds: &'a [Bounds],
    first: usize,
    descent: f64,
    columns: &'a [[f32; BLOCK]],
    width: usize,
    known: &'a [usize],
    factors: &'a [f64],
    out: &'a mut [f64],
}

impl Kernel for Direction<'_> {
    type Output = f64;

    #[inline(always)]
    fn run<I: Isa>(self, isa: I) -> f64 {
        let mut bounds = BlockBounds::new(self.bounds);
        let mut slope = 0.0;
        let blocks = self.columns.chunks_exact(self.width);
        let mut ahead = Ahead::default();
        ahead.push(self.columns);
        ahead.step(2 * self.width * 8);
        for ((b, out), columns) in self.out.chunks_mut(BLOCK).enumerate().zip(blocks) {
            let start = b * BLOCK;
            bounds.fill(self.first + start, out.len());
            let x = padded(&self.x[start..][..out.len()]);
            let g = padded(&self.gradient[start..][..out.len()]);
            let mut d = g.map(|g| self.descent * g);
            // Several at a time: d is read and written less often.
            let (known, known_left) = self.known.as_chunks::<4>();
            let (factors, factors_left) = self.factors.as_chunks::<4>();
            for (known, f) in known.iter().zip(factors) {
                ahead.step(4 * 8);
                let w = known.map(|i| &columns[i]);
                for i in 0..BLOCK {
                    let [a, b, c, e] = w.map(|w| f64::from(w[i]));
                    d[i] += (f[0] * a + f[1] * b) + (f[2] * c + f[3] * e);
                }
            }
            for (&known, factor) in known_left.iter().zip(factors_left) {
                for i in 0..BLOCK {
                    d[i] += factor * f64::from(columns[known][i]);
                }
            }
            let mut p = [0.0; BLOCK];
            for i in 0..BLOCK {
                let (lower, upper) = (bounds.lower[i], bounds.upper[i]);
                let target = (x[i] - d[i]).max(lower).min(upper);
                let free = is_free(x[i], g[i], lower, upper);
                p[i] = if free { target - x[i] } else { 0.0 };
            }
            slope += Dot { a: &g, b: &p }.run(isa);
            out.copy_from_slice(&p[..out.len()]);
        }
        slope
    }
}

/// Rows of [`Counts`]: the newest s and y over what is free, the gradient over it, the newest over
/// all.
const FREE: usize = 0;
const GRADIENT: usize = 2;
const ALL: usize = 3;
const ROWS: usize = 5;

/// Sums of products, without units, of the known columns.
struct Counts {
    /// Each with the known columns and, at the end, with the gradient over what is free.
    rows: [Vec<f64>; ROWS],
    /// Of columns with each other, over what has come free, less what no longer is; without the
    /// newest: (known, known), the upper triangle.
    changes: Vec<f64>,
}

impl Counts {
    fn new(known: usize) -> Self {
        Self {
            rows: std::array::from_fn(|_| vec![0.0; known + 1]),
            changes: vec![0.0; known * known],
        }
    }

    fn add(&mut self, other: &Self) {
        let rows = self.rows.iter_mut().zip(&other.rows);
        let all = rows.chain([(&mut self.changes, &other.changes)]);
        for (total, partial) in all.flat_map(|(a, b)| a.iter_mut().zip(b)) {
            *total += partial;
        }
    }
}

struct Count<'a> {
    state: Option<(&'a [f64], &'a [f64])>,
    bounds: &'a [Bounds],
    columns: &'a [[f32; BLOCK]],
    width: usize,
    known: &'a [usize],
    newest: Option<[usize; 2]>,
    masks: &'a mut [Mask],
    range: Range<usize>,
}

impl Kernel for Count<'_> {
    type Output = Counts;

    #[inline(always)]
    fn run<I: Isa>(self, isa: I) -> Counts {
        let lanes = <I as Vectors<f64>>::LANES;
        let known = self.known.len();
        let mut counts = Counts::new(known);
        let mut sums = vec![0.0; (known + 1) * ROWS * lanes];
        let mut bounds = BlockBounds::new(self.bounds);
        let mut rows = [[0.0; BLOCK]; ROWS];
        let mut entries = vec![0.0; known];
        let blocks = self.columns.chunks_exact(self.width);
        let mut ahead = Ahead::default();
        ahead.push(self.columns);
        ahead.step(2 * self.width * 8);
        for ((b, mask), columns) in self.masks.iter_mut().enumerate().zip(blocks) {
            let start = b * BLOCK;
            let count = BLOCK.min(self.range.len() - start);
            let mut free = *mask;
            if let Some((x, g)) = self.state {
                bounds.fill(self.range.start + start, count);
                rows[GRADIENT] = padded(&g[start..][..count]);
                let x = padded(&x[start..][..count]);
                free = free_of(&x, &rows[GRADIENT], &bounds, count);
            }
            let mut changed = free ^ *mask;
            while changed != 0 {
                let i = changed.trailing_zeros() as usize;
                changed &= changed - 1;
                let sign = if free >> i & 1 == 1 { 1.0 } else { -1.0 };
                for (entry, &column) in entries.iter_mut().zip(self.known) {
                    *entry = f64::from(columns[column][i]);
                }
                for &newest in self.newest.iter().flatten() {
                    entries[newest] = 0.0;
                }
                for (row, &entry) in entries.iter().enumerate() {
                    let entry = sign * entry;
                    let changes = &mut counts.changes[row * known..][row..known];
                    for (change, other) in changes.iter_mut().zip(&entries[row..]) {
                        *change += entry * other;
                    }
                }
            }
            *mask = free;

            for (row, &newest) in self.newest.iter().flatten().enumerate() {
                rows[ALL + row] = columns[self.known[newest]].map(f64::from);
                rows[FREE + row] = rows[ALL + row];
            }
            if free != Mask::MAX {
                for i in 0..BLOCK {
                    let factor = if free >> i & 1 == 1 { 1.0 } else { 0.0 };
                    for row in &mut rows[..ALL] {
                        row[i] *= factor;
                    }
                }
            }
            for (j, sums) in sums.chunks_exact_mut(ROWS * lanes).enumerate() {
                ahead.step(8);
                let column = match self.known.get(j) {
                    Some(&column) => columns[column].map(f64::from),
                    None => rows[GRADIENT],
                };
                add_products(isa, &rows, &column, sums);
            }
        }
        for (j, sums) in sums.chunks_exact(ROWS * lanes).enumerate() {
            for (row, parts) in counts.rows.iter_mut().zip(sums.chunks_exact(lanes)) {
                row[j] = parts.iter().sum();
            }
        }
        counts
    }
}

/// Adds the products of each row with a column, lane by lane.
#[inline(always)]
fn add_products<I: Isa>(isa: I, rows: &[Numbers; ROWS], column: &Numbers, sums: &mut [f64]) {
    let sums = <I as Vectors<f64>>::of_mut(sums);
    let column = <I as Vectors<f64>>::of(column);
    let rows: [_; ROWS] =
        std::array::from_fn(|r| &<I as Vectors<f64>>::of(&rows[r])[..column.len()]);
    let mut t: [_; ROWS] = std::array::from_fn(|r| sums[r]);
    for (v, &value) in column.iter().enumerate() {
        for r in 0..ROWS {
            t[r] = Vectors::<f64>::mul_add(isa, rows[r][v], value, t[r]);
        }
    }
    sums.copy_from_slice(&t);
}

/// The numbers, and zeros up to a whole block.
#[inline(always)]
fn padded(values: &[f64]) -> Numbers {
    let mut block = [0.0; BLOCK];
    block[..values.len()].copy_from_slice(values);
    block
}

/// Which of the first `count` entries of a block are free.
#[inline(always)]
fn free_of(x: &Numbers, gradient: &Numbers, bounds: &BlockBounds, count: usize) -> Mask {
    let mut free = [0; BLOCK];
    for i in 0..BLOCK {
        let (lower, upper) = (bounds.lower[i], bounds.upper[i]);
        free[i] = u8::from(is_free(x[i], gradient[i], lower, upper));
    }
    free[count..].fill(0);
    // Eight bytes of 0 or 1 are gathered into the top byte: each is moved to its own bit.
    let bytes =
        free.as_chunks::<8>().0.iter().map(|&eight| {
            (u64::from_le_bytes(eight).wrapping_mul(0x0102_0408_1020_4080) >> 56) as u8
        });
    bytes
        .rev()
        .fold(0, |mask, byte| mask << 8 | Mask::from(byte))
}
