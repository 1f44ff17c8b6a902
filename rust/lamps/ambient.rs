//! What a pixel makes of light that comes alike from all sides, and its derivatives.

use glam::DVec3;

use crate::reflectance::ggx::MIN_COSINE;
use crate::reflectance::planes::{MAX_ROWS, Material, directions};
use crate::reflectance::reflection::{Factors, Reflection};
use crate::reflectance::shade::Frame;

/// What radiance is derived by: its channel's albedo, roughness, metallic, both tangent offsets.
pub(super) const SLOPES_OF_SAMPLE: usize = 5;

/// By channel, and their derivatives.
pub(super) type AmbientSlopes = ([f64; 3], [[f64; SLOPES_OF_SAMPLE]; 3]);

/// The weights w_c of the first coefficient of SH light, and their derivatives by channel:
///
/// ```text
/// w_c = kd_c A₀ Y₀ + s_c0 R₀,        ∂w_c/∂a = (∂kd_c/∂x A₀ Y₀ + ∂s_c0/∂x R₀) v·∂n/∂a
/// ```
///
/// by a tangent offset a with x = n·v, as neither Y₀ nor R₀ depend on directions; 0 where n·v ≤ 10⁻⁴.
/// Those by the material are what the adjoint of the factors makes of w_c.
#[inline(always)]
pub(super) fn weights_with_slopes<M: Reflection>(
    [normal, view]: [DVec3; 2],
    material: &Material,
    turned: &[DVec3; 2],
) -> AmbientSlopes {
    let (cosine, mirror) = directions(normal, view);
    let frame = Frame::<M>::at(cosine, normal, mirror);
    let functions = M::functions_of_band_0(cosine, material.roughness);
    let factors = M::factors(cosine, material, functions);
    let (diffuse_slopes, row_slopes) = factors.slopes_by_cosine(cosine, material);
    let (matt, lobe) = (frame.diffuse[0], frame.lobe[0]);
    let turns = normal.dot(view) > MIN_COSINE;
    let (mut weights, mut slopes) = ([0.0; 3], [[0.0; SLOPES_OF_SAMPLE]; 3]);
    for c in 0..3 {
        let of_channel = Material {
            albedo: [material.albedo[c]],
            roughness: material.roughness,
            metallic: material.metallic,
        };
        let mut rows = [0.0; MAX_ROWS];
        rows[0] = lobe;
        let alone = M::factors(cosine, &of_channel, functions);
        let by = alone.pull_back(&of_channel, &[matt], &[rows]);
        weights[c] = factors.diffuse(c) * matt + factors.row(c, 0) * lobe;
        slopes[c][..3].copy_from_slice(&[by.albedo[0], by.roughness, by.metallic]);
        if turns {
            let by_cosine = diffuse_slopes[c] * matt + row_slopes[c][0] * lobe;
            slopes[c][3] = by_cosine * view.dot(turned[0]);
            slopes[c][4] = by_cosine * view.dot(turned[1]);
        }
    }
    (weights, slopes)
}
