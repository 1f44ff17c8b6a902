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
use crate::pixel::products::{PixelProducts, Products};
use crate::pixel::samples::{DERIVATIVES, FillResponses, Responses, Sums, unknowns_of_channel};
use crate::reflectance::planes::{BLOCK, Directions, Doubles, Materials, no_functions};
use crate::reflectance::principled::Principled;
use crate::reflectance::reflection::{ExactFunctions, Reflection};
use crate::runtime::simd::{Instructions, Isa, Kernel};

mod paper;

/// Models whose sum of squared residuals comes from products.
pub(crate) trait LeastSquaresFromProducts: Reflection {
    /// Fills in sum of squares, gradient and matrix; of the albedos with each other only the
    /// diagonal.
    fn fill_sums<const C: usize, const U: usize>(
        isa: Instructions,
        channels: Channels<'_, Self, C, U>,
    ) {
        *channels.sums = Sums::default();
        for c in 0..C {
            isa.run(FillResponses {
                directions: channels.directions,
                albedo: &channels.materials.albedo[c],
                roughness: &channels.materials.roughness,
                metallic: &channels.materials.metallic,
                functions: channels.functions,
                responses: channels.responses,
                model: PhantomData::<Self>,
            });
            isa.run(AddChannel::<Self, U> {
                products: &channels.products[c],
                responses: channels.responses,
                unknowns: unknowns_of_channel::<C, DERIVATIVES>(c),
                sums: channels.sums,
                model: PhantomData,
            });
        }
    }
}

impl<const S: bool> LeastSquaresFromProducts for Principled<S> {}

/// The channels of a block.
pub(crate) struct Channels<'a, M: Reflection, const C: usize, const U: usize> {
    pub(crate) directions: &'a Directions<f64>,
    pub(crate) products: &'a [Products],
    pub(crate) functions: &'a ExactFunctions<M>,
    pub(crate) materials: &'a Materials<C>,
    /// Room for what a sample is made of.
    pub(crate) responses: &'a mut Responses,
    /// To be written.
    pub(crate) sums: &'a mut Sums<U>,
}

/// Sums of squares from products, at the normals that these were summed at.
pub(crate) struct Form<M: Reflection> {
    isa: Instructions,
    functions: Box<ExactFunctions<M>>,
    responses: Responses,
}

impl<M: LeastSquaresFromProducts> Form<M> {
    pub(crate) fn new(isa: Instructions) -> Self {
        Self {
            isa,
            functions: no_functions(),
            responses: Responses::default(),
        }
    }
}

/// A form and the products that it is of.
pub(crate) struct FromProducts<'a, M: Reflection>(
    pub(crate) &'a mut Form<M>,
    pub(crate) &'a PixelProducts,
);

impl<M: LeastSquaresFromProducts, const C: usize, const U: usize> LeastSquares<C, U>
    for FromProducts<'_, M>
{
    fn take(
        &mut self,
        materials: &Materials<C>,
        _: &TangentOffsets,
        _only_squares: bool,
        sums: &mut Sums<U>,
    ) {
        let Self(form, products) = self;
        form.isa.run(FillFunctions::<M> {
            cosine: products.directions.cosines(),
            roughness: &materials.roughness,
            by_cosine: false,
            functions: &mut form.functions,
        });
        let channels = Channels {
            directions: &products.directions,
            products: &products.by_channel,
            functions: &form.functions,
            materials,
            responses: &mut form.responses,
            sums,
        };
        M::fill_sums(form.isa, channels);
    }
}

/// Adds one channel, with all of a pixel's light projections.
struct AddChannel<'a, M: Reflection, const U: usize> {
    products: &'a Products,
    responses: &'a Responses,
    unknowns: [usize; DERIVATIVES],
    sums: &'a mut Sums<U>,
    model: PhantomData<M>,
}

impl<M: Reflection, const U: usize> Kernel for AddChannel<'_, M, U> {
    type Output = ();

    #[inline(always)]
    fn run<I: Isa>(self, _: I) {
        let Self {
            products,
            responses:
                Responses {
                    radiance,
                    derivatives,
                },
            unknowns,
            sums,
            ..
        } = self;
        // Gf − t, and G f_x.
        let mut slope = [Doubles::default(); MAX_PROJECTIONS];
        let mut bent = [[Doubles::default(); MAX_PROJECTIONS]; DERIVATIVES];
        for s in 0..=M::ROWS {
            let target = products.with_target(s);
            for x in 0..BLOCK {
                slope[s].0[x] = -target.0[x];
            }
            for t in 0..=M::ROWS {
                let product = products.of(s, t);
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
            sums.sum_sq_residuals.0[x] += products.target_target().0[x];
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
