//! Light from single directions with the full reflection models: relighting by lamps and the sun.
//!
//! SH light cannot hold a sharp lamp, so nothing here is projected: reflection is evaluated point
//! by point. Of the paper that is eqs. 1 and 3-5 as they are, without the approximations of eq. 12
//! that [`shade`](crate::reflectance::shade) makes; of the principled model the BRDF whose integral
//! over SH light `shade` has.

use std::f64::consts::{FRAC_1_PI, PI};

use glam::DVec3;

use crate::problem::render::pictures;
use crate::reflectance::ggx::{DIELECTRIC_F0, MIN_COSINE, schlick, smith_g1};
use crate::reflectance::lobe_table;
use crate::reflectance::model::Model;
use crate::reflectance::planes::Material;
use crate::reflectance::principled::{self, Mixer};
use crate::runtime::{Result, check};

/// Pixels in a piece of work.
const PIECE: usize = 1024;

/// Largest colour of a light that is taken, a radiance. It does not overflow: a surface reflects at
/// most 10³⁵ times as much.
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

/// Radiance of one pixel under unit light from a direction: π f_r (n·l) by channel.
///
/// Light of irradiance π on a surface that faces it is L(l') = π δ(l'−l), so that the paper's eq. 1
/// gives
///
/// ```text
/// I = ∫ f_r(v, l') L(l') (n·l') dl' = π f_r(v, l) (n·l),      0 where n·l ≤ 0,   h = (v+l)/|v+l|
/// ```
///
/// with, as the paper has it,
///
/// ```text
/// f_r = (1−F)(1−m) ρ/π + D F G₁(n·v) G₁(n·l) / (4 (n·v)(n·l))                         (3)
/// D = α² / (π ((n·h)²(α²−1) + 1)²)                              α = r²                (4)
/// F = F0 + (1−F0)(1−v·h)⁵,  F0 = 0.04(1−m) + mρ                                       (5)
/// ```
///
/// and as the principled model has it, with kd and M of [`principled`], Fresnel's equations F_g of
/// glass, and the height-correlated Smith masking V = G/(4 (n·v)(n·l)) (E. Heitz, "Understanding the
/// masking-shadowing function in microfacet-based BRDFs", JCGT 2014, eq. 99),
///
/// ```text
/// f_r = kd + D V ((1−m) M(0.04) F_g(v·h) + m M(ρ) F(v·h))       F = ρ + (1−ρ)(1−v·h)⁵
/// V   = ½ / ((n·l) √((n·v)²(1−α²) + α²) + (n·v) √((n·l)²(1−α²) + α²)).
/// ```
///
/// As elsewhere n·v is at least [`MIN_COSINE`].
pub struct Surface<'a> {
    normal: DVec3,
    view: DVec3,
    material: &'a Material,
    n_dot_v: f64,
    alpha: f64,
    kind: Kind,
}

/// What of a surface no light changes.
enum Kind {
    Paper,
    /// Of each channel kd, and by what the dielectric's and the metal's lobe are multiplied.
    Principled([[f64; 3]; 3]),
}

impl<'a> Surface<'a> {
    /// From unit normal and unit view direction (surface to camera).
    pub fn new(model: Model, normal: DVec3, view: DVec3, material: &'a Material) -> Self {
        let n_dot_v = normal.dot(view).max(MIN_COSINE);
        let kind = match model {
            Model::Paper => Kind::Paper,
            Model::Principled => Kind::Principled(parts(n_dot_v, material)),
        };
        Self {
            normal,
            view,
            material,
            n_dot_v,
            alpha: material.roughness * material.roughness,
            kind,
        }
    }

    /// Radiance under unit light from `light`, a unit vector from the surface.
    #[inline]
    pub fn reflected(&self, light: DVec3) -> [f64; 3] {
        let n_dot_l = self.normal.dot(light);
        let bisector = self.view + light;
        // From straight behind there is no half vector, and below the smallest normal number
        // quotients of masking overflow.
        if n_dot_l < f64::MIN_POSITIVE || bisector == DVec3::ZERO {
            return [0.0; 3];
        }
        let half = bisector.normalize();
        let cosine = self.view.dot(half).clamp(0.0, 1.0);
        let grazing = schlick(cosine);
        let distribution = distribution(self.normal, half, self.alpha);
        let n_dot_v = self.n_dot_v;
        match &self.kind {
            Kind::Paper => {
                let Material {
                    albedo,
                    roughness,
                    metallic,
                } = *self.material;
                let (masking_v, _) = smith_g1(n_dot_v, roughness);
                let (masking_l, _) = smith_g1(n_dot_l, roughness);
                // π D G₁ G₁ / (4 (n·v)(n·l)) · (n·l)
                let lobe = PI * distribution * masking_v * masking_l / (4.0 * n_dot_v);
                let matt = 1.0 - metallic;
                albedo.map(|rho| {
                    let f0 = DIELECTRIC_F0 * matt + metallic * rho;
                    let fresnel = f0 + (1.0 - f0) * grazing;
                    (1.0 - fresnel) * matt * rho * n_dot_l + fresnel * lobe
                })
            }
            Kind::Principled(parts) => {
                // π D V · (n·l)
                let lobe = PI * distribution * masked_cosine(n_dot_v, n_dot_l, self.alpha);
                let glass = glass(cosine);
                let mut reflected = [0.0; 3];
                for c in 0..3 {
                    let ([ground, dielectric, metal], rho) = (parts[c], self.material.albedo[c]);
                    let fresnel = dielectric * glass + metal * (rho + (1.0 - rho) * grazing);
                    reflected[c] = PI * ground * n_dot_l + lobe * fresnel;
                }
                reflected
            }
        }
    }
}

/// See [`Kind::Principled`].
fn parts(n_dot_v: f64, material: &Material) -> [[f64; 3]; 3] {
    let [values, _, _] = lobe_table::values(material.roughness, n_dot_v);
    let mixer = Mixer::new(material.metallic, principled::Surface::of(|f| values[f]));
    material.albedo.map(|rho| mixer.parts(rho))
}

/// Fresnel's equations for unpolarised light at an index of refraction of 1.5, 0.04 head on.
#[inline]
fn glass(cosine: f64) -> f64 {
    // In the form of R. L. Cook, K. E. Torrance, "A reflectance model for computer graphics", 1982,
    // with g = √(1.5² − 1 + c²).
    let c = cosine;
    let g = (1.25 + c * c).sqrt();
    let (across, along) = ((g - c) / (g + c), (c * (g + c) - 1.0) / (c * (g - c) + 1.0));
    0.5 * across * across * (1.0 + along * along)
}

/// D of the angle θ between n and h.
///
/// The root of D cancels where α is small: 1 − (n·h)² has lost all digits at the angles where a
/// narrow lobe lives. But (n·h)²(α²−1) + 1 = sin²θ + α² cos²θ, and sin θ = |n×h| keeps its digits:
///
/// ```text
/// D = (α / (sin²θ + α² cos²θ))² / π.
/// ```
///
/// At θ = 0 this is 1/(πα²), which overflows. But rounded unit vectors that are equal may differ by
/// ε = 2⁻⁵², and so sin θ counts as no less than that. D stays below 1/(4πε²), a lobe with α ≫ ε is
/// as it was, and narrower ones fade to what a mirror shows of a point, nothing.
#[inline]
fn distribution(normal: DVec3, half: DVec3, alpha: f64) -> f64 {
    let cosine = normal.dot(half);
    let sine2 = normal.cross(half).length_squared();
    let denominator = sine2.max(f64::EPSILON * f64::EPSILON) + alpha * alpha * cosine * cosine;
    let root = alpha / denominator;
    FRAC_1_PI * root * root
}

/// V (n·l) of the principled model, at most 1/(4 n·v).
///
/// (n·l)²(1−α²) + α² is (n·l)² + α² (1−(n·l)²), whose terms may both underflow; a root that is taken
/// of neither does not.
#[inline]
fn masked_cosine(n_dot_v: f64, n_dot_l: f64, alpha: f64) -> f64 {
    let slanted = |x: f64| x.hypot(alpha * ((1.0 - x) * (1.0 + x)).max(0.0).sqrt());
    0.5 * n_dot_l / (n_dot_l * slanted(n_dot_v) + n_dot_v * slanted(n_dot_l))
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
    model: Model,
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
        let count = parts.first().map_or(0, |part| part.len() / 3);
        for i in 0..count {
            let p = first + i;
            let surface = Surface::new(model, normals[p], views[p], &materials[p]);
            for (light, part) in lights.iter().zip(parts.iter_mut()) {
                let unit = surface.reflected(light.direction);
                for c in 0..3 {
                    part[3 * i + c] = unit[c] * light.color[c];
                }
            }
        }
    })
}
