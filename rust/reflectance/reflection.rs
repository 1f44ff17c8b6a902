//! What a reflection model has to give: the rows of its lobe, and their factors.
//!
//! A lobe depends on a few projections of a light, its *rows* j, each a sum over one band: B_j =
//! Σ_k R_jk L_k. R depends on directions alone, the factors kd and s on material and n·v; no
//! picture changes either. Which rows there are and what their factors are is the [`Reflection`]
//! model: [`Paper`](super::paper::Paper) or [`Principled`](super::principled::Principled). All
//! else, here and in the fast float32 blocks, is the same code for both.

use std::fmt::Debug;

use super::lobe_table::Tabled;
use super::planes::{
    BLOCK, BlockFunctions, ByRow, ChannelFactors, ChannelSums, Directions, MAX_ENTRIES, MAX_ROWS,
    Material, Materials, Plane,
};
use super::sh::{BAND_OF, BANDS, COEFFICIENTS, Real};
use crate::runtime::simd::Isa;

/// Weights w_ck of one pixel, channel first.
pub type Weights<const C: usize = 3> = [[f64; COEFFICIENTS]; C];

/// Those of a model M, where nothing is rounded.
pub type ExactFunctions<M> = BlockFunctions<<M as Reflection>::Precision<f64>>;

/// What is the model's own: the rows of its lobe, and their factors.
///
/// Everything is always inlined: the fast path runs it over blocks of pixels, and only then does the
/// compiler turn it into vector code.
pub trait Reflection: Copy + Debug + Default + Send + Sync + 'static {
    /// Rows FIRST_ROW\[l\] to FIRST_ROW\[l + 1\] see band l.
    const FIRST_ROW: [usize; BANDS + 1];

    /// Functions of roughness and n·v that a pixel's factors are made of, with their derivatives.
    type Functions: Copy;

    /// Factors of a pixel with C channels.
    type Factors<const C: usize>: Factors<C>;

    /// What functions of blocks are kept in where factors are rounded to T.
    type Precision<T: Real>: Real;

    /// The functions of one pixel at its clamped n·v.
    fn functions(cosine: f64, roughness: f64) -> Self::Functions;

    /// The same under light that is alike from all sides, of which band 0 is all: others may be 0.
    #[inline(always)]
    fn functions_of_band_0(cosine: f64, roughness: f64) -> Self::Functions {
        Self::functions(cosine, roughness)
    }

    /// Fills in the functions of a block at its clamped n·v; derivatives by n·v only where they are
    /// asked for.
    fn fill_functions<I: Isa, T: Tabled>(
        isa: I,
        cosine: &Plane<f64>,
        roughness: &Plane<f64>,
        by_cosine: bool,
        functions: &mut BlockFunctions<Self::Precision<T>>,
    );

    /// Those of one pixel of the block.
    fn functions_of<P: Real>(functions: &BlockFunctions<P>, pixel: usize) -> Self::Functions;

    /// The factors of a material at its clamped n·v and functions.
    fn factors<const C: usize>(
        cosine: f64,
        material: &Material<C>,
        functions: Self::Functions,
    ) -> Self::Factors<C>;

    /// R_jk at normal and mirror direction, at the places that [`first_entry`] says.
    fn lobe<T: Real>(normal: [T; 3], mirror: [T; 3]) -> [T; MAX_ENTRIES];

    /// Their change where normal and mirror direction change so.
    fn lobe_along<T: Real>(directions: [[T; 3]; 2], change: [[T; 3]; 2]) -> [T; MAX_ENTRIES];

    /// The adjoint: derivatives by normal and mirror direction from those by R_jk, for the first K
    /// coefficients.
    fn lobe_adjoint<T: Real, const K: usize>(
        normal: [T; 3],
        mirror: [T; 3],
        cotangent: impl Fn(usize) -> T,
    ) -> [[T; 3]; 2];

    /// Fills in the factors of a block of pixels.
    #[inline(always)]
    fn fill_factors<T: Real, const C: usize>(
        directions: &Directions<T>,
        materials: &Materials<C>,
        functions: &BlockFunctions<Self::Precision<T>>,
        factors: &mut [ChannelFactors<T>; C],
    ) {
        for x in 0..BLOCK {
            let of_pixel = factors_of::<Self, T, C>(directions, materials, functions, x);
            for c in 0..C {
                factors[c].diffuse.0[x] = T::from_f64(of_pixel.diffuse(c));
                for j in 0..Self::ROWS {
                    factors[c].rows[j].0[x] = T::from_f64(of_pixel.row(c, j));
                }
            }
        }
    }

    /// [`Factors::pull_back`] of a block of pixels, times `scale`.
    #[inline(always)]
    fn pull_back_block<const C: usize>(
        directions: &Directions,
        materials: &Materials<C>,
        functions: &BlockFunctions<Self::Precision<f32>>,
        sums: &[ChannelSums; C],
        scale: f64,
        gradient: &mut Materials<C>,
    ) {
        for x in 0..BLOCK {
            let factors = factors_of::<Self, f32, C>(directions, materials, functions, x);
            let (by_diffuse, by_row) = sums_of::<Self, C>(sums, x);
            let of_pixel = factors.pull_back(&materials.get(x), &by_diffuse, &by_row);
            for c in 0..C {
                gradient.albedo[c].0[x] = scale * of_pixel.albedo[c];
            }
            gradient.roughness.0[x] = scale * of_pixel.roughness;
            gradient.metallic.0[x] = scale * of_pixel.metallic;
        }
    }

    /// Number of rows.
    const ROWS: usize = Self::FIRST_ROW[BANDS];

    /// Whether basis functions are those of a [transfer](crate::transport): then every row, and the
    /// matt part, sees all bands. They are given then, and none of the functions of directions is
    /// called.
    const SURROUNDED: bool;

    /// Coefficients that the matt part sees.
    const DIFFUSE: usize = if Self::SURROUNDED {
        COEFFICIENTS
    } else {
        OPEN_DIFFUSE
    };
}

/// Coefficients that a matt surface sees of an open sky, those of bands 0 to 2: A₃ = 0.
pub const OPEN_DIFFUSE: usize = 9;

/// The first row that sees band l, and how many do.
pub const fn rows_of_band<M: Reflection>(l: usize) -> (usize, usize) {
    if M::SURROUNDED {
        (0, M::ROWS)
    } else {
        (M::FIRST_ROW[l], M::FIRST_ROW[l + 1] - M::FIRST_ROW[l])
    }
}

/// Factors of the weights that depend on the material, with what their derivatives need.
pub trait Factors<const C: usize>: Copy + Debug {
    /// Rows of the lobe.
    const ROWS: usize;

    /// kd_c
    fn diffuse(&self, channel: usize) -> f64;

    /// s_cj
    fn row(&self, channel: usize, row: usize) -> f64;

    /// The adjoint: from the derivatives of a scalar by the weights to those by the material.
    ///
    /// The weights' derivatives arrive summed: `by_diffuse[c]` = Σ_k g_ck A_l Y_k(n), which is the
    /// derivative by kd_c, and `by_row[c][j]` = Σ_k g_ck R_jk, that by s_cj.
    fn pull_back(
        &self,
        material: &Material<C>,
        by_diffuse: &[f64; C],
        by_row: &[ByRow; C],
    ) -> Material<C>;

    /// ∂kd_c and ∂s_cj by n·v, at the cosine and material that these factors are of.
    ///
    /// They hold for n·v > [`MIN_COSINE`](super::ggx::MIN_COSINE). Up to and at it the clamped cosine stays where it is
    /// when the normal changes, and callers take 0 instead.
    fn slopes_by_cosine(&self, cosine: f64, material: &Material<C>) -> ([f64; C], [ByRow; C]);

    /// The derivative of a scalar by n·v, what each channel adds to it; arguments as of
    /// [`pull_back`](Self::pull_back), and the same holds for n·v.
    #[inline(always)]
    fn by_cosine(
        &self,
        cosine: f64,
        material: &Material<C>,
        by_diffuse: &[f64; C],
        by_row: &[ByRow; C],
    ) -> [f64; C] {
        let (diffuse, rows) = self.slopes_by_cosine(cosine, material);
        let mut by = [0.0; C];
        for c in 0..C {
            by[c] = diffuse[c] * by_diffuse[c];
            for j in 0..Self::ROWS {
                by[c] += rows[c][j] * by_row[c][j];
            }
        }
        by
    }
}

/// Where the basis functions R_jk of coefficient k begin; there is one for each row of its band.
pub const fn first_entry<M: Reflection>(k: usize) -> usize {
    let (mut first, mut i) = (0, 0);
    while i < k {
        first += rows_of_band::<M>(BAND_OF[i]).1;
        i += 1;
    }
    first
}

/// Calls `f` with every R_jk's coefficient k, row j and place, of the first K coefficients.
#[inline(always)]
pub fn each_entry<M: Reflection, const K: usize>(mut f: impl FnMut(usize, usize, usize)) {
    let mut entry = 0;
    for k in 0..K {
        let (first, rows) = rows_of_band::<M>(BAND_OF[k]);
        for row in first..first + rows {
            f(k, row, entry);
            entry += 1;
        }
    }
}

#[inline(always)]
pub(crate) fn factors_of<M: Reflection, T: Real, const C: usize>(
    directions: &Directions<T>,
    materials: &Materials<C>,
    functions: &BlockFunctions<M::Precision<T>>,
    x: usize,
) -> M::Factors<C> {
    M::factors(
        directions.cosine.0[x],
        &materials.get(x),
        M::functions_of(functions, x),
    )
}

/// The adjoint of one pixel's factors: derivatives by kd_c and by s_cj.
#[inline(always)]
pub(crate) fn sums_of<M: Reflection, const C: usize>(
    sums: &[ChannelSums; C],
    x: usize,
) -> ([f64; C], [ByRow; C]) {
    let (mut by_diffuse, mut by_row) = ([0.0; C], [[0.0; MAX_ROWS]; C]);
    for c in 0..C {
        by_diffuse[c] = f64::from(sums[c].diffuse.0[x]);
        for j in 0..M::ROWS {
            by_row[c][j] = f64::from(sums[c].rows[j].0[x]);
        }
    }
    (by_diffuse, by_row)
}
