//! The vector kernels of an elimination, over one block of pixels each.

use crate::pixel::samples::Sums;
use crate::reflectance::planes::{BLOCK, Doubles};
use crate::reflectance::sh::COEFFICIENTS;
use crate::runtime::simd::{Isa, Kernel, Vectors};

/// Ridge on the unit diagonal of scaled matrices, and their least pivot: far below what data can
/// tell.
const RIDGE: f64 = 1e-12;

/// Numbers that are summed side by side.
pub(super) const LANES: usize = 8;

/// Sums by the coefficients of a light, in parts that add up.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Lanes(pub(super) [[f64; LANES]; COEFFICIENTS]);

/// Inverts the scaled and damped matrices' Cholesky factors: U = L⁻¹ D with L Lᵀ = D A D + damping.
pub(super) struct Whiten<'a, const U: usize> {
    pub(super) sums: &'a Sums<U>,
    /// D, the root of the inverse diagonal; 0 for what is held.
    pub(super) scale: &'a [Doubles; U],
    pub(super) damping: f64,
    pub(super) whiten: &'a mut [[Doubles; U]; U],
    pub(super) whitened: &'a mut [Doubles; U],
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
pub(super) struct FillRows<'a, const D: usize, const U: usize> {
    pub(super) own: [usize; D],
    pub(super) weighted: &'a [Doubles; D],
    pub(super) whiten: &'a [[Doubles; U]; U],
    pub(super) rows: &'a mut [Doubles; D],
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
    pub(super) fn all<I: Vectors<f64>>(self, isa: I) {
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
pub(super) struct FillDenseRows<'a, const D: usize> {
    pub(super) weights: &'a [Doubles],
    pub(super) rows: &'a [Doubles; D],
    pub(super) albedo: &'a mut [[f64; BLOCK]],
    /// Added to: lights that all channels have collect from all.
    pub(super) shared: &'a mut [[f64; BLOCK]],
}

impl<const D: usize> Kernel for FillDenseRows<'_, D> {
    type Output = ();

    #[inline(always)]
    fn run<I: Isa>(self, _: I) {
        for (k, weights) in self.weights.iter().enumerate() {
            for x in 0..BLOCK {
                self.albedo[k][x] = self.rows[0].0[x] * weights.0[x];
            }
            for (unknown, rows) in self.rows[1..].iter().enumerate() {
                for x in 0..BLOCK {
                    self.shared[(D - 1) * k + unknown][x] += rows.0[x] * weights.0[x];
                }
            }
        }
    }
}

/// Adds R times the values of one sample.
pub(super) struct AddRows<'a, const D: usize, const U: usize> {
    pub(super) own: [usize; D],
    pub(super) rows: &'a [Doubles; D],
    pub(super) values: &'a Doubles,
    pub(super) sums: &'a mut [Doubles; U],
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
pub(super) struct SubtractRows<'a, const D: usize, const U: usize> {
    pub(super) own: [usize; D],
    pub(super) rows: &'a [Doubles; D],
    pub(super) whitened: &'a [Doubles; U],
    pub(super) left: &'a mut Doubles,
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
pub(super) struct Collect<'a> {
    pub(super) weights: &'a [Doubles; COEFFICIENTS],
    pub(super) values: &'a Doubles,
    pub(super) sums: &'a mut Lanes,
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
