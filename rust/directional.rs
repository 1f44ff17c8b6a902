//! Light from single directions with the full reflection model: relighting by lamps and the sun.
//!
//! SH light cannot hold a sharp lamp, so nothing here is projected. The paper's eqs. 1 and 3-5 are
//! evaluated as they are, without the approximations of eq. 12 that [`shade`](crate::shade) makes.

use std::f64::consts::{FRAC_1_PI, PI};

use glam::DVec3;

use crate::ggx::{DIELECTRIC_F0, MIN_COSINE, schlick, smith_g1};
use crate::render::pictures;
use crate::shade::Material;
use crate::{Result, check};

/// Pixels in a piece of work.
const PIECE: usize = 1024;

/// Colours up to here do not overflow: a surface reflects at most 10³⁵ times as much.
const LARGEST_COLOR: f64 = 1e260;

/// Light from one direction, infinitely far away.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DirectionalLight {
    /// Unit vector from the surface to the light.
    pub direction: DVec3,
    /// Radiance, linear Rec.709, of a white diffuse surface without Fresnel loss that faces the
    /// light: its irradiance over π.
    pub color: [f64; 3],
}

/// Radiance of one pixel under unit light from `light`: π f_r (n·l) by channel.
///
/// Light of irradiance π on a surface that faces it is L(l') = π δ(l'−l), so that eq. 1 gives
///
/// ```text
/// I = ∫ f_r(v, l') L(l') (n·l') dl' = π f_r(v, l) (n·l),      0 where n·l ≤ 0
/// f_r = (1−F)(1−m) ρ/π + D F G₁(n·v) G₁(n·l) / (4 (n·v)(n·l)),   h = (v+l)/|v+l|      (3)
/// D = α² / (π ((n·h)²(α²−1) + 1)²)                              α = r²                (4)
/// F = F0 + (1−F0)(1−v·h)⁵,  F0 = 0.04(1−m) + mρ                                       (5)
/// ```
///
/// The root of D cancels where α is small: 1 − (n·h)² has lost all digits at the angles where a
/// narrow lobe lives. With θ between n and h it is (n·h)²(α²−1) + 1 = sin²θ + α² cos²θ, and sin θ =
/// |n×h| keeps its digits:
///
/// ```text
/// D = (α / (sin²θ + α² cos²θ))² / π.
/// ```
///
/// At θ = 0 this is 1/(πα²), which overflows. But rounded unit vectors that are equal may differ by
/// ε = 2⁻⁵², and so sin θ counts as no less than that. D stays below 1/(4πε²), a lobe with α ≫ ε is
/// as it was, and narrower ones fade to what a mirror shows of a point, nothing.
///
/// As elsewhere n·v is at least [`MIN_COSINE`].
#[inline]
pub fn reflected(normal: DVec3, view: DVec3, material: &Material, light: DVec3) -> [f64; 3] {
    let n_dot_l = normal.dot(light);
    let bisector = view + light;
    // From straight behind there is no half vector, and below the smallest normal number G₁'s
    // quotient overflows.
    if n_dot_l < f64::MIN_POSITIVE || bisector == DVec3::ZERO {
        return [0.0; 3];
    }
    let n_dot_v = normal.dot(view).max(MIN_COSINE);
    let half = bisector.normalize();
    let grazing = schlick(view.dot(half).clamp(0.0, 1.0));

    let alpha = material.roughness * material.roughness;
    let cosine = normal.dot(half);
    let sine2 = normal.cross(half).length_squared();
    let spread = sine2.max(f64::EPSILON * f64::EPSILON) + alpha * alpha * cosine * cosine;
    let root = alpha / spread;
    let distribution = FRAC_1_PI * root * root;
    let (masking_v, _) = smith_g1(n_dot_v, material.roughness);
    let (masking_l, _) = smith_g1(n_dot_l, material.roughness);
    // π D G₁ G₁ / (4 (n·v)(n·l)) · (n·l)
    let lobe = PI * distribution * masking_v * masking_l / (4.0 * n_dot_v);
    let matt = 1.0 - material.metallic;
    material.albedo.map(|rho| {
        let f0 = DIELECTRIC_F0 * matt + material.metallic * rho;
        let fresnel = f0 + (1.0 - f0) * grazing;
        (1.0 - fresnel) * matt * rho * n_dot_l + fresnel * lobe
    })
}

/// Radiance of every pixel under every light: (light, pixel, channel).
///
/// `threads` = 0 means one for each processor; the result does not depend on it.
pub fn render_directional(
    normals: &[DVec3],
    views: &[DVec3],
    materials: &[Material],
    lights: &[DirectionalLight],
    threads: usize,
) -> Result<Vec<f64>> {
    let pixels = normals.len();
    check::length("views", pixels, views.len())?;
    check::length("materials", pixels, materials.len())?;
    check::unit_vectors("normals", normals)?;
    check::unit_vectors("views", views)?;
    for light in lights {
        check::unit_vectors("directions", &[light.direction])?;
        check::moderate("colors", &light.color, LARGEST_COLOR)?;
    }
    pictures(lights.len(), pixels, PIECE, threads, |first, parts| {
        for (light, part) in lights.iter().zip(parts) {
            let pixels = part.as_chunks_mut::<3>().0.iter_mut();
            for (p, pixel) in (first..).zip(pixels) {
                let unit = reflected(normals[p], views[p], &materials[p], light.direction);
                *pixel = [0, 1, 2].map(|c| unit[c] * light.color[c]);
            }
        }
    })
}
