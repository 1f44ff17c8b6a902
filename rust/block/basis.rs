//! The basis functions at the directions of a block, and what they project of a light.

use crate::reflectance::planes::{
    BLOCK, Directions, MAX_ENTRIES, MAX_LOBE, MAX_ROWS, Plane, vector,
};
use crate::reflectance::reflection::{OPEN_DIFFUSE, Reflection, first_entry, rows_of_band};
use crate::reflectance::sh::{self, BAND_OF, COEFFICIENTS, COSINE_TRANSFER, Real};
use crate::runtime::simd::Vectors;

/// The basis functions at those directions, A_l Y_k(n) and R_jk; of the latter, as many as the model
/// has.
#[derive(Clone, Debug)]
pub struct Basis<T: Copy + Default = f32> {
    /// A_l Y_k(n)
    pub diffuse: [Plane<T>; COEFFICIENTS],
    /// R_jk, coefficient by coefficient; on the heap, for a thread's stack is small.
    pub lobe: Box<[Plane<T>; MAX_LOBE]>,
}

impl<T: Copy + Default> Default for Basis<T> {
    fn default() -> Self {
        Self {
            diffuse: [Plane::default(); COEFFICIENTS],
            lobe: (vec![Plane::default(); MAX_LOBE].into_boxed_slice())
                .try_into()
                .unwrap_or_else(|_| unreachable!("as many as there are")),
        }
    }
}

/// Fills in the basis functions, those of the lobe for K coefficients.
#[inline(always)]
pub fn fill_basis<M: Reflection, T: Real, const K: usize>(
    directions: &Directions<T>,
    basis: &mut Basis<T>,
) {
    for x in 0..BLOCK {
        let y = sh::basis(directions.normal(x));
        for k in 0..OPEN_DIFFUSE {
            basis.diffuse[k].0[x] = T::from_f64(COSINE_TRANSFER[BAND_OF[k]]) * y[k];
        }
    }
    let lobe = basis.lobe.first_chunk_mut().expect("room for the lobe");
    fill_lobe::<M, T, K>(&directions.normal, &directions.mirror, lobe);
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

/// The basis functions of one vector of pixels, out of their planes: these lie so that few of them
/// stay in the cache at once.
pub struct BasisAt<I: Vectors<f64>> {
    diffuse: [I::Vector; COEFFICIENTS],
    lobe: [I::Vector; MAX_LOBE],
}

/// Lights that are projected together at most.
pub const TOGETHER: usize = 4;

/// What is projected of each.
pub type Projections<V> = [[V; MAX_PROJECTIONS]; TOGETHER];

// Whatever is larger than a few registers is made once for a block and written again: to be made
// anew for each vector, it would be filled with zeros each time.
impl<I: Vectors<f64>> BasisAt<I> {
    /// Of no vector yet.
    #[inline(always)]
    pub fn new(isa: I) -> Self {
        Self {
            diffuse: [isa.splat(0.0); COEFFICIENTS],
            lobe: [isa.splat(0.0); MAX_LOBE],
        }
    }

    /// Takes up vector number `v` of a block.
    #[inline(always)]
    pub fn take<M: Reflection>(&mut self, basis: &Basis<f64>, v: usize) {
        for k in 0..M::DIFFUSE {
            self.diffuse[k] = I::of(&basis.diffuse[k].0)[v];
        }
        for entry in 0..const { first_entry::<M>(COEFFICIENTS) } {
            self.lobe[entry] = I::of(&basis.lobe[entry].0)[v];
        }
    }

    /// What they project of J lights: Σ_k A_l Y_k(n) L_k, and for each row Σ_k R_jk L_k, with
    /// coefficient k of light j from `light(j, k)`.
    #[inline(always)]
    pub fn project<M: Reflection, const J: usize>(
        &self,
        isa: I,
        light: impl Fn(usize, usize) -> I::Vector,
        projections: &mut Projections<I::Vector>,
    ) {
        let mut sums = [isa.splat(0.0); J];
        for k in 0..M::DIFFUSE {
            for j in 0..J {
                sums[j] = isa.mul_add(light(j, k), self.diffuse[k], sums[j]);
            }
        }
        for j in 0..J {
            projections[j][0] = sums[j];
        }
        self.project_band::<M, J, 0>(isa, &light, projections);
        self.project_band::<M, J, 1>(isa, &light, projections);
        self.project_band::<M, J, 2>(isa, &light, projections);
        self.project_band::<M, J, 3>(isa, &light, projections);
    }

    /// The rows of band L; of one band, because then the compiler knows all counts.
    #[inline(always)]
    fn project_band<M: Reflection, const J: usize, const L: usize>(
        &self,
        isa: I,
        light: &impl Fn(usize, usize) -> I::Vector,
        projections: &mut Projections<I::Vector>,
    ) {
        let (first, rows) = const { rows_of_band::<M>(L) };
        let entry = const { first_entry::<M>(L * L) };
        for row in 0..rows {
            let mut sums = [isa.splat(0.0); J];
            if M::SURROUNDED && L > 0 {
                for j in 0..J {
                    sums[j] = projections[j][1 + first + row];
                }
            }
            for i in 0..2 * L + 1 {
                let lobe = self.lobe[entry + i * rows + row];
                for j in 0..J {
                    sums[j] = isa.mul_add(light(j, L * L + i), lobe, sums[j]);
                }
            }
            for j in 0..J {
                projections[j][1 + first + row] = sums[j];
            }
        }
    }
}
