//! The damped normal equations of one pixel.
//!
//! Channels have nothing to do with each other but for roughness, metallic and the tangent offsets of
//! a free normal, so the matrix is an arrowhead: its albedo part is diagonal, and what is left to be
//! factorised is two by two, or four by four with tangent offsets.

use crate::pixel::samples::{Sums, UNKNOWNS};
use crate::reflectance::tangent_offset::OFFSETS;

/// Least pivot, as a share of its diagonal entry: below it a pivot is rounding, and is raised to it.
const PIVOT_MIN: f64 = 1e-14;

/// Unknowns at most that all channels share: of U, those that are no albedo.
pub(crate) const MAX_SHARED: usize = 2 + OFFSETS;

/// How many these are.
pub(crate) const fn shared(unknowns: usize) -> usize {
    unknowns + 2 - UNKNOWNS
}

/// The matrix and gradient of one pixel; albedos first, then what all channels share: roughness,
/// metallic, tangent offsets.
pub(crate) struct Arrowhead<const C: usize, const U: usize> {
    pub(crate) diagonal: [f64; U],
    /// Entries of shared unknowns with the albedos.
    arms: [[f64; C]; MAX_SHARED],
    /// Entries of shared unknowns with each other, below the diagonal.
    dense: [[f64; MAX_SHARED]; MAX_SHARED],
    pub(crate) gradient: [f64; U],
    /// 1, or 0 for an unknown that moves by `fixed`.
    pub(crate) free: [f64; U],
    pub(crate) fixed: [f64; U],
}

impl<const C: usize, const U: usize> Arrowhead<C, U> {
    /// Unknowns that all channels share.
    const SHARED: usize = shared(U);

    #[inline(always)]
    pub(crate) fn of(sums: &Sums<U>, x: usize) -> Self {
        Self::with(|i, j| sums.matrix[i][j].0[x], |j| sums.gradient[j].0[x])
    }

    /// From the matrix, of which entries above the diagonal are not looked at, and the gradient.
    #[inline(always)]
    pub(crate) fn new(matrix: &[[f64; U]; U], gradient: &[f64; U]) -> Self {
        Self::with(|i, j| matrix[i][j], |j| gradient[j])
    }

    #[inline(always)]
    fn with(matrix: impl Fn(usize, usize) -> f64, gradient: impl Fn(usize) -> f64) -> Self {
        let mut arrowhead = Self {
            diagonal: [0.0; U],
            arms: [[0.0; C]; MAX_SHARED],
            dense: [[0.0; MAX_SHARED]; MAX_SHARED],
            gradient: [0.0; U],
            free: [0.0; U],
            fixed: [0.0; U],
        };
        for j in 0..C + Self::SHARED {
            arrowhead.diagonal[j] = matrix(j, j);
            arrowhead.gradient[j] = gradient(j);
        }
        for f in 0..Self::SHARED {
            for c in 0..C {
                arrowhead.arms[f][c] = matrix(C + f, c);
            }
            for g in 0..f {
                arrowhead.dense[f][g] = matrix(C + f, C + g);
            }
        }
        arrowhead
    }

    /// δ with (A + λ diag A) δ = −g in the free unknowns, where `damped` = 1 + λ.
    #[inline(always)]
    pub(crate) fn solve(&self, damped: f64) -> [f64; U] {
        let Self {
            free, fixed, arms, ..
        } = self;
        // Of a fixed unknown the equation is δ = fixed, and its share moves to the right side.
        let mut right = [0.0; U];
        let mut pivot = [0.0; U];
        for c in 0..C {
            let mut share = arms[0][c] * fixed[C];
            for f in 1..Self::SHARED {
                share += arms[f][c] * fixed[C + f];
            }
            right[c] = free[c] * (-self.gradient[c] - share) + fixed[c];
        }
        for f in 0..Self::SHARED {
            let mut share = 0.0;
            for c in 0..C {
                share += arms[f][c] * fixed[c];
            }
            for g in 0..Self::SHARED {
                if g != f {
                    share += self.dense[f.max(g)][f.min(g)] * fixed[C + g];
                }
            }
            right[C + f] = free[C + f] * (-self.gradient[C + f] - share) + fixed[C + f];
        }
        for j in 0..C + Self::SHARED {
            pivot[j] = if free[j] > 0.0 {
                damped * self.diagonal[j]
            } else {
                1.0
            };
        }
        // The albedos out of the way.
        let mut least = [0.0; MAX_SHARED];
        let mut dense = [[0.0; MAX_SHARED]; MAX_SHARED];
        for f in 0..Self::SHARED {
            least[f] = PIVOT_MIN * pivot[C + f];
            for g in 0..f {
                dense[f][g] = free[C + f] * free[C + g] * self.dense[f][g];
            }
        }
        let mut of_arms = [[0.0; C]; MAX_SHARED];
        for c in 0..C {
            let inverse = 1.0 / pivot[c];
            let mut with = [0.0; MAX_SHARED];
            for f in 0..Self::SHARED {
                with[f] = free[C + f] * free[c] * arms[f][c];
                of_arms[f][c] = with[f] * inverse;
                pivot[C + f] -= of_arms[f][c] * with[f];
                for g in 0..f {
                    dense[f][g] -= of_arms[g][c] * with[f];
                }
                right[C + f] -= of_arms[f][c] * right[c];
            }
            right[c] *= inverse;
        }
        // L D Lᵀ of what is shared; L ends up in `dense`.
        let mut inverse = [0.0; MAX_SHARED];
        for f in 0..Self::SHARED {
            pivot[C + f] = pivot[C + f].max(least[f]);
            inverse[f] = 1.0 / pivot[C + f];
            let mut column = [0.0; MAX_SHARED];
            for h in f + 1..Self::SHARED {
                column[h] = dense[h][f];
                let of_column = column[h] * inverse[f];
                pivot[C + h] -= of_column * column[h];
                for g in f + 1..h {
                    dense[h][g] -= of_column * column[g];
                }
                right[C + h] -= of_column * right[C + f];
                dense[h][f] = of_column;
            }
        }
        let mut step = [0.0; U];
        for f in (0..Self::SHARED).rev() {
            step[C + f] = if f + 1 < Self::SHARED {
                right[C + f] * inverse[f]
            } else {
                right[C + f] / pivot[C + f]
            };
            for h in f + 1..Self::SHARED {
                step[C + f] -= dense[h][f] * step[C + h];
            }
        }
        for c in 0..C {
            step[c] = right[c];
            for f in 0..Self::SHARED {
                step[c] -= of_arms[f][c] * step[C + f];
            }
        }
        step
    }

    /// By how much the sum of squares falls with a step: −2gᵀδ − δᵀAδ.
    #[inline(always)]
    pub(crate) fn decrease(&self, step: &[f64; U]) -> f64 {
        let mut sum = 0.0;
        for j in 0..C + Self::SHARED {
            sum += step[j] * (2.0 * self.gradient[j] + self.diagonal[j] * step[j]);
        }
        for c in 0..C {
            let mut by_shared = self.arms[0][c] * step[C];
            for f in 1..Self::SHARED {
                by_shared += self.arms[f][c] * step[C + f];
            }
            sum += 2.0 * step[c] * by_shared;
        }
        for f in 0..Self::SHARED {
            for g in 0..f {
                sum += 2.0 * self.dense[f][g] * step[C + g] * step[C + f];
            }
        }
        -sum
    }
}
