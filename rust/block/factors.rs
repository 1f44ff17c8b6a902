//! From the materials of a block to the factors of its weights, and back.

use std::ops::Range;

use crate::reflectance::lobe_table::Tabled;
use crate::reflectance::planes::{BlockFunctions, ChannelFactors, Directions, Materials, Plane};
use crate::reflectance::reflection::Reflection;
use crate::runtime::simd::{Isa, Kernel};

/// Takes some pixels from maps of `pixels` values each, one after the other, into as many planes. Values
/// are clamped to the range; the rest of each plane is `unused`. Returns whether all lie in the range.
///
/// The copy lets the compiler know that no two planes overlap, without which the loops over them
/// are no vector code.
#[inline(always)]
pub fn load<'p>(
    maps: &[f64],
    pixels: usize,
    taken: Range<usize>,
    [lowest, highest]: [f64; 2],
    unused: f64,
    planes: impl Iterator<Item = &'p mut Plane<f64>>,
) -> bool {
    let mut in_range = true;
    for (plane, to) in maps.chunks(pixels).zip(planes) {
        to.0[taken.len()..].fill(unused);
        for (to, &from) in to.0.iter_mut().zip(&plane[taken.clone()]) {
            *to = from.clamp(lowest, highest); // tables are of no others
            in_range &= from == *to; // NaN is not
        }
    }
    in_range
}

/// Fills in the functions of roughness and n·v of a block, in double precision.
pub struct FillFunctions<'a, M: Reflection> {
    /// The clamped n·v.
    pub cosine: &'a Plane<f64>,
    /// In \[0, 1\].
    pub roughness: &'a Plane<f64>,
    /// Whether derivatives by n·v are filled in too.
    pub by_cosine: bool,
    /// To be written.
    pub functions: &'a mut BlockFunctions<M::Precision<f64>>,
}

impl<M: Reflection> Kernel for FillFunctions<'_, M> {
    type Output = ();

    #[inline(always)]
    fn run<I: Isa>(self, isa: I) {
        M::fill_functions::<I, f64>(
            isa,
            self.cosine,
            self.roughness,
            self.by_cosine,
            self.functions,
        );
    }
}

/// Fills in functions and factors of the first `pixels` pixels; the others' factors become zero, and
/// with them their weights, residuals and derivatives.
pub struct FillFactors<'a, M: Reflection, T: Tabled, const C: usize> {
    /// Where the pixels look.
    pub directions: &'a Directions<T>,
    /// What they are made of.
    pub materials: &'a Materials<C>,
    /// Pixels used.
    pub pixels: usize,
    /// Whether derivatives by n·v will be asked for.
    pub by_cosine: bool,
    /// To be written.
    pub functions: &'a mut BlockFunctions<M::Precision<T>>,
    /// To be written.
    pub factors: &'a mut [ChannelFactors<T>; C],
}

impl<M: Reflection, T: Tabled, const C: usize> Kernel for FillFactors<'_, M, T, C> {
    type Output = ();

    #[inline(always)]
    fn run<I: Isa>(self, isa: I) {
        let (directions, materials) = (self.directions, self.materials);
        M::fill_functions::<I, T>(
            isa,
            &directions.cosine,
            &materials.roughness,
            self.by_cosine,
            self.functions,
        );
        M::fill_factors(directions, materials, self.functions, self.factors);
        for of_channel in self.factors {
            of_channel.diffuse.0[self.pixels..].fill(T::default());
            for plane in &mut of_channel.rows[..M::ROWS] {
                plane.0[self.pixels..].fill(T::default());
            }
        }
    }
}
