//! The weights of SH light at one pixel, and their derivatives by all of its unknowns.

use glam::DVec3;

use crate::reflectance::ggx::MIN_COSINE;
use crate::reflectance::planes::{MAX_ROWS, Material, directions};
use crate::reflectance::reflection::{Factors, Reflection, each_entry};
use crate::reflectance::sh::{self, BAND_OF, COEFFICIENTS, COSINE_TRANSFER};
use crate::reflectance::shade::Frame;

/// What each weight is derived by: its channel's albedo, roughness, metallic, both tangent offsets.
pub(super) const SLOPES_OF_SAMPLE: usize = 5;

/// The derivatives of w_ck, by channel and unknown.
///
/// Those by the material are what the adjoint of the factors makes of kd_c alone, and of each s_cj
/// alone:
///
/// ```text
/// ∂w_ck/∂x = ∂kd_c/∂x A_l Y_k(n) + Σ_j ∂s_cj/∂x R_jk.
/// ```
///
/// Those by a tangent offset a, with the clamped x = n·v, ∂x/∂a = v·∂n/∂a (0 where n·v ≤ 10⁻⁴) and
/// the mirror direction R, ∂R/∂a = 2 (v·∂n/∂a) n + 2 (n·v) ∂n/∂a, which is not clamped, are
///
/// ```text
/// ∂w_ck/∂a = kd_c A_l ∇Y_k(n)·∂n/∂a + (dkd_c/dx) (∂x/∂a) A_l Y_k(n)
///          + Σ_j s_cj ∂R_jk/∂a + (ds_cj/dx) (∂x/∂a) R_jk.
/// ```
pub(super) fn weight_slopes<M: Reflection>(
    [normal, view]: [DVec3; 2],
    material: &Material,
    by_offset: Option<&[DVec3; 2]>,
) -> [[[f64; COEFFICIENTS]; SLOPES_OF_SAMPLE]; 3] {
    let (cosine, mirror) = directions(normal, view);
    let frame = Frame::<M>::at(cosine, normal, mirror);
    let functions = M::functions(cosine, material.roughness);
    let mut slopes = [[[0.0; COEFFICIENTS]; SLOPES_OF_SAMPLE]; 3];
    for c in 0..3 {
        let of_channel = Material {
            albedo: [material.albedo[c]],
            roughness: material.roughness,
            metallic: material.metallic,
        };
        let factors = M::factors(cosine, &of_channel, functions);
        let by_material = |by_diffuse, by_row| {
            let by = factors.pull_back(&of_channel, &[by_diffuse], &[by_row]);
            [by.albedo[0], by.roughness, by.metallic]
        };
        let diffuse = by_material(1.0, [0.0; MAX_ROWS]);
        let mut rows = [[0.0; 3]; MAX_ROWS];
        for j in 0..M::ROWS {
            let mut alone = [0.0; MAX_ROWS];
            alone[j] = 1.0;
            rows[j] = by_material(0.0, alone);
        }
        for x in 0..3 {
            for k in 0..COEFFICIENTS {
                slopes[c][x][k] = diffuse[x] * frame.diffuse[k];
            }
            each_entry::<M, COEFFICIENTS>(|k, j, entry| {
                slopes[c][x][k] += rows[j][x] * frame.lobe[entry];
            });
        }
    }
    let Some(by_offset) = by_offset else {
        return slopes;
    };
    let factors = M::factors(cosine, material, functions);
    let (diffuse_slopes, row_slopes) = factors.slopes_by_cosine(cosine, material);
    let of_basis = sh::slopes(normal.to_array()).map(DVec3::from);
    for (t, &turned) in by_offset.iter().enumerate() {
        let along_view = view.dot(turned);
        let by_mirror = 2.0 * (along_view * normal + normal.dot(view) * turned);
        let by_cosine = if normal.dot(view) > MIN_COSINE {
            along_view
        } else {
            0.0
        };
        let places = [normal, mirror].map(|d| d.to_array());
        let change = [turned, by_mirror].map(|d| d.to_array());
        let lobe = M::lobe_along(places, change);
        for c in 0..3 {
            let weights = &mut slopes[c][3 + t];
            for k in 0..COEFFICIENTS {
                let basis = COSINE_TRANSFER[BAND_OF[k]] * of_basis[k].dot(turned);
                weights[k] =
                    factors.diffuse(c) * basis + by_cosine * diffuse_slopes[c] * frame.diffuse[k];
            }
            each_entry::<M, COEFFICIENTS>(|k, j, entry| {
                weights[k] += factors.row(c, j) * lobe[entry]
                    + by_cosine * row_slopes[c][j] * frame.lobe[entry];
            });
        }
    }
    slopes
}

/// Σ_k w_k L_k
#[inline]
pub(super) fn under(weights: &[f64; COEFFICIENTS], light: &[f64; COEFFICIENTS]) -> f64 {
    let mut sum = 0.0;
    for k in 0..COEFFICIENTS {
        sum += weights[k] * light[k];
    }
    sum
}
