//! From the materials of a block to the factors of its weights, and back.

use crate::reflectance::lobe_table::Tabled;
use crate::reflectance::planes::{
    BlockFunctions, ChannelFactors, ChannelSums, Directions, Materials, Plane,
};
use crate::reflectance::reflection::Reflection;
use crate::runtime::simd::{Isa, Kernel};

/// Takes `count` pixels from planes of `pixels` values each, starting at `first`. Returns whether all
/// of them lie in the range.
///
/// The copy lets the compiler know that no two planes overlap, without which the loops over them
/// are no vector code.
pub struct Load<'a, P> {
    /// One plane after the other.
    pub maps: &'a [f64],
    /// Pixels in a plane.
    pub pixels: usize,
    /// First pixel of the block.
    pub first: usize,
    /// Pixels of the block that are used; the others get the value `unused`.
    pub count: usize,
    /// Lowest and highest value.
    pub range: [f64; 2],
    /// See `count`.
    pub unused: f64,
    /// To be written, as many as there are in the maps.
    pub planes: P,
}

impl<'p, P: Iterator<Item = &'p mut Plane<f64>>> Kernel for Load<'_, P> {
    type Output = bool;

    #[inline(always)]
    fn run<I: Isa>(self, _: I) -> bool {
        let [lowest, highest] = self.range;
        let mut in_range = true;
        for (plane, to) in self.maps.chunks(self.pixels).zip(self.planes) {
            to.0[self.count..].fill(self.unused);
            for (to, &from) in to.0.iter_mut().zip(&plane[self.first..][..self.count]) {
                *to = from.clamp(lowest, highest); // tables are of no others
                in_range &= from == *to; // NaN is not
            }
        }
        in_range
    }
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
        let Self {
            directions,
            materials,
            pixels,
            by_cosine,
            functions,
            factors,
        } = self;
        M::fill_functions::<I, T>(
            isa,
            &directions.cosine,
            &materials.roughness,
            by_cosine,
            functions,
        );
        M::fill_factors(directions, materials, functions, factors);
        for of_channel in factors {
            of_channel.diffuse.0[pixels..].fill(T::default());
            for plane in &mut of_channel.rows[..M::ROWS] {
                plane.0[pixels..].fill(T::default());
            }
        }
    }
}

/// The last step: from the channels' sums to the derivatives by the material, times `scale`.
pub struct PullBack<'a, M: Reflection, const C: usize> {
    /// Where the pixels look.
    pub directions: &'a Directions,
    /// What they are made of.
    pub materials: &'a Materials<C>,
    /// The functions of their roughness and n·v.
    pub functions: &'a BlockFunctions<M::Precision<f32>>,
    /// The adjoint of the factors.
    pub sums: &'a [ChannelSums; C],
    /// Factor on all derivatives.
    pub scale: f64,
    /// To be written.
    pub gradient: &'a mut Materials<C>,
}

impl<M: Reflection, const C: usize> Kernel for PullBack<'_, M, C> {
    type Output = ();

    #[inline(always)]
    fn run<I: Isa>(self, _: I) {
        let Self {
            directions,
            materials,
            functions,
            sums,
            scale,
            gradient,
        } = self;
        M::pull_back_block(directions, materials, functions, sums, scale, gradient);
    }
}
