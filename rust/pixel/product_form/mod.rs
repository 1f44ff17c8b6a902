//! Sums of squared residuals of pixels as a function of their materials, from products over pictures.
//!
//! With f the factors of a pixel's light projections ([`products`](super::products)) and f_ρ, f_m,
//! f_r their derivatives, Σ ω (I − T)² is fᵀGf − 2fᵀt + TᵀT, half of its gradient f_x·(Gf − t), the
//! Gauss–Newton matrix f_xᵀGf_y. They cost the same for any number of pictures, and know the sum to
//! 10⁻¹⁵ of Σ ω T².

use crate::block::basis::MAX_PROJECTIONS;
use crate::block::factors::FillFunctions;
use crate::block::normal_jacobian::TangentOffsets;
use crate::pixel::descent::LeastSquares;
use crate::pixel::products::{PixelProducts, Products};
use crate::pixel::samples::{DERIVATIVES, Responses, Sums, unknowns_of_channel};
use crate::reflectance::planes::{BLOCK, Doubles, Materials, no_functions};
use crate::reflectance::principled::Principled;
use crate::reflectance::reflection::{ExactFunctions, Reflection};
use crate::runtime::simd::{Instructions, vectorized};

mod paper;

/// Models whose sum of squared residuals comes from products.
pub(crate) trait LeastSquaresFromProducts: Reflection {
    /// Fills in sum of squares, gradient and matrix; of the albedos with each other only the
    /// diagonal.
    fn fill_sums<const C: usize, const U: usize>(
        form: &mut Form<Self>,
        products: &PixelProducts,
        materials: &Materials<C>,
        sums: &mut Sums<U>,
    ) {
        *sums = Sums::default();
        let (directions, functions) = (&products.directions, &form.functions);
        let responses = &mut form.responses;
        for (c, products) in products.by_channel.iter().enumerate() {
            vectorized!(
                form.isa,
                responses.fill::<Self, C>(c, directions, materials, functions)
            );
            let unknowns = unknowns_of_channel::<C, DERIVATIVES>(c);
            vectorized!(
                form.isa,
                add_channel::<Self, U>(products, responses, unknowns, sums)
            );
        }
    }
}

impl<const S: bool> LeastSquaresFromProducts for Principled<S> {}

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
        M::fill_sums(form, products, materials, sums);
    }
}

/// Adds one channel, with all of a pixel's light projections.
#[inline(always)]
fn add_channel<M: Reflection, const U: usize>(
    products: &Products,
    responses: &Responses,
    unknowns: [usize; DERIVATIVES],
    sums: &mut Sums<U>,
) {
    let Responses {
        radiance,
        derivatives,
    } = responses;
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
                let (row, column) = (unknowns[i].max(unknowns[j]), unknowns[i].min(unknowns[j]));
                for x in 0..BLOCK {
                    sums.matrix[row][column].0[x] += by[s].0[x] * bent[j][s].0[x];
                }
            }
        }
    }
}
