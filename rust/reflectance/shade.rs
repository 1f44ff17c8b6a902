//! One pixel: from material and directions to the 16 weights of each colour channel, and back.
//!
//! Radiance is linear in the light, I_c = Σ_k w_ck L_kc, and what a surface does with it is a matt
//! part and a lobe:
//!
//! ```text
//! w_ck = kd_c A_l Y_k(n) + Σ_j s_cj R_jk
//! ```
//!
//! with the rows and factors of a [`Reflection`] model.

use std::marker::PhantomData;

use glam::DVec3;

use super::ggx::MIN_COSINE;
use super::planes::{ByRow, MAX_ENTRIES, MAX_LOBE, MAX_ROWS, Material, directions};
use super::reflection::{Factors, Reflection, Weights, each_entry};
use super::sh::{self, BAND_OF, COEFFICIENTS, COSINE_TRANSFER};

/// What a pixel's weights need of its directions; fixed while materials change.
#[derive(Clone, Copy, Debug)]
pub struct Frame<M> {
    /// n·v, at least [`MIN_COSINE`].
    pub cosine: f64,
    /// A_l Y_k(n); entries of band 3 are 0.
    pub diffuse: [f64; COEFFICIENTS],
    /// R_jk, or where surroundings block light what a [transfer](crate::transport) has in its place.
    pub lobe: [f64; MAX_LOBE],
    model: PhantomData<M>,
}

impl<M: Reflection> Frame<M> {
    /// From unit normal and unit view direction (surface to camera).
    pub fn new(normal: DVec3, view: DVec3) -> Self {
        let (cosine, mirror) = directions(normal, view);
        Self::at(cosine, normal, mirror)
    }

    /// From the clamped n·v, the normal and the mirror direction.
    #[inline(always)]
    pub fn at(cosine: f64, normal: DVec3, mirror: DVec3) -> Self {
        let mut diffuse = sh::basis(normal.to_array());
        for (y, &l) in diffuse.iter_mut().zip(&BAND_OF) {
            *y *= COSINE_TRANSFER[l];
        }
        let mut lobe = [0.0; MAX_LOBE];
        lobe[..MAX_ENTRIES].copy_from_slice(&M::lobe(normal.to_array(), mirror.to_array()));
        Self {
            cosine,
            diffuse,
            lobe,
            model: PhantomData,
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

pub(crate) fn factors_at<M: Reflection, const C: usize>(
    frame: &Frame<M>,
    material: &Material<C>,
) -> M::Factors<C> {
    let functions = M::functions(frame.cosine, material.roughness);
    M::factors(frame.cosine, material, functions)
}

/// The adjoint of [`shade`]: `cotangent` holds the derivatives of a scalar by the weights, the result
/// its derivatives by the material and by the normal. The latter is a vector in the normal's tangent
/// plane, so that its product with a small change dn of the normal is the change of the scalar.
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
pub fn shade_vjp<M: Reflection, const C: usize>(
    normal: DVec3,
    view: DVec3,
    material: &Material<C>,
    cotangent: &Weights<C>,
) -> (Material<C>, DVec3) {
    let (cosine, mirror) = directions(normal, view);
    let frame = Frame::<M>::at(cosine, normal, mirror);
    let (by_diffuse, by_row) = sums(&frame, cotangent);
    let factors = factors_at(&frame, material);
    let mut by_normal = DVec3::ZERO;
    let mut by_lobe = [0.0; MAX_ENTRIES];
    let slopes = sh::slopes(normal.to_array()).map(DVec3::from);
    for c in 0..C {
        for k in 0..COEFFICIENTS {
            let transfer = COSINE_TRANSFER[BAND_OF[k]];
            by_normal += cotangent[c][k] * factors.diffuse(c) * transfer * slopes[k];
        }
        each_entry::<M, COEFFICIENTS>(|k, row, entry| {
            by_lobe[entry] += cotangent[c][k] * factors.row(c, row);
        });
    }
    let places = [normal, mirror].map(|d| d.to_array());
    let [lobe_by_normal, by_mirror] =
        M::lobe_adjoint::<f64, COEFFICIENTS>(places[0], places[1], |entry| by_lobe[entry])
            .map(DVec3::from);
    let cosine = normal.dot(view);
    by_normal += lobe_by_normal + 2.0 * (by_mirror.dot(normal) * view + cosine * by_mirror);
    if cosine > MIN_COSINE {
        for by in factors.by_cosine(cosine, material, &by_diffuse, &by_row) {
            by_normal += by * view;
        }
    }
    (
        factors.pull_back(material, &by_diffuse, &by_row),
        by_normal - by_normal.dot(normal) / normal.length_squared() * normal,
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
