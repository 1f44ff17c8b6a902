//! Products over pictures of a pixel's light projections, and of its targets.
//!
//! Radiance in one channel is I_i = Σ_s f_s B_is over pictures i, with the projections of a light,
//! B_0 = D = Σ_k A_l Y_k(n) L_k and B_j = Σ_k R_jk L_k for each row of its lobe, and factors f that
//! depend on the material alone. So Σ ω (I − T)², and all its derivatives by the material, follow
//! from the products of these vectors and T over pictures. They are summed once a pixel; what is
//! done with them costs the same for any number of pictures. They know a sum of squares to about
//! 10⁻¹⁵ of Σ ω T², which is half of the digits of a residual.

use std::marker::PhantomData;

use crate::block::basis::{Basis, BasisAt, MAX_PROJECTIONS, Projections, TOGETHER};
use crate::problem::Problem;
use crate::reflectance::planes::{BLOCK, Directions, Doubles};
use crate::reflectance::reflection::Reflection;
use crate::reflectance::sh::COEFFICIENTS;
use crate::runtime::simd::{Isa, Kernel, Vectors};

/// What is multiplied at most: the targets, and after them the projections.
const VECTORS: usize = MAX_PROJECTIONS + 1;
/// Pairs of them.
const PAIRS: usize = VECTORS * (VECTORS + 1) / 2;

/// Products over pictures, Σ ω u v, of one channel.
#[derive(Clone, Debug)]
pub(crate) struct Products([Doubles; PAIRS]);

impl Default for Products {
    fn default() -> Self {
        Self([Doubles::default(); PAIRS])
    }
}

impl Products {
    /// Of projections s and t: 0 is D, 1 + j is B_j.
    #[inline(always)]
    pub(crate) fn of(&self, s: usize, t: usize) -> &Doubles {
        &self.0[pair(1 + s, 1 + t)]
    }

    /// Of projection s and T.
    #[inline(always)]
    pub(crate) fn with_target(&self, s: usize) -> &Doubles {
        &self.0[pair(1 + s, 0)]
    }

    /// Σ ω T²
    pub(crate) fn target_target(&self) -> &Doubles {
        &self.0[pair(0, 0)]
    }
}

/// Where the product of two vectors is.
#[inline(always)]
fn pair(s: usize, t: usize) -> usize {
    let (low, high) = if t < s { (t, s) } else { (s, t) };
    high * (high + 1) / 2 + low
}

/// Up to [`BLOCK`] pixels, where they look, and their products by channel.
pub(crate) struct PixelProducts {
    basis: Basis<f64>,
    given: Vec<[Doubles; 2]>,
    /// What surroundings bring: (channel, picture); or empty.
    bounced: Vec<[Doubles; MAX_PROJECTIONS]>,
    pub(crate) directions: Directions<f64>,
    pub(crate) by_channel: Vec<Products>,
}

impl PixelProducts {
    pub(crate) fn new(channels: usize) -> Self {
        Self {
            basis: Basis::default(),
            given: Vec::new(),
            bounced: Vec::new(),
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
        let isa = problem.options.instructions;
        self.directions = problem.picked_directions(maps, pixels);
        problem.fill_basis::<M, f64, COEFFICIENTS>(
            &self.directions,
            pixels.iter().copied(),
            &mut self.basis,
        );
        problem.pick_samples(pixels, &mut self.given);
        problem.pick_bounced::<M>(pixels, &mut self.bounced);
        let pictures = problem.pictures();
        for (c, products) in self.by_channel.iter_mut().enumerate() {
            isa.run(SumPictures {
                basis: &self.basis,
                lights: &lights[c * pictures..][..pictures],
                given: &self.given[c * pictures..][..pictures],
                bounced: self.bounced.get(c * pictures..).unwrap_or_default(),
                products,
                model: PhantomData::<M>,
            });
        }
    }
}

/// Products of one channel.
struct SumPictures<'a, M: Reflection> {
    basis: &'a Basis<f64>,
    /// By picture.
    lights: &'a [[f64; COEFFICIENTS]],
    /// Target and weight, by picture.
    given: &'a [[Doubles; 2]],
    /// By picture, or empty.
    bounced: &'a [[Doubles; MAX_PROJECTIONS]],
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

/// One vector of pixels: their basis functions and sums, and room for some pictures.
struct Room<I: Vectors<f64>> {
    basis: BasisAt<I>,
    sums: [I::Vector; PAIRS],
    projections: Projections<I::Vector>,
    values: [[I::Vector; TOGETHER]; VECTORS],
}

impl<M: Reflection> SumPictures<'_, M> {
    #[inline(always)]
    fn all<I: Vectors<f64>>(self, isa: I) {
        let (n, zero) = (self.lights.len(), isa.splat(0.0));
        let mut room = Room {
            basis: BasisAt::new(isa),
            sums: [zero; PAIRS],
            projections: [[zero; MAX_PROJECTIONS]; TOGETHER],
            values: [[zero; TOGETHER]; VECTORS],
        };
        for v in 0..BLOCK / I::LANES {
            room.basis.take::<M>(self.basis, v);
            for s in 0..M::ROWS + 2 {
                for t in 0..=s {
                    room.sums[pair(s, t)] = zero;
                }
            }
            let mut first = 0;
            while first + TOGETHER <= n {
                self.some::<I, TOGETHER>(isa, v, first, &mut room);
                first += TOGETHER;
            }
            for first in first..n {
                self.some::<I, 1>(isa, v, first, &mut room);
            }
            for s in 0..M::ROWS + 2 {
                for t in 0..=s {
                    I::of_mut(&mut self.products.0[pair(s, t)].0)[v] = room.sums[pair(s, t)];
                }
            }
        }
    }

    /// Adds J pictures, from number `first` on.
    #[inline(always)]
    fn some<I: Vectors<f64>, const J: usize>(
        &self,
        isa: I,
        v: usize,
        first: usize,
        room: &mut Room<I>,
    ) {
        let Room {
            basis,
            sums,
            projections,
            values,
        } = room;
        let lights = &self.lights[first..first + J];
        basis.project::<M, J>(isa, |j, k| isa.splat(lights[j][k]), projections);
        if M::SURROUNDED {
            for (j, bounced) in self.bounced.iter().skip(first).take(J).enumerate() {
                for s in 0..=M::ROWS {
                    projections[j][s] = isa.add(projections[j][s], I::of(&bounced[s].0)[v]);
                }
            }
        }
        let mut weights = [isa.splat(0.0); J];
        for j in 0..J {
            let [target, weight] = &self.given[first + j];
            weights[j] = I::of(&weight.0)[v];
            values[0][j] = I::of(&target.0)[v];
            for s in 0..=M::ROWS {
                values[1 + s][j] = projections[j][s];
            }
        }
        for s in 0..M::ROWS + 2 {
            let mut weighted = weights;
            for j in 0..J {
                weighted[j] = isa.mul(weights[j], values[s][j]);
            }
            for t in 0..=s {
                let mut sum = sums[pair(s, t)];
                for j in 0..J {
                    sum = isa.mul_add(weighted[j], values[t][j], sum);
                }
                sums[pair(s, t)] = sum;
            }
        }
    }
}
