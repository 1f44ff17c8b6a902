//! The best albedo from products with the paper's model.
//!
//! ```text
//! I_i = a D_i + b S_i        a = kd(ρ) = (1−F)(1−m)ρ/π       b = ks(ρ)/h = F G₁/4
//! D_i = Σ_k A_l Y_k(n) L_ik          S_i = Σ_l h_l(r) B_li          B_li = Σ_{k in l} Y_k(mirror) L_ik
//! F   = f₀ + f₁ρ             f₀ = s + (1−s) 0.04(1−m)        f₁ = (1−s) m       s = (1−n·v)⁵
//! ```
//!
//! so that χ² is a polynomial of degree 4 in ρ.

use std::f64::consts::FRAC_1_PI;

use crate::pixel::material_grid::{AlbedoFromProducts, ByAlbedo, Given, STARTS};
use crate::reflectance::ggx::{self, DIELECTRIC_F0};
use crate::reflectance::paper::Paper;
use crate::reflectance::planes::{BLOCK, BlockFunctions, Doubles, Plane};
use crate::reflectance::sh::BANDS;
use crate::runtime::simd::{Instructions, Isa};

/// What remains of a channel when roughness is given: products of D, S and T, masking and Fresnel.
#[derive(Clone, Debug, Default)]
pub(crate) struct AtRoughness {
    /// Of D with D, D with S, S with S, D with T, and S with T.
    products: [Doubles; 5],
    /// The same, scaled to what float32 can hold.
    rough: [Plane<f32>; 5],
    /// (1−n·v)⁵
    schlick: Doubles,
    /// G₁/4
    masking: Doubles,
    /// a₁, a₂, b₀ and b₁ of a metallic.
    factors: [Doubles; 4],
    rough_factors: [Plane<f32>; 4],
    /// The albedo that was started from, and the one found.
    found: [Plane<f32>; 2],
}

impl<const S: bool> AlbedoFromProducts for Paper<S> {
    type AtRoughness = AtRoughness;

    fn fill_shared(_: Instructions, _: &Doubles, roughness: f64, functions: &mut BlockFunctions) {
        for (plane, h) in functions.iter_mut().zip(ggx::bands(roughness).weight) {
            plane.0.fill(h);
        }
    }

    /// From the products of bands to those of S = Σ h_l B_l.
    #[inline(always)]
    fn set_channel(given: Given<'_, Self>, at: &mut AtRoughness) {
        let Given {
            products,
            cosine,
            roughness,
            functions,
        } = given;
        let [mut ss, mut ds, mut st] = <[Doubles; 3]>::default();
        for l in 0..BANDS {
            let (diffuse, target) = (products.of(0, 1 + l), products.with_target(1 + l));
            for x in 0..BLOCK {
                let h = functions[l].0[x];
                ds.0[x] += h * diffuse.0[x];
                st.0[x] += h * target.0[x];
            }
            for j in 0..=l {
                let product = products.of(1 + l, 1 + j);
                let twice = if j < l { 2.0 } else { 1.0 };
                for x in 0..BLOCK {
                    ss.0[x] += twice * functions[l].0[x] * functions[j].0[x] * product.0[x];
                }
            }
        }
        at.products = [*products.of(0, 0), ds, ss, *products.with_target(0), st];
        let tt = products.target_target();
        let mut scale = Doubles::default();
        for x in 0..BLOCK {
            at.schlick.0[x] = ggx::schlick(cosine.0[x]);
            at.masking.0[x] = 0.25 * ggx::smith_g1(cosine.0[x], roughness.0[x]).0;
            let size = at.products[0].0[x] + ss.0[x] + tt.0[x];
            scale.0[x] = 1.0 / (size + f64::MIN_POSITIVE);
        }
        for (rough, product) in at.rough.iter_mut().zip(&at.products) {
            for x in 0..BLOCK {
                rough.0[x] = (product.0[x] * scale.0[x]) as f32;
            }
        }
    }

    #[inline(always)]
    fn minimize<I: Isa, const STEPS: usize, const EXACT: usize>(
        by_albedo: ByAlbedo<'_, AtRoughness>,
    ) {
        let ByAlbedo {
            products,
            at_roughness,
            metallic,
            albedo,
            sum_sq_residuals,
        } = by_albedo;
        fill_factors::<I>(&mut at_roughness[0], metallic);
        let (factors, rough_factors) = (at_roughness[0].factors, at_roughness[0].rough_factors);
        let of_channels = products.iter().zip(at_roughness).zip(albedo);
        for ((products, at), albedo) in of_channels {
            search::<I, STEPS>(&at.rough, &rough_factors, &mut at.found);
            let tt = products.target_target();
            take_least::<I, EXACT>(at, &factors, tt, albedo, sum_sq_residuals);
        }
    }
}

/// a = a₁ρ − a₂ρ²,  b = b₀ + b₁ρ
#[inline(always)]
fn fill_factors<I: Isa>(at: &mut AtRoughness, metallic: &Doubles) {
    let [a1, a2, b0, b1] = &mut at.factors;
    for x in 0..BLOCK {
        let (s, matt) = (at.schlick.0[x], 1.0 - metallic.0[x]);
        let f0 = I::fma((1.0 - s) * DIELECTRIC_F0, matt, s);
        let f1 = (1.0 - s) * metallic.0[x];
        a1.0[x] = (1.0 - f0) * (matt * FRAC_1_PI);
        a2.0[x] = f1 * (matt * FRAC_1_PI);
        b0.0[x] = at.masking.0[x] * f0;
        b1.0[x] = at.masking.0[x] * f1;
    }
    for (rough, factor) in at.rough_factors.iter_mut().zip(&at.factors) {
        for x in 0..BLOCK {
            rough.0[x] = factor.0[x] as f32;
        }
    }
}

/// The albedo that is found from the lowest of [`STARTS`] by `STEPS` of Newton's method on
///
/// ```text
/// χ² − TᵀT = b₀(b₀ SS − 2 ST) + c₁ρ + c₂ρ² + c₃ρ³ + c₄ρ⁴
/// c₁ = 2 (a₁ u + b₁ w)               u = b₀ DS − DT
/// c₂ = a₁ v + b₁ (b₁ SS + a₁ DS) − 2 a₂ u     v = a₁ DD + b₁ DS
/// c₃ = −2 a₂ v       c₄ = a₂² DD     w = b₀ SS − ST
/// ```
#[inline(always)]
fn search<I: Isa, const STEPS: usize>(
    [dd, ds, ss, dt, st]: &[Plane<f32>; 5],
    [a1, a2, b0, b1]: &[Plane<f32>; 4],
    found: &mut [Plane<f32>; 2],
) {
    for x in 0..BLOCK {
        let (dd, ds, ss, dt, st) = (dd.0[x], ds.0[x], ss.0[x], dt.0[x], st.0[x]);
        let (a1, a2, b0, b1) = (a1.0[x], a2.0[x], b0.0[x], b1.0[x]);
        let (u, v) = (I::fma32(b0, ds, -dt), I::fma32(a1, dd, b1 * ds));
        let w = I::fma32(b0, ss, -st);
        let c1 = 2.0 * I::fma32(a1, u, b1 * w);
        let c2 = I::fma32(
            b1,
            I::fma32(b1, ss, a1 * ds),
            I::fma32(a1, v, -2.0 * a2 * u),
        );
        let (c3, c4) = (-2.0 * a2 * v, a2 * a2 * dd);
        // Without c₀, which all have.
        let value = |rho: f32| rho * I::fma32(I::fma32(I::fma32(c4, rho, c3), rho, c2), rho, c1);
        let (mut best, mut least) = (0.0, 0.0);
        for start in STARTS {
            let value = value(start);
            best = if value < least { start } else { best };
            least = if value < least { value } else { least };
        }
        let (s4, s3, s2) = (4.0 * c4, 3.0 * c3, 2.0 * c2);
        let mut rho = best;
        for _ in 0..STEPS {
            let slope = I::fma32(I::fma32(I::fma32(s4, rho, s3), rho, s2), rho, c1);
            let bend = I::fma32(I::fma32(3.0 * s4, rho, 2.0 * s3), rho, s2);
            let next = rho - slope / (bend.abs() + f32::MIN_POSITIVE);
            // A comparison with NaN is false: then the albedo stays where it is.
            rho = if next > 0.0 { next } else { 0.0 };
            rho = if rho < 1.0 { rho } else { 1.0 };
        }
        [found[0].0[x], found[1].0[x]] = [best, rho];
    }
}

/// χ² at the albedo found, and `EXACT` steps on from there.
#[inline(always)]
fn take_least<I: Isa, const EXACT: usize>(
    at: &AtRoughness,
    [a1, a2, b0, b1]: &[Doubles; 4],
    tt: &Doubles,
    albedo: &mut Doubles,
    sum_sq_residuals: &mut Doubles,
) {
    let [dd, ds, ss, dt, st] = &at.products;
    for x in 0..BLOCK {
        let (dd, ds, ss, dt, st) = (dd.0[x], ds.0[x], ss.0[x], dt.0[x], st.0[x]);
        let (a1, a2, b0, b1) = (a1.0[x], a2.0[x], b0.0[x], b1.0[x]);
        let value = |rho: f64| {
            let (a, b) = (I::fma(-a2, rho, a1) * rho, I::fma(b1, rho, b0));
            let by_a = I::fma(a, dd, 2.0 * I::fma(b, ds, -dt));
            let by_b = I::fma(b, ss, -2.0 * st);
            I::fma(a, by_a, I::fma(b, by_b, tt.0[x]))
        };
        let (start, found) = (f64::from(at.found[0].0[x]), f64::from(at.found[1].0[x]));
        let (at_start, mut least) = (value(start), value(found));
        let mut best = if at_start < least { start } else { found };
        least = if at_start < least { at_start } else { least };
        if EXACT > 0 {
            let mut rho = best;
            for _ in 0..EXACT {
                // Slope and bend of χ²/2: of a and b, and of what they multiply.
                let (a, b) = (I::fma(-a2, rho, a1) * rho, I::fma(b1, rho, b0));
                let a_slope = I::fma(-2.0 * a2, rho, a1);
                let by_a = I::fma(a, dd, I::fma(b, ds, -dt));
                let by_b = I::fma(b, ss, I::fma(a, ds, -st));
                let slope = I::fma(a_slope, by_a, b1 * by_b);
                let bent = I::fma(a_slope * a_slope, dd, b1 * b1 * ss);
                let bend = I::fma(2.0 * a_slope * b1, ds, I::fma(-2.0 * a2, by_a, bent));
                let next = rho - slope / (bend.abs() + f64::MIN_POSITIVE);
                // A comparison with NaN is false: then the albedo stays where it is.
                rho = if next > 0.0 { next } else { 0.0 };
                rho = if rho < 1.0 { rho } else { 1.0 };
            }
            let value = value(rho);
            // Of equals the later one: the first is rounded to float32.
            best = if value <= least { rho } else { best };
            least = if value <= least { value } else { least };
        }
        albedo.0[x] = best;
        // Rounding may leave less than nothing of a sum of squares.
        sum_sq_residuals.0[x] += if least > 0.0 { least } else { 0.0 };
    }
}
