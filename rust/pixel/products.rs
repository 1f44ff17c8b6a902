//! Products over pictures of a pixel's light projections, and of its targets.
//!
//! Radiance in one channel is I_i = Σ_s f_s B_is over pictures i, with the projections of a light,
//! B_0 = D = Σ_k A_l Y_k(n) L_k and B_j = Σ_k R_jk L_k for each row of its lobe, and factors f that
//! depend on the material alone. So Σ ω (I − T)², and all its derivatives by the material, follow
//! from the products of these vectors and T over pictures. They are summed once a pixel; what is
//! done with them costs the same for any number of pictures. They know a sum of squares to about
//! 10⁻¹⁵ of Σ ω T², which is half of the digits of a residual.

use std::marker::PhantomData;

use crate::block::basis::{Basis, FillBasis, MAX_PROJECTIONS, light_projections_at};
use crate::problem::Problem;
use crate::reflectance::planes::MAX_ROWS;
use crate::reflectance::planes::{BLOCK, Directions, Doubles};
use crate::reflectance::reflection::Reflection;
use crate::reflectance::sh::COEFFICIENTS;
use crate::runtime::simd::{Isa, Kernel, Vectors};

/// Pairs of rows at most.
const MAX_PAIRS: usize = MAX_ROWS * (MAX_ROWS + 1) / 2;

/// Products over pictures, Σ ω u v, of one channel.
#[derive(Clone, Debug)]
pub(crate) struct Products {
    pub(crate) target_target: Doubles,
    pub(crate) diffuse_diffuse: Doubles,
    pub(crate) diffuse_target: Doubles,
    /// Of D with each B_j.
    pub(crate) diffuse_row: [Doubles; MAX_ROWS],
    /// Of T with each B_j.
    pub(crate) row_target: [Doubles; MAX_ROWS],
    /// Of B_i with B_j, j ≤ i, row by row.
    pub(crate) row_row: [Doubles; MAX_PAIRS],
}

impl Default for Products {
    fn default() -> Self {
        Self {
            target_target: Doubles::default(),
            diffuse_diffuse: Doubles::default(),
            diffuse_target: Doubles::default(),
            diffuse_row: [Doubles::default(); MAX_ROWS],
            row_target: [Doubles::default(); MAX_ROWS],
            row_row: [Doubles::default(); MAX_PAIRS],
        }
    }
}

/// Where the product of rows i and j is.
#[inline(always)]
pub(crate) fn pair(i: usize, j: usize) -> usize {
    let (low, high) = if j < i { (j, i) } else { (i, j) };
    high * (high + 1) / 2 + low
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
    pub(crate) fn load<M: Reflection>(
        &mut self,
        problem: &Problem,
        maps: &[f64],
        lights: &[[f64; COEFFICIENTS]],
        pixels: &[usize],
    ) {
        let isa = problem.instructions();
        self.directions = problem.picked_directions(maps, pixels);
        let model = M::default();
        isa.run(FillBasis::<M, f64, COEFFICIENTS> {
            directions: &self.directions,
            basis: &mut self.basis,
            model,
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
                model: PhantomData::<M>,
            });
        }
    }
}

/// Products of one channel, which stay at hand until all pictures have added theirs.
struct SumPictures<'a, M: Reflection> {
    basis: &'a Basis<f64>,
    /// By picture.
    lights: &'a [[f64; COEFFICIENTS]],
    /// Target and weight, by picture.
    given: &'a [[Doubles; 2]],
    /// To be written.
    products: &'a mut Products,
    model: PhantomData<M>,
}

impl<M: Reflection> Kernel for SumPictures<'_, M> {
    type Output = ();

    #[inline(always)]
    fn run<I: Isa>(self, isa: I) {
        self.all(isa);
    }
}

impl<M: Reflection> SumPictures<'_, M> {
    #[inline(always)]
    fn all<I: Vectors<f64>>(self, isa: I) {
        let Self {
            basis,
            lights,
            given,
            products,
            ..
        } = self;
        let zero = isa.splat(0.0);
        for v in 0..BLOCK / I::LANES {
            let (mut tt, mut dd, mut dt) = (zero, zero, zero);
            let (mut dr, mut rt) = ([zero; MAX_ROWS], [zero; MAX_ROWS]);
            let mut rr = [zero; MAX_PAIRS];
            for (light, [target, weight]) in lights.iter().zip(given) {
                let light_projections: [_; MAX_PROJECTIONS] =
                    light_projections_at::<M, I>(isa, basis, light, v);
                let diffuse = light_projections[0];
                let (target, weight) = (I::of(&target.0)[v], I::of(&weight.0)[v]);
                let d = isa.mul(weight, diffuse);
                tt = isa.mul_add(isa.mul(weight, target), target, tt);
                dd = isa.mul_add(d, diffuse, dd);
                dt = isa.mul_add(d, target, dt);
                for i in 0..M::ROWS {
                    let row = isa.mul(weight, light_projections[1 + i]);
                    dr[i] = isa.mul_add(row, diffuse, dr[i]);
                    rt[i] = isa.mul_add(row, target, rt[i]);
                    for j in 0..=i {
                        let sum = &mut rr[pair(i, j)];
                        *sum = isa.mul_add(row, light_projections[1 + j], *sum);
                    }
                }
            }
            let put = |to: &mut Doubles, sum| I::of_mut(&mut to.0)[v] = sum;
            put(&mut products.target_target, tt);
            put(&mut products.diffuse_diffuse, dd);
            put(&mut products.diffuse_target, dt);
            for i in 0..M::ROWS {
                put(&mut products.diffuse_row[i], dr[i]);
                put(&mut products.row_target[i], rt[i]);
                for j in 0..=i {
                    put(&mut products.row_row[pair(i, j)], rr[pair(i, j)]);
                }
            }
        }
    }
}
