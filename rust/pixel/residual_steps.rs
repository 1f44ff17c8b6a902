//! The last steps of a pixel's fit, on its residuals one by one, in passes over the pictures.
//!
//! Where normals are given they only end what products began, from which the Gauss–Newton matrix still
//! comes: a pass makes the residuals, and the gradient from them. Free normals move here: each trial
//! makes directions, basis functions and derivatives anew. What is best at the normals of x may lie
//! in another valley than what is best with better normals, so pixels descend twice then, from the
//! material of x and from the best that products found, and the lower one is kept.

use crate::block::normal_jacobian::TangentOffsets;
use crate::pixel::descent::{Descent, LeastSquares, Point, PriorPlanes};
use crate::pixel::product_form::{FromProducts, LeastSquaresFromProducts};
use crate::pixel::samples::{Block, DERIVATIVES, Sums, UNKNOWNS};
use crate::problem::Problem;
use crate::reflectance::planes::{BLOCK, Doubles, Materials};
use crate::reflectance::reflection::Reflection;
use crate::reflectance::sh::COEFFICIENTS;
use crate::runtime::simd::Instructions;

/// Decrease of the cost, as a share of it, up to which residuals cannot tell it from rounding: the
/// pixel stops.
const RESIDUALS_ROUNDING: f64 = 1e-14;
/// Damping λ of the first step, as a share of the diagonal, where materials are nearly the best
/// already.
const MATERIALS_DAMPING: f64 = 1e-9;
/// The same where normals move too, which are not.
const NORMALS_DAMPING: f64 = 1e-3;
/// Least perceptual roughness that a descent with normals begins at: far below, radiance hardly
/// depends on roughness, and a pixel whose wrong normal made it a mirror would stay one.
const NORMALS_ROUGHNESS_MIN: f64 = 0.05;

/// Up to [`BLOCK`] pixels, and where they stand.
pub(crate) struct ResidualSteps<'a, M: Reflection, const C: usize, const D: usize, const U: usize> {
    pub(crate) best: Box<Point<C, U>>,
    /// Tangent offsets of the pixels, as they were given.
    offsets: TangentOffsets,
    /// What descends, where normals are free.
    candidate: Option<Box<Point<C, U>>>,
    isa: Instructions,
    metallic_known: bool,
    lights: &'a [[f64; COEFFICIENTS]],
    block: Block<'a, M, C, D>,
    trial: Box<Point<C, U>>,
}

/// Sums of squares from residuals.
struct FromResiduals<'a, 'b, M: Reflection, const C: usize, const D: usize> {
    lights: &'a [[f64; COEFFICIENTS]],
    block: &'b mut Block<'a, M, C, D>,
    products: FromProducts<'b, M>,
}

impl<M: LeastSquaresFromProducts, const C: usize, const D: usize, const U: usize> LeastSquares<C, U>
    for FromResiduals<'_, '_, M, C, D>
{
    fn take(
        &mut self,
        materials: &Materials<C>,
        offsets: &TangentOffsets,
        only_squares: bool,
        sums: &mut Sums<U>,
    ) {
        self.block.take(materials, offsets);
        if D > DERIVATIVES {
            *sums = Sums::default();
            self.block.add_samples(self.lights, false, sums);
            return;
        }
        if !only_squares {
            self.products.take(materials, offsets, false, sums);
        }
        self.block.put_residuals(self.lights, !only_squares, sums);
    }
}

impl<'a, M: LeastSquaresFromProducts, const C: usize, const D: usize, const U: usize>
    ResidualSteps<'a, M, C, D, U>
{
    pub(crate) fn new(problem: &'a Problem, lights: &'a [[f64; COEFFICIENTS]]) -> Self {
        Self {
            best: Box::default(),
            offsets: TangentOffsets::default(),
            candidate: (U > UNKNOWNS).then(Box::default),
            isa: problem.options.instructions,
            metallic_known: problem.options.metallic.is_some(),
            lights,
            block: Block::new(problem),
            trial: Box::default(),
        }
    }

    /// Takes up pixels with the normals of `maps`, whose tangent offsets are `offsets`.
    pub(crate) fn place(&mut self, maps: &[f64], pixels: &[usize], offsets: &TangentOffsets) {
        self.block.place(maps, pixels);
        self.offsets = *offsets;
    }

    /// Leaves in `best` where at most `steps` steps of the `used` pixels lead from their `own`
    /// materials or those that were `found`, whichever is better. Where it is not `unclear`, that is
    /// what was found.
    pub(crate) fn run(
        &mut self,
        [own, found]: [&Materials<C>; 2],
        [used, unclear]: [&Doubles; 2],
        products: FromProducts<M>,
        prior: Option<&PriorPlanes>,
        steps: usize,
    ) {
        let Self {
            best,
            offsets,
            candidate,
            lights,
            block,
            trial,
            ..
        } = self;
        let (isa, metallic_known) = (self.isa, self.metallic_known);
        let mut least_squares = FromResiduals {
            lights,
            block,
            products,
        };
        let mut descent = Descent {
            isa,
            prior,
            metallic_known,
            floor: &Doubles::default(),
            damping: MATERIALS_DAMPING,
            trial,
        };
        let Some(candidate) = candidate else {
            best.materials = *found;
            best.take(isa, &mut least_squares, prior, steps == 0);
            let unclear = differing(own, found, unclear);
            if unclear.0.iter().any(|&unclear| unclear > 0.0) {
                let trial = &mut *descent.trial;
                trial.materials = *own;
                trial.take(isa, &mut least_squares, prior, true);
                ignore_others(&mut trial.cost, &unclear);
                if (0..BLOCK).any(|x| trial.cost.0[x] < best.cost.0[x]) {
                    trial.take(isa, &mut least_squares, prior, false);
                    ignore_others(&mut trial.cost, &unclear);
                    best.keep_lower(isa, trial);
                }
            }
            let floor = floor(best);
            descent.floor = &floor;
            descent.run(&mut least_squares, best, *used, steps);
            return;
        };
        best.materials = *own;
        best.offsets = *offsets;
        best.take(isa, &mut least_squares, prior, false);
        let others = differing(own, found, used);
        for (start, active) in [(own, used), (found, &others)] {
            if active.0.iter().any(|&active| active > 0.0) {
                // Normals and materials of the active pixels move; others cost more than anything.
                candidate.materials = *start;
                candidate.offsets = *offsets;
                for r in &mut candidate.materials.roughness.0 {
                    *r = r.max(NORMALS_ROUGHNESS_MIN);
                }
                candidate.take(isa, &mut least_squares, prior, false);
                let floor = floor(candidate);
                let mut descent = Descent {
                    floor: &floor,
                    damping: NORMALS_DAMPING,
                    trial: &mut *descent.trial,
                    ..descent
                };
                descent.run(&mut least_squares, candidate, *active, steps);
                ignore_others(&mut candidate.cost, active);
                best.keep_lower(isa, candidate);
            }
        }
    }
}

/// Decreases that residuals cannot tell from rounding.
fn floor<const C: usize, const U: usize>(point: &Point<C, U>) -> Doubles {
    let mut floor = point.cost;
    for floor in &mut floor.0 {
        *floor *= RESIDUALS_ROUNDING;
    }
    floor
}

/// 1 for the `used` pixels whose materials are not the same.
fn differing<const C: usize>(one: &Materials<C>, other: &Materials<C>, used: &Doubles) -> Doubles {
    let mut differing = Doubles::default();
    for (one, other) in one.planes().zip(other.planes()) {
        for x in 0..BLOCK {
            if one.0[x] != other.0[x] {
                differing.0[x] = used.0[x];
            }
        }
    }
    differing
}

/// Pixels that are not active cost more than anything.
fn ignore_others(cost: &mut Doubles, active: &Doubles) {
    for x in 0..BLOCK {
        if active.0[x] == 0.0 {
            cost.0[x] = f64::INFINITY;
        }
    }
}
