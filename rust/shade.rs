//! One pixel: from material and directions to the 16 weights of each colour channel, and back.
//!
//! Radiance is linear in the light, I_c = Σ_k w_ck L_kc (paper eqs. 6 and 12), with
//!
//! ```text
//! w_ck = kd_c A_l Y_k(n) + ks_c h_l(r) Y_k(mirror),      mirror = 2(n·v)n − v
//! kd_c = (1−F_c)(1−m) ρ_c/π                  ks_c = F_c G₁(n·v)/4
//! F_c  = F0_c + (1−F0_c)(1−n·v)⁵            F0_c = 0.04(1−m) + m ρ_c
//! ```
//!
//! The factors that depend on the material ([`Factors`]) are kept apart from the two sets of
//! basis functions ([`Frame`]), which do not. This file is the one place that knows the model:
//! the double-precision reference and the fast float32 blocks are both built on it.

use std::f64::consts::FRAC_1_PI;

use glam::DVec3;

use crate::ggx::{self, Bands, DIELECTRIC_F0, MIN_COSINE};
use crate::sh::{self, BAND_OF, COEFFICIENTS, COSINE_TRANSFER};

/// Weights w_ck of one pixel, channel first.
pub type Weights<const C: usize = 3> = [[f64; COEFFICIENTS]; C];

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

/// What a pixel's weights need of its directions; fixed while materials change.
#[derive(Clone, Copy, Debug)]
pub struct Frame {
    /// n·v, at least [`MIN_COSINE`].
    pub cosine: f64,
    /// A_l Y_k(n); entries of band 3 are 0.
    pub diffuse: [f64; COEFFICIENTS],
    /// Y_k(mirror).
    pub mirror: [f64; COEFFICIENTS],
}

impl Frame {
    /// From unit normal and unit view direction (surface to camera).
    pub fn new(normal: DVec3, view: DVec3) -> Self {
        let (cosine, mirror) = Self::directions(normal, view);
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
            mirror: sh::basis(mirror.to_array()),
        }
    }

    /// The clamped n·v and the mirror direction; the latter is not clamped.
    pub fn directions(normal: DVec3, view: DVec3) -> (f64, DVec3) {
        let cosine = normal.dot(view);
        (cosine.max(MIN_COSINE), 2.0 * cosine * normal - view)
    }
}

/// A [`Frame`], and how it changes with the normal.
#[derive(Clone, Copy, Debug)]
pub struct TurningFrame {
    /// At this normal.
    pub frame: Frame,
    normal: DVec3,
    view: DVec3,
    /// A_l ∇Y_k(n)
    diffuse: [DVec3; COEFFICIENTS],
    /// ∇Y_k(mirror)
    mirror: [DVec3; COEFFICIENTS],
}

impl TurningFrame {
    /// From unit normal and unit view direction (surface to camera).
    pub fn new(normal: DVec3, view: DVec3) -> Self {
        let (cosine, mirror) = Frame::directions(normal, view);
        let mut diffuse = sh::slopes(normal.to_array()).map(DVec3::from);
        for (slope, &l) in diffuse.iter_mut().zip(&BAND_OF) {
            *slope *= COSINE_TRANSFER[l];
        }
        Self {
            frame: Frame::at(cosine, normal, mirror),
            normal,
            view,
            diffuse,
            mirror: sh::slopes(mirror.to_array()).map(DVec3::from),
        }
    }
}

/// The factors of the weights that depend on the material, and what their derivatives need.
#[derive(Clone, Copy, Debug)]
pub struct Factors<const C: usize = 3> {
    /// kd_c
    pub diffuse: [f64; C],
    /// ks_c
    pub specular: [f64; C],
    /// h_l and dh_l/dr
    pub bands: Bands,
    fresnel: [f64; C],
    schlick: f64,
    g1: f64,
    g1_slope: f64,
}

impl<const C: usize> Factors<C> {
    /// Factors of one material seen at the clamped cosine n·v, with the bands of its roughness.
    ///
    /// Always inlined, here and in [`pull_back`](Self::pull_back): the fast path runs them over
    /// blocks of pixels, and only then does the compiler turn them into vector code.
    #[inline(always)]
    pub fn new(cosine: f64, material: &Material<C>, bands: Bands) -> Self {
        let Material {
            albedo,
            roughness,
            metallic,
        } = *material;
        let schlick = ggx::schlick(cosine);
        let (g1, g1_slope) = ggx::smith_g1(cosine, roughness);
        let mut fresnel = [0.0; C];
        let mut diffuse = [0.0; C];
        let mut specular = [0.0; C];
        for c in 0..C {
            let f0 = DIELECTRIC_F0 * (1.0 - metallic) + metallic * albedo[c];
            fresnel[c] = f0 + (1.0 - f0) * schlick;
            diffuse[c] = (1.0 - fresnel[c]) * (1.0 - metallic) * albedo[c] * FRAC_1_PI;
            specular[c] = 0.25 * fresnel[c] * g1;
        }
        Self {
            diffuse,
            specular,
            bands,
            fresnel,
            schlick,
            g1,
            g1_slope,
        }
    }

    /// The adjoint: from the derivatives of a scalar by the weights to those by the material.
    ///
    /// The weights' derivatives arrive summed: `by_diffuse[c]` = Σ_k g_ck A_l Y_k(n), which is the
    /// derivative by kd_c, and `band_sums[c][l]` = Σ_{k in l} g_ck Y_k(mirror). Then
    ///
    /// ```text
    /// g_ks_c = Σ_l h_l band_sums[c][l]             g_h_l = Σ_c ks_c band_sums[c][l]
    /// g_F_c  = −(1−m)(ρ_c/π) g_kd_c + (G₁/4) g_ks_c          g_F0_c = (1 − (1−n·v)⁵) g_F_c
    /// g_ρ_c  = (1−F_c)(1−m)/π g_kd_c + m g_F0_c
    /// g_m    = Σ_c −(1−F_c)(ρ_c/π) g_kd_c + (ρ_c − 0.04) g_F0_c
    /// g_r    = Σ_c (F_c/4) G₁′ g_ks_c + Σ_l h_l′ g_h_l
    /// ```
    #[inline(always)]
    pub fn pull_back(
        &self,
        material: &Material<C>,
        by_diffuse: &[f64; C],
        band_sums: &[[f64; 4]; C],
    ) -> Material<C> {
        let Material {
            albedo, metallic, ..
        } = *material;
        let mut gradient = Material {
            albedo: [0.0; C],
            roughness: 0.0,
            metallic: 0.0,
        };
        for c in 0..C {
            let mut by_specular = 0.0;
            for l in 0..4 {
                by_specular += self.bands.weight[l] * band_sums[c][l];
                gradient.roughness += self.bands.slope[l] * self.specular[c] * band_sums[c][l];
            }
            gradient.roughness += 0.25 * self.fresnel[c] * self.g1_slope * by_specular;
            let transmitted = (1.0 - self.fresnel[c]) * FRAC_1_PI * by_diffuse[c];
            let by_fresnel = -(1.0 - metallic) * albedo[c] * FRAC_1_PI * by_diffuse[c]
                + 0.25 * self.g1 * by_specular;
            let by_f0 = (1.0 - self.schlick) * by_fresnel;
            gradient.albedo[c] = (1.0 - metallic) * transmitted + metallic * by_f0;
            gradient.metallic += -albedo[c] * transmitted + (albedo[c] - DIELECTRIC_F0) * by_f0;
        }
        gradient
    }

    /// Derivatives of kd_c and of ks_c by n·v, at the cosine and material that these factors are of.
    ///
    /// ```text
    /// dF_c  = −5(1−F0_c)(1−n·v)⁴
    /// dkd_c = −(1−m)(ρ_c/π) dF_c              dks_c = (dF_c G₁ + F_c dG₁)/4
    /// ```
    ///
    /// They hold for n·v > [`MIN_COSINE`]. Up to and at it the clamped cosine stays where it is
    /// when the normal turns, and callers take 0 instead.
    #[inline(always)]
    pub fn by_cosine(&self, cosine: f64, material: &Material<C>) -> ([f64; C], [f64; C]) {
        let Material {
            albedo,
            roughness,
            metallic,
        } = *material;
        let schlick_slope = ggx::schlick_by_cosine(cosine);
        let g1_slope = ggx::smith_g1_by_cosine(cosine, roughness);
        let (mut diffuse, mut specular) = ([0.0; C], [0.0; C]);
        for c in 0..C {
            let f0 = DIELECTRIC_F0 * (1.0 - metallic) + metallic * albedo[c];
            let fresnel_slope = (1.0 - f0) * schlick_slope;
            diffuse[c] = -(1.0 - metallic) * albedo[c] * FRAC_1_PI * fresnel_slope;
            specular[c] = 0.25 * (fresnel_slope * self.g1 + self.fresnel[c] * g1_slope);
        }
        (diffuse, specular)
    }
}

/// The weights of one pixel in double precision.
pub fn shade<const C: usize>(frame: &Frame, material: &Material<C>) -> Weights<C> {
    let factors = Factors::new(frame.cosine, material, ggx::bands(material.roughness));
    let mut weights = [[0.0; COEFFICIENTS]; C];
    for c in 0..C {
        for k in 0..COEFFICIENTS {
            weights[c][k] = factors.diffuse[c] * frame.diffuse[k]
                + factors.specular[c] * factors.bands.weight[BAND_OF[k]] * frame.mirror[k];
        }
    }
    weights
}

/// The adjoint of [`shade`] by the material: `cotangent` holds the derivatives of a scalar by the
/// weights, the result its derivatives by albedo, roughness and metallic.
pub fn shade_vjp<const C: usize>(
    frame: &Frame,
    material: &Material<C>,
    cotangent: &Weights<C>,
) -> Material<C> {
    let (by_diffuse, band_sums) = sums(frame, cotangent);
    Factors::new(frame.cosine, material, ggx::bands(material.roughness)).pull_back(
        material,
        &by_diffuse,
        &band_sums,
    )
}

/// [`shade_vjp`], and the derivative by the normal: a vector in the normal's tangent plane, so that
/// its product with a small turn dn of the normal is the change of the scalar.
///
/// With g_ck the cotangent and R the mirror direction, dR = 2(v·dn)n + 2(n·v)dn and d(n·v) = v·dn:
///
/// ```text
/// g_R = Σ_ck g_ck ks_c h_l ∇Y_k(R)
/// g_x = Σ_ck g_ck (dkd_c A_l Y_k(n) + dks_c h_l Y_k(R))          0 where n·v ≤ 10⁻⁴
/// g_n = Σ_ck g_ck kd_c A_l ∇Y_k(n) + 2(g_R·n)v + 2(n·v)g_R + g_x v
/// ```
///
/// of which the part along n is taken away. The mirror direction is not clamped, so g_R holds
/// everywhere.
pub fn shade_vjp_by_normal<const C: usize>(
    turning: &TurningFrame,
    material: &Material<C>,
    cotangent: &Weights<C>,
) -> (Material<C>, DVec3) {
    let TurningFrame {
        frame,
        normal,
        view,
        diffuse,
        mirror,
    } = turning;
    let (by_diffuse, band_sums) = sums(frame, cotangent);
    let factors = Factors::new(frame.cosine, material, ggx::bands(material.roughness));
    let h = factors.bands.weight;
    let (mut by_normal, mut by_mirror) = (DVec3::ZERO, DVec3::ZERO);
    for c in 0..C {
        for k in 0..COEFFICIENTS {
            by_normal += cotangent[c][k] * factors.diffuse[c] * diffuse[k];
            by_mirror += cotangent[c][k] * factors.specular[c] * h[BAND_OF[k]] * mirror[k];
        }
    }
    let cosine = normal.dot(*view);
    by_normal += 2.0 * (by_mirror.dot(*normal) * *view + cosine * by_mirror);
    if cosine > MIN_COSINE {
        let (diffuse, specular) = factors.by_cosine(cosine, material);
        for c in 0..C {
            let by_specular: f64 = h.iter().zip(&band_sums[c]).map(|(h, sum)| h * sum).sum();
            by_normal += (diffuse[c] * by_diffuse[c] + specular[c] * by_specular) * *view;
        }
    }
    (
        factors.pull_back(material, &by_diffuse, &band_sums),
        by_normal - by_normal.dot(*normal) / normal.length_squared() * *normal,
    )
}

/// Σ_k g_ck A_l Y_k(n), and for each band Σ_{k in l} g_ck Y_k(mirror).
fn sums<const C: usize>(frame: &Frame, cotangent: &Weights<C>) -> ([f64; C], [[f64; 4]; C]) {
    let (mut by_diffuse, mut band_sums) = ([0.0; C], [[0.0; 4]; C]);
    for c in 0..C {
        for k in 0..COEFFICIENTS {
            by_diffuse[c] += cotangent[c][k] * frame.diffuse[k];
            band_sums[c][BAND_OF[k]] += cotangent[c][k] * frame.mirror[k];
        }
    }
    (by_diffuse, band_sums)
}
