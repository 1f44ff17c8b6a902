//! What surroundings bring to a block, beside its light: known projections B of each picture, which
//! add Σ_s f_s B_s to radiance.

use std::marker::PhantomData;

use crate::reflectance::planes::{BLOCK, ChannelFactors, ChannelSums, Plane};
use crate::reflectance::reflection::Reflection;
use crate::runtime::simd::{Isa, Kernel};

/// Targets less what is brought, T − Σ_s f_s B_s, of one channel and some pictures.
pub struct LessBounced<'a, M: Reflection> {
    /// f_s
    pub factors: &'a ChannelFactors,
    /// B_s: (picture, projection).
    pub bounced: &'a [Plane],
    /// T, a plane for each picture.
    pub targets: &'a [Plane],
    /// To be written, a plane for each picture.
    pub less: &'a mut [Plane],
    /// Whose factors they are.
    pub model: PhantomData<M>,
}

impl<M: Reflection> Kernel for LessBounced<'_, M> {
    type Output = ();

    #[inline(always)]
    fn run<I: Isa>(self, _: I) {
        for ((less, target), bounced) in self
            .less
            .iter_mut()
            .zip(self.targets)
            .zip(self.bounced.chunks(1 + M::ROWS))
        {
            *less = *target;
            for (s, bounced) in bounced.iter().enumerate() {
                let factor = match s {
                    0 => &self.factors.diffuse,
                    s => &self.factors.rows[s - 1],
                };
                for x in 0..BLOCK {
                    less.0[x] -= factor.0[x] * bounced.0[x];
                }
            }
        }
    }
}

/// Adds Σ_i e_i B_is to the derivatives by the factors.
pub struct ByBounced<'a, M: Reflection> {
    /// e, a plane for each picture.
    pub residuals: &'a [Plane],
    /// B_s: (picture, projection).
    pub bounced: &'a [Plane],
    /// Added to.
    pub sums: &'a mut ChannelSums,
    /// Whose factors they are.
    pub model: PhantomData<M>,
}

impl<M: Reflection> Kernel for ByBounced<'_, M> {
    type Output = ();

    #[inline(always)]
    fn run<I: Isa>(self, _: I) {
        for (residual, bounced) in self.residuals.iter().zip(self.bounced.chunks(1 + M::ROWS)) {
            for (s, bounced) in bounced.iter().enumerate() {
                let sum = match s {
                    0 => &mut self.sums.diffuse,
                    s => &mut self.sums.rows[s - 1],
                };
                for x in 0..BLOCK {
                    sum.0[x] += residual.0[x] * bounced.0[x];
                }
            }
        }
    }
}
