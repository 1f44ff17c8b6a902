//! The weights of SH light at one pixel, and their derivatives by all of its unknowns.

use glam::DVec3;

use crate::reflectance::ggx::MIN_COSINE;
use crate::reflectance::planes::{MAX_ROWS, Material, directions};
use crate::reflectance::reflection::{Factors, Reflection, each_entry};
use crate::reflectance::sh::{self, BAND_OF, COSINE_TRANSFER};
use crate::reflectance::shade::Frame;

/// What each weight is derived by: its channel's albedo, roughness, metallic, both tangent offsets.
pub(super) const SLOPES_OF_SAMPLE: usize = 5;

/// The weights w_ck of the first K coefficients, by channel, and their derivatives, by channel and
/// unknown.
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
#[inline(always)]
pub(super) fn weights_with_slopes<M: Reflection, const K: usize>(
    [normal, view]: [DVec3; 2],
    material: &Material,
    by_offset: &[DVec3; 2],
) -> ([[f64; K]; 3], [[[f64; K]; SLOPES_OF_SAMPLE]; 3]) {
    let (cosine, mirror) = directions(normal, view);
    let frame = Frame::<M>::at(cosine, normal, mirror);
    let functions = M::functions(cosine, material.roughness);
    let factors = M::factors(cosine, material, functions);
    let mut weights = [[0.0; K]; 3];
    let mut slopes = [[[0.0; K]; SLOPES_OF_SAMPLE]; 3];
    for c in 0..3 {
        let of_channel = Material {
            albedo: [material.albedo[c]],
            roughness: material.roughness,
            metallic: material.metallic,
        };
        let alone = M::factors(cosine, &of_channel, functions);
        let by_material = |by_diffuse, by_row| {
            let by = alone.pull_back(&of_channel, &[by_diffuse], &[by_row]);
            [by.albedo[0], by.roughness, by.metallic]
        };
        let diffuse = by_material(1.0, [0.0; MAX_ROWS]);
        let mut rows = [[0.0; 3]; MAX_ROWS];
        each_entry::<M, K>(|_, j, _| {
            let mut alone = [0.0; MAX_ROWS];
            alone[j] = 1.0;
            rows[j] = by_material(0.0, alone);
        });
        for k in 0..K {
            weights[c][k] = factors.diffuse(c) * frame.diffuse[k];
            for x in 0..3 {
                slopes[c][x][k] = diffuse[x] * frame.diffuse[k];
            }
        }
        each_entry::<M, K>(|k, j, entry| {
            weights[c][k] += factors.row(c, j) * frame.lobe[entry];
            for x in 0..3 {
                slopes[c][x][k] += rows[j][x] * frame.lobe[entry];
            }
        });
    }
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
            let slopes = &mut slopes[c][3 + t];
            for k in 0..K {
                let basis = COSINE_TRANSFER[BAND_OF[k]] * of_basis[k].dot(turned);
                slopes[k] =
                    factors.diffuse(c) * basis + by_cosine * diffuse_slopes[c] * frame.diffuse[k];
            }
            each_entry::<M, K>(|k, j, entry| {
                slopes[k] += factors.row(c, j) * lobe[entry]
                    + by_cosine * row_slopes[c][j] * frame.lobe[entry];
            });
        }
    }
    (weights, slopes)
}
