//! Squares of pixels as a function of their materials, from products over pictures.
//!
//! With D, S = Σ_l h_l B_l, S' = Σ_l h'_l B_l and T as vectors over pictures,
//!
//! ```text
//! I     = a D + b S               a = kd, b = ks
//! ∂I/∂ρ = a_ρ D + b_ρ S           ∂I/∂m = a_m D + b_m S           ∂I/∂r = b_r S + b S'
//! ```
//!
//! so squares, gradient and Gauss–Newton matrix follow from ten products a channel, which are small
//! quadratic forms in h and h' of the [`products`](crate::products) ([`AddChannel`]). They cost the
//! same for any number of pictures, and know squares to 10⁻¹⁵ of Σ ω T².

use crate::block::{BLOCK, BlockBands, Directions, FillBands, Materials, Plane};
use crate::descent::Squares;
use crate::ggx::Bands;
use crate::products::{PixelProducts, Products};
use crate::samples::{Sums, UNKNOWNS};
use crate::shade::{Factors, Material};
use crate::simd::{Instructions, Isa, Kernel};
use crate::turns::Tilts;

type Doubles = Plane<f64>;

/// Squares from products, at the normals that these were summed at.
pub(crate) struct Form<'a> {
    isa: Instructions,
    products: &'a PixelProducts,
    bands: BlockBands,
}

impl<'a> Form<'a> {
    pub(crate) fn new(isa: Instructions, products: &'a PixelProducts) -> Self {
        Self {
            isa,
            products,
            bands: BlockBands::default(),
        }
    }
}

impl<const C: usize> Squares<C, UNKNOWNS> for Form<'_> {
    fn take(&mut self, materials: &Materials<C>, _: &Tilts, sums: &mut Sums<UNKNOWNS>) {
        self.isa.run(FillBands {
            roughness: &materials.roughness,
            bands: &mut self.bands,
        });
        *sums = Sums::default();
        for c in 0..C {
            self.isa.run(AddChannel {
                directions: &self.products.directions,
                products: &self.products.by_channel[c],
                bands: &self.bands,
                materials,
                channel: c,
                sums,
            });
        }
    }
}

/// Adds one channel's squares, gradient and matrix, from its products.
struct AddChannel<'a, const C: usize> {
    directions: &'a Directions<f64>,
    products: &'a Products,
    bands: &'a BlockBands,
    materials: &'a Materials<C>,
    channel: usize,
    sums: &'a mut Sums<UNKNOWNS>,
}

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
        let Self {
            directions,
            products,
            bands,
            materials,
            channel,
            sums,
        } = self;
        let mut at = AtRoughness::default();
        for x in 0..BLOCK {
            let (mut h, mut slope) = ([0.0; 4], [0.0; 4]);
            for l in 0..4 {
                h[l] = bands[l].0[x];
                slope[l] = bands[4 + l].0[x];
            }
            for l in 0..4 {
                // Row l of the products of bands, times h and h'.
                let (mut by_h, mut by_slope) = (0.0, 0.0);
                for j in 0..4 {
                    let (low, high) = if j < l { (j, l) } else { (l, j) };
                    let product = products.band_band[high * (high + 1) / 2 + low].0[x];
                    by_h += product * h[j];
                    by_slope += product * slope[j];
                }
                at.ss.0[x] += h[l] * by_h;
                at.sp.0[x] += slope[l] * by_h;
                at.pp.0[x] += slope[l] * by_slope;
                at.ds.0[x] += h[l] * products.diffuse_band[l].0[x];
                at.dp.0[x] += slope[l] * products.diffuse_band[l].0[x];
                at.st.0[x] += h[l] * products.band_target[l].0[x];
                at.pt.0[x] += slope[l] * products.band_target[l].0[x];
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
            let of_a = factors.pull_back(&material, &[1.0], &[[0.0; 4]]);
            let of_b = factors.pull_back(&material, &[0.0], &[[1.0, 0.0, 0.0, 0.0]]);
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
            sums.squares.0[x] += a * (ed - dt) + b * (es - st) + products.target_target.0[x];
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
