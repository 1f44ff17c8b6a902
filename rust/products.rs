//! Products over pictures of what a pixel sees of the lights, and of its targets.
//!
//! Radiance in one channel is I_i = a D_i + b Σ_l h_l(r) B_li over pictures i (see
//! [`material_grid`](crate::material_grid)), so Σ ω (I − T)², and all its derivatives by the
//! material, follow from the products of the six vectors D, B₀ to B₃ and T over pictures. These are
//! summed once a pixel; what is done with them costs the same for any number of pictures. They know
//! a sum of squares to about 10⁻¹⁵ of Σ ω T², which is half of the digits of a residual.

use crate::block::{BLOCK, Basis, Directions, FillBasis, Plane, seen_by};
use crate::problem::Problem;
use crate::sh::COEFFICIENTS;
use crate::simd::{Isa, Kernel, Vectors};

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

    /// Takes up pixels, with the normals of `maps`, and sums their products over pictures.
    pub(crate) fn load(
        &mut self,
        problem: &Problem,
        maps: &[f64],
        lights: &[[f64; COEFFICIENTS]],
        pixels: &[usize],
    ) {
        let isa = problem.instructions();
        self.directions = problem.picked_directions(maps, pixels);
        isa.run(FillBasis::<f64, COEFFICIENTS> {
            directions: &self.directions,
            basis: &mut self.basis,
        });
        let pictures = problem.pictures();
        let mut given = Vec::with_capacity(pictures);
        for (c, products) in self.by_channel.iter_mut().enumerate() {
            given.clear();
            given.extend((0..pictures).map(|i| problem.picked_samples(c, i, pixels)));
            isa.run(SumPictures {
                basis: &self.basis,
                lights: &lights[c * pictures..][..pictures],
                given: &given,
                products,
            });
        }
    }
}

/// Products of one channel, which stay in registers until all pictures have added theirs.
struct SumPictures<'a> {
    basis: &'a Basis<f64>,
    /// By picture.
    lights: &'a [[f64; COEFFICIENTS]],
    /// Target and weight, by picture.
    given: &'a [[Doubles; 2]],
    /// To be written.
    products: &'a mut Products,
}

impl Kernel for SumPictures<'_> {
    type Output = ();

    #[inline(always)]
    fn run<I: Isa>(self, isa: I) {
        self.all(isa);
    }
}

impl SumPictures<'_> {
    #[inline(always)]
    fn all<I: Vectors<f64>>(self, isa: I) {
        let Self {
            basis,
            lights,
            given,
            products,
        } = self;
        let zero = isa.splat(0.0);
        for v in 0..BLOCK / I::LANES {
            let (mut tt, mut dd, mut dt) = (zero, zero, zero);
            let (mut db, mut bt, mut bb) = ([zero; 4], [zero; 4], [zero; 10]);
            for (light, [target, weight]) in lights.iter().zip(given) {
                let [diffuse, bands @ ..] = seen_by(isa, basis, light, v);
                let (target, weight) = (I::of(&target.0)[v], I::of(&weight.0)[v]);
                let d = isa.mul(weight, diffuse);
                tt = isa.mul_add(isa.mul(weight, target), target, tt);
                dd = isa.mul_add(d, diffuse, dd);
                dt = isa.mul_add(d, target, dt);
                for l in 0..4 {
                    let b = isa.mul(weight, bands[l]);
                    db[l] = isa.mul_add(b, diffuse, db[l]);
                    bt[l] = isa.mul_add(b, target, bt[l]);
                    for j in 0..=l {
                        let sum = &mut bb[l * (l + 1) / 2 + j];
                        *sum = isa.mul_add(b, bands[j], *sum);
                    }
                }
            }
            let put = |to: &mut Doubles, sum| I::of_mut(&mut to.0)[v] = sum;
            put(&mut products.target_target, tt);
            put(&mut products.diffuse_diffuse, dd);
            put(&mut products.diffuse_target, dt);
            for l in 0..4 {
                put(&mut products.diffuse_band[l], db[l]);
                put(&mut products.band_target[l], bt[l]);
            }
            for (to, sum) in products.band_band.iter_mut().zip(bb) {
                put(to, sum);
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
