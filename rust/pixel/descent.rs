//! Levenberg–Marquardt on the materials, and free tangent offsets, of a block of pixels, each for
//! itself.
//!
//! With g half of the gradient and A the Gauss–Newton matrix of a pixel's sum of squared residuals, a
//! step δ solves
//!
//! ```text
//! (A + λ diag A) δ = −g
//! ```
//!
//! for the unknowns that are free, inside a box: the bounds \[0, 1\], and for roughness no further
//! than [`ROUGHNESS_STEP_MAX`]. Tangent offsets have no bounds, but both together a longest step
//! ([`limit_offset_step`]). Damping by the diagonal means that the unit of an unknown does not
//! matter, so no scaling is needed; an unknown that radiance does not depend on has a diagonal of 0
//! and is fixed, as is one on a bound whose gradient points outwards. A step that leaves the box is
//! cut there and the other unknowns are solved for again with the cut ones where they are: cut
//! alone, it would leave them where they make sense only with the rest of the step.
//!
//! The equations of one pixel are in [`arrowhead`](super::arrowhead).

use crate::block::normal_jacobian::TangentOffsets;
use crate::pixel::arrowhead::{Arrowhead, MAX_SHARED, shared};
use crate::pixel::offset_step::limit_offset_step;
use crate::pixel::samples::{Sums, UNKNOWNS};
use crate::reflectance::planes::{BLOCK, Doubles, Materials, Plane};
use crate::reflectance::tangent_offset::OFFSETS;
use crate::runtime::simd::{Instructions, vectorized};

/// Longest move of perceptual roughness in one step; a longer one is cut to it. The derivative by
/// roughness falls with r³ towards 0, so from there the step that Gauss–Newton proposes is far too
/// long.
const ROUGHNESS_STEP_MAX: f64 = 0.25;
/// Perceptual roughness ε in the limits of a step with free normals, which goes down at most half way
/// to ε, and up at most to twice the roughness plus ε. With a wrong normal it is mostly the normal
/// that asks for a mirror, and a mirror does not say how rough it should be.
const ROUGHNESS_HALVING_FLOOR: f64 = 1e-3;
/// Least damping λ after a rejected step, as a share of the diagonal.
const DAMPING_AFTER_REJECTION_MIN: f64 = 1e-3;
/// Least damping λ at any time, as a share of the diagonal: it keeps the pivots positive.
pub(crate) const DAMPING_MIN: f64 = 1e-12;
/// Damping λ from which a pixel stops: its steps would be this much shorter than Newton's.
pub(crate) const DAMPING_MAX: f64 = 1e10;
/// Factor on the damping after a step whose gain ratio is good.
const DAMPING_DECREASE: f64 = 0.2;
/// Factor on the damping after a step that was rejected, or whose gain ratio is poor. Where residuals
/// are large and bend, steps are too long time after time, though the cost falls.
const DAMPING_INCREASE: f64 = 10.0;
/// Gain ratio (decrease of the cost over the predicted one) above which damping falls.
const GAIN_RATIO_GOOD: f64 = 0.25;
/// Gain ratio up to which damping grows; between both it stays.
const GAIN_RATIO_POOR: f64 = 0.1;
/// Diagonal entries up to this count as 0, and their unknowns are held: the inverse would overflow.
const DIAGONAL_MIN: f64 = 1e-280;
/// The sums of squared residuals of a block of pixels as a function of their unknowns, U at most.
pub(crate) trait LeastSquares<const C: usize, const U: usize> {
    /// Sum of squares, gradient and matrix at materials and tangent offsets; `sums` is overwritten.
    /// Where nobody looks at more, it may be `only_squares`.
    fn take(
        &mut self,
        materials: &Materials<C>,
        offsets: &TangentOffsets,
        only_squares: bool,
        sums: &mut Sums<U>,
    );
}

/// Gaussian priors, Σ_f precision (v_f − mean)² beside the squared residuals, for f = roughness,
/// metallic and the tangent offsets; a precision of 0 is no prior.
#[derive(Clone, Debug, Default)]
pub(crate) struct PriorPlanes {
    pub(crate) mean: [Doubles; MAX_SHARED],
    pub(crate) precision: [Doubles; MAX_SHARED],
}

/// A point for each pixel, and what is known there.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Point<const C: usize, const U: usize> {
    pub(crate) materials: Materials<C>,
    /// Where they are among the U unknowns; else not looked at.
    pub(crate) offsets: TangentOffsets,
    pub(crate) sums: Sums<U>,
    /// Sum of squared residuals and prior.
    pub(crate) cost: Doubles,
}

impl<const C: usize, const U: usize> Default for Point<C, U> {
    fn default() -> Self {
        Self {
            materials: Materials::default(),
            offsets: TangentOffsets::default(),
            sums: Sums::default(),
            cost: Doubles::default(),
        }
    }
}

impl<const C: usize, const U: usize> Point<C, U> {
    /// Works out what holds at the materials and tangent offsets.
    pub(crate) fn take(
        &mut self,
        isa: Instructions,
        least_squares: &mut impl LeastSquares<C, U>,
        prior: Option<&PriorPlanes>,
        only_squares: bool,
    ) {
        least_squares.take(&self.materials, &self.offsets, only_squares, &mut self.sums);
        self.cost = self.sums.sum_sq_residuals;
        if let Some(prior) = prior {
            vectorized!(isa, self.add_prior(prior));
        }
    }

    /// Takes the pixels of `other` whose cost is less.
    pub(crate) fn keep_lower(&mut self, isa: Instructions, other: &Self) {
        let mut lower = Doubles::default();
        for x in 0..BLOCK {
            lower.0[x] = if other.cost.0[x] < self.cost.0[x] {
                1.0
            } else {
                0.0
            };
        }
        vectorized!(isa, self.copy_selected(&lower, other));
    }

    #[inline(always)]
    fn add_prior(&mut self, prior: &PriorPlanes) {
        let (materials, [a, b]) = (&self.materials, &self.offsets);
        let shared_values = [&materials.roughness, &materials.metallic, a, b];
        for (f, values) in shared_values.into_iter().take(shared(U)).enumerate() {
            let unknown = C + f;
            for x in 0..BLOCK {
                let precision = prior.precision[f].0[x];
                let deviation = values.0[x] - prior.mean[f].0[x];
                self.cost.0[x] += precision * deviation * deviation;
                self.sums.gradient[unknown].0[x] += precision * deviation;
                self.sums.matrix[unknown][unknown].0[x] += precision;
            }
        }
    }

    /// Copies the pixels whose entry of `which` is 1.
    #[inline(always)]
    fn copy_selected(&mut self, which: &Doubles, from: &Self) {
        // By bits: of a choice between two numbers in memory the compiler makes a jump a pixel.
        let mut new = [0; BLOCK];
        for x in 0..BLOCK {
            new[x] = if which.0[x] > 0.0 { u64::MAX } else { 0 };
        }
        let take = |from: &Doubles, to: &mut Doubles| {
            for x in 0..BLOCK {
                let (a, b) = (from.0[x].to_bits(), to.0[x].to_bits());
                to.0[x] = f64::from_bits((a & new[x]) | (b & !new[x]));
            }
        };
        for c in 0..C {
            take(&from.materials.albedo[c], &mut self.materials.albedo[c]);
        }
        take(&from.materials.roughness, &mut self.materials.roughness);
        take(&from.materials.metallic, &mut self.materials.metallic);
        for offset in 0..shared(U) - 2 {
            take(&from.offsets[offset], &mut self.offsets[offset]);
        }
        let (from_sums, to_sums) = (&from.sums, &mut self.sums);
        for row in 0..C + shared(U) {
            take(&from_sums.gradient[row], &mut to_sums.gradient[row]);
            for column in 0..=row {
                // Of the albedos with each other there is only the diagonal.
                if row >= C || row == column {
                    let to = &mut to_sums.matrix[row][column];
                    take(&from_sums.matrix[row][column], to);
                }
            }
        }
        take(&from_sums.sum_sq_residuals, &mut to_sums.sum_sq_residuals);
        take(&from.cost, &mut self.cost);
    }

    /// One step: writes what is to be tried into `trial`, and by how much the cost would fall were it
    /// quadratic.
    #[inline(always)]
    fn step(
        &self,
        metallic_known: bool,
        damping: &Doubles,
        active: &Doubles,
        trial: &mut Self,
        predicted: &mut Doubles,
    ) {
        let materials = &self.materials;
        let metallic_free = if metallic_known { 0.0 } else { 1.0 };
        for x in 0..BLOCK {
            let mut value = [0.0; U];
            for c in 0..C {
                value[c] = materials.albedo[c].0[x];
            }
            value[C] = materials.roughness.0[x];
            value[C + 1] = materials.metallic.0[x];
            let mut free = [active.0[x]; U];
            free[C + 1] *= metallic_free;
            let mut system = Arrowhead::<C, U>::of(&self.sums, x);
            let offset = [self.offsets[0].0[x], self.offsets[1].0[x]];
            let (step, there) =
                boxed_step::<_, _, false>(&mut system, &value, offset, free, damping.0[x]);
            for c in 0..C {
                trial.materials.albedo[c].0[x] = (value[c] + step[c]).clamp(0.0, 1.0);
            }
            trial.materials.roughness.0[x] = (value[C] + step[C]).clamp(0.0, 1.0);
            trial.materials.metallic.0[x] = (value[C + 1] + step[C + 1]).clamp(0.0, 1.0);
            if U > UNKNOWNS {
                for t in 0..OFFSETS {
                    trial.offsets[t].0[x] = there[t];
                }
            }
            predicted.0[x] = system.decrease(&step);
        }
    }
}

/// How a block descends.
pub(crate) struct Descent<'a, const C: usize, const U: usize> {
    pub(crate) isa: Instructions,
    pub(crate) prior: Option<&'a PriorPlanes>,
    /// Where it is known, metallic stays.
    pub(crate) metallic_known: bool,
    /// Decreases up to this are rounding.
    pub(crate) floor: &'a Doubles,
    /// Before the first step.
    pub(crate) damping: f64,
    pub(crate) trial: &'a mut Box<Point<C, U>>,
}

impl<const C: usize, const U: usize> Descent<'_, C, U> {
    /// At most `steps` steps from a point at which everything is known, for the pixels that are
    /// `active` (1, else 0). Of where the last one leads, only materials and squares are known.
    pub(crate) fn run(
        &mut self,
        least_squares: &mut impl LeastSquares<C, U>,
        point: &mut Box<Point<C, U>>,
        mut active: Doubles,
        steps: usize,
    ) {
        let mut damping = Plane([self.damping; BLOCK]);
        let mut predicted = Doubles::default();
        for step in 1..=steps {
            if active.0.iter().all(|&a| a == 0.0) {
                break;
            }
            let known = self.metallic_known;
            let trial = &mut **self.trial;
            vectorized!(
                self.isa,
                point.step(known, &damping, &active, trial, &mut predicted)
            );
            self.trial
                .take(self.isa, least_squares, self.prior, step == steps);
            let mut accepted = Doubles::default();
            let tried = active;
            let costs = [&point.cost, &self.trial.cost, &predicted, self.floor];
            let changes = [&mut active, &mut damping, &mut accepted];
            vectorized!(self.isa, update_damping(costs, changes));
            // Where a pixel was not tried, both points are the same.
            if accepted.0 == tried.0 {
                std::mem::swap(point, self.trial);
            } else {
                vectorized!(self.isa, point.copy_selected(&accepted, self.trial));
            }
        }
    }
}

/// Which trials are accepted, who is done, and the damping of the next step.
#[inline(always)]
fn update_damping(
    [cost, trial, predicted, floor]: [&Doubles; 4],
    [active, damping, accepted]: [&mut Doubles; 3],
) {
    for x in 0..BLOCK {
        // A comparison with NaN is false.
        let fell = trial.0[x] < cost.0[x];
        accepted.0[x] = if fell { active.0[x] } else { 0.0 };
        let predicted = predicted.0[x];
        let gained = if fell {
            cost.0[x] - trial.0[x]
        } else {
            predicted
        };
        let before = damping.0[x];
        damping.0[x] = if fell & (gained > GAIN_RATIO_GOOD * predicted) {
            (DAMPING_DECREASE * before).max(DAMPING_MIN)
        } else if fell & (gained > GAIN_RATIO_POOR * predicted) {
            before
        } else {
            (DAMPING_INCREASE * before).max(DAMPING_AFTER_REJECTION_MIN)
        };
        let goes_on = gained > floor.0[x] && damping.0[x] < DAMPING_MAX;
        active.0[x] = if goes_on { active.0[x] } else { 0.0 };
    }
}

/// How far the unknowns of a pixel go from `value` and its tangent offsets in one step, those that are
/// `free` (1, else 0); and where this leads the tangent offsets. A pixel `ALONE` asks whether anything
/// was cut; in a block that would be a jump a pixel.
#[inline(always)]
pub(crate) fn boxed_step<const C: usize, const U: usize, const ALONE: bool>(
    system: &mut Arrowhead<C, U>,
    value: &[f64; U],
    offset: [f64; OFFSETS],
    free: [f64; U],
    damping: f64,
) -> ([f64; U], [f64; OFFSETS]) {
    let mut lowest = [0.0; U];
    let mut highest = [0.0; U];
    for j in 0..C + 2 {
        lowest[j] = -value[j];
        highest[j] = 1.0 - value[j];
        let outwards = if system.gradient[j] > 0.0 {
            lowest[j] >= 0.0
        } else {
            highest[j] <= 0.0
        };
        let held = outwards | (system.diagonal[j] <= DIAGONAL_MIN);
        system.free[j] = if held { 0.0 } else { free[j] };
    }
    for j in C + 2..C + shared(U) {
        let held = system.diagonal[j] <= DIAGONAL_MIN;
        system.free[j] = if held { 0.0 } else { free[j] };
    }
    if U > UNKNOWNS {
        let down = 0.5 * (ROUGHNESS_HALVING_FLOOR - value[C]);
        lowest[C] = lowest[C].max(down.min(0.0));
        highest[C] = highest[C].min(value[C] + ROUGHNESS_HALVING_FLOOR);
    }
    lowest[C] = lowest[C].max(-ROUGHNESS_STEP_MAX);
    highest[C] = highest[C].min(ROUGHNESS_STEP_MAX);

    let damped = 1.0 + damping;
    let mut step = system.solve(damped);
    let mut whole = true;
    for j in 0..C + 2 {
        let cut = step[j].max(lowest[j]).min(highest[j]);
        let inside = cut == step[j];
        whole &= inside;
        system.free[j] = if inside { system.free[j] } else { 0.0 };
        system.fixed[j] = if inside { 0.0 } else { cut };
    }
    if U > UNKNOWNS {
        let wanted = [step[C + 2], step[C + 3]];
        let (share, there) = limit_offset_step(offset, wanted);
        // Turned round or shortened, it leads elsewhere than the step.
        let inside = (share == 1.0)
            & (there[0] == offset[0] + wanted[0])
            & (there[1] == offset[1] + wanted[1]);
        whole &= inside;
        for t in 0..OFFSETS {
            let j = C + 2 + t;
            system.free[j] = if inside { system.free[j] } else { 0.0 };
            system.fixed[j] = if inside { 0.0 } else { there[t] - offset[t] };
        }
    }
    if !(ALONE && whole) {
        step = system.solve(damped);
    }
    for j in 0..C + 2 {
        step[j] = step[j].max(lowest[j]).min(highest[j]);
    }
    let mut there = offset;
    if U > UNKNOWNS {
        (_, there) = limit_offset_step(offset, [step[C + 2], step[C + 3]]);
        for t in 0..OFFSETS {
            step[C + 2 + t] = there[t] - offset[t];
        }
    }
    (step, there)
}
