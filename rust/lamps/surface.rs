//! Radiance of one pixel under unit light from single directions.

use std::f64::consts::PI;

use glam::DVec3;

use super::microfacets::{distribution, glass, masked_cosine, slanted};
use crate::reflectance::ggx::{DIELECTRIC_F0, MIN_COSINE, schlick, smith_g1};
use crate::reflectance::lobe_table;
use crate::reflectance::model::Model;
use crate::reflectance::planes::Material;
use crate::reflectance::principled::{self, Mixer, Parts};

/// Small disks that a large one is made of.
const PARTS: usize = 16;
/// π (3 − √5), radians: points at its multiples are never in line.
const GOLDEN_ANGLE: f64 = 2.399_963_229_728_653;

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
    /// G₁(n·v)
    Paper(f64),
    /// S(n·v), and by channel.
    Principled(f64, [Parts; 3]),
}

impl<'a> Surface<'a> {
    /// From unit normal and unit view direction (surface to camera).
    pub fn new(model: Model, normal: DVec3, view: DVec3, material: &'a Material) -> Self {
        let n_dot_v = normal.dot(view).max(MIN_COSINE);
        let alpha = material.roughness * material.roughness;
        let kind = match model {
            Model::Paper => Kind::Paper(smith_g1(n_dot_v, material.roughness).0),
            Model::Principled => {
                Kind::Principled(slanted(n_dot_v, alpha), parts(n_dot_v, material))
            }
        };
        Self {
            normal,
            view,
            material,
            n_dot_v,
            alpha,
            kind,
        }
    }

    /// Radiance under unit light from `light`, a unit vector from the surface, of a lamp that is a
    /// disk of the angular radius `extent`, radians: the mean of [`PARTS`] smaller ones.
    pub fn reflected_of_disk(&self, light: DVec3, extent: f64) -> [f64; 3] {
        if extent == 0.0 {
            return self.reflected(light);
        }
        let (across, up) = light.any_orthonormal_pair();
        let mut sum = [0.0; 3];
        for k in 0..PARTS {
            // A spiral fills the disk evenly.
            let part = (k as f64 + 0.5) / PARTS as f64;
            let (radius, turn) = (extent * part.sqrt(), k as f64 * GOLDEN_ANGLE);
            let aside = turn.cos() * across + turn.sin() * up;
            let direction = radius.cos() * light + radius.sin() * aside;
            let unit = self.reflected_of_part(direction, extent / (PARTS as f64).sqrt());
            for c in 0..3 {
                sum[c] += unit[c] / PARTS as f64;
            }
        }
        sum
    }

    /// Radiance under unit light from `light`, a unit vector from the surface.
    #[inline]
    pub fn reflected(&self, light: DVec3) -> [f64; 3] {
        self.reflected_of_part(light, 0.0)
    }

    /// The same of a small disk at once.
    ///
    /// It is seen by a lobe as a lamp without extent by a wider one, of α² + ρ²/4: near its middle
    /// GGX is a Gaussian of variance α²/4 an axis of h, a disk has ρ²/4 of l, a quarter of that of
    /// h. The cosine n·l is [`mean_cosine`].
    #[inline]
    fn reflected_of_part(&self, light: DVec3, extent: f64) -> [f64; 3] {
        let n_dot_l = mean_cosine(self.normal.dot(light), extent);
        let bisector = self.view + light;
        // From straight behind there is no half vector. Below the smallest normal number lengths lose
        // their digits, and quotients of masking overflow.
        if n_dot_l < f64::MIN_POSITIVE || bisector.length_squared() < f64::MIN_POSITIVE {
            return [0.0; 3];
        }
        let half = bisector.normalize();
        let cosine = self.view.dot(half).clamp(0.0, 1.0);
        let alpha = match extent {
            0.0 => self.alpha,
            _ => self.alpha.hypot(0.5 * extent).min(1.0),
        };
        let grazing = schlick(cosine);
        let distribution = distribution(self.normal, half, alpha);
        let n_dot_v = self.n_dot_v;
        match &self.kind {
            Kind::Paper(masking_v) => {
                let Material {
                    albedo,
                    roughness,
                    metallic,
                } = *self.material;
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
            Kind::Principled(of_view, parts) => {
                // π D V · (n·l)
                let lobe =
                    PI * distribution * masked_cosine(n_dot_v, *of_view, n_dot_l, self.alpha);
                let glass = glass(cosine);
                let mut reflected = [0.0; 3];
                for c in 0..3 {
                    let (parts, rho) = (&parts[c], self.material.albedo[c]);
                    let metal = parts.metal * (rho + (1.0 - rho) * grazing);
                    let fresnel = parts.dielectric * glass + metal;
                    reflected[c] = PI * parts.ground * n_dot_l + lobe * fresnel;
                }
                reflected
            }
        }
    }
}

/// Mean over a disk of the angular radius ρ of max(0, n·l), `cosine` being that of its middle.
///
/// Across the horizon n·l changes by s = ρ sin θ to either side of the middle, and a part
/// 2 √(1−t²)/π of the disk is t s away, −1 ≤ t ≤ 1, so that with x = cosine/s
///
/// ```text
/// s ∫ max(0, x + t) 2 √(1−t²)/π dt = s (x/2 + (x² √(1−x²) + x asin x)/π + 2 (1−x²)^{3/2}/(3π))
/// ```
///
/// where |x| < 1, and max(0, cosine) elsewhere.
#[inline]
pub fn mean_cosine(cosine: f64, extent: f64) -> f64 {
    let reach = extent * (1.0 - cosine * cosine).max(0.0).sqrt();
    if cosine.abs() >= reach {
        return cosine;
    }
    let x = cosine / reach;
    let root = (1.0 - x * x).sqrt();
    reach * (0.5 * x + (x * x * root + x * x.asin() + 2.0 / 3.0 * root * root * root) / PI)
}

/// See [`Kind::Principled`].
fn parts(n_dot_v: f64, material: &Material) -> [Parts; 3] {
    let [values, _, _] = lobe_table::values(material.roughness, n_dot_v);
    let mixer = Mixer::new(material.metallic, principled::Surface::of(|f| values[f]));
    material.albedo.map(|rho| mixer.parts(rho))
}
