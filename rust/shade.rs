//! One pixel: from material and directions to the 16 weights of each colour channel, and back.
//!
//! Radiance is linear in the light, I_c = Σ_k w_ck L_kc, and what a surface does with it is a matt
//! part and a lobe:
//!
//! ```text
//! w_ck = kd_c A_l Y_k(n) + Σ_j s_cj R_jk
//! ```
//!
//! A lobe sees a few numbers of a light, its *rows* j, each a sum over one band: B_j = Σ_k R_jk L_k.
//! R depends on directions alone, the factors kd and s on material and n·v; no picture changes
//! either. Which rows there are and what their factors are is the [`Reflection`] model:
//! [`Paper`](crate::paper::Paper) or [`Principled`](crate::principled::Principled). All else, here
//! and in the fast float32 blocks, is the same code for both.

use std::fmt::Debug;
use std::marker::PhantomData;

use glam::DVec3;

use crate::block::{
    BLOCK, ChannelFactors, ChannelSums, Directions, Materials, Plane, factors_of, sums_of,
};
use crate::ggx::MIN_COSINE;
use crate::sh::{self, BAND_OF, BANDS, COEFFICIENTS, COSINE_TRANSFER, Real};
use crate::simd::Isa;

/// Weights w_ck of one pixel, channel first.
pub type Weights<const C: usize = 3> = [[f64; COEFFICIENTS]; C];

/// Rows of a lobe at most.
pub const MAX_ROWS: usize = 10;
/// Basis functions R_jk of a lobe at most.
pub const MAX_ENTRIES: usize = 50;
/// Functions of roughness and n·v at most.
pub const MAX_FUNCTIONS: usize = 72;

/// One number for each row of a lobe.
pub type ByRow = [f64; MAX_ROWS];

/// The [functions](Reflection::Functions) of a block of pixels.
pub type BlockFunctions<T = f64> = [Plane<T>; MAX_FUNCTIONS];

/// Those of a model M, where nothing is rounded.
pub type ExactFunctions<M> = BlockFunctions<<M as Reflection>::Precision<f64>>;

/// Material of one pixel with C colour channels; all numbers lie in \[0, 1\].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Material<const C: usize = 3> {
    /// Base colour ρ, linear Rec.709; of a metal it is F0.
    pub albedo: [f64; C],
    /// Perceptual roughness r, α = r².
    pub roughness: f64,
    /// Metallic m.
    pub metallic: f64,
}

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

    /// Fills in the functions of a block at its clamped n·v; derivatives by n·v only where they are
    /// asked for.
    fn fill_functions<I: Isa, T: Real>(
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

    /// Derivatives by normal and mirror direction of Σ_ck g_ck Σ_j s_cj R_jk, with the cotangent g.
    fn lobe_by_normal<const C: usize>(
        [normal, mirror]: [DVec3; 2],
        factors: &Self::Factors<C>,
        cotangent: &Weights<C>,
    ) -> [DVec3; 2] {
        let mut by_lobe = [0.0; MAX_ENTRIES];
        for c in 0..C {
            each_entry::<Self, COEFFICIENTS>(|k, row, entry| {
                by_lobe[entry] += cotangent[c][k] * factors.row(c, row);
            });
        }
        Self::lobe_adjoint::<f64, COEFFICIENTS>(normal.to_array(), mirror.to_array(), |entry| {
            by_lobe[entry]
        })
        .map(DVec3::from)
    }

    /// Number of rows.
    const ROWS: usize = Self::FIRST_ROW[BANDS];
}

/// Factors of the weights that depend on the material, with what their derivatives need.
pub trait Factors<const C: usize>: Copy + Debug {
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
    /// They hold for n·v > [`MIN_COSINE`]. Up to and at it the clamped cosine stays where it is
    /// when the normal turns, and callers take 0 instead.
    fn slopes_by_cosine(&self, cosine: f64, material: &Material<C>) -> ([f64; C], [ByRow; C]);

    /// The derivative of a scalar by n·v, what each channel adds to it; arguments as of
    /// [`pull_back`](Self::pull_back), and the same holds for n·v.
    fn by_cosine(
        &self,
        cosine: f64,
        material: &Material<C>,
        by_diffuse: &[f64; C],
        by_row: &[ByRow; C],
    ) -> [f64; C];
}

/// Where the basis functions R_jk of coefficient k begin; there is one for each row of its band.
pub const fn first_entry<M: Reflection>(k: usize) -> usize {
    let (mut first, mut i) = (0, 0);
    while i < k {
        let l = BAND_OF[i];
        first += M::FIRST_ROW[l + 1] - M::FIRST_ROW[l];
        i += 1;
    }
    first
}

/// Calls `f` with every R_jk's coefficient k, row j and place, of the first K coefficients.
#[inline(always)]
pub fn each_entry<M: Reflection, const K: usize>(mut f: impl FnMut(usize, usize, usize)) {
    let mut entry = 0;
    for k in 0..K {
        for row in M::FIRST_ROW[BAND_OF[k]]..M::FIRST_ROW[BAND_OF[k] + 1] {
            f(k, row, entry);
            entry += 1;
        }
    }
}

/// What a pixel's weights need of its directions; fixed while materials change.
#[derive(Clone, Copy, Debug)]
pub struct Frame<M> {
    /// n·v, at least [`MIN_COSINE`].
    pub cosine: f64,
    /// A_l Y_k(n); entries of band 3 are 0.
    pub diffuse: [f64; COEFFICIENTS],
    /// R_jk
    pub lobe: [f64; MAX_ENTRIES],
    model: PhantomData<M>,
}

/// The clamped n·v and the mirror direction; the latter is not clamped.
pub fn directions(normal: DVec3, view: DVec3) -> (f64, DVec3) {
    let cosine = normal.dot(view);
    (cosine.max(MIN_COSINE), 2.0 * cosine * normal - view)
}

impl<M: Reflection> Frame<M> {
    /// From unit normal and unit view direction (surface to camera).
    pub fn new(normal: DVec3, view: DVec3) -> Self {
        let (cosine, mirror) = directions(normal, view);
        Self::at(cosine, normal, mirror)
    }

    /// From the clamped n·v, the normal and the mirror direction.
    pub fn at(cosine: f64, normal: DVec3, mirror: DVec3) -> Self {
        let mut diffuse = sh::basis(normal.to_array());
        for (y, &l) in diffuse.iter_mut().zip(&BAND_OF) {
            *y *= COSINE_TRANSFER[l];
        }
        Self {
            cosine,
            diffuse,
            lobe: M::lobe(normal.to_array(), mirror.to_array()),
            model: PhantomData,
        }
    }
}

/// A [`Frame`], and how it changes with the normal.
#[derive(Clone, Copy, Debug)]
pub struct TurningFrame<M> {
    /// At this normal.
    pub frame: Frame<M>,
    normal: DVec3,
    view: DVec3,
    mirror: DVec3,
    /// A_l ∇Y_k(n)
    diffuse: [DVec3; COEFFICIENTS],
}

impl<M: Reflection> TurningFrame<M> {
    /// From unit normal and unit view direction (surface to camera).
    pub fn new(normal: DVec3, view: DVec3) -> Self {
        let (cosine, mirror) = directions(normal, view);
        let mut diffuse = sh::slopes(normal.to_array()).map(DVec3::from);
        for (slope, &l) in diffuse.iter_mut().zip(&BAND_OF) {
            *slope *= COSINE_TRANSFER[l];
        }
        Self {
            frame: Frame::at(cosine, normal, mirror),
            normal,
            view,
            mirror,
            diffuse,
        }
    }
}

/// The weights of one pixel in double precision.
pub fn shade<M: Reflection, const C: usize>(
    frame: &Frame<M>,
    material: &Material<C>,
) -> Weights<C> {
    let factors = factors_at(frame, material);
    let mut weights = [[0.0; COEFFICIENTS]; C];
    for c in 0..C {
        for k in 0..COEFFICIENTS {
            weights[c][k] = factors.diffuse(c) * frame.diffuse[k];
        }
        each_entry::<M, COEFFICIENTS>(|k, row, entry| {
            weights[c][k] += factors.row(c, row) * frame.lobe[entry];
        });
    }
    weights
}

fn factors_at<M: Reflection, const C: usize>(
    frame: &Frame<M>,
    material: &Material<C>,
) -> M::Factors<C> {
    let functions = M::functions(frame.cosine, material.roughness);
    M::factors(frame.cosine, material, functions)
}

/// The adjoint of [`shade`] by the material: `cotangent` holds the derivatives of a scalar by the
/// weights, the result its derivatives by albedo, roughness and metallic.
pub fn shade_vjp<M: Reflection, const C: usize>(
    frame: &Frame<M>,
    material: &Material<C>,
    cotangent: &Weights<C>,
) -> Material<C> {
    let (by_diffuse, by_row) = sums(frame, cotangent);
    factors_at(frame, material).pull_back(material, &by_diffuse, &by_row)
}

/// [`shade_vjp`], and the derivative by the normal: a vector in the normal's tangent plane, so that
/// its product with a small turn dn of the normal is the change of the scalar.
///
/// With g_ck the cotangent and R the mirror direction, dR = 2(v·dn)n + 2(n·v)dn and d(n·v) = v·dn:
///
/// ```text
/// g_jk = Σ_c g_ck s_cj               g_R = Σ_jk g_jk ∂R_jk/∂R
/// g_x  = Σ_ck g_ck (∂kd_c/∂x A_l Y_k(n) + Σ_j ∂s_cj/∂x R_jk)           0 where n·v ≤ 10⁻⁴
/// g_n  = Σ_ck g_ck kd_c A_l ∇Y_k(n) + Σ_jk g_jk ∂R_jk/∂n + 2(g_R·n)v + 2(n·v)g_R + g_x v
/// ```
///
/// of which the part along n is taken away. The mirror direction is not clamped, so g_R holds
/// everywhere.
pub fn shade_vjp_by_normal<M: Reflection, const C: usize>(
    turning: &TurningFrame<M>,
    material: &Material<C>,
    cotangent: &Weights<C>,
) -> (Material<C>, DVec3) {
    let TurningFrame {
        frame,
        normal,
        view,
        mirror,
        diffuse,
    } = turning;
    let (by_diffuse, by_row) = sums(frame, cotangent);
    let factors = factors_at(frame, material);
    let mut by_normal = DVec3::ZERO;
    for c in 0..C {
        for k in 0..COEFFICIENTS {
            by_normal += cotangent[c][k] * factors.diffuse(c) * diffuse[k];
        }
    }
    let [lobe_by_normal, by_mirror] = M::lobe_by_normal([*normal, *mirror], &factors, cotangent);
    let cosine = normal.dot(*view);
    by_normal += lobe_by_normal + 2.0 * (by_mirror.dot(*normal) * *view + cosine * by_mirror);
    if cosine > MIN_COSINE {
        for by in factors.by_cosine(cosine, material, &by_diffuse, &by_row) {
            by_normal += by * *view;
        }
    }
    (
        factors.pull_back(material, &by_diffuse, &by_row),
        by_normal - by_normal.dot(*normal) / normal.length_squared() * *normal,
    )
}

/// Σ_k g_ck A_l Y_k(n), and for each row Σ_k g_ck R_jk.
fn sums<M: Reflection, const C: usize>(
    frame: &Frame<M>,
    cotangent: &Weights<C>,
) -> ([f64; C], [ByRow; C]) {
    let (mut by_diffuse, mut by_row) = ([0.0; C], [[0.0; MAX_ROWS]; C]);
    for c in 0..C {
        for k in 0..COEFFICIENTS {
            by_diffuse[c] += cotangent[c][k] * frame.diffuse[k];
        }
        each_entry::<M, COEFFICIENTS>(|k, row, entry| {
            by_row[c][row] += cotangent[c][k] * frame.lobe[entry];
        });
    }
    (by_diffuse, by_row)
}
