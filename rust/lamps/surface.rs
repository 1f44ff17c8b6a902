//! Radiance of one pixel under unit light from single directions, and its derivatives by normal,
//! direction and material.

use std::f64::consts::PI;

use glam::DVec3;

use super::microfacets::{distribution, glass, glass_by_cosine, masked_cosine, slanted};
use crate::reflectance::ggx::{
    DIELECTRIC_F0, MIN_COSINE, schlick, schlick_by_cosine, smith_g1, smith_g1_by_cosine,
};
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
///
/// With `SLOPES` there are the derivatives too; else these are not worked out.
pub struct Surface<'a, const SLOPES: bool = false> {
    normal: DVec3,
    view: DVec3,
    material: &'a Material,
    n_dot_v: f64,
    /// d(n·v) by a change of n along v: 0 where n·v is raised to [`MIN_COSINE`].
    turns: f64,
    alpha: f64,
    kind: Kind,
}

/// What of a surface no light changes.
#[expect(clippy::large_enum_variant)] // one at a time, on the stack
enum Kind {
    /// G₁(n·v), and its derivative by roughness.
    Paper(f64, f64),
    /// S(n·v), and by channel.
    Principled(f64, [PartsWithSlopes; 3]),
}

/// Of one channel kd, and by what the dielectric's and the metal's lobe are multiplied.
#[derive(Clone, Copy, Debug, Default)]
struct PartsWithSlopes {
    value: Parts,
    by_albedo: Parts,
    by_metallic: Parts,
    by_roughness: Parts,
    by_n_dot_v: Parts,
}

/// Radiance of one pixel under unit light, and its derivatives.
///
/// Radiance of channel c depends on directions by x = n·v, y = n·l, and by the half vector h =
/// s/|s|, s = v + l, of which D depends on n·h and Fresnel on z = v·h. A change dl of l in its tangent
/// plane changes h by (I − hhᵀ) dl/|s|, so with T of [`distribution`]
///
/// ```text
/// ∂I/∂n = I_x v + I_y l + I_D T h                                       I_x = 0 where n·v ≤ 10⁻⁴
/// ∂I/∂l = I_y n + I_z (v − z h)/|s| + I_D T (n − (n·h) h)/|s|
/// ```
///
/// without the parts along n and along l.
#[derive(Clone, Copy, Debug, Default)]
pub struct Reflected {
    /// By channel.
    pub radiance: [f64; 3],
    /// By channel, by its own albedo.
    pub by_albedo: [f64; 3],
    /// By channel, by roughness.
    pub by_roughness: [f64; 3],
    /// By channel, by metallic.
    pub by_metallic: [f64; 3],
    normal: DVec3,
    view: DVec3,
    light: DVec3,
    half: DVec3,
    /// |s|
    bisector: f64,
    /// I_x by channel.
    by_n_dot_v: [f64; 3],
    /// I_y by channel.
    by_n_dot_l: [f64; 3],
    /// I_z by channel.
    by_v_dot_h: [f64; 3],
    /// I_D T by channel.
    by_half: [f64; 3],
}

impl Reflected {
    /// Derivatives by the normal, by channel: vectors in the normal's tangent plane, so that the product
    /// with a small change dn of the normal is the change of radiance.
    pub fn by_normal(&self) -> [DVec3; 3] {
        let [v, l, h] = [self.view, self.light, self.half].map(|d| across(d, self.normal));
        [0, 1, 2].map(|c| self.by_n_dot_v[c] * v + self.by_n_dot_l[c] * l + self.by_half[c] * h)
    }

    /// Derivatives by the light's direction, by channel: vectors in its tangent plane.
    pub fn by_direction(&self) -> [DVec3; 3] {
        if self.light == DVec3::ZERO {
            return [DVec3::ZERO; 3]; // nothing is reflected
        }
        let [n, v, h] = [self.normal, self.view, self.half];
        let [of_v, of_n] = [v, n].map(|d| across(d, h) / self.bisector);
        let [of_v, of_n, n] = [of_v, of_n, n].map(|d| across(d, self.light));
        [0, 1, 2]
            .map(|c| self.by_n_dot_l[c] * n + self.by_v_dot_h[c] * of_v + self.by_half[c] * of_n)
    }

    /// Derivatives of all channels by what turns the normal so: dn has to lie in the normal's tangent
    /// plane.
    #[inline]
    pub(super) fn along(&self, change: DVec3) -> [f64; 3] {
        let [x, y, h] = [self.view, self.light, self.half].map(|d| d.dot(change));
        let mut along = [0.0; 3];
        for c in 0..3 {
            along[c] = self.by_n_dot_v[c] * x + self.by_n_dot_l[c] * y + self.by_half[c] * h;
        }
        along
    }
}

/// A vector without its part along an axis.
fn across(vector: DVec3, axis: DVec3) -> DVec3 {
    let length2 = axis.length_squared();
    if length2 == 0.0 {
        return vector; // of a surface that reflects nothing
    }
    vector - vector.dot(axis) / length2 * axis
}

impl<'a, const SLOPES: bool> Surface<'a, SLOPES> {
    /// From unit normal and unit view direction (surface to camera).
    pub fn new(model: Model, normal: DVec3, view: DVec3, material: &'a Material) -> Self {
        let cosine = normal.dot(view);
        let n_dot_v = cosine.max(MIN_COSINE);
        let alpha = material.roughness * material.roughness;
        let kind = match model {
            Model::Paper => {
                let (masking, by_roughness) = smith_g1(n_dot_v, material.roughness);
                Kind::Paper(masking, by_roughness)
            }
            Model::Principled => {
                let parts = parts::<SLOPES>(n_dot_v, material);
                Kind::Principled(slanted(n_dot_v, alpha), parts)
            }
        };
        Self {
            normal,
            view,
            material,
            n_dot_v,
            turns: if cosine > MIN_COSINE { 1.0 } else { 0.0 },
            alpha,
            kind,
        }
    }

    /// Radiance under unit light from `light`, a unit vector from the surface, and derivatives.
    ///
    /// Where nothing is reflected, all are 0. Of the paper's model, with J = π D G₁(x) G₁(y)/(4x),
    /// g = (1−z)⁵ and what F is multiplied with, Q = J − (1−m) ρ y,
    ///
    /// ```text
    /// I   = (1−F)(1−m) ρ y + F J                  F = F0 + (1−F0) g,  F0 = 0.04(1−m) + mρ
    /// I_y = (1−F)(1−m) ρ + F J_y                  J_y = π D G₁(x) G₁′(y)/(4x)
    /// I_x = F J_x                                 J_x = −π D G₁(y) (1−k)(G₁(x)/x)²/4,  k = r⁴/2
    /// I_D = F J/D                                 I_z = Q (1−F0) g′
    /// I_ρ = (1−F)(1−m) y + Q (1−g) m              I_r = F J_r
    /// I_m = Q (1−g)(ρ − 0.04) − (1−F) ρ y
    /// ```
    ///
    /// because G₁(x)/x = 1/(x(1−k)+k). Of the principled model, with J = π D W and its parts kd, d and
    /// e ([`principled`]), which depend on x, r, m and ρ,
    ///
    /// ```text
    /// I   = π kd y + J L                          L = d F_g(z) + e F,  F = ρ + (1−ρ) g
    /// I_y = π kd + π D W_y L                      I_x = π kd_x y + π D W_x L + J (d_x F_g + e_x F)
    /// I_D = π W L                                 I_z = J (d F_g′ + e (1−ρ) g′)
    /// I_ρ = π kd_ρ y + J (e_ρ F + e (1−g))        I_m = π kd_m y + J (d_m F_g + e_m F)
    /// I_r = π kd_r y + J_r L + J (d_r F_g + e_r F)
    /// ```
    ///
    /// with J_r = 2r π (D_α W + D W_α).
    #[inline]
    pub fn reflected(&self, light: DVec3) -> Reflected {
        self.reflected_of_part(light, 0.0)
    }

    /// The same of a small disk at once; derivatives are those of a point.
    ///
    /// It is seen by a lobe as a lamp without extent by a wider one, of α² + ρ²/4: near its middle
    /// GGX is a Gaussian of variance α²/4 an axis of h, a disk has ρ²/4 of l, a quarter of that of
    /// h. The cosine n·l is [`mean_cosine`].
    #[inline(always)]
    fn reflected_of_part(&self, light: DVec3, extent: f64) -> Reflected {
        let n_dot_l = mean_cosine(self.normal.dot(light), extent);
        let bisector = self.view + light;
        // From straight behind there is no half vector. Below the smallest normal number lengths lose
        // their digits, and quotients of masking overflow.
        if n_dot_l < f64::MIN_POSITIVE || bisector.length_squared() < f64::MIN_POSITIVE {
            return Reflected::default();
        }
        let half = bisector.normalize();
        let cosine = self.view.dot(half).clamp(0.0, 1.0);
        let alpha = match extent {
            0.0 => self.alpha,
            _ => self.alpha.hypot(0.5 * extent).min(1.0),
        };
        let (grazing, grazing_slope) = (schlick(cosine), schlick_by_cosine(cosine));
        let (distribution, [d_by_alpha, turned]) = distribution(self.normal, half, alpha);
        let n_dot_v = self.n_dot_v;
        let Material {
            albedo,
            roughness,
            metallic,
        } = *self.material;
        let mut reflected = Reflected::default();
        if SLOPES {
            (reflected.normal, reflected.view) = (self.normal, self.view);
            (reflected.light, reflected.half) = (light, half);
            reflected.bisector = bisector.length();
        }
        match &self.kind {
            &Kind::Paper(masking_v, masking_v_by_r) => {
                let (masking_l, masking_l_by_r) = smith_g1(n_dot_l, roughness);
                // π D G₁ G₁ / (4 (n·v)(n·l)) · (n·l)
                let lobe = PI * distribution * masking_v * masking_l / (4.0 * n_dot_v);
                let quarter = 0.25 * PI / n_dot_v;
                let share = masking_v / n_dot_v;
                let rest = 1.0 - 0.5 * alpha * alpha;
                let lobe_by_v = -0.25 * PI * distribution * masking_l * rest * share * share;
                let masking_l_slope = smith_g1_by_cosine(n_dot_l, roughness);
                let lobe_by_l = quarter * distribution * masking_v * masking_l_slope;
                let masking = masking_v * masking_l;
                let masking_by_r = masking_v_by_r * masking_l + masking_v * masking_l_by_r;
                let d_by_r = 2.0 * roughness * d_by_alpha;
                let lobe_by_r = quarter * (d_by_r * masking + distribution * masking_by_r);
                let lobe_by_half = quarter * masking * turned;
                let matt = 1.0 - metallic;
                for c in 0..3 {
                    let rho = albedo[c];
                    let f0 = DIELECTRIC_F0 * matt + metallic * rho;
                    let fresnel = f0 + (1.0 - f0) * grazing;
                    let transmitted = 1.0 - fresnel;
                    reflected.radiance[c] = transmitted * matt * rho * n_dot_l + fresnel * lobe;
                    if SLOPES {
                        let by_fresnel = lobe - matt * rho * n_dot_l;
                        let by_f0 = by_fresnel * (1.0 - grazing);
                        reflected.by_n_dot_l[c] = transmitted * matt * rho + fresnel * lobe_by_l;
                        reflected.by_n_dot_v[c] = self.turns * fresnel * lobe_by_v;
                        reflected.by_v_dot_h[c] = by_fresnel * (1.0 - f0) * grazing_slope;
                        reflected.by_half[c] = fresnel * lobe_by_half;
                        reflected.by_albedo[c] = transmitted * matt * n_dot_l + by_f0 * metallic;
                        reflected.by_metallic[c] =
                            by_f0 * (rho - DIELECTRIC_F0) - transmitted * rho * n_dot_l;
                        reflected.by_roughness[c] = fresnel * lobe_by_r;
                    }
                }
            }
            Kind::Principled(of_view, parts) => {
                let (masked, [w_by_v, w_by_l, w_by_alpha]) =
                    masked_cosine(n_dot_v, *of_view, n_dot_l, self.alpha);
                // π D V · (n·l)
                let scaled = PI * distribution;
                let lobe = scaled * masked;
                let lobe_by_r = 2.0 * roughness * (PI * d_by_alpha * masked + scaled * w_by_alpha);
                let lobe_by_half = PI * masked * turned;
                let (glass, glass_slope) = (glass(cosine), glass_by_cosine(cosine));
                for c in 0..3 {
                    let (parts, rho) = (&parts[c], albedo[c]);
                    let metal_fresnel = rho + (1.0 - rho) * grazing;
                    // π kd y + J (d F_g + e F), or a derivative of it by kd, d and e.
                    let sum = |parts: &Parts| {
                        let fresnel = parts.dielectric * glass + parts.metal * metal_fresnel;
                        PI * parts.ground * n_dot_l + lobe * fresnel
                    };
                    reflected.radiance[c] = sum(&parts.value);
                    if SLOPES {
                        let Parts {
                            ground,
                            dielectric,
                            metal,
                        } = parts.value;
                        let fresnel = dielectric * glass + metal * metal_fresnel;
                        reflected.by_n_dot_l[c] = PI * ground + scaled * w_by_l * fresnel;
                        reflected.by_n_dot_v[c] =
                            self.turns * (sum(&parts.by_n_dot_v) + scaled * w_by_v * fresnel);
                        reflected.by_v_dot_h[c] =
                            lobe * (dielectric * glass_slope + metal * (1.0 - rho) * grazing_slope);
                        reflected.by_half[c] = lobe_by_half * fresnel;
                        reflected.by_albedo[c] =
                            sum(&parts.by_albedo) + lobe * metal * (1.0 - grazing);
                        reflected.by_metallic[c] = sum(&parts.by_metallic);
                        reflected.by_roughness[c] = sum(&parts.by_roughness) + lobe_by_r * fresnel;
                    }
                }
            }
        }
        reflected
    }
}

impl Surface<'_> {
    /// Radiance under unit light from `light`, a unit vector from the surface, of a lamp that is a
    /// disk of the angular radius `extent`, radians: the mean of [`PARTS`] smaller ones.
    pub fn reflected_of_disk(&self, light: DVec3, extent: f64) -> [f64; 3] {
        if extent == 0.0 {
            return self.reflected(light).radiance;
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
                sum[c] += unit.radiance[c] / PARTS as f64;
            }
        }
        sum
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
fn parts<const SLOPES: bool>(n_dot_v: f64, material: &Material) -> [PartsWithSlopes; 3] {
    let [values, by_roughness, by_n_dot_v] = lobe_table::values(material.roughness, n_dot_v)
        .map(|values| principled::Surface::of(|f| values[f]));
    let mixer = Mixer::new(material.metallic, values);
    material.albedo.map(|rho| {
        if !SLOPES {
            return PartsWithSlopes {
                value: mixer.parts(rho),
                ..PartsWithSlopes::default()
            };
        }
        let [value, by_albedo, by_metallic] = mixer.parts_with_slopes(rho);
        PartsWithSlopes {
            value,
            by_albedo,
            by_metallic,
            by_roughness: mixer.parts_along(rho, &by_roughness),
            by_n_dot_v: mixer.parts_along(rho, &by_n_dot_v),
        }
    })
}
