//! The paper's model: eq. 12.
//!
//! ```text
//! w_ck = kd_c A_l Y_k(n) + ks_c h_l(r) Y_k(mirror),      mirror = 2(n·v)n − v
//! kd_c = (1−F_c)(1−m) ρ_c/π                  ks_c = F_c G₁(n·v)/4
//! F_c  = F0_c + (1−F0_c)(1−n·v)⁵            F0_c = 0.04(1−m) + m ρ_c
//! ```
//!
//! The lobe is round about the mirror direction, so it has one row a band, R_lk = Y_k(mirror), with
//! the factor s_cl = ks_c h_l(r).

use std::f64::consts::FRAC_1_PI;

use crate::reflectance::band_table::{FUNCTIONS, TABLE};
use crate::reflectance::ggx::{self, Bands, DIELECTRIC_F0};
use crate::reflectance::lobe_table::Tabled;
use crate::reflectance::planes::{
    BLOCK, BlockFunctions, ByRow, MAX_ENTRIES, MAX_ROWS, Material, Plane,
};
use crate::reflectance::reflection::{self, Reflection};
use crate::reflectance::sh::{self, BANDS, COEFFICIENTS, Real};
use crate::runtime::simd::Isa;

/// See the [module](self); its pixels are in the open or among surroundings.
#[derive(Clone, Copy, Debug, Default)]
pub struct Paper<const SURROUNDED: bool = false>;

impl<const SURROUNDED: bool> Reflection for Paper<SURROUNDED> {
    const SURROUNDED: bool = SURROUNDED;
    const FIRST_ROW: [usize; BANDS + 1] = [0, 1, 2, 3, 4];

    type Functions = Bands;
    type Factors<const C: usize> = Factors<C>;
    type Precision<T: Real> = f64;

    #[inline(always)]
    fn functions(_: f64, roughness: f64) -> Bands {
        ggx::bands(roughness)
    }

    #[inline(always)]
    fn functions_of_band_0(_: f64, roughness: f64) -> Bands {
        ggx::band_0(roughness)
    }

    #[inline(always)]
    fn fill_functions<I: Isa, T: Tabled>(
        isa: I,
        _: &Plane<f64>,
        roughness: &Plane<f64>,
        _: bool,
        functions: &mut BlockFunctions,
    ) {
        let table = &*TABLE;
        for x in 0..BLOCK {
            let row = table.row(isa, roughness.0[x]);
            for f in 0..FUNCTIONS {
                functions[f].0[x] = row.0[f];
            }
        }
    }

    #[inline(always)]
    fn functions_of<P: Real>(functions: &BlockFunctions<P>, pixel: usize) -> Bands {
        let mut bands = Bands {
            weight: [0.0; BANDS],
            slope: [0.0; BANDS],
        };
        for l in 0..BANDS {
            bands.weight[l] = functions[l].0[pixel].to_f64();
            bands.slope[l] = functions[BANDS + l].0[pixel].to_f64();
        }
        bands
    }

    #[inline(always)]
    fn factors<const C: usize>(
        cosine: f64,
        material: &Material<C>,
        functions: Bands,
    ) -> Factors<C> {
        Factors::new(cosine, material, functions)
    }

    #[inline(always)]
    fn lobe<T: Real>(_: [T; 3], mirror: [T; 3]) -> [T; MAX_ENTRIES] {
        let basis = sh::basis(mirror);
        let mut lobe = [T::default(); MAX_ENTRIES];
        lobe[..COEFFICIENTS].copy_from_slice(&basis);
        lobe
    }

    #[inline(always)]
    fn lobe_along<T: Real>(
        [_, mirror]: [[T; 3]; 2],
        [_, by_mirror]: [[T; 3]; 2],
    ) -> [T; MAX_ENTRIES] {
        let mut along = [T::default(); MAX_ENTRIES];
        sh::each_slope(mirror, |k, axis, slope| {
            along[k] = along[k] + slope * by_mirror[axis];
        });
        along
    }

    #[inline(always)]
    fn lobe_adjoint<T: Real, const K: usize>(
        _: [T; 3],
        mirror: [T; 3],
        cotangent: impl Fn(usize) -> T,
    ) -> [[T; 3]; 2] {
        let mut by = [T::default(); 3];
        sh::each_slope(mirror, |k, axis, slope| {
            if k < K {
                by[axis] = by[axis] + slope * cotangent(k);
            }
        });
        [[T::default(); 3], by]
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
    /// Always inlined, as all that the fast path runs over blocks of pixels.
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
}

impl<const C: usize> reflection::Factors<C> for Factors<C> {
    const ROWS: usize = BANDS;

    #[inline(always)]
    fn diffuse(&self, channel: usize) -> f64 {
        self.diffuse[channel]
    }

    #[inline(always)]
    fn row(&self, channel: usize, row: usize) -> f64 {
        self.specular[channel] * self.bands.weight[row]
    }

    /// With S_cl what arrives for row l, the sum over its band:
    ///
    /// ```text
    /// g_ks_c = Σ_l h_l S_cl             g_h_l = Σ_c ks_c S_cl
    /// g_F_c  = −(1−m)(ρ_c/π) g_kd_c + (G₁/4) g_ks_c          g_F0_c = (1 − (1−n·v)⁵) g_F_c
    /// g_ρ_c  = (1−F_c)(1−m)/π g_kd_c + m g_F0_c
    /// g_m    = Σ_c −(1−F_c)(ρ_c/π) g_kd_c + (ρ_c − 0.04) g_F0_c
    /// g_r    = Σ_c (F_c/4) G₁′ g_ks_c + Σ_l h_l′ g_h_l
    /// ```
    #[inline(always)]
    fn pull_back(
        &self,
        material: &Material<C>,
        by_diffuse: &[f64; C],
        band_sums: &[ByRow; C],
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

    /// ```text
    /// dF_c  = −5(1−F0_c)(1−n·v)⁴
    /// dkd_c = −(1−m)(ρ_c/π) dF_c              dks_c = (dF_c G₁ + F_c dG₁)/4
    /// ```
    #[inline(always)]
    fn slopes_by_cosine(&self, cosine: f64, material: &Material<C>) -> ([f64; C], [ByRow; C]) {
        let Material {
            albedo,
            roughness,
            metallic,
        } = *material;
        let schlick_slope = ggx::schlick_by_cosine(cosine);
        let g1_slope = ggx::smith_g1_by_cosine(cosine, roughness);
        let (mut diffuse, mut rows) = ([0.0; C], [[0.0; MAX_ROWS]; C]);
        for c in 0..C {
            let f0 = DIELECTRIC_F0 * (1.0 - metallic) + metallic * albedo[c];
            let fresnel_slope = (1.0 - f0) * schlick_slope;
            diffuse[c] = -(1.0 - metallic) * albedo[c] * FRAC_1_PI * fresnel_slope;
            let specular = 0.25 * (fresnel_slope * self.g1 + self.fresnel[c] * g1_slope);
            for l in 0..BANDS {
                rows[c][l] = specular * self.bands.weight[l];
            }
        }
        (diffuse, rows)
    }
}
