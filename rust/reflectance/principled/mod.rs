//! The microfacet model that Blender's Principled BSDF, glTF and game engines share, under light of
//! l ≤ 3: GGX, height-correlated Smith masking, Schlick's Fresnel at v·h, multiple scattering.
//!
//! In the pixel's frame (z the normal, the mirror direction in the xz-plane) a lobe answers to the
//! ten harmonics that are even in y, j = l(l+1)/2 + m with 0 ≤ m ≤ l. Schlick's F = F0 +
//! (1−F0)(1−v·h)⁵ makes the lobe F0 a_j + b_j with
//!
//! ```text
//! a_j(r, n·v) = ∫ D V (n·l) (1 − (1−v·h)⁵) Y_j dl          b_j(r, n·v) = ∫ D V (n·l) (1−v·h)⁵ Y_j dl
//! ```
//!
//! over n·l > 0 ([`lobe_table`]). With F0 = 1 a lobe reflects E = 2√π(a₀ + b₀) of a uniform
//! light, and of what is scattered on, a surface of reflectance F0 gives back so much that the lobe
//! grows by
//!
//! ```text
//! M(F0) = 1 + F_ms (1−E)/E,   F_ms = F̄ Ē/(1 − F̄(1−Ē)),   F̄ = F0 + (1−F0)/21,   Ē(r) = 2∫E x dx.
//! ```
//!
//! A pixel is a mixture of a dielectric over a matt ground that gets what the lobe leaves, and a
//! metal, F0 = ρ. Schlick's Fresnel with F0 = 0.04 is some way off glass; κ(r, n·v) makes up for
//! what that changes of a uniform light. With G = κ M(0.04),
//!
//! ```text
//! w_ck = kd_c A_l Y_k(n) + Σ_j s_cj R_jk             s_cj = A_c a_j + B_c b_j
//! A_c  = (1−m) 0.04 G + m ρ_c M(ρ_c)                 kd_c = (1−m)(1−E_d) ρ_c/π
//! B_c  = (1−m) G + m M(ρ_c)                          E_d  = 2√π G (0.04 a₀ + b₀)
//! ```
//!
//! R_jk is the rotation of spherical harmonics into the frame ([`lobe_rows`]).
//! Sources of the formulas: docs/model.md.

mod block;
pub mod lobe_rows;

use std::f64::consts::{FRAC_1_PI, PI};

use crate::reflectance::ggx::DIELECTRIC_F0;
use crate::reflectance::lobe_table::{self, SECTION, Tabled};
use crate::reflectance::planes::{
    BlockFunctions, ByRow, ChannelFactors, ChannelSums, Directions, MAX_ENTRIES, Material,
    Materials, Plane,
};
use crate::reflectance::reflection::{self, Reflection};
use crate::reflectance::sh::{BANDS, Real};
use crate::runtime::simd::Isa;

/// Rows: harmonics that are even in y.
pub const ROWS: usize = 10;

/// 2√π: from the first row to what is reflected of a light that is 1 all around.
const UNIFORM: f64 = 3.544_907_701_811_032;
const _: () = assert!(UNIFORM * UNIFORM - 4.0 * PI < 1e-14 && 4.0 * PI - UNIFORM * UNIFORM < 1e-14);
/// The mean of (1−x)⁵ over the cosine-weighted hemisphere.
const SCHLICK_MEAN: f64 = 1.0 / 21.0;

/// See the [module](self); its pixels are in the open or among surroundings.
#[derive(Clone, Copy, Debug, Default)]
pub struct Principled<const SURROUNDED: bool = false>;

/// a_j, b_j over sinᵐ of the view angle, and what remains of the lobe otherwise.
#[derive(Clone, Copy, Debug)]
pub struct Lobe {
    a: ByRow,
    b: ByRow,
    surface: Surface,
}

/// What a lobe does with light on the whole, or how that changes.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Surface<T = f64> {
    /// E: of a uniform light, with F0 = 1.
    reflected: T,
    /// The same with Schlick's Fresnel of a dielectric.
    dielectric: T,
    /// Ē
    mean: T,
    /// κ
    glass: T,
}

impl<T: Real> Surface<T> {
    /// From a₀, b₀, Ē and κ.
    #[inline(always)]
    pub(crate) fn new(a: T, b: T, mean: T, glass: T) -> Self {
        let of = T::from_f64;
        Self {
            reflected: of(UNIFORM) * (a + b),
            dielectric: of(UNIFORM) * (of(DIELECTRIC_F0) * a + b),
            mean,
            glass,
        }
    }

    /// From the table's functions.
    #[inline(always)]
    pub(crate) fn of(values: impl Fn(usize) -> T) -> Self {
        let rest = 2 * ROWS;
        Self::new(values(0), values(ROWS), values(rest), values(rest + 1))
    }
}

impl Lobe {
    #[inline(always)]
    fn of(values: impl Fn(usize) -> f64) -> Self {
        let mut lobe = Self {
            a: [0.0; ROWS],
            b: [0.0; ROWS],
            surface: Surface::of(&values),
        };
        for j in 0..ROWS {
            lobe.a[j] = values(j);
            lobe.b[j] = values(ROWS + j);
        }
        lobe
    }
}

/// The lobe and its derivatives.
#[derive(Clone, Copy, Debug)]
pub struct Functions {
    lobe: Lobe,
    by_roughness: Lobe,
    by_cosine: Lobe,
}

impl<const SURROUNDED: bool> Reflection for Principled<SURROUNDED> {
    const SURROUNDED: bool = SURROUNDED;
    const FIRST_ROW: [usize; BANDS + 1] = [0, 1, 3, 6, 10];

    type Functions = Functions;
    type Factors<const C: usize> = Factors<C>;
    type Precision<T: Real> = T;

    #[inline(always)]
    fn functions(cosine: f64, roughness: f64) -> Functions {
        let [lobe, by_roughness, by_cosine] = lobe_table::values(roughness, cosine);
        Functions {
            lobe: Lobe::of(|f| lobe[f]),
            by_roughness: Lobe::of(|f| by_roughness[f]),
            by_cosine: Lobe::of(|f| by_cosine[f]),
        }
    }

    #[inline(always)]
    fn fill_functions<I: Isa, T: Tabled>(
        isa: I,
        cosine: &Plane<f64>,
        roughness: &Plane<f64>,
        by_cosine: bool,
        functions: &mut BlockFunctions<T>,
    ) {
        T::look_up(isa, roughness, cosine, by_cosine, functions);
    }

    #[inline(always)]
    fn functions_of<P: Real>(functions: &BlockFunctions<P>, pixel: usize) -> Functions {
        let at = |f: usize| functions[f].0[pixel].to_f64();
        Functions {
            lobe: Lobe::of(at),
            by_roughness: Lobe::of(|f| at(SECTION + f)),
            by_cosine: Lobe::of(|f| at(2 * SECTION + f)),
        }
    }

    #[inline(always)]
    fn factors<const C: usize>(_: f64, material: &Material<C>, functions: Functions) -> Factors<C> {
        Factors::new(material, functions)
    }

    #[inline(always)]
    fn fill_factors<T: Real, const C: usize>(
        _: &Directions<T>,
        materials: &Materials<C>,
        functions: &BlockFunctions<T>,
        factors: &mut [ChannelFactors<T>; C],
    ) {
        block::fill_factors(materials, functions, factors);
    }

    #[inline(always)]
    fn pull_back_block<const C: usize>(
        _: &Directions,
        materials: &Materials<C>,
        functions: &BlockFunctions<f32>,
        sums: &[ChannelSums; C],
        scale: f64,
        gradient: &mut Materials<C>,
    ) {
        block::pull_back(materials, functions, sums, scale, gradient);
    }

    #[inline(always)]
    fn lobe<T: Real>(normal: [T; 3], mirror: [T; 3]) -> [T; MAX_ENTRIES] {
        lobe_rows::rows(normal, mirror)
    }

    #[inline(always)]
    fn lobe_along<T: Real>(directions: [[T; 3]; 2], by: [[T; 3]; 2]) -> [T; MAX_ENTRIES] {
        lobe_rows::along(directions, by)
    }

    #[inline(always)]
    fn lobe_adjoint<T: Real, const K: usize>(
        normal: [T; 3],
        mirror: [T; 3],
        cotangent: impl Fn(usize) -> T,
    ) -> [[T; 3]; 2] {
        lobe_rows::adjoint::<T, K>(normal, mirror, cotangent)
    }
}

/// M(F0), and its derivatives by F0 and by the lobe's E and Ē.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Gain<T = f64> {
    value: T,
    by_f0: T,
    by_reflected: T,
    by_mean: T,
}

impl<T: Real> Gain<T> {
    /// ```text
    /// dM/dF̄ = q Ē/n²     dM/dĒ = q F̄(1−F̄)/n²     dM/dE = −F_ms/E²     q = 1/E − 1,  n = 1 − F̄(1−Ē)
    /// ```
    #[inline(always)]
    fn new(f0: T, reflected: T, mean: T) -> Self {
        let of = T::from_f64;
        let one = of(1.0);
        let mean_fresnel = f0 + (one - f0) * of(SCHLICK_MEAN);
        let inverse = one / (one - mean_fresnel * (one - mean));
        let again = mean_fresnel * mean * inverse;
        let rest = one / reflected;
        let lost = rest - one;
        Self {
            value: one + again * lost,
            by_f0: of(1.0 - SCHLICK_MEAN) * lost * mean * inverse * inverse,
            by_reflected: of(0.0) - again * rest * rest,
            by_mean: lost * mean_fresnel * (one - mean_fresnel) * inverse * inverse,
        }
    }

    /// The change with a change of the lobe.
    #[inline(always)]
    fn along(&self, change: &Surface<T>) -> T {
        self.by_reflected * change.reflected + self.by_mean * change.mean
    }
}

/// kd, A and B of one channel, or a derivative of them.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Mix<T = f64> {
    pub(crate) diffuse: T,
    pub(crate) a: T,
    pub(crate) b: T,
}

/// What mixtures of a pixel have in common, whatever their albedo.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Mixer<T = f64> {
    metallic: T,
    surface: Surface<T>,
    /// M(0.04)
    gain: Gain<T>,
    /// G
    ground: T,
    /// (1−E_d)/π
    transmitted: T,
}

impl<T: Real> Mixer<T> {
    #[inline(always)]
    pub(crate) fn new(metallic: T, surface: Surface<T>) -> Self {
        let of = T::from_f64;
        let gain = Gain::new(of(DIELECTRIC_F0), surface.reflected, surface.mean);
        let ground = gain.value * surface.glass;
        Self {
            metallic,
            surface,
            gain,
            ground,
            transmitted: (of(1.0) - ground * surface.dielectric) * of(FRAC_1_PI),
        }
    }

    /// M(ρ)
    #[inline(always)]
    pub(crate) fn metal(&self, albedo: T) -> Gain<T> {
        Gain::new(albedo, self.surface.reflected, self.surface.mean)
    }

    #[inline(always)]
    fn matt(&self) -> T {
        T::from_f64(1.0) - self.metallic
    }

    /// The mixture with an albedo, and its derivative by that.
    #[inline(always)]
    pub(crate) fn mix(&self, albedo: T, metal: &Gain<T>) -> [Mix<T>; 2] {
        let (m, matt) = (self.metallic, self.matt());
        let ground = matt * self.ground;
        let mix = Mix {
            diffuse: matt * albedo * self.transmitted,
            a: T::from_f64(DIELECTRIC_F0) * ground + m * albedo * metal.value,
            b: ground + m * metal.value,
        };
        let by_albedo = Mix {
            diffuse: matt * self.transmitted,
            a: m * (metal.value + albedo * metal.by_f0),
            b: m * metal.by_f0,
        };
        [mix, by_albedo]
    }

    /// The derivative by metallic.
    #[inline(always)]
    fn by_metallic(&self, albedo: T, metal: &Gain<T>) -> Mix<T> {
        let of = T::from_f64;
        Mix {
            diffuse: of(0.0) - albedo * self.transmitted,
            a: albedo * metal.value - of(DIELECTRIC_F0) * self.ground,
            b: metal.value - self.ground,
        }
    }

    /// The change with a change of the lobe.
    #[inline(always)]
    fn along(&self, albedo: T, metal: &Gain<T>, change: &Surface<T>) -> Mix<T> {
        let of = T::from_f64;
        let (m, matt) = (self.metallic, self.matt());
        let ground = self.gain.along(change) * self.surface.glass + self.gain.value * change.glass;
        let reflected = ground * self.surface.dielectric + self.ground * change.dielectric;
        let metal = m * metal.along(change);
        Mix {
            diffuse: of(0.0) - matt * albedo * reflected * of(FRAC_1_PI),
            a: of(DIELECTRIC_F0) * matt * ground + albedo * metal,
            b: matt * ground + metal,
        }
    }
}

/// Of one channel kd, and by what the dielectric's and the metal's lobe are multiplied, d = (1−m)
/// M(0.04) and e = m M(ρ); or a derivative of them.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Parts {
    /// kd
    pub(crate) ground: f64,
    /// d
    pub(crate) dielectric: f64,
    /// e
    pub(crate) metal: f64,
}

impl Mixer {
    /// The parts of an albedo.
    #[inline(always)]
    pub(crate) fn parts(&self, albedo: f64) -> Parts {
        let (m, matt) = (self.metallic, 1.0 - self.metallic);
        Parts {
            ground: matt * albedo * self.transmitted,
            dielectric: matt * self.gain.value,
            metal: m * self.metal(albedo).value,
        }
    }

    /// The parts, and their derivatives by albedo and by metallic.
    #[inline(always)]
    pub(crate) fn parts_with_slopes(&self, albedo: f64) -> [Parts; 3] {
        let (m, matt, metal) = (self.metallic, self.matt(), self.metal(albedo));
        let by_albedo = Parts {
            ground: matt * self.transmitted,
            dielectric: 0.0,
            metal: m * metal.by_f0,
        };
        let by_metallic = Parts {
            ground: -albedo * self.transmitted,
            dielectric: -self.gain.value,
            metal: metal.value,
        };
        [self.parts(albedo), by_albedo, by_metallic]
    }

    /// The change of the parts with a change of the lobe.
    #[inline(always)]
    pub(crate) fn parts_along(&self, albedo: f64, change: &Surface) -> Parts {
        let metal = self.metal(albedo);
        Parts {
            ground: self.along(albedo, &metal, change).diffuse,
            dielectric: self.matt() * self.gain.along(change),
            metal: self.metallic * metal.along(change),
        }
    }
}

/// The factors of one pixel.
#[derive(Clone, Copy, Debug)]
pub struct Factors<const C: usize = 3> {
    functions: Functions,
    mixer: Mixer,
    metal: [Gain; C],
    mix: [Mix; C],
    by_albedo: [Mix; C],
}

impl<const C: usize> Factors<C> {
    #[inline(always)]
    fn new(material: &Material<C>, functions: Functions) -> Self {
        let mixer = Mixer::new(material.metallic, functions.lobe.surface);
        let mut factors = Self {
            functions,
            mixer,
            metal: [Gain::default(); C],
            mix: [Mix::default(); C],
            by_albedo: [Mix::default(); C],
        };
        for c in 0..C {
            let albedo = material.albedo[c];
            factors.metal[c] = mixer.metal(albedo);
            [factors.mix[c], factors.by_albedo[c]] = mixer.mix(albedo, &factors.metal[c]);
        }
        factors
    }

    /// The change of kd, A and B with a change of the lobe.
    #[inline(always)]
    fn change(&self, channel: usize, albedo: f64, change: &Lobe) -> Mix {
        self.mixer
            .along(albedo, &self.metal[channel], &change.surface)
    }
}

/// Σ_j f_j g_j
#[inline(always)]
fn dot(functions: &ByRow, by_row: &ByRow) -> f64 {
    let mut sum = 0.0;
    for j in 0..ROWS {
        sum += functions[j] * by_row[j];
    }
    sum
}

/// What a change of kd, A and B is worth, given what their factors are.
#[inline(always)]
pub(crate) fn worth<T: Real>(mix: &Mix<T>, [by_diffuse, by_a, by_b]: [T; 3]) -> T {
    mix.diffuse * by_diffuse + mix.a * by_a + mix.b * by_b
}

impl<const C: usize> reflection::Factors<C> for Factors<C> {
    const ROWS: usize = ROWS;

    #[inline(always)]
    fn diffuse(&self, channel: usize) -> f64 {
        self.mix[channel].diffuse
    }

    #[inline(always)]
    fn row(&self, channel: usize, row: usize) -> f64 {
        let (lobe, mix) = (&self.functions.lobe, &self.mix[channel]);
        mix.a * lobe.a[row] + mix.b * lobe.b[row]
    }

    /// With S_cj what arrives for row j,
    ///
    /// ```text
    /// g_A_c = Σ_j a_j S_cj     g_B_c = Σ_j b_j S_cj
    /// g_ρ_c = ∂kd/∂ρ g_kd_c + ∂A/∂ρ g_A_c + ∂B/∂ρ g_B_c                 g_m the same, summed over c
    /// g_r   = Σ_c ∂kd/∂r g_kd_c + ∂A/∂r g_A_c + ∂B/∂r g_B_c + Σ_j (A_c ∂a_j/∂r + B_c ∂b_j/∂r) S_cj
    /// ```
    #[inline(always)]
    fn pull_back(
        &self,
        material: &Material<C>,
        by_diffuse: &[f64; C],
        by_row: &[ByRow; C],
    ) -> Material<C> {
        let Functions {
            lobe, by_roughness, ..
        } = &self.functions;
        let mut gradient = Material {
            albedo: [0.0; C],
            roughness: 0.0,
            metallic: 0.0,
        };
        for c in 0..C {
            let albedo = material.albedo[c];
            let by = [
                by_diffuse[c],
                dot(&lobe.a, &by_row[c]),
                dot(&lobe.b, &by_row[c]),
            ];
            gradient.albedo[c] = worth(&self.by_albedo[c], by);
            gradient.metallic += worth(&self.mixer.by_metallic(albedo, &self.metal[c]), by);
            gradient.roughness += worth(&self.change(c, albedo, by_roughness), by)
                + self.mix[c].a * dot(&by_roughness.a, &by_row[c])
                + self.mix[c].b * dot(&by_roughness.b, &by_row[c]);
        }
        gradient
    }

    #[inline(always)]
    fn slopes_by_cosine(&self, _: f64, material: &Material<C>) -> ([f64; C], [ByRow; C]) {
        let Functions {
            lobe, by_cosine, ..
        } = &self.functions;
        let (mut diffuse, mut rows) = ([0.0; C], [[0.0; ROWS]; C]);
        for c in 0..C {
            let (mix, change) = (&self.mix[c], self.change(c, material.albedo[c], by_cosine));
            diffuse[c] = change.diffuse;
            for j in 0..ROWS {
                rows[c][j] = change.a * lobe.a[j]
                    + change.b * lobe.b[j]
                    + mix.a * by_cosine.a[j]
                    + mix.b * by_cosine.b[j];
            }
        }
        (diffuse, rows)
    }
}
