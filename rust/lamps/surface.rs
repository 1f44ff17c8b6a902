//! Radiance of one pixel under unit light from single directions, and its derivatives by normal,
//! direction and material.

use std::f64::consts::PI;

use glam::DVec3;

use super::microfacets::{distribution, glass, masked_cosine, masking, slanted};
use super::number::{Number, Vector, dot, length_squared};
use crate::reflectance::ggx::{DIELECTRIC_F0, MIN_COSINE};
use crate::reflectance::lobe_table;
use crate::reflectance::model::Model;
use crate::reflectance::planes::Material;
use crate::reflectance::principled::{self, Mixer, Parts};

/// Least n·l of light that is reflected.
const DARK: f64 = 1e-290;
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
pub struct Reflected<T = f64> {
    /// By channel.
    pub radiance: [T; 3],
    /// By channel, by its own albedo.
    pub by_albedo: [T; 3],
    /// By channel, by roughness.
    pub by_roughness: [T; 3],
    /// By channel, by metallic.
    pub by_metallic: [T; 3],
    normal: DVec3,
    view: DVec3,
    light: [T; 3],
    half: [T; 3],
    /// |s|
    bisector: T,
    /// I_x by channel.
    by_n_dot_v: [T; 3],
    /// I_y by channel.
    by_n_dot_l: [T; 3],
    /// I_z by channel.
    by_v_dot_h: [T; 3],
    /// I_D T by channel.
    by_half: [T; 3],
}

impl<T: Number> Reflected<T> {
    /// Derivatives by the light's direction, by channel: vectors in its tangent plane.
    #[inline(always)]
    pub fn by_direction(&self) -> [Vector<T>; 3] {
        let normal = self.constant(self.normal);
        let inverse = self.bisector.all(1.0) / self.bisector.max(self.bisector.all(DARK));
        let of_v = across(across(self.constant(self.view), self.half), self.light);
        let of_n = across(across(normal, self.half), self.light);
        let n = across(normal, self.light);
        let mut by = [n; 3];
        for c in 0..3 {
            for a in 0..3 {
                let by_half = of_v[a] * self.by_v_dot_h[c] + of_n[a] * self.by_half[c];
                by[c][a] = n[a] * self.by_n_dot_l[c] + by_half * inverse;
            }
        }
        by
    }

    #[inline(always)]
    fn constant(&self, vector: DVec3) -> Vector<T> {
        let all = |value| self.bisector.all(value);
        [all(vector.x), all(vector.y), all(vector.z)]
    }

    /// Derivatives of all channels by what turns the normal so: dn has to lie in the normal's tangent
    /// plane.
    #[inline(always)]
    pub fn along(&self, change: DVec3) -> [T; 3] {
        let x = self.view.dot(change);
        let (y, h) = (dot(self.light, change), dot(self.half, change));
        let mut along = self.by_n_dot_v;
        for c in 0..3 {
            along[c] = along[c] * x + self.by_n_dot_l[c] * y + self.by_half[c] * h;
        }
        along
    }
}

/// A vector without its part along an axis.
#[inline(always)]
fn across<T: Number>(vector: Vector<T>, axis: Vector<T>) -> Vector<T> {
    let along = vector[0] * axis[0] + vector[1] * axis[1] + vector[2] * axis[2];
    // No axis, of a surface that reflects nothing.
    let share = along / length_squared(axis).max(along.all(DARK));
    let mut found = vector;
    for a in 0..3 {
        found[a] = vector[a] - share * axis[a];
    }
    found
}

impl<'a, const SLOPES: bool> Surface<'a, SLOPES> {
    /// From unit normal and unit view direction (surface to camera).
    #[inline(always)]
    pub fn new(model: Model, normal: DVec3, view: DVec3, material: &'a Material) -> Self {
        let cosine = normal.dot(view);
        let n_dot_v = cosine.max(MIN_COSINE);
        let alpha = material.roughness * material.roughness;
        let kind = match model {
            Model::Paper => {
                let (masking, [_, by_roughness]) = masking(n_dot_v, material.roughness);
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
    fn reflected_of_part(&self, light: DVec3, extent: f64) -> Reflected {
        let n_dot_l = mean_cosine(self.normal.dot(light), extent);
        let alpha = match extent {
            0.0 => self.alpha,
            _ => self.alpha.hypot(0.5 * extent).min(1.0),
        };
        match self.met::<f64>(light.to_array(), n_dot_l, alpha) {
            (lit, reflected) if lit > 0.0 => reflected,
            _ => Reflected::default(),
        }
    }

    /// Whether anything is reflected of light (1, else 0), and what; of light from where nothing is,
    /// finite numbers. All lanes alike, without branches.
    #[inline(always)]
    pub(super) fn reflected_of<T: Number>(&self, light: Vector<T>) -> (T, Reflected<T>) {
        self.met(light, dot(light, self.normal), self.alpha)
    }

    #[inline(always)]
    fn met<T: Number>(&self, light: Vector<T>, n_dot_l: T, alpha: f64) -> (T, Reflected<T>) {
        let all = |value| n_dot_l.all(value);
        let (normal, view) = (self.normal.to_array(), self.view.to_array());
        let mut half = light;
        for a in 0..3 {
            half[a] = light[a] + view[a];
        }
        let length2 = length_squared(half);
        // From straight behind there is no half vector. Below the smallest numbers lengths lose their
        // digits, and quotients of masking overflow.
        let lit = length2.at_least(f64::MIN_POSITIVE, all(1.0), all(0.0));
        let lit = n_dot_l.at_least(DARK, lit, all(0.0));
        let n_dot_l = lit.at_least(1.0, n_dot_l, all(1.0));
        let bisector = lit.at_least(1.0, length2.sqrt(), all(1.0));
        let inverse = all(1.0) / bisector;
        for a in 0..3 {
            half[a] = lit.at_least(1.0, half[a] * inverse, all(normal[a]));
        }
        let v_dot_h = dot(half, self.view).max(all(0.0)).min(all(1.0));
        let (distribution, [d_by_alpha, turned]) = distribution(self.normal, half, alpha);
        let none = [all(0.0); 3];
        let mut reflected = Reflected {
            radiance: none,
            by_albedo: none,
            by_roughness: none,
            by_metallic: none,
            normal: self.normal,
            view: self.view,
            light,
            half,
            bisector,
            by_n_dot_v: none,
            by_n_dot_l: none,
            by_v_dot_h: none,
            by_half: none,
        };
        let rest = all(1.0) - v_dot_h;
        let rest4 = rest * rest * (rest * rest);
        let (grazing, grazing_slope) = (rest4 * rest, rest4 * -5.0);
        let n_dot_v = self.n_dot_v;
        let &Material {
            albedo,
            roughness,
            metallic,
        } = self.material;
        match &self.kind {
            &Kind::Paper(masking_v, masking_v_by_r) => {
                let (masking_l, [masking_l_slope, masking_l_by_r]) = masking(n_dot_l, roughness);
                // π D G₁ G₁ / (4 (n·v)(n·l)) · (n·l)
                let quarter = 0.25 * PI / n_dot_v;
                let of_view = distribution * (quarter * masking_v);
                let lobe = of_view * masking_l;
                let share = masking_v / n_dot_v;
                let rest = 1.0 - 0.5 * alpha * alpha;
                let lobe_by_v = distribution * masking_l * (-0.25 * PI * rest * share * share);
                let lobe_by_l = of_view * masking_l_slope;
                let masking = masking_l * masking_v;
                let masking_by_r = masking_l * masking_v_by_r + masking_l_by_r * masking_v;
                let d_by_r = d_by_alpha * (2.0 * roughness);
                let lobe_by_r = (d_by_r * masking + distribution * masking_by_r) * quarter;
                let lobe_by_half = masking * turned * quarter;
                let matt = 1.0 - metallic;
                for c in 0..3 {
                    let rho = albedo[c];
                    let f0 = DIELECTRIC_F0 * matt + metallic * rho;
                    let fresnel = grazing * (1.0 - f0) + f0;
                    let transmitted = all(1.0) - fresnel;
                    let diffuse = transmitted * n_dot_l;
                    reflected.radiance[c] = diffuse * (matt * rho) + fresnel * lobe;
                    if SLOPES {
                        let by_fresnel = lobe - n_dot_l * (matt * rho);
                        let by_f0 = by_fresnel * (all(1.0) - grazing);
                        reflected.by_n_dot_l[c] = transmitted * (matt * rho) + fresnel * lobe_by_l;
                        reflected.by_n_dot_v[c] = fresnel * lobe_by_v * self.turns;
                        reflected.by_v_dot_h[c] = by_fresnel * (1.0 - f0) * grazing_slope;
                        reflected.by_half[c] = fresnel * lobe_by_half;
                        reflected.by_albedo[c] = diffuse * matt + by_f0 * metallic;
                        reflected.by_metallic[c] = by_f0 * (rho - DIELECTRIC_F0) - diffuse * rho;
                        reflected.by_roughness[c] = fresnel * lobe_by_r;
                    }
                }
            }
            Kind::Principled(of_view, parts) => {
                let (masked, [w_by_v, w_by_l, w_by_alpha]) =
                    masked_cosine(n_dot_v, *of_view, n_dot_l, self.alpha);
                // π D V · (n·l)
                let scaled = distribution * PI;
                let lobe = scaled * masked;
                let lobe_by_r = d_by_alpha * PI * masked + scaled * w_by_alpha;
                let lobe_by_r = lobe_by_r * (2.0 * roughness);
                let lobe_by_half = masked * turned * PI;
                let [glass, glass_slope] = glass(v_dot_h);
                for c in 0..3 {
                    let (parts, rho) = (&parts[c], albedo[c]);
                    let metal_fresnel = grazing * (1.0 - rho) + rho;
                    // d F_g + e F, and with it π kd y + J L; or derivatives of these by kd, d and e.
                    let fresnel =
                        |parts: &Parts| glass * parts.dielectric + metal_fresnel * parts.metal;
                    let sum = |parts: &Parts| n_dot_l * (PI * parts.ground) + lobe * fresnel(parts);
                    reflected.radiance[c] = sum(&parts.value);
                    if SLOPES {
                        let Parts {
                            ground,
                            dielectric,
                            metal,
                        } = parts.value;
                        let fresnel = fresnel(&parts.value);
                        reflected.by_n_dot_l[c] = scaled * w_by_l * fresnel + PI * ground;
                        reflected.by_n_dot_v[c] =
                            (sum(&parts.by_n_dot_v) + scaled * w_by_v * fresnel) * self.turns;
                        reflected.by_v_dot_h[c] = lobe
                            * (glass_slope * dielectric + grazing_slope * (metal * (1.0 - rho)));
                        reflected.by_half[c] = lobe_by_half * fresnel;
                        reflected.by_albedo[c] =
                            sum(&parts.by_albedo) + lobe * (all(1.0) - grazing) * metal;
                        reflected.by_metallic[c] = sum(&parts.by_metallic);
                        reflected.by_roughness[c] = sum(&parts.by_roughness) + lobe_by_r * fresnel;
                    }
                }
            }
        }
        (lit, reflected)
    }

    /// Radiance under unit light from `light`, a unit vector from the surface, of a lamp that is a
    /// disk of the angular radius `extent`, radians: the mean of [`PARTS`] smaller ones.
    pub fn of_disk(&self, light: DVec3, extent: f64) -> [f64; 3] {
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
#[inline(always)]
fn parts<const SLOPES: bool>(n_dot_v: f64, material: &Material) -> [PartsWithSlopes; 3] {
    let values = lobe_table::values(material.roughness, n_dot_v);
    let mixer = Mixer::new(material.metallic, principled::Surface::of(|f| values[0][f]));
    let mut parts = [PartsWithSlopes::default(); 3];
    for c in 0..3 {
        let rho = material.albedo[c];
        let of = &mut parts[c];
        if SLOPES {
            [of.value, of.by_albedo, of.by_metallic] = mixer.parts_with_slopes(rho);
            of.by_roughness = mixer.parts_along(rho, &principled::Surface::of(|f| values[1][f]));
            of.by_n_dot_v = mixer.parts_along(rho, &principled::Surface::of(|f| values[2][f]));
        } else {
            of.value = mixer.parts(rho);
        }
    }
    parts
}
