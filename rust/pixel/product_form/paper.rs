//! Squares from products with the paper's model, whose lobe is one vector over pictures.
//!
//! With D, S = Σ_l h_l B_l, S' = Σ_l h'_l B_l and T as vectors over pictures,
//!
//! ```text
//! I     = a D + b S               a = kd, b = ks
//! ∂I/∂ρ = a_ρ D + b_ρ S           ∂I/∂m = a_m D + b_m S           ∂I/∂r = b_r S + b S'
//! ```
//!
//! so all follows from ten products a channel, which are small quadratic forms in h and h' of the
//! [`products`](super::super::products).

use std::f64::consts::FRAC_1_PI;

use crate::pixel::product_form::{Form, LeastSquaresFromProducts};
use crate::pixel::products::PixelProducts;
use crate::pixel::samples::Sums;
use crate::reflectance::ggx::{self, DIELECTRIC_F0};
use crate::reflectance::paper::Paper;
use crate::reflectance::planes::{BLOCK, BlockFunctions, Doubles, Materials};
use crate::reflectance::sh::BANDS;
use crate::runtime::simd::{Isa, Kernel, Vectors};

impl<const S: bool> LeastSquaresFromProducts for Paper<S> {
    fn fill_sums<const C: usize, const U: usize>(
        form: &mut Form<Self>,
        products: &PixelProducts,
        materials: &Materials<C>,
        sums: &mut Sums<U>,
    ) {
        form.isa.run(FillSums {
            products,
            functions: &form.functions,
            materials,
            sums,
        });
    }
}

/// Fills in sum of squares, gradient and matrix, from products.
struct FillSums<'a, const C: usize, const U: usize> {
    products: &'a PixelProducts,
    functions: &'a BlockFunctions,
    materials: &'a Materials<C>,
    sums: &'a mut Sums<U>,
}

impl<const C: usize, const U: usize> Kernel for FillSums<'_, C, U> {
    type Output = ();

    #[inline(always)]
    fn run<I: Isa>(self, isa: I) {
        // (1−n·v)⁵, G₁/4 and its derivative by roughness, which all channels share.
        let mut shared = [Doubles::default(); 3];
        for x in 0..BLOCK {
            let cosine = self.products.directions.cosine(x);
            let (g1, slope) = ggx::smith_g1(cosine, self.materials.roughness.0[x]);
            shared[0].0[x] = ggx::schlick(cosine);
            shared[1].0[x] = 0.25 * g1;
            shared[2].0[x] = 0.25 * slope;
        }
        self.all(isa, &shared);
    }
}

impl<const C: usize, const U: usize> FillSums<'_, C, U> {
    #[inline(always)]
    fn all<I: Vectors<f64>>(self, isa: I, shared: &[Doubles; 3]) {
        let Self {
            products,
            functions,
            materials,
            sums,
        } = self;
        let (zero, one) = (isa.splat(0.0), isa.splat(1.0));
        let (inverse_pi, dielectric) = (isa.splat(FRAC_1_PI), isa.splat(DIELECTRIC_F0));
        let mul = |a, b| isa.mul(a, b);
        let sum2 = |a, b, c, d| isa.mul_add(a, b, isa.mul(c, d));
        for v in 0..BLOCK / I::LANES {
            let at = |plane: &Doubles| I::of(&plane.0)[v];
            let put = |plane: &mut Doubles, value| I::of_mut(&mut plane.0)[v] = value;
            let (mut h, mut slope) = ([zero; BANDS], [zero; BANDS]);
            for l in 0..BANDS {
                h[l] = at(&functions[l]);
                slope[l] = at(&functions[BANDS + l]);
            }
            let (schlick, g, g_slope) = (at(&shared[0]), at(&shared[1]), at(&shared[2]));
            let metallic = at(&materials.metallic);
            let (matt, unschlick) = (isa.sub(one, metallic), isa.sub(one, schlick));
            let (mut squares, mut by_r, mut by_m) = (zero, zero, zero);
            let (mut m_m, mut m_r, mut r_r) = (zero, zero, zero);
            for c in 0..C {
                let products = &products.by_channel[c];
                // Products of S and S' with each other, with D and with T.
                let (mut ss, mut sp, mut pp) = (zero, zero, zero);
                let (mut ds, mut dp, mut st, mut pt) = (zero, zero, zero, zero);
                for l in 0..BANDS {
                    let (mut by_h, mut by_slope) = (zero, zero);
                    for j in 0..BANDS {
                        let product = at(products.of(1 + l, 1 + j));
                        by_h = isa.mul_add(product, h[j], by_h);
                        by_slope = isa.mul_add(product, slope[j], by_slope);
                    }
                    ss = isa.mul_add(h[l], by_h, ss);
                    sp = isa.mul_add(slope[l], by_h, sp);
                    pp = isa.mul_add(slope[l], by_slope, pp);
                    let (diffuse, target) = (products.of(0, 1 + l), products.with_target(1 + l));
                    ds = isa.mul_add(h[l], at(diffuse), ds);
                    dp = isa.mul_add(slope[l], at(diffuse), dp);
                    st = isa.mul_add(h[l], at(target), st);
                    pt = isa.mul_add(slope[l], at(target), pt);
                }
                let (dd, dt) = (at(products.of(0, 0)), at(products.with_target(0)));
                // F and its slopes by albedo and metallic, then a, b and theirs.
                let rho = at(&materials.albedo[c]);
                let f0 = sum2(dielectric, matt, metallic, rho);
                let fresnel = isa.mul_add(unschlick, f0, schlick);
                let f_rho = mul(unschlick, metallic);
                let f_m = mul(unschlick, isa.sub(rho, dielectric));
                let passed = isa.sub(one, fresnel);
                let (rho_pi, matt_pi) = (mul(rho, inverse_pi), mul(matt, inverse_pi));
                let a = mul(mul(passed, matt), rho_pi);
                let a_rho = mul(matt_pi, isa.sub(passed, mul(rho, f_rho)));
                let a_m = isa.sub(zero, mul(rho_pi, isa.mul_add(matt, f_m, passed)));
                let (b, b_rho, b_m) = (mul(fresnel, g), mul(f_rho, g), mul(f_m, g));
                let b_r = mul(fresnel, g_slope);
                // The residual e = a D + b S − T with D, S and S'.
                let ed = isa.sub(sum2(a, dd, b, ds), dt);
                let es = isa.sub(sum2(a, ds, b, ss), st);
                let ep = isa.sub(sum2(a, dp, b, sp), pt);
                let both = sum2(a, isa.sub(ed, dt), b, isa.sub(es, st));
                squares = isa.add(squares, isa.add(both, at(products.target_target())));
                put(&mut sums.gradient[c], sum2(a_rho, ed, b_rho, es));
                by_r = isa.add(by_r, sum2(b_r, es, b, ep));
                by_m = isa.add(by_m, sum2(a_m, ed, b_m, es));
                // ∂I/∂ρ, ∂I/∂m and ∂I/∂r with D, S and S', as far as they are needed.
                let (rho_d, rho_s) = (sum2(a_rho, dd, b_rho, ds), sum2(a_rho, ds, b_rho, ss));
                let (m_d, m_s) = (sum2(a_m, dd, b_m, ds), sum2(a_m, ds, b_m, ss));
                let (rho_p, m_p) = (sum2(a_rho, dp, b_rho, sp), sum2(a_m, dp, b_m, sp));
                let (r_s, r_p) = (sum2(b_r, ss, b, sp), sum2(b_r, sp, b, pp));
                let (r, m) = (C, C + 1);
                put(&mut sums.matrix[c][c], sum2(a_rho, rho_d, b_rho, rho_s));
                put(&mut sums.matrix[m][c], sum2(a_m, rho_d, b_m, rho_s));
                put(&mut sums.matrix[r][c], sum2(b_r, rho_s, b, rho_p));
                m_m = isa.add(m_m, sum2(a_m, m_d, b_m, m_s));
                m_r = isa.add(m_r, sum2(b_r, m_s, b, m_p));
                r_r = isa.add(r_r, sum2(b_r, r_s, b, r_p));
            }
            put(&mut sums.sum_sq_residuals, squares);
            put(&mut sums.gradient[C], by_r);
            put(&mut sums.gradient[C + 1], by_m);
            put(&mut sums.matrix[C + 1][C + 1], m_m);
            put(&mut sums.matrix[C + 1][C], m_r);
            put(&mut sums.matrix[C][C], r_r);
        }
    }
}
