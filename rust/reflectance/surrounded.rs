//! A reflection model whose pixels see light through their surroundings.
//!
//! Factors, and what they depend on, are the model's own. Its basis functions are not computed from
//! directions but given, pixel by pixel, by a [transfer](crate::transport).

use std::marker::PhantomData;

use super::lobe_table::Tabled;
use super::planes::{
    BlockFunctions, ChannelFactors, ChannelSums, Directions, MAX_ENTRIES, Material, Materials,
    Plane,
};
use super::reflection::Reflection;
use super::sh::{BANDS, Real};
use crate::runtime::simd::Isa;

/// The model M among surroundings.
#[derive(Clone, Copy, Debug, Default)]
pub struct Surrounded<M>(PhantomData<M>);

/// Why nobody asks for basis functions by directions: normals are given where there is a transfer.
const HELD: &str = "the basis functions of a transfer do not turn with the normal";

impl<M: Reflection> Reflection for Surrounded<M> {
    const FIRST_ROW: [usize; BANDS + 1] = M::FIRST_ROW;
    const SURROUNDED: bool = true;

    type Functions = M::Functions;
    type Factors<const C: usize> = M::Factors<C>;
    type Precision<T: Real> = M::Precision<T>;

    #[inline(always)]
    fn functions(cosine: f64, roughness: f64) -> Self::Functions {
        M::functions(cosine, roughness)
    }

    #[inline(always)]
    fn fill_functions<I: Isa, T: Tabled>(
        isa: I,
        cosine: &Plane<f64>,
        roughness: &Plane<f64>,
        by_cosine: bool,
        functions: &mut BlockFunctions<Self::Precision<T>>,
    ) {
        M::fill_functions::<I, T>(isa, cosine, roughness, by_cosine, functions);
    }

    #[inline(always)]
    fn functions_of<P: Real>(functions: &BlockFunctions<P>, pixel: usize) -> Self::Functions {
        M::functions_of(functions, pixel)
    }

    #[inline(always)]
    fn factors<const C: usize>(
        cosine: f64,
        material: &Material<C>,
        functions: Self::Functions,
    ) -> Self::Factors<C> {
        M::factors(cosine, material, functions)
    }

    #[inline(always)]
    fn fill_factors<T: Real, const C: usize>(
        directions: &Directions<T>,
        materials: &Materials<C>,
        functions: &BlockFunctions<Self::Precision<T>>,
        factors: &mut [ChannelFactors<T>; C],
    ) {
        M::fill_factors(directions, materials, functions, factors);
    }

    #[inline(always)]
    fn pull_back_block<const C: usize>(
        directions: &Directions,
        materials: &Materials<C>,
        functions: &BlockFunctions<Self::Precision<f32>>,
        sums: &[ChannelSums; C],
        scale: f64,
        gradient: &mut Materials<C>,
    ) {
        M::pull_back_block(directions, materials, functions, sums, scale, gradient);
    }

    fn lobe<T: Real>(_: [T; 3], _: [T; 3]) -> [T; MAX_ENTRIES] {
        unreachable!("{HELD}")
    }

    fn lobe_along<T: Real>(_: [[T; 3]; 2], _: [[T; 3]; 2]) -> [T; MAX_ENTRIES] {
        unreachable!("{HELD}")
    }

    fn lobe_adjoint<T: Real, const K: usize>(
        _: [T; 3],
        _: [T; 3],
        _: impl Fn(usize) -> T,
    ) -> [[T; 3]; 2] {
        unreachable!("{HELD}")
    }
}
