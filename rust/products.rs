//! Products over pictures of what a pixel sees of the lights, and of its targets.
//!
//! Radiance in one channel is I_i = a D_i + b Σ_l h_l(r) B_li over pictures i (see
//! [`material_grid`](crate::material_grid)), so Σ ω (I − T)², and all its derivatives by the
//! material, follow from the products of the six vectors D, B₀ to B₃ and T over pictures. These are
//! summed once a pixel; what is done with them costs the same for any number of pictures. They know
//! a sum of squares to about 10⁻¹⁵ of Σ ω T², which is half of the digits of a residual.

use crate::block::{BLOCK, Basis, Directions, FillBasis, Plane, seen};
use crate::problem::Problem;
use crate::sh::COEFFICIENTS;
use crate::simd::{Isa, Kernel};

type Doubles = Plane<f64>;

/// Products over pictures, Σ ω u v, of one channel.
#[derive(Clone, Debug, Default)]
pub(crate) struct Products {
    pub(crate) target_target: Doubles,
    pub(crate) diffuse_diffuse: Doubles,
    pub(crate) diffuse_target: Doubles,
    /// Of D with each B_l.
    pub(crate) diffuse_band: [Doubles; 4],
    /// Of T with each B_l.
    pub(crate) band_target: [Doubles; 4],
    /// Of B_l with B_j, j ≤ l, row by row.
    pub(crate) band_band: [Doubles; 10],
}

/// The products that remain when roughness is given: those of D, S and T.
#[derive(Clone, Debug, Default)]
pub(crate) struct Specular {
    pub(crate) specular_specular: Doubles,
    pub(crate) diffuse_specular: Doubles,
    pub(crate) specular_target: Doubles,
}

/// Up to [`BLOCK`] pixels, where they look, and their products by channel.
pub(crate) struct PixelProducts {
    basis: Basis<f64>,
    pub(crate) directions: Directions<f64>,
    pub(crate) by_channel: Vec<Products>,
}

impl PixelProducts {
    pub(crate) fn new(channels: usize) -> Self {
        Self {
            basis: Basis::default(),
            directions: Directions::default(),
            by_channel: vec![Products::default(); channels],
        }
    }

    /// Takes up pixels and sums their products over pictures.
    pub(crate) fn load(
        &mut self,
        problem: &Problem,
        lights: &[[f64; COEFFICIENTS]],
        pixels: &[usize],
    ) {
        let isa = problem.instructions();
        self.directions = problem.picked_directions(pixels);
        isa.run(FillBasis::<f64, COEFFICIENTS> {
            directions: &self.directions,
            basis: &mut self.basis,
        });
        let pictures = problem.pictures();
        for (c, products) in self.by_channel.iter_mut().enumerate() {
            *products = Products::default();
            for (i, light) in lights[c * pictures..][..pictures].iter().enumerate() {
                let [target, weight] = problem.picked_samples(c, i, pixels);
                isa.run(AddPicture {
                    basis: &self.basis,
                    light,
                    target: &target,
                    weight: &weight,
                    products,
                });
            }
        }
    }
}

/// Adds one picture's share of the products.
struct AddPicture<'a> {
    basis: &'a Basis<f64>,
    light: &'a [f64; COEFFICIENTS],
    target: &'a Doubles,
    weight: &'a Doubles,
    products: &'a mut Products,
}

impl Kernel for AddPicture<'_> {
    type Output = ();

    #[inline(always)]
    fn run<I: Isa>(self, _: I) {
        let Self {
            basis,
            light,
            target,
            weight,
            products,
        } = self;
        let [diffuse, bands @ ..] = seen(basis, light);
        for x in 0..BLOCK {
            let (d, t) = (weight.0[x] * diffuse.0[x], weight.0[x] * target.0[x]);
            products.target_target.0[x] += t * target.0[x];
            products.diffuse_diffuse.0[x] += d * diffuse.0[x];
            products.diffuse_target.0[x] += d * target.0[x];
        }
        for l in 0..4 {
            for x in 0..BLOCK {
                let b = weight.0[x] * bands[l].0[x];
                products.diffuse_band[l].0[x] += b * diffuse.0[x];
                products.band_target[l].0[x] += b * target.0[x];
            }
            for j in 0..=l {
                let product = &mut products.band_band[l * (l + 1) / 2 + j];
                for x in 0..BLOCK {
                    product.0[x] += weight.0[x] * bands[l].0[x] * bands[j].0[x];
                }
            }
        }
    }
}

/// From the products of bands to those of S = Σ h_l B_l.
pub(crate) struct TakeRoughness<'a> {
    pub(crate) products: &'a Products,
    pub(crate) bands: &'a [Doubles; 4],
    pub(crate) specular: &'a mut Specular,
}

impl Kernel for TakeRoughness<'_> {
    type Output = ();

    #[inline(always)]
    fn run<I: Isa>(self, _: I) {
        let Self {
            products,
            bands,
            specular,
        } = self;
        *specular = Specular::default();
        for l in 0..4 {
            for x in 0..BLOCK {
                let h = bands[l].0[x];
                specular.diffuse_specular.0[x] += h * products.diffuse_band[l].0[x];
                specular.specular_target.0[x] += h * products.band_target[l].0[x];
            }
            for j in 0..=l {
                let product = &products.band_band[l * (l + 1) / 2 + j];
                let twice = if j < l { 2.0 } else { 1.0 };
                for x in 0..BLOCK {
                    specular.specular_specular.0[x] +=
                        twice * bands[l].0[x] * bands[j].0[x] * product.0[x];
                }
            }
        }
    }
}
