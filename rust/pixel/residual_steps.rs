//! The last steps of a pixel's fit, on its residuals one by one, in passes over the pictures.
//!
//! Where normals are given they only end what products began. Free normals move here: each trial
//! makes directions, basis functions and derivatives anew. What is best at the normals of x may lie
//! in another valley than what is best with better normals, so pixels descend twice then, from the
//! material of x and from the best that products found, and the lower one is kept.

use crate::block::normal_jacobian::TangentOffsets;
use crate::pixel::descent::{Descent, LeastSquares, Point, PriorPlanes};
use crate::pixel::samples::{Block, Sums, UNKNOWNS};
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
    workspace: Workspace<'a, M, C, D, U>,
}

/// What a descent needs beside the point that it moves.
struct Workspace<'a, M: Reflection, const C: usize, const D: usize, const U: usize> {
    isa: Instructions,
    metallic_known: bool,
    least_squares: FromResiduals<'a, M, C, D>,
    trial: Box<Point<C, U>>,
}

/// Sums of squares from residuals.
struct FromResiduals<'a, M: Reflection, const C: usize, const D: usize> {
    lights: &'a [[f64; COEFFICIENTS]],
    block: Block<'a, M, C, D>,
}

impl<M: Reflection, const C: usize, const D: usize, const U: usize> LeastSquares<C, U>
    for FromResiduals<'_, M, C, D>
{
    fn take(&mut self, materials: &Materials<C>, offsets: &TangentOffsets, sums: &mut Sums<U>) {
        *sums = Sums::default();
        self.block.take(materials, offsets);
        self.block.add_samples(self.lights, sums);
    }
}

impl<'a, M: Reflection, const C: usize, const D: usize, const U: usize>
    ResidualSteps<'a, M, C, D, U>
{
    pub(crate) fn new(problem: &'a Problem, lights: &'a [[f64; COEFFICIENTS]]) -> Self {
        Self {
            best: Box::default(),
            offsets: TangentOffsets::default(),
            candidate: (U > UNKNOWNS).then(Box::default),
            workspace: Workspace {
                isa: problem.instructions(),
                metallic_known: problem.known_metallic().is_some(),
                least_squares: FromResiduals {
                    lights,
                    block: Block::new(problem),
                },
                trial: Box::default(),
            },
        }
    }

    /// Takes up pixels with the normals of `maps`, whose tangent offsets are `offsets`.
    pub(crate) fn place(&mut self, maps: &[f64], pixels: &[usize], offsets: &TangentOffsets) {
        self.workspace.least_squares.block.place(maps, pixels);
        self.offsets = *offsets;
    }

    /// Leaves in `best` where at most `steps` steps of the `used` pixels lead from their `own`
    /// materials or those that were `found`, whichever is better. Where it is not `unclear`, that is
    /// what was found.
    pub(crate) fn run(
        &mut self,
        [own, found]: [&Materials<C>; 2],
        [used, unclear]: [&Doubles; 2],
        prior: Option<&PriorPlanes>,
        steps: usize,
    ) {
        let Self {
            best,
            offsets,
            candidate,
            workspace,
        } = self;
        if let Some(candidate) = candidate {
            best.materials.clone_from(own);
            best.offsets = *offsets;
            workspace.take(best, prior);
            let others = differing(own, found, used);
            for (start, active) in [(own, used), (found, &others)] {
                if active.0.iter().any(|&active| active > 0.0) {
                    candidate.materials.clone_from(start);
                    candidate.offsets = *offsets;
                    workspace.descend_with_normals(candidate, active, prior, steps);
                    best.keep_lower(workspace.isa, candidate);
                }
            }
            return;
        }
        best.materials.clone_from(found);
        workspace.take(best, prior);
        if unclear.0.iter().any(|&unclear| unclear > 0.0) {
            let trial = &mut workspace.trial;
            trial.materials.clone_from(own);
            trial.take(workspace.isa, &mut workspace.least_squares, prior);
            ignore_others(&mut trial.cost, unclear);
            best.keep_lower(workspace.isa, trial);
        }
        workspace.descend(best, used, prior, MATERIALS_DAMPING, steps);
    }
}

impl<M: Reflection, const C: usize, const D: usize, const U: usize> Workspace<'_, M, C, D, U> {
    fn take(&mut self, point: &mut Point<C, U>, prior: Option<&PriorPlanes>) {
        point.take(self.isa, &mut self.least_squares, prior);
    }

    /// Moves normals and materials of the `active` pixels; other pixels cost more than anything then.
    fn descend_with_normals(
        &mut self,
        candidate: &mut Box<Point<C, U>>,
        active: &Doubles,
        prior: Option<&PriorPlanes>,
        steps: usize,
    ) {
        for r in &mut candidate.materials.roughness.0 {
            *r = r.max(NORMALS_ROUGHNESS_MIN);
        }
        self.take(candidate, prior);
        self.descend(candidate, active, prior, NORMALS_DAMPING, steps);
        ignore_others(&mut candidate.cost, active);
    }

    fn descend(
        &mut self,
        point: &mut Box<Point<C, U>>,
        active: &Doubles,
        prior: Option<&PriorPlanes>,
        damping: f64,
        steps: usize,
    ) {
        let mut floor = Doubles::default();
        for x in 0..BLOCK {
            floor.0[x] = RESIDUALS_ROUNDING * point.cost.0[x];
        }
        Descent {
            isa: self.isa,
            prior,
            metallic_known: self.metallic_known,
            floor: &floor,
            damping,
            trial: &mut self.trial,
        }
        .run(&mut self.least_squares, point, *active, steps);
    }
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
