//! The basis functions at the directions of a block, and what they project of a light.

use crate::reflectance::planes::{BLOCK, Directions, MAX_ENTRIES, MAX_ROWS, Plane, vector};
use crate::reflectance::reflection::{Reflection, each_entry, first_entry};
use crate::reflectance::sh::{self, BAND_OF, COEFFICIENTS, COSINE_TRANSFER, Real};
use crate::runtime::simd::{Isa, Kernel, Vectors};

/// Basis functions with a diffuse response, those of bands 0 to 2: A₃ = 0.
pub const DIFFUSE: usize = 9;

/// The basis functions at those directions, A_l Y_k(n) and R_jk; of the latter, as many as the model
/// has.
#[derive(Clone, Debug)]
pub struct Basis<T: Copy + Default = f32> {
    /// A_l Y_k(n)
    pub diffuse: [Plane<T>; DIFFUSE],
    /// R_jk, coefficient by coefficient.
    pub lobe: [Plane<T>; MAX_ENTRIES],
}

impl<T: Copy + Default> Default for Basis<T> {
    fn default() -> Self {
        Self {
            diffuse: [Plane::default(); DIFFUSE],
            lobe: [Plane::default(); MAX_ENTRIES],
        }
    }
}

/// Fills in the basis functions, those of the lobe for K coefficients.
pub struct FillBasis<'a, M: Reflection, T: Real, const K: usize> {
    /// Where the pixels look.
    pub directions: &'a Directions<T>,
    /// To be written.
    pub basis: &'a mut Basis<T>,
    /// Whose lobe it is.
    pub model: M,
}

impl<M: Reflection, T: Real, const K: usize> Kernel for FillBasis<'_, M, T, K> {
    type Output = ();

    #[inline(always)]
    fn run<I: Isa>(self, _: I) {
        let Self {
            directions, basis, ..
        } = self;
        for x in 0..BLOCK {
            let y = sh::basis(directions.normal(x));
            for k in 0..DIFFUSE {
                basis.diffuse[k].0[x] = T::from_f64(COSINE_TRANSFER[BAND_OF[k]]) * y[k];
            }
        }
        fill_lobe::<M, T, K>(&directions.normal, &directions.mirror, &mut basis.lobe);
    }
}

/// A function of its own, from whose arguments the compiler knows that they do not overlap, and a
/// count that it knows beforehand: else it makes no vector code of so many planes.
#[inline(always)]
fn fill_lobe<M: Reflection, T: Real, const K: usize>(
    normal: &[Plane<T>; 3],
    mirror: &[Plane<T>; 3],
    lobe: &mut [Plane<T>; MAX_ENTRIES],
) {
    let entries = const { first_entry::<M>(K) };
    for x in 0..BLOCK {
        let of_pixel = M::lobe(vector(normal, x), vector(mirror, x));
        for entry in 0..entries {
            lobe[entry].0[x] = of_pixel[entry];
        }
    }
}

/// Projections of a light on a pixel at most: the diffuse one, then one for each row of its lobe.
pub const MAX_PROJECTIONS: usize = 1 + MAX_ROWS;

/// The light projected on the pixels' basis: Σ_k A_l Y_k(n) L_k, and for each row Σ_k R_jk L_k.
#[inline(always)]
pub fn light_projections<M: Reflection>(
    basis: &Basis<f64>,
    light: &[f64; COEFFICIENTS],
) -> [Plane<f64>; MAX_PROJECTIONS] {
    let mut light_projections = [Plane::default(); MAX_PROJECTIONS];
    for k in 0..DIFFUSE {
        for x in 0..BLOCK {
            light_projections[0].0[x] += light[k] * basis.diffuse[k].0[x];
        }
    }
    each_entry::<M, COEFFICIENTS>(|k, row, entry| {
        let (sum, lobe) = (&mut light_projections[1 + row], &basis.lobe[entry]);
        for x in 0..BLOCK {
            sum.0[x] += light[k] * lobe.0[x];
        }
    });
    light_projections
}

/// The same for one vector of pixels, number `v` of the block.
#[inline(always)]
pub fn light_projections_at<M: Reflection, I: Vectors<f64>>(
    isa: I,
    basis: &Basis<f64>,
    light: &[f64; COEFFICIENTS],
    v: usize,
) -> [I::Vector; MAX_PROJECTIONS] {
    let mut light_projections = [isa.splat(0.0); MAX_PROJECTIONS];
    for k in 0..DIFFUSE {
        light_projections[0] = isa.mul_add(
            isa.splat(light[k]),
            I::of(&basis.diffuse[k].0)[v],
            light_projections[0],
        );
    }
    each_entry::<M, COEFFICIENTS>(|k, row, entry| {
        let sum = &mut light_projections[1 + row];
        *sum = isa.mul_add(isa.splat(light[k]), I::of(&basis.lobe[entry].0)[v], *sum);
    });
    light_projections
}
