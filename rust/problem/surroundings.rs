//! A problem's pixels among surroundings: their basis functions, and what is brought to them.

use super::Problem;
use crate::block::basis::{Basis, MAX_PROJECTIONS, fill_basis};
use crate::reflectance::planes::{BLOCK, Directions, Plane};
use crate::reflectance::reflection::Reflection;
use crate::reflectance::sh::Real;
use crate::runtime::simd::vectorized;

impl Problem {
    /// Basis functions of some pixels, at most [`BLOCK`], that look in some directions.
    pub(crate) fn fill_basis<M: Reflection, T: Real, const K: usize>(
        &self,
        directions: &Directions<T>,
        pixels: impl ExactSizeIterator<Item = usize>,
        basis: &mut Basis<T>,
    ) {
        let Some(transfer) = &self.transfer else {
            let isa = self.options.instructions;
            return vectorized!(isa, fill_basis::<M, T, K>(directions, basis));
        };
        transfer.fill_basis::<M, T>(pixels, basis);
    }

    /// What is brought to each projection of some pixels, at most [`BLOCK`]: (channel, picture); nothing
    /// where nothing is.
    pub(crate) fn pick_bounced<M: Reflection, T: Real>(
        &self,
        pixels: impl ExactSizeIterator<Item = usize>,
        picked: &mut Vec<[Plane<T>; MAX_PROJECTIONS]>,
    ) {
        let Some(transfer) = self.transfer.as_ref().filter(|t| !t.bounced.is_empty()) else {
            return;
        };
        if pixels.len() < BLOCK {
            picked.clear();
        }
        let (pictures, channels) = (self.pictures(), self.channels());
        picked.resize(channels * pictures, [Plane::default(); MAX_PROJECTIONS]);
        for (x, p) in pixels.enumerate() {
            for s in 0..=M::ROWS {
                let of_row = transfer.bounced_of::<M>(p, s, pictures * channels);
                for (j, &value) in of_row.iter().enumerate() {
                    let sample = j % channels * pictures + j / channels;
                    picked[sample][s].0[x] = T::from_f64(value.into());
                }
            }
        }
    }
}
