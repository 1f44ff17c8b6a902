//! The vector work of a bounded L-BFGS, for more unknowns than fit small caches.
//!
//! The method itself is in `python/pbrfit/projected_lbfgs.py`: it deals in matrices of a few dozen
//! rows. Here is what touches vectors: kept pairs of steps s and changes of the gradient y, their
//! products, and sums of them. Pairs are kept in float32, which costs no iterations: a loss in
//! float32 does not know its gradient any better. All sums are float64, over fixed pieces in order,
//! so that every bit is the same at any number of threads.

use std::iter;
use std::ops::Range;

use crate::simd::{Instructions, Isa, Kernel, Vectors};
use crate::{Error, Result, check, pool};

/// Entries that a kernel handles at once: all pairs' fit the second cache, and some the first.
const BLOCK: usize = 128;
/// At most so many pieces of work. Their borders depend on the length alone.
const MAX_PIECES: usize = 64;
/// Entries in a piece of work at least, in blocks: a piece has a cost of its own.
const MIN_PIECE: usize = 16;
/// Sums are kept in so many parts, which the compiler can put into vector registers.
const PARTS: usize = 8;
/// Rows and columns of a tile of a Gram matrix, whose sums stay in registers.
const TILE: (usize, usize) = (2, 4);
/// More pairs would take longer than an evaluation.
const MAX_CORRECTIONS: usize = 64;

/// Equal bounds of consecutive entries.
#[derive(Clone, Copy, Debug)]
struct Bounds {
    end: usize,
    lower: f64,
    upper: f64,
}

/// A vector in float32: its entries are `unit` times `values`.
#[derive(Clone, Debug, Default)]
struct Column {
    unit: f64,
    values: Vec<f32>,
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
    /// Pairs (s, y). Where there are more than `corrections`, the last place is the oldest's.
    pairs: Vec<[Column; 2]>,
    /// Places of the pairs that are known, the oldest first.
    order: Vec<usize>,
    /// Products of columns over all entries, by place: s of place i is 2i, y is 2i + 1.
    all: Vec<f64>,
    /// Whether the newest pair is not in `all` yet.
    fresh: bool,
}

impl Lbfgs {
    /// With no pairs yet. `lower` and `upper` may be infinite; at most `corrections` pairs are
    /// kept.
    ///
    /// # Errors
    /// If bounds are crossed or NaN, there are none, or `corrections` is not 1 to 64.
    pub fn new(lower: &[f64], upper: &[f64], corrections: usize, threads: usize) -> Result<Self> {
        if lower.is_empty() {
            return Err(Error::argument("lower", "at least one number", 0));
        }
        check::length("upper", lower.len(), upper.len())?;
        if !(1..=MAX_CORRECTIONS).contains(&corrections) {
            let expected = format!("1 to {MAX_CORRECTIONS} pairs");
            return Err(Error::argument("corrections", expected, corrections));
        }
        let mut bounds: Vec<Bounds> = Vec::new();
        for (i, (&lower, &upper)) in lower.iter().zip(upper).enumerate() {
            // Written so that NaN fails.
            let possible = lower <= upper && lower < f64::INFINITY && upper > f64::NEG_INFINITY;
            if !possible {
                let found = format!("{lower} and {upper} at {i}");
                return Err(Error::argument("lower", "at most upper", found));
            }
            match bounds.last_mut() {
                Some(last) if (last.lower, last.upper) == (lower, upper) => last.end = i + 1,
                _ => bounds.push(Bounds {
                    end: i + 1,
                    lower,
                    upper,
                }),
            }
        }
        Ok(Self {
            size: lower.len(),
            bounds,
            corrections,
            threads,
            instructions: Instructions::best(),
            pairs: Vec::new(),
            order: Vec::new(),
            all: vec![0.0; (2 * corrections).pow(2)],
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
    /// A pair is good if sᵀy > ε yᵀy: that keeps the matrix positive definite. Others are not
    /// taken, and false is returned.
    ///
    /// # Errors
    /// If a vector has another length, or there is no memory for one more pair.
    pub fn learn(&mut self, x: [&[f64]; 2], gradient: [&[f64]; 2]) -> Result<bool> {
        self.check("x", &x)?;
        self.check("gradient", &gradient)?;
        if self.fresh {
            self.gram(None);
        }
        let [mut ss, mut sy, mut yy] = [0.0; 3];
        for [a, b, c] in self.map(|_, range| {
            let [x, new_x] = x.map(|v| &v[range.clone()]);
            let [g, new_g] = gradient.map(|v| &v[range.clone()]);
            self.instructions.run(Squares { x, new_x, g, new_g })
        }) {
            ss += a;
            sy += b;
            yy += c;
        }
        // Written so that NaN fails.
        let good = sy > f64::EPSILON * yy && ss.is_finite() && yy.is_finite();
        if !good {
            return Ok(false);
        }
        // In this unit entries are near 1, far from where float32 ends.
        let unit = |squares: f64| (squares / self.size as f64).sqrt();
        let units = [unit(ss), unit(yy)];
        let place = if self.order.len() == self.corrections {
            self.order.remove(0)
        } else {
            let known = self.order.len();
            (0..known)
                .find(|i| !self.order.contains(i))
                .unwrap_or(known)
        };
        if place == self.pairs.len() {
            self.pairs.push(self.new_pair()?);
        }
        let piece = self.piece();
        let [s, y] = &mut self.pairs[place];
        (s.unit, y.unit) = (units[0], units[1]);
        let pieces = s.values.chunks_mut(piece).zip(y.values.chunks_mut(piece));
        let work = pieces.enumerate().collect();
        pool::map(self.threads, work, |(i, (s, y)): (usize, _)| {
            let range = i * piece..i * piece + <[f32]>::len(s);
            differences(x.map(|v| &v[range.clone()]), units[0], s);
            differences(gradient.map(|v| &v[range.clone()]), units[1], y);
        });
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
        let gram = self.gram(Some((x, gradient)));
        let columns: Vec<usize> = self.places().collect();
        let (count, width) = (columns.len(), columns.len() + 1);
        let side = 2 * self.corrections;
        let pairs = || (0..count).flat_map(|i| (0..count).map(move |j| (i, j)));
        Ok(Products {
            all: pairs()
                .map(|(i, j)| self.all[columns[i] * side + columns[j]])
                .collect(),
            free: pairs().map(|(i, j)| gram[i * width + j]).collect(),
            by_gradient: (0..count).map(|i| gram[i * width + count]).collect(),
            gradient: gram[count * width + count],
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
        let columns = self.columns();
        let factors = columns.iter().zip(coefficients);
        let factors: Vec<f64> = factors.map(|(column, c)| c * column.unit).collect();
        let pieces = self.map_out(out, |_, range, out| {
            self.instructions.run(Direction {
                x: &x[range.clone()],
                gradient: &gradient[range.clone()],
                bounds: self.bounds_from(range.start),
                first: range.start,
                descent,
                columns: columns.iter().map(|c| &c.values[range.clone()]).collect(),
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
        self.map_out(out, |_, range, out| {
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
        let pieces = self.map(|_, range| {
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

    fn new_pair(&self) -> Result<[Column; 2]> {
        let mut pair = [Column::default(), Column::default()];
        for column in &mut pair {
            let values = &mut column.values;
            let refused = |_| Error::Memory("pairs of steps and gradients");
            values.try_reserve_exact(self.size).map_err(refused)?;
            values.resize(self.size, 0.0);
        }
        Ok(pair)
    }

    /// Rows of `all` that belong to the columns s₁ … s_k, y₁ … y_k.
    fn places(&self) -> impl Iterator<Item = usize> {
        let of = |part: usize| self.order.iter().map(move |place| 2 * place + part);
        of(0).chain(of(1))
    }

    fn columns(&self) -> Vec<&Column> {
        let columns = self.places().map(|i| &self.pairs[i / 2][i % 2]);
        columns.collect()
    }

    /// Gram matrix of the columns and the gradient over what is free, or without them over
    /// nothing; and the newest pair's products, if they are missing, are put into `all`.
    fn gram(&mut self, state: Option<(&[f64], &[f64])>) -> Vec<f64> {
        let columns = self.columns();
        let width = columns.len() + 1;
        let newest = self.fresh.then(|| [width / 2 - 1, width - 2]);
        let pieces = self.map(|_, range| {
            self.instructions.run(Gram {
                state: state.map(|(x, g)| (&x[range.clone()], &g[range.clone()])),
                bounds: self.bounds_from(range.start),
                columns: columns.iter().map(|c| &c.values[range.clone()]).collect(),
                newest,
                range,
            })
        });
        let mut gram = vec![0.0; width * width];
        let mut rows = vec![0.0; 2 * width];
        for (of_gram, of_rows) in &pieces {
            add(&mut gram, of_gram);
            add(&mut rows, of_rows);
        }
        let units: Vec<f64> = columns.iter().map(|c| c.unit).chain([1.0]).collect();
        for i in 0..width {
            for j in i..width {
                gram[i * width + j] *= units[i] * units[j];
                gram[j * width + i] = gram[i * width + j];
            }
        }
        if let Some(newest) = newest {
            let places: Vec<usize> = self.places().collect();
            let side = 2 * self.corrections;
            for (row, &i) in newest.iter().enumerate() {
                for j in 0..width - 1 {
                    let product = rows[row * width + j] * units[i] * units[j];
                    self.all[places[i] * side + places[j]] = product;
                    self.all[places[j] * side + places[i]] = product;
                }
            }
            self.fresh = false;
        }
        gram
    }

    fn piece(&self) -> usize {
        let blocks = self.size.div_ceil(BLOCK).div_ceil(MAX_PIECES);
        blocks.max(MIN_PIECE) * BLOCK
    }

    /// Of all pieces of work, in order.
    fn map<R: Send>(&self, f: impl Fn(usize, Range<usize>) -> R + Send + Sync) -> Vec<R> {
        let piece = self.piece();
        let pieces = (0..self.size.div_ceil(piece)).collect();
        pool::map(self.threads, pieces, |i: usize| {
            f(i, i * piece..(i * piece + piece).min(self.size))
        })
    }

    /// The same with each piece of a vector that is written.
    fn map_out<R: Send>(
        &self,
        out: &mut [f64],
        f: impl Fn(usize, Range<usize>, &mut [f64]) -> R + Send + Sync,
    ) -> Vec<R> {
        let piece = self.piece();
        let pieces = out.chunks_mut(piece).enumerate().collect();
        pool::map(self.threads, pieces, |(i, out): (usize, &mut [f64])| {
            f(i, i * piece..i * piece + out.len(), out)
        })
    }

    /// Those that hold from an entry on.
    fn bounds_from(&self, first: usize) -> &[Bounds] {
        &self.bounds[self.bounds.partition_point(|b| b.end <= first)..]
    }
}

fn add(total: &mut [f64], partial: &[f64]) {
    for (t, p) in total.iter_mut().zip(partial) {
        *t += p;
    }
}

/// The bounds of one block after the other.
struct BlockBounds<'a> {
    left: &'a [Bounds],
    lower: [f64; BLOCK],
    upper: [f64; BLOCK],
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
    columns: Vec<&'a [f32]>,
    factors: &'a [f64],
    out: &'a mut [f64],
}

impl Kernel for Direction<'_> {
    type Output = f64;

    #[inline(always)]
    fn run<I: Isa>(self, _isa: I) -> f64 {
        let mut bounds = BlockBounds::new(self.bounds);
        let mut slope = [0.0; PARTS];
        let mut d = [0.0; BLOCK];
        for (b, out) in self.out.chunks_mut(BLOCK).enumerate() {
            let (start, count) = (b * BLOCK, out.len());
            bounds.fill(self.first + start, count);
            let x = &self.x[start..][..count];
            let g = &self.gradient[start..][..count];
            for (d, g) in d.iter_mut().zip(g) {
                *d = self.descent * g;
            }
            for (column, factor) in self.columns.iter().zip(self.factors) {
                for (d, &value) in d.iter_mut().zip(&column[start..][..count]) {
                    *d += factor * f64::from(value);
                }
            }
            let (lower, upper) = (&bounds.lower[..count], &bounds.upper[..count]);
            for i in 0..count {
                let target = (x[i] - d[i]).max(lower[i]).min(upper[i]);
                let free = is_free(x[i], g[i], lower[i], upper[i]);
                out[i] = if free { target - x[i] } else { 0.0 };
            }
            for i in 0..count {
                slope[i % PARTS] += g[i] * out[i];
            }
        }
        slope.iter().sum()
    }
}

/// Gram matrix of the masked columns and gradient, its upper triangle, without units; and products
/// of the newest pair with all columns, unmasked: (2, width).
struct Gram<'a> {
    state: Option<(&'a [f64], &'a [f64])>,
    bounds: &'a [Bounds],
    columns: Vec<&'a [f32]>,
    newest: Option<[usize; 2]>,
    range: Range<usize>,
}

impl Kernel for Gram<'_> {
    type Output = (Vec<f64>, Vec<f64>);

    #[inline(always)]
    fn run<I: Isa>(self, isa: I) -> (Vec<f64>, Vec<f64>) {
        let width = self.columns.len() + 1;
        // Whole tiles: what is too much stays 0.
        let mut block = vec![[0.0; BLOCK]; width.next_multiple_of(TILE.1)];
        let mut tiles = Tiles::new::<I>(width);
        let mut rows = vec![0.0; 2 * width];
        let mut bounds = BlockBounds::new(self.bounds);
        for start in (0..self.range.len()).step_by(BLOCK) {
            let count = BLOCK.min(self.range.len() - start);
            for (of_block, column) in block.iter_mut().zip(&self.columns) {
                let (values, rest) = of_block.split_at_mut(count);
                for (to, &value) in values.iter_mut().zip(&column[start..][..count]) {
                    *to = f64::from(value);
                }
                rest.fill(0.0);
            }
            for (row, &newest) in self.newest.iter().flatten().enumerate() {
                for j in 0..width - 1 {
                    rows[row * width + j] += Dot {
                        a: &block[newest],
                        b: &block[j],
                    }
                    .run(isa);
                }
            }
            let Some((x, gradient)) = self.state else {
                continue;
            };
            bounds.fill(self.range.start + start, count);
            let (x, g) = (&x[start..][..count], &gradient[start..][..count]);
            let (lower, upper) = (&bounds.lower[..count], &bounds.upper[..count]);
            let mut free = [0.0; BLOCK];
            for i in 0..count {
                let is_free = is_free(x[i], g[i], lower[i], upper[i]);
                free[i] = if is_free { 1.0 } else { 0.0 };
            }
            block[width - 1][..count].copy_from_slice(g);
            block[width - 1][count..].fill(0.0);
            for column in &mut block[..width] {
                for (value, free) in column.iter_mut().zip(&free) {
                    *value *= free;
                }
            }
            tiles.add(isa, &block);
        }
        (tiles.sums::<I>(width), rows)
    }
}

/// Sums of a Gram matrix in tiles, each in as many parts as a vector register has lanes.
struct Tiles {
    /// Row and column of the first entry of each tile that is not wholly below the diagonal.
    corners: Vec<(usize, usize)>,
    /// (tile, row, column, lane)
    sums: Vec<f64>,
}

impl Tiles {
    #[inline(always)]
    fn new<I: Isa>(width: usize) -> Self {
        let rows = (0..width).step_by(TILE.0);
        let corners: Vec<_> = rows
            .flat_map(|i| {
                let first = i - i % TILE.1;
                (first..width).step_by(TILE.1).map(move |j| (i, j))
            })
            .collect();
        let lanes = <I as Vectors<f64>>::LANES;
        let sums = vec![0.0; corners.len() * TILE.0 * TILE.1 * lanes];
        Self { corners, sums }
    }

    #[inline(always)]
    fn add<I: Isa>(&mut self, isa: I, block: &[[f64; BLOCK]]) {
        let sums = <I as Vectors<f64>>::of_mut(&mut self.sums)
            .as_chunks_mut::<8>()
            .0;
        for (&(i, j), sums) in self.corners.iter().zip(sums) {
            let column = |k: usize| <I as Vectors<f64>>::of(&block[k]);
            let a = [column(i), column(i + 1)];
            let b = [column(j), column(j + 1), column(j + 2), column(j + 3)];
            let lengths = BLOCK / <I as Vectors<f64>>::LANES;
            let (a, b) = (a.map(|v| &v[..lengths]), b.map(|v| &v[..lengths]));
            let mut t = *sums;
            for v in 0..lengths {
                for row in 0..TILE.0 {
                    for column in 0..TILE.1 {
                        let sum = &mut t[row * TILE.1 + column];
                        *sum = Vectors::<f64>::mul_add(isa, a[row][v], b[column][v], *sum);
                    }
                }
            }
            *sums = t;
        }
    }

    /// (width, width), the upper triangle.
    #[inline(always)]
    fn sums<I: Isa>(&self, width: usize) -> Vec<f64> {
        let lanes = <I as Vectors<f64>>::LANES;
        let mut gram = vec![0.0; width * width];
        let tiles = self.sums.chunks_exact(TILE.0 * TILE.1 * lanes);
        for (&(i, j), tile) in self.corners.iter().zip(tiles) {
            for (entry, parts) in tile.chunks_exact(lanes).enumerate() {
                let (i, j) = (i + entry / TILE.1, j + entry % TILE.1);
                if i <= j && j < width {
                    gram[i * width + j] = parts.iter().sum();
                }
            }
        }
        gram
    }
}
