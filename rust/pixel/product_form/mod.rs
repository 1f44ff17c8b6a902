//! Sums of squared residuals of pixels as a function of their materials, from products over pictures.
//!
//! With f the factors of a pixel's light projections ([`products`](super::products)) and f_ρ, f_m,
//! f_r their derivatives, Σ ω (I − T)² is fᵀGf − 2fᵀt + TᵀT, half of its gradient f_x·(Gf − t), the
//! Gauss–Newton matrix f_xᵀGf_y. They cost the same for any number of pictures, and know the sum to
//! 10⁻¹⁵ of Σ ω T².

use std::marker::PhantomData;

use crate::block::basis::MAX_PROJECTIONS;
use crate::block::factors::FillFunctions;
use crate::block::normal_jacobian::TangentOffsets;
use crate::pixel::descent::LeastSquares;
use crate::pixel::products::{PixelProducts, Products, pair};
use crate::pixel::samples::{
    DERIVATIVES, FillResponses, Responses, Sums, UNKNOWNS, unknowns_of_channel,
};
use crate::reflectance::planes::{BLOCK, Directions, Doubles, Materials, no_functions};
use crate::reflectance::principled::Principled;
use crate::reflectance::reflection::{ExactFunctions, Reflection};
use crate::runtime::simd::{Instructions, Isa, Kernel};

mod paper;

/// Models whose sum of squared residuals comes from products.
pub(crate) trait LeastSquaresFromProducts: Reflection {
    /// Adds one channel's sum of squares, gradient and matrix.
    fn add_channel<const C: usize>(isa: Instructions, channel: Channel<'_, Self, C>) {
        add_channel::<Self, C>(isa, channel);
    }
}

impl LeastSquaresFromProducts for Principled {}

/// One channel of a block.
pub(crate) struct Channel<'a, M: Reflection, const C: usize> {
    pub(crate) directions: &'a Directions<f64>,
    pub(crate) products: &'a Products,
    pub(crate) functions: &'a ExactFunctions<M>,
    pub(crate) materials: &'a Materials<C>,
    pub(crate) channel: usize,
    /// Room for what a sample is made of.
    pub(crate) responses: &'a mut Responses,
    /// Added to.
    pub(crate) sums: &'a mut Sums<UNKNOWNS>,
}

/// Sums of squares from products, at the normals that these were summed at.
pub(crate) struct Form<'a, M: Reflection> {
    isa: Instructions,
    products: &'a PixelProducts,
    functions: Box<ExactFunctions<M>>,
    responses: Responses,
    model: M,
}

impl<'a, M: Reflection> Form<'a, M> {
    pub(crate) fn new(isa: Instructions, products: &'a PixelProducts) -> Self {
        Self {
            isa,
            products,
            functions: no_functions(),
            responses: Responses::default(),
            model: M::default(),
        }
    }
}

impl<M: LeastSquaresFromProducts, const C: usize> LeastSquares<C, UNKNOWNS> for Form<'_, M> {
    fn take(&mut self, materials: &Materials<C>, _: &TangentOffsets, sums: &mut Sums<UNKNOWNS>) {
        self.isa.run(FillFunctions {
            cosine: self.products.directions.cosines(),
            roughness: &materials.roughness,
            by_cosine: false,
            functions: &mut self.functions,
            model: self.model,
        });
        *sums = Sums::default();
        for c in 0..C {
            M::add_channel(
                self.isa,
                Channel {
                    directions: &self.products.directions,
                    products: &self.products.by_channel[c],
                    functions: &self.functions,
                    materials,
                    channel: c,
                    responses: &mut self.responses,
                    sums,
                },
            );
        }
    }
}

/// Adds one channel, with all of a pixel's light projections.
fn add_channel<M: Reflection, const C: usize>(isa: Instructions, channel: Channel<'_, M, C>) {
    isa.run(FillResponses {
        directions: channel.directions,
        albedo: &channel.materials.albedo[channel.channel],
        roughness: &channel.materials.roughness,
        metallic: &channel.materials.metallic,
        functions: channel.functions,
        responses: channel.responses,
        model: PhantomData::<M>,
    });
    isa.run(AddChannel { channel });
}

struct AddChannel<'a, M: Reflection, const C: usize> {
    channel: Channel<'a, M, C>,
}

impl<M: Reflection, const C: usize> Kernel for AddChannel<'_, M, C> {
    type Output = ();

    #[inline(always)]
    fn run<I: Isa>(self, _: I) {
        let Channel {
            products,
            channel,
            responses,
            sums,
            ..
        } = self.channel;
        let Responses {
            radiance,
            derivatives,
        } = &*responses;
        let unknowns = unknowns_of_channel::<C, DERIVATIVES>(channel);
        // Gf − t, and G f_x.
        let mut slope = [Doubles::default(); MAX_PROJECTIONS];
        let mut bent = [[Doubles::default(); MAX_PROJECTIONS]; DERIVATIVES];
        for s in 0..=M::ROWS {
            let target = if s == 0 {
                &products.diffuse_target
            } else {
                &products.row_target[s - 1]
            };
            for x in 0..BLOCK {
                slope[s].0[x] = -target.0[x];
            }
            for t in 0..=M::ROWS {
                let product = match (s, t) {
                    (0, 0) => &products.diffuse_diffuse,
                    (0, j) | (j, 0) => &products.diffuse_row[j - 1],
                    (i, j) => &products.row_row[pair(i - 1, j - 1)],
                };
                for x in 0..BLOCK {
                    slope[s].0[x] += product.0[x] * radiance[t].0[x];
                }
                for (bent, by) in bent.iter_mut().zip(derivatives) {
                    for x in 0..BLOCK {
                        bent[s].0[x] += product.0[x] * by[t].0[x];
                    }
                }
            }
            for x in 0..BLOCK {
                sums.sum_sq_residuals.0[x] += radiance[s].0[x] * (slope[s].0[x] - target.0[x]);
            }
        }
        for x in 0..BLOCK {
            sums.sum_sq_residuals.0[x] += products.target_target.0[x];
        }
        for (i, by) in derivatives.iter().enumerate() {
            for s in 0..=M::ROWS {
                for x in 0..BLOCK {
                    sums.gradient[unknowns[i]].0[x] += by[s].0[x] * slope[s].0[x];
                }
                for j in 0..=i {
                    let (row, column) =
                        (unknowns[i].max(unknowns[j]), unknowns[i].min(unknowns[j]));
                    for x in 0..BLOCK {
                        sums.matrix[row][column].0[x] += by[s].0[x] * bent[j][s].0[x];
                    }
                }
            }
        }
    }
}
