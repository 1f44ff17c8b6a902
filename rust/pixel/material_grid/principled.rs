//! The best albedo from products with the principled model.
//!
//! ```text
//! I_i = kd D_i + A U_i + B V_i         U_i = Σ_j a_j B_ji         V_i = Σ_j b_j B_ji
//! ```
//!
//! With the factors f = (kd, A, B)(ρ) and G, t the products of D, U and V with each other and with
//! T, χ² = fᵀGf − 2f·t + TᵀT. The factors are nearly linear in ρ, so Newton's method may take 2
//! f'ᵀGf' for its second derivative, which is never negative.

use crate::pixel::material_grid::{AlbedoFromProducts, ByAlbedo, STARTS};
use crate::pixel::products::{Products, pair};
use crate::reflectance::planes::BlockFunctions;
use crate::reflectance::planes::{BLOCK, Doubles};
use crate::reflectance::principled::{Mix, Mixer, Principled, ROWS, Surface};
use crate::runtime::simd::{Instructions, Isa, Kernel};

/// What remains when roughness is given.
#[derive(Clone, Debug, Default)]
pub(crate) struct AtRoughness {
    /// a₀, b₀, Ē and κ.
    a: Doubles,
    b: Doubles,
    mean: Doubles,
    glass: Doubles,
    /// Products of D, U and V with U and V.
    du: Doubles,
    dv: Doubles,
    uu: Doubles,
    uv: Doubles,
    vv: Doubles,
    /// With T.
    ut: Doubles,
    vt: Doubles,
}

impl AlbedoFromProducts for Principled {
    type AtRoughness = AtRoughness;

    fn set_roughness(
        _: &Doubles,
        _: &Doubles,
        functions: &BlockFunctions,
        at_roughness: &mut AtRoughness,
    ) {
        (at_roughness.a, at_roughness.b) = (functions[0], functions[ROWS]);
        (at_roughness.mean, at_roughness.glass) = (functions[2 * ROWS], functions[2 * ROWS + 1]);
    }

    fn set_channel(
        isa: Instructions,
        products: &Products,
        functions: &BlockFunctions,
        at_roughness: &mut AtRoughness,
    ) {
        isa.run(TakeLobe {
            products,
            functions,
            at_roughness,
        });
    }

    fn minimize<const STEPS: usize>(isa: Instructions, by_albedo: ByAlbedo<'_, AtRoughness>) {
        isa.run(Minimize::<STEPS>(by_albedo));
    }
}

/// From the products of rows to those of U and V.
struct TakeLobe<'a> {
    products: &'a Products,
    functions: &'a BlockFunctions,
    at_roughness: &'a mut AtRoughness,
}

impl Kernel for TakeLobe<'_> {
    type Output = ();

    #[inline(always)]
    fn run<I: Isa>(self, _: I) {
        let Self {
            products,
            functions,
            at_roughness,
        } = self;
        let (a, b) = (&functions[..ROWS], &functions[ROWS..2 * ROWS]);
        let zero = Doubles::default();
        let (mut du, mut dv, mut ut, mut vt) = (zero, zero, zero, zero);
        let (mut uu, mut uv, mut vv) = (zero, zero, zero);
        for i in 0..ROWS {
            // Row i of the products, times a and b.
            let (mut by_a, mut by_b) = (zero, zero);
            for j in 0..ROWS {
                let product = &products.row_row[pair(i, j)];
                for x in 0..BLOCK {
                    by_a.0[x] += product.0[x] * a[j].0[x];
                    by_b.0[x] += product.0[x] * b[j].0[x];
                }
            }
            let (diffuse, target) = (&products.diffuse_row[i], &products.row_target[i]);
            for x in 0..BLOCK {
                uu.0[x] += a[i].0[x] * by_a.0[x];
                uv.0[x] += a[i].0[x] * by_b.0[x];
                vv.0[x] += b[i].0[x] * by_b.0[x];
                du.0[x] += a[i].0[x] * diffuse.0[x];
                dv.0[x] += b[i].0[x] * diffuse.0[x];
                ut.0[x] += a[i].0[x] * target.0[x];
                vt.0[x] += b[i].0[x] * target.0[x];
            }
        }
        (at_roughness.uu, at_roughness.uv, at_roughness.vv) = (uu, uv, vv);
        (
            at_roughness.du,
            at_roughness.dv,
            at_roughness.ut,
            at_roughness.vt,
        ) = (du, dv, ut, vt);
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
            at_roughness,
            metallic,
            albedo,
            sum_sq_residuals,
        } = self.0;
        for x in 0..BLOCK {
            let surface = Surface::new(
                at_roughness.a.0[x],
                at_roughness.b.0[x],
                at_roughness.mean.0[x],
                at_roughness.glass.0[x],
            );
            let mixer = Mixer::new(metallic.0[x], surface);
            let mixed = |rho: f64| mixer.mix(rho, &mixer.metal(rho));
            let (dd, dt) = (products.diffuse_diffuse.0[x], products.diffuse_target.0[x]);
            let (du, dv) = (at_roughness.du.0[x], at_roughness.dv.0[x]);
            let (uu, uv, vv) = (
                at_roughness.uu.0[x],
                at_roughness.uv.0[x],
                at_roughness.vv.0[x],
            );
            let (ut, vt) = (at_roughness.ut.0[x], at_roughness.vt.0[x]);
            let tt = products.target_target.0[x];
            // Gf
            let through = |f: &Mix| Mix {
                diffuse: dd * f.diffuse + du * f.a + dv * f.b,
                a: du * f.diffuse + uu * f.a + uv * f.b,
                b: dv * f.diffuse + uv * f.a + vv * f.b,
            };
            let dot = |f: &Mix, g: &Mix| f.diffuse * g.diffuse + f.a * g.a + f.b * g.b;
            let target = Mix {
                diffuse: dt,
                a: ut,
                b: vt,
            };
            let value = |rho: f64| {
                let [mix, _] = mixed(rho);
                dot(&mix, &through(&mix)) - 2.0 * dot(&mix, &target) + tt
            };

            let mut best = STARTS[0];
            let mut least = value(best);
            for start in STARTS {
                let value = value(start);
                best = if value < least { start } else { best };
                least = if value < least { value } else { least };
            }
            let mut rho = best;
            for _ in 0..STEPS {
                let [mix, by_rho] = mixed(rho);
                let bent = through(&by_rho);
                let slope = dot(&bent, &mix) - dot(&by_rho, &target);
                let next = rho - slope / (dot(&by_rho, &bent).abs() + f64::MIN_POSITIVE);
                // A comparison with NaN is false: then the albedo stays where it is.
                rho = if next > 0.0 { next } else { 0.0 };
                rho = if rho < 1.0 { rho } else { 1.0 };
            }
            let value = value(rho);
            albedo.0[x] = if value < least { rho } else { best };
            least = if value < least { value } else { least };
            // Rounding may leave less than nothing of a sum of squares.
            sum_sq_residuals.0[x] += if least > 0.0 { least } else { 0.0 };
        }
    }
}
