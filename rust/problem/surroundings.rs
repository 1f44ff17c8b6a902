//! A problem's pixels among surroundings: their basis functions, and what is brought to them.

use super::Problem;
use crate::block::basis::{Basis, MAX_PROJECTIONS, fill_basis};
use crate::reflectance::planes::{BLOCK, Directions, Doubles, Plane};
use crate::reflectance::reflection::Reflection;
use crate::reflectance::sh::Real;
use crate::runtime::simd::vectorized;
use crate::transport::table::Transfer;

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

    /// What is brought to a block in one channel: (picture, projection); nothing where nothing is.
    pub(crate) fn fill_bounced<M: Reflection>(
        &self,
        pixels: impl Iterator<Item = usize>,
        channel: usize,
        bounced: &mut Vec<Plane>,
    ) {
        bounced.clear();
        let Some(transfer) = self.transfer.as_ref().filter(|t| !t.bounced.is_empty()) else {
            return;
        };
        bounced.resize(self.pictures() * (1 + M::ROWS), Plane::default());
        for (x, p) in pixels.enumerate() {
            for s in 0..=M::ROWS {
                let of_row = self.bounced_of::<M>(transfer, p, s);
                for i in 0..self.pictures() {
                    bounced[i * (1 + M::ROWS) + s].0[x] = of_row[i * self.channels() + channel];
                }
            }
        }
    }

    /// The same of picked pixels in float64, of all channels: (channel, picture).
    pub(crate) fn pick_bounced<M: Reflection>(
        &self,
        pixels: &[usize],
        picked: &mut Vec<[Doubles; MAX_PROJECTIONS]>,
    ) {
        let Some(transfer) = self.transfer.as_ref().filter(|t| !t.bounced.is_empty()) else {
            return;
        };
        if pixels.len() < BLOCK {
            picked.clear();
        }
        let samples = self.channels() * self.pictures();
        picked.resize(samples, [Doubles::default(); MAX_PROJECTIONS]);
        for (x, &p) in pixels.iter().enumerate() {
            for s in 0..=M::ROWS {
                for (j, &value) in self.bounced_of::<M>(transfer, p, s).iter().enumerate() {
                    let sample = j % self.channels() * self.pictures() + j / self.channels();
                    picked[sample][s].0[x] = value.into();
                }
            }
        }
    }

    /// Of one row of a pixel: (picture, channel).
    fn bounced_of<'a, M: Reflection>(
        &self,
        transfer: &'a Transfer,
        p: usize,
        row: usize,
    ) -> &'a [f32] {
        transfer.bounced_of::<M>(p, row, self.pictures() * self.channels())
    }
}
