//! What surroundings bring to a block, beside its light: known projections B_s of each picture, in
//! planes (picture, projection), which add Σ_s f_s B_s to radiance.

use crate::reflectance::planes::{BLOCK, ChannelFactors, ChannelSums, Plane};
use crate::reflectance::reflection::Reflection;

/// Writes targets less what is brought, T − Σ_s f_s B_s, of one channel and some pictures.
#[inline(always)]
pub fn subtract_bounced<M: Reflection>(
    factors: &ChannelFactors,
    bounced: &[Plane],
    targets: &[Plane],
    less: &mut [Plane],
) {
    for ((less, target), bounced) in less
        .iter_mut()
        .zip(targets)
        .zip(bounced.chunks(1 + M::ROWS))
    {
        *less = *target;
        for (s, bounced) in bounced.iter().enumerate() {
            let factor = match s {
                0 => &factors.diffuse,
                s => &factors.rows[s - 1],
            };
            for x in 0..BLOCK {
                less.0[x] -= factor.0[x] * bounced.0[x];
            }
        }
    }
}

/// Adds Σ_i e_i B_is to the derivatives by the factors.
#[inline(always)]
pub fn add_bounced<M: Reflection>(residuals: &[Plane], bounced: &[Plane], sums: &mut ChannelSums) {
    for (residual, bounced) in residuals.iter().zip(bounced.chunks(1 + M::ROWS)) {
        for (s, bounced) in bounced.iter().enumerate() {
            let sum = match s {
                0 => &mut sums.diffuse,
                s => &mut sums.rows[s - 1],
            };
            for x in 0..BLOCK {
                sum.0[x] += residual.0[x] * bounced.0[x];
            }
        }
    }
}
