//! Levenberg–Marquardt on one pixel under known lamps.
//!
//! Steps, and the box that they stay in, are those of [`pixel::descent`](crate::pixel::descent) where
//! normals are free: a lobe of a lamp is as narrow as α, so roughness always moves down by at most
//! half, up to at most twice as much.

use glam::DVec3;

use super::samples::{Equations, METALLIC, OFFSET, Point, ROUGHNESS, Samples, UNKNOWNS};
use crate::pixel::arrowhead::Arrowhead;
use crate::pixel::descent::{DAMPING_MAX, DAMPING_MIN, boxed_step};
use crate::reflectance::planes::Material;
use crate::reflectance::reflection::Reflection;
use crate::reflectance::tangent_offset::{OFFSETS, OffsetNormal, offset_normal};

/// Least perceptual roughness that a fit starts from where it is free. The derivative by roughness is
/// 0 at 0: it would stay there.
const START_ROUGHNESS_MIN: f64 = 0.03;
/// Least n·v of a normal that a step may lead to, unless it was less before: 89.4 degrees.
const N_DOT_V_MIN: f64 = 0.01;
/// Damping λ of the first step, as a share of the diagonal. A start may be far away, where the first
/// steps of a smaller one lead more pixels to other minima.
const FIRST_DAMPING: f64 = 0.1;
/// Decrease of the cost, as a share of it, up to which a pixel stops: of the χ² of a dozen pictures it
/// is a hundredth of a standard deviation.
const DECREASE_MIN: f64 = 1e-6;

/// Factor on the damping after a step that was rejected; after each more in a row it is twice as much.
const FIRST_INCREASE: f64 = 2.0;

/// Factor on the damping after a step with the gain ratio q (decrease of the cost over the predicted
/// one),
///
/// ```text
/// max(1/3, 1 − (2q−1)³),
/// ```
///
/// so it stays at q = 1/2, and falls to a third where the cost is as quadratic as predicted (H. B.
/// Nielsen, "Damping parameter in Marquardt's method", 1999). Radiance is nearly the same along bent
/// valleys, as of more roughness and less metallic; rules that cut damping whenever a step succeeds
/// have every second one rejected there.
fn decrease(gain_ratio: f64) -> f64 {
    let x = 2.0 * gain_ratio - 1.0;
    (1.0 - x * x * x).clamp(1.0 / 3.0, 2.0)
}

/// Which unknowns move.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Free {
    /// The normal, by its tangent offset.
    pub normals: bool,
    /// Metallic.
    pub metallic: bool,
    /// Roughness.
    pub roughness: bool,
}

impl Free {
    /// By unknown: 1, or 0 of one that is held.
    pub(super) fn unknowns(self) -> [f64; UNKNOWNS] {
        let of = |free| if free { 1.0 } else { 0.0 };
        let mut free = [1.0; UNKNOWNS];
        free[ROUGHNESS] = of(self.roughness);
        free[METALLIC] = of(self.metallic);
        free[OFFSET..].fill(of(self.normals));
        free
    }
}

/// A pixel where its fit ended.
pub(super) struct Ended {
    pub(super) point: Point,
    pub(super) cost: f64,
    pub(super) equations: Equations,
}

/// The fit of one pixel.
pub(super) struct Descent<'a> {
    pub(super) samples: Samples<'a>,
    /// The normal that tangent offsets are of.
    pub(super) base: DVec3,
    pub(super) start: Point,
    pub(super) free: Free,
}

impl Descent<'_> {
    /// At most so many steps. What it ends at is never worse than the start.
    pub(super) fn run<M: Reflection>(&self, iterations: usize) -> Ended {
        let start = self.start;
        let mut at = start;
        let raised = self.free.roughness
            && at.material.roughness < START_ROUGHNESS_MIN
            && iterations > 0
            && self.samples.any();
        if raised {
            at.material.roughness = START_ROUGHNESS_MIN;
        }
        let ended = self.from::<M>(at, iterations);
        // A comparison with NaN is false, and leaves the start.
        match raised.then(|| self.here::<M>(start)) {
            Some(here) if ended.cost < here.cost => ended,
            Some(here) => here,
            None => ended,
        }
    }

    fn from<M: Reflection>(&self, start: Point, iterations: usize) -> Ended {
        let mut ended = self.here::<M>(start);
        let (mut damping, mut increase) = (FIRST_DAMPING, FIRST_INCREASE);
        for _ in 0..iterations {
            let (trial, predicted) = self.step(&ended, damping);
            let n_dot_v = |point: &Point| point.normal.dot(self.samples.view);
            let least = N_DOT_V_MIN.min(n_dot_v(&ended.point));
            // Most steps are taken, so that their equations come with their cost.
            let there = (n_dot_v(&trial) >= least).then(|| self.here::<M>(trial));
            // A comparison with NaN is false.
            let lower = there.filter(|there| there.cost < ended.cost);
            let gained = match &lower {
                Some(lower) => ended.cost - lower.cost,
                // Less than 0 of a step that the box has cut to one that leads upwards: more damping
                // makes it shorter, until it is not cut.
                None => predicted.abs(),
            };
            let goes_on = gained > DECREASE_MIN * ended.cost;
            if let Some(lower) = lower {
                ended = lower;
                damping = (damping * decrease(gained / predicted)).max(DAMPING_MIN);
                increase = FIRST_INCREASE;
            } else {
                damping *= increase;
                increase *= 2.0;
            }
            if !goes_on || damping >= DAMPING_MAX {
                break;
            }
        }
        ended
    }

    fn here<M: Reflection>(&self, point: Point) -> Ended {
        let turned = match self.free.normals {
            true => self.turned(point.offset).by_offset,
            false => [DVec3::ZERO; OFFSETS],
        };
        let (cost, equations) = self.samples.equations::<M>(&point, &turned);
        Ended {
            point,
            cost,
            equations,
        }
    }

    /// The normal of a tangent offset: that of the start to the last digit.
    fn turned(&self, offset: [f64; OFFSETS]) -> OffsetNormal {
        let mut turned = offset_normal(self.base, offset);
        if offset == self.start.offset {
            turned.normal = self.start.normal;
        }
        turned
    }

    /// Where one step leads, and by how much the cost would fall were it quadratic.
    fn step(&self, from: &Ended, damping: f64) -> (Point, f64) {
        let value = from.point.values();
        let Equations { matrix, gradient } = &from.equations;
        let mut system = Arrowhead::<3, UNKNOWNS>::new(matrix, gradient);
        let free = self.free.unknowns();
        let (step, there) =
            boxed_step::<_, _, true>(&mut system, &value, from.point.offset, free, damping);
        let moved = |x: usize| (value[x] + step[x]).clamp(0.0, 1.0);
        let trial = Point {
            offset: there,
            normal: self.turned(there).normal,
            material: Material {
                albedo: [moved(0), moved(1), moved(2)],
                roughness: moved(ROUGHNESS),
                metallic: moved(METALLIC),
            },
        };
        (trial, system.decrease(&step))
    }
}
