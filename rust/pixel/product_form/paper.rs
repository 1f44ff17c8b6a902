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

use crate::pixel::product_form::{Channel, LeastSquaresFromProducts};
use crate::pixel::products::pair;
use crate::reflectance::ggx::Bands;
use crate::reflectance::paper::{Factors, Paper};
use crate::reflectance::planes::{BLOCK, Doubles};
use crate::reflectance::planes::{ByRow, MAX_ROWS, Material};
use crate::reflectance::reflection::Factors as _;
use crate::runtime::simd::{Instructions, Isa, Kernel};

impl LeastSquaresFromProducts for Paper {
    fn add_channel<const C: usize>(isa: Instructions, channel: Channel<'_, Self, C>) {
        isa.run(AddChannel(channel));
    }
}

/// Adds one channel's sum of squares, gradient and matrix, from its products.
struct AddChannel<'a, const C: usize>(Channel<'a, Paper, C>);

/// Products of S and S' at the roughness of each pixel.
#[derive(Default)]
struct AtRoughness {
    ss: Doubles,
    sp: Doubles,
    pp: Doubles,
    ds: Doubles,
    dp: Doubles,
    st: Doubles,
    pt: Doubles,
}

impl<const C: usize> Kernel for AddChannel<'_, C> {
    type Output = ();

    #[inline(always)]
    fn run<I: Isa>(self, _: I) {
        let Channel {
            directions,
            products,
            functions,
            materials,
            channel,
            sums,
            ..
        } = self.0;
        let mut at = AtRoughness::default();
        for x in 0..BLOCK {
            let (mut h, mut slope) = ([0.0; 4], [0.0; 4]);
            for l in 0..4 {
                h[l] = functions[l].0[x];
                slope[l] = functions[4 + l].0[x];
            }
            for l in 0..4 {
                // Row l of the products of bands, times h and h'.
                let (mut by_h, mut by_slope) = (0.0, 0.0);
                for j in 0..4 {
                    let product = products.row_row[pair(l, j)].0[x];
                    by_h += product * h[j];
                    by_slope += product * slope[j];
                }
                at.ss.0[x] += h[l] * by_h;
                at.sp.0[x] += slope[l] * by_h;
                at.pp.0[x] += slope[l] * by_slope;
                at.ds.0[x] += h[l] * products.diffuse_row[l].0[x];
                at.dp.0[x] += slope[l] * products.diffuse_row[l].0[x];
                at.st.0[x] += h[l] * products.row_target[l].0[x];
                at.pt.0[x] += slope[l] * products.row_target[l].0[x];
            }
        }
        let (r, m) = (C, C + 1);
        for x in 0..BLOCK {
            let material = Material {
                albedo: [materials.albedo[channel].0[x]],
                roughness: materials.roughness.0[x],
                metallic: materials.metallic.0[x],
            };
            // S in the place of band 0, its weight 1 whatever the roughness: then the derivatives
            // by roughness are those of b, and S' comes by hand.
            let whole = Bands {
                weight: [1.0, 0.0, 0.0, 0.0],
                slope: [0.0; 4],
            };
            let factors = Factors::new(directions.cosine(x), &material, whole);
            let (a, b) = (factors.diffuse[0], factors.specular[0]);
            let mut first: ByRow = [0.0; MAX_ROWS];
            let of_a = factors.pull_back(&material, &[1.0], &[first]);
            first[0] = 1.0;
            let of_b = factors.pull_back(&material, &[0.0], &[first]);
            let (a_rho, a_m) = (of_a.albedo[0], of_a.metallic);
            let (b_rho, b_m, b_r) = (of_b.albedo[0], of_b.metallic, of_b.roughness);
            let dd = products.diffuse_diffuse.0[x];
            let dt = products.diffuse_target.0[x];
            let (ds, ss, st) = (at.ds.0[x], at.ss.0[x], at.st.0[x]);
            let (dp, sp, pp, pt) = (at.dp.0[x], at.sp.0[x], at.pp.0[x], at.pt.0[x]);
            // The residual e = a D + b S − T with D, S and S'.
            let ed = a * dd + b * ds - dt;
            let es = a * ds + b * ss - st;
            let ep = a * dp + b * sp - pt;
            sums.sum_sq_residuals.0[x] +=
                a * (ed - dt) + b * (es - st) + products.target_target.0[x];
            sums.gradient[channel].0[x] += a_rho * ed + b_rho * es;
            sums.gradient[r].0[x] += b_r * es + b * ep;
            sums.gradient[m].0[x] += a_m * ed + b_m * es;
            // ∂I/∂ρ, ∂I/∂m and ∂I/∂r with D, S and S', as far as they are needed.
            let (rho_d, rho_s) = (a_rho * dd + b_rho * ds, a_rho * ds + b_rho * ss);
            let (m_d, m_s) = (a_m * dd + b_m * ds, a_m * ds + b_m * ss);
            let (rho_p, m_p) = (a_rho * dp + b_rho * sp, a_m * dp + b_m * sp);
            sums.matrix[channel][channel].0[x] += a_rho * rho_d + b_rho * rho_s;
            sums.matrix[m][channel].0[x] += a_m * rho_d + b_m * rho_s;
            sums.matrix[m][m].0[x] += a_m * m_d + b_m * m_s;
            sums.matrix[r][channel].0[x] += b_r * rho_s + b * rho_p;
            sums.matrix[m][r].0[x] += b_r * m_s + b * m_p;
            sums.matrix[r][r].0[x] += b_r * (b_r * ss + 2.0 * b * sp) + b * b * pp;
        }
    }
}
