//! The weights W of a block, from its basis functions and factors.

use super::basis::Basis;
use crate::reflectance::planes::{BLOCK, ChannelFactors, MAX_ROWS, Plane};
use crate::reflectance::reflection::{Reflection, first_entry, rows_of_band};
use crate::reflectance::sh::{COEFFICIENTS, Real};
use crate::runtime::simd::{Isa, Kernel, Vectors};

/// Fills in the weights of C channels, W transposed: coefficient first.
///
/// Of all channels at once, because there are more basis functions than a cache would hold long.
pub struct FillWeights<'a, M: Reflection, T: Real, const K: usize, const C: usize> {
    /// The basis functions.
    pub basis: &'a Basis<T>,
    /// The channels' factors.
    pub factors: &'a [ChannelFactors<T>; C],
    /// To be written.
    pub weights: &'a mut [[Plane<T>; K]; C],
    /// Whose weights they are.
    pub model: M,
}

impl<M: Reflection, const K: usize, const C: usize> Kernel for FillWeights<'_, M, f64, K, C> {
    type Output = ();

    #[inline(always)]
    fn run<I: Isa>(self, isa: I) {
        fill_weights::<M, f64, I, K, C>(isa, self.basis, self.factors, self.weights);
    }
}

impl<M: Reflection, const K: usize, const C: usize> Kernel for FillWeights<'_, M, f32, K, C> {
    type Output = ();

    #[inline(always)]
    fn run<I: Isa>(self, isa: I) {
        fill_weights::<M, f32, I, K, C>(isa, self.basis, self.factors, self.weights);
    }
}

#[inline(always)]
fn fill_weights<M: Reflection, T: Real, I: Vectors<T>, const K: usize, const C: usize>(
    isa: I,
    basis: &Basis<T>,
    factors: &[ChannelFactors<T>; C],
    weights: &mut [[Plane<T>; K]; C],
) {
    // Pixels outside, so that the factors stay in registers.
    for v in 0..BLOCK / I::LANES {
        weights_of_band::<M, T, I, K, C, 0>(isa, basis, factors, v, weights);
        weights_of_band::<M, T, I, K, C, 1>(isa, basis, factors, v, weights);
        weights_of_band::<M, T, I, K, C, 2>(isa, basis, factors, v, weights);
        if K == COEFFICIENTS {
            weights_of_band::<M, T, I, K, C, 3>(isa, basis, factors, v, weights);
        }
    }
}

/// Those of band L, for one vector of pixels. Of one band, because then the compiler knows all
/// counts.
#[inline(always)]
fn weights_of_band<
    M: Reflection,
    T: Real,
    I: Vectors<T>,
    const K: usize,
    const C: usize,
    const L: usize,
>(
    isa: I,
    basis: &Basis<T>,
    factors: &[ChannelFactors<T>; C],
    v: usize,
    weights: &mut [[Plane<T>; K]; C],
) {
    let (first_row, rows) = const { rows_of_band::<M>(L) };
    let mut diffuse = [isa.splat(T::default()); C];
    let mut factor = [[isa.splat(T::default()); MAX_ROWS]; C];
    for c in 0..C {
        diffuse[c] = I::of(&factors[c].diffuse.0)[v];
        for j in 0..rows {
            factor[c][j] = I::of(&factors[c].rows[first_row + j].0)[v];
        }
    }
    let first_entry = const { first_entry::<M>(L * L) };
    for i in 0..2 * L + 1 {
        let (k, entry) = (L * L + i, first_entry + i * rows);
        let mut lobe = [isa.splat(T::default()); MAX_ROWS];
        for j in 0..rows {
            lobe[j] = I::of(&basis.lobe[entry + j].0)[v];
        }
        for c in 0..C {
            let mut w = isa.mul(factor[c][0], lobe[0]);
            for j in 1..rows {
                w = isa.mul_add(factor[c][j], lobe[j], w);
            }
            if k < M::DIFFUSE {
                w = isa.mul_add(diffuse[c], I::of(&basis.diffuse[k].0)[v], w);
            }
            I::of_mut(&mut weights[c][k].0)[v] = w;
        }
    }
}
