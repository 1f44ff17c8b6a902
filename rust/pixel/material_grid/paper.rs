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

use crate::pixel::material_grid::{AlbedoFromProducts, ByAlbedo, STARTS};
use crate::pixel::products::{Products, pair};
use crate::reflectance::ggx::{self, DIELECTRIC_F0};
use crate::reflectance::paper::Paper;
use crate::reflectance::planes::BlockFunctions;
use crate::reflectance::planes::{BLOCK, Doubles};
use crate::reflectance::sh::BANDS;
use crate::runtime::simd::{Instructions, Isa, Kernel};

/// What remains when roughness is given: products of D, S and T, and masking and Fresnel.
#[derive(Clone, Debug, Default)]
pub(crate) struct AtRoughness {
    specular_specular: Doubles,
    diffuse_specular: Doubles,
    specular_target: Doubles,
    /// (1−n·v)⁵
    schlick: Doubles,
    g1: Doubles,
}

impl AlbedoFromProducts for Paper {
    type AtRoughness = AtRoughness;

    fn fill_shared(_: Instructions, _: &Doubles, roughness: f64, functions: &mut BlockFunctions) {
        for (plane, h) in functions.iter_mut().zip(ggx::bands(roughness).weight) {
            plane.0.fill(h);
        }
    }

    fn set_roughness(
        cosine: &Doubles,
        roughness: &Doubles,
        _: &BlockFunctions,
        at_roughness: &mut AtRoughness,
    ) {
        for x in 0..BLOCK {
            at_roughness.schlick.0[x] = ggx::schlick(cosine.0[x]);
            at_roughness.g1.0[x] = ggx::smith_g1(cosine.0[x], roughness.0[x]).0;
        }
    }

    fn set_channel(
        isa: Instructions,
        products: &Products,
        functions: &BlockFunctions,
        at_roughness: &mut AtRoughness,
    ) {
        isa.run(TakeRoughness {
            products,
            functions,
            at_roughness,
        });
    }

    fn minimize<const STEPS: usize>(isa: Instructions, by_albedo: ByAlbedo<'_, AtRoughness>) {
        isa.run(Minimize::<STEPS>(by_albedo));
    }
}

/// From the products of bands to those of S = Σ h_l B_l.
struct TakeRoughness<'a> {
    products: &'a Products,
    functions: &'a BlockFunctions,
    at_roughness: &'a mut AtRoughness,
}

impl Kernel for TakeRoughness<'_> {
    type Output = ();

    #[inline(always)]
    fn run<I: Isa>(self, _: I) {
        let Self {
            products,
            functions,
            at_roughness,
        } = self;
        at_roughness.specular_specular = Doubles::default();
        at_roughness.diffuse_specular = Doubles::default();
        at_roughness.specular_target = Doubles::default();
        for l in 0..BANDS {
            for x in 0..BLOCK {
                let h = functions[l].0[x];
                at_roughness.diffuse_specular.0[x] += h * products.diffuse_row[l].0[x];
                at_roughness.specular_target.0[x] += h * products.row_target[l].0[x];
            }
            for j in 0..=l {
                let product = &products.row_row[pair(l, j)];
                let twice = if j < l { 2.0 } else { 1.0 };
                for x in 0..BLOCK {
                    at_roughness.specular_specular.0[x] +=
                        twice * functions[l].0[x] * functions[j].0[x] * product.0[x];
                }
            }
        }
    }
}

/// By `STEPS` of Newton's method.
struct Minimize<'a, const STEPS: usize>(ByAlbedo<'a, AtRoughness>);

impl<const STEPS: usize> Kernel for Minimize<'_, STEPS> {
    type Output = ();

    #[inline(always)]
    fn run<I: Isa>(self, _: I) {
        let ByAlbedo {
            products,
            at_roughness: specular,
            metallic,
            albedo,
            sum_sq_residuals,
        } = self.0;
        for x in 0..BLOCK {
            let (m, s) = (metallic.0[x], specular.schlick.0[x]);
            let f0 = s + (1.0 - s) * DIELECTRIC_F0 * (1.0 - m);
            let f1 = (1.0 - s) * m;
            // a = a₁ρ − a₂ρ²,  b = b₀ + b₁ρ
            let a1 = (1.0 - f0) * (1.0 - m) * FRAC_1_PI;
            let a2 = f1 * (1.0 - m) * FRAC_1_PI;
            let (b0, b1) = (0.25 * specular.g1.0[x] * f0, 0.25 * specular.g1.0[x] * f1);
            let dd = products.diffuse_diffuse.0[x];
            let dt = products.diffuse_target.0[x];
            let ds = specular.diffuse_specular.0[x];
            let ss = specular.specular_specular.0[x];
            let st = specular.specular_target.0[x];
            // χ² = c₀ + c₁ρ + c₂ρ² + c₃ρ³ + c₄ρ⁴
            let c0 = products.target_target.0[x] + b0 * (b0 * ss - 2.0 * st);
            let c1 = 2.0 * (a1 * (b0 * ds - dt) + b1 * (b0 * ss - st));
            let c2 = a1 * a1 * dd + b1 * b1 * ss + 2.0 * ((a1 * b1 - a2 * b0) * ds + a2 * dt);
            let c3 = -2.0 * a2 * (a1 * dd + b1 * ds);
            let c4 = a2 * a2 * dd;
            let polynomial = |rho: f64| (((c4 * rho + c3) * rho + c2) * rho + c1) * rho + c0;

            let (mut best, mut least) = (0.0, c0);
            for start in STARTS {
                let value = polynomial(start);
                best = if value < least { start } else { best };
                least = if value < least { value } else { least };
            }
            let mut rho = best;
            for _ in 0..STEPS {
                let slope = ((4.0 * c4 * rho + 3.0 * c3) * rho + 2.0 * c2) * rho + c1;
                let bend = (12.0 * c4 * rho + 6.0 * c3) * rho + 2.0 * c2;
                let next = rho - slope / (bend.abs() + f64::MIN_POSITIVE);
                // A comparison with NaN is false: then the albedo stays where it is.
                rho = if next > 0.0 { next } else { 0.0 };
                rho = if rho < 1.0 { rho } else { 1.0 };
            }
            let value = polynomial(rho);
            albedo.0[x] = if value < least { rho } else { best };
            least = if value < least { value } else { least };
            // Rounding may leave less than nothing of a sum of squares.
            sum_sq_residuals.0[x] += if least > 0.0 { least } else { 0.0 };
        }
    }
}
