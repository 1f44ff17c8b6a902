//! Kernels over vectors: sums of products, and steps.

use std::iter;

use super::bounds::{BlockBounds, Bounds, is_free};
use super::{BLOCK, LINES, Numbers};
use crate::runtime::simd::{Ahead, Isa, Kernel};

/// Sums are kept in so many parts, which the compiler can put into vector registers.
const PARTS: usize = 8;

/// The numbers, and zeros up to a whole block.
#[inline(always)]
pub(super) fn padded(values: &[f64]) -> Numbers {
    let mut block = [0.0; BLOCK];
    block[..values.len()].copy_from_slice(values);
    block
}

/// [sᵀs, sᵀy, yᵀy]
pub(super) struct PairProducts<'a> {
    pub(super) x: &'a [f64],
    pub(super) new_x: &'a [f64],
    pub(super) g: &'a [f64],
    pub(super) new_g: &'a [f64],
}

impl Kernel for PairProducts<'_> {
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
pub(super) fn differences([old, new]: [&[f64]; 2], unit: f64, out: &mut [f32]) {
    // A vector of zeros has no unit.
    let factor = if unit > 0.0 { unit.recip() } else { 0.0 };
    for ((out, old), new) in out.iter_mut().zip(old).zip(new) {
        *out = ((new - old) * factor) as f32;
    }
}

pub(super) struct Dot<'a> {
    pub(super) a: &'a [f64],
    pub(super) b: &'a [f64],
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

pub(super) struct Moved<'a> {
    pub(super) x: &'a [f64],
    pub(super) p: &'a [f64],
    pub(super) length: f64,
    pub(super) bounds: &'a [Bounds],
    pub(super) first: usize,
    pub(super) out: &'a mut [f64],
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

pub(super) struct Direction<'a> {
    pub(super) x: &'a [f64],
    pub(super) gradient: &'a [f64],
    pub(super) bounds: &'a [Bounds],
    pub(super) first: usize,
    pub(super) descent: f64,
    pub(super) columns: &'a [[f32; BLOCK]],
    pub(super) width: usize,
    pub(super) known: &'a [usize],
    pub(super) factors: &'a [f64],
    pub(super) out: &'a mut [f64],
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
        ahead.step(2 * self.width * LINES);
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
                ahead.step(4 * LINES);
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
