//! Levenberg–Marquardt on the materials of a block of pixels, each for itself.
//!
//! With g half of the gradient and A the Gauss–Newton matrix of a pixel's squares, a step δ solves
//!
//! ```text
//! (A + λ diag A) δ = −g
//! ```
//!
//! for the unknowns that are free, inside a box: the bounds \[0, 1\], and for roughness no further
//! than [`REACH`]. Damping by the diagonal means that the unit of an unknown does not matter, so no
//! scaling is needed; an unknown that radiance does not depend on has a diagonal of 0 and is held,
//! as is one on a bound whose gradient points outwards. A step that leaves the box is cut there and
//! the other unknowns are solved for again with the cut ones where they are: cut alone, it would
//! leave them where they make sense only with the rest of the step.
//!
//! Channels have nothing to do with each other but for roughness and metallic, so A is an arrow:
//! its albedo part is diagonal, and what has to be factorised is two by two.

use crate::block::{BLOCK, Materials, Plane};
use crate::normal_matrix::{MAX_UNKNOWNS, Sums};
use crate::simd::{Instructions, Isa, Kernel};

/// Roughness at most moves so far in a step. Its derivative falls with r³ towards 0, so from there
/// the step that Gauss–Newton proposes is far too long.
const REACH: f64 = 0.25;
/// Damping after a rejected step is at least this.
const RESTRAINED: f64 = 1e-3;
/// Damping never falls below: it keeps the pivots positive.
const LEAST_DAMPING: f64 = 1e-12;
/// Beyond it nothing is to be gained.
const MOST_DAMPING: f64 = 1e10;
/// Factors of the damping after a step that kept its promise, and one that did not. Where residuals
/// are large and bend, steps are too long time after time, though squares fall.
const CALMER: f64 = 0.2;
const WILDER: f64 = 10.0;
/// Parts of the predicted decrease from which a promise is kept, or else broken.
const HELD: f64 = 0.25;
const BROKEN: f64 = 0.1;
/// Diagonals up to this are 0: their inverse would overflow.
const NOTHING: f64 = 1e-280;
/// Of the diagonal, below which a pivot is rounding.
const LEAST_PIVOT: f64 = 1e-14;

type Doubles = Plane<f64>;

/// Squares of a block of pixels as a function of their materials.
pub(crate) trait Squares<const C: usize> {
    /// Squares, gradient and matrix at `materials`; what `sums` holds is overwritten.
    fn take(&mut self, materials: &Materials<C>, sums: &mut Sums);
}

/// Σ_f precision (v_f − centre)² beside the squares, for f = roughness, metallic; zeros are none.
#[derive(Clone, Debug, Default)]
pub(crate) struct Pull {
    pub(crate) centre: [Doubles; 2],
    pub(crate) precision: [Doubles; 2],
}

/// A point for each pixel, and what is known there.
#[derive(Clone, Debug)]
pub(crate) struct Point<const C: usize> {
    pub(crate) materials: Materials<C>,
    pub(crate) sums: Sums,
    /// Squares and pull.
    pub(crate) cost: Doubles,
}

impl<const C: usize> Default for Point<C> {
    fn default() -> Self {
        Self {
            materials: Materials::default(),
            sums: Sums::default(),
            cost: Doubles::default(),
        }
    }
}

impl<const C: usize> Point<C> {
    /// Works out what holds at the materials.
    pub(crate) fn take(
        &mut self,
        isa: Instructions,
        squares: &mut impl Squares<C>,
        pull: Option<&Pull>,
    ) {
        squares.take(&self.materials, &mut self.sums);
        self.cost = self.sums.squares;
        if let Some(pull) = pull {
            isa.run(AddPull { point: self, pull });
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
        isa.run(Take {
            which: &lower,
            from: other,
            to: self,
        });
    }
}

/// How a block descends.
pub(crate) struct Descent<'a, const C: usize> {
    pub(crate) isa: Instructions,
    pub(crate) pull: Option<&'a Pull>,
    /// Where it is known, metallic stays.
    pub(crate) metallic_known: bool,
    /// Decreases up to this are rounding.
    pub(crate) floor: &'a Doubles,
    /// Before the first step.
    pub(crate) damping: f64,
    pub(crate) trial: &'a mut Box<Point<C>>,
}

impl<const C: usize> Descent<'_, C> {
    /// At most `steps` steps from a point at which everything is known, for the pixels that are
    /// `active` (1, else 0).
    pub(crate) fn run(
        &mut self,
        squares: &mut impl Squares<C>,
        point: &mut Box<Point<C>>,
        mut active: Doubles,
        steps: usize,
    ) {
        let mut damping = Plane([self.damping; BLOCK]);
        let mut predicted = Doubles::default();
        for _ in 0..steps {
            if active.0.iter().all(|&a| a == 0.0) {
                break;
            }
            self.isa.run(Step {
                point,
                metallic_known: self.metallic_known,
                damping: &damping,
                active: &active,
                trial: &mut self.trial.materials,
                predicted: &mut predicted,
            });
            self.trial.take(self.isa, squares, self.pull);
            let mut accepted = Doubles::default();
            let tried = active;
            self.isa.run(Judge {
                cost: &point.cost,
                trial: &self.trial.cost,
                predicted: &predicted,
                floor: self.floor,
                active: &mut active,
                damping: &mut damping,
                accepted: &mut accepted,
            });
            // Where a pixel was not tried, both points are the same.
            if accepted.0 == tried.0 {
                std::mem::swap(point, self.trial);
            } else {
                self.isa.run(Take {
                    which: &accepted,
                    from: self.trial,
                    to: point,
                });
            }
        }
    }
}

struct AddPull<'a, const C: usize> {
    point: &'a mut Point<C>,
    pull: &'a Pull,
}

impl<const C: usize> Kernel for AddPull<'_, C> {
    type Output = ();

    #[inline(always)]
    fn run<I: Isa>(self, _: I) {
        let Self { point, pull } = self;
        let finish = [&point.materials.roughness, &point.materials.metallic];
        for (f, values) in finish.into_iter().enumerate() {
            let unknown = C + f;
            for x in 0..BLOCK {
                let precision = pull.precision[f].0[x];
                let offset = values.0[x] - pull.centre[f].0[x];
                point.cost.0[x] += precision * offset * offset;
                point.sums.gradient[unknown].0[x] += precision * offset;
                point.sums.matrix[unknown][unknown].0[x] += precision;
            }
        }
    }
}

/// Copies the pixels whose entry of `which` is 1.
struct Take<'a, const C: usize> {
    which: &'a Doubles,
    from: &'a Point<C>,
    to: &'a mut Point<C>,
}

impl<const C: usize> Kernel for Take<'_, C> {
    type Output = ();

    #[inline(always)]
    fn run<I: Isa>(self, _: I) {
        let Self { which, from, to } = self;
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
            take(&from.materials.albedo[c], &mut to.materials.albedo[c]);
        }
        take(&from.materials.roughness, &mut to.materials.roughness);
        take(&from.materials.metallic, &mut to.materials.metallic);
        for row in 0..C + 2 {
            take(&from.sums.gradient[row], &mut to.sums.gradient[row]);
            for column in 0..=row {
                // Of the albedos with each other there is only the diagonal.
                if row >= C || row == column {
                    take(
                        &from.sums.matrix[row][column],
                        &mut to.sums.matrix[row][column],
                    );
                }
            }
        }
        take(&from.sums.squares, &mut to.sums.squares);
        take(&from.cost, &mut to.cost);
    }
}

/// Which trials are accepted, who is done, and the damping of the next step.
struct Judge<'a> {
    cost: &'a Doubles,
    trial: &'a Doubles,
    predicted: &'a Doubles,
    floor: &'a Doubles,
    active: &'a mut Doubles,
    damping: &'a mut Doubles,
    accepted: &'a mut Doubles,
}

impl Kernel for Judge<'_> {
    type Output = ();

    #[inline(always)]
    fn run<I: Isa>(self, _: I) {
        for x in 0..BLOCK {
            // A comparison with NaN is false.
            let fell = self.trial.0[x] < self.cost.0[x];
            let accepted = if fell { self.active.0[x] } else { 0.0 };
            let gained = if fell {
                self.cost.0[x] - self.trial.0[x]
            } else {
                self.predicted.0[x]
            };
            let promised = self.predicted.0[x];
            let damping = self.damping.0[x];
            let damping = if fell & (gained > HELD * promised) {
                (CALMER * damping).max(LEAST_DAMPING)
            } else if fell & (gained > BROKEN * promised) {
                damping
            } else {
                (WILDER * damping).max(RESTRAINED)
            };
            let goes_on = gained > self.floor.0[x] && damping < MOST_DAMPING;
            self.accepted.0[x] = accepted;
            self.damping.0[x] = damping;
            self.active.0[x] = if goes_on { self.active.0[x] } else { 0.0 };
        }
    }
}

/// One step: materials to be tried, and by how much the squares would fall were they quadratic.
struct Step<'a, const C: usize> {
    point: &'a Point<C>,
    metallic_known: bool,
    damping: &'a Doubles,
    active: &'a Doubles,
    trial: &'a mut Materials<C>,
    predicted: &'a mut Doubles,
}

impl<const C: usize> Kernel for Step<'_, C> {
    type Output = ();

    #[inline(always)]
    fn run<I: Isa>(self, _: I) {
        let Self {
            point,
            metallic_known,
            damping,
            active,
            trial,
            predicted,
        } = self;
        let Point {
            materials, sums, ..
        } = point;
        let metallic_free = if metallic_known { 0.0 } else { 1.0 };
        for x in 0..BLOCK {
            let mut value = [0.0; MAX_UNKNOWNS];
            for c in 0..C {
                value[c] = materials.albedo[c].0[x];
            }
            value[C] = materials.roughness.0[x];
            value[C + 1] = materials.metallic.0[x];
            let mut system = Arrow::<C>::of(sums, x);
            let mut lowest = [0.0; MAX_UNKNOWNS];
            let mut highest = [0.0; MAX_UNKNOWNS];
            for j in 0..C + 2 {
                lowest[j] = -value[j];
                highest[j] = 1.0 - value[j];
                let outwards = if system.gradient[j] > 0.0 {
                    lowest[j] >= 0.0
                } else {
                    highest[j] <= 0.0
                };
                let held = outwards | (system.diagonal[j] <= NOTHING);
                system.free[j] = if held { 0.0 } else { active.0[x] };
            }
            system.free[C + 1] *= metallic_free;
            lowest[C] = lowest[C].max(-REACH);
            highest[C] = highest[C].min(REACH);

            let damped = 1.0 + damping.0[x];
            let mut step = system.solve(damped);
            for j in 0..C + 2 {
                let cut = step[j].max(lowest[j]).min(highest[j]);
                let inside = cut == step[j];
                system.free[j] = if inside { system.free[j] } else { 0.0 };
                system.fixed[j] = if inside { 0.0 } else { cut };
            }
            step = system.solve(damped);
            for j in 0..C + 2 {
                step[j] = step[j].max(lowest[j]).min(highest[j]);
            }
            for c in 0..C {
                trial.albedo[c].0[x] = (value[c] + step[c]).clamp(0.0, 1.0);
            }
            trial.roughness.0[x] = (value[C] + step[C]).clamp(0.0, 1.0);
            trial.metallic.0[x] = (value[C + 1] + step[C + 1]).clamp(0.0, 1.0);
            predicted.0[x] = system.decrease(&step);
        }
    }
}

/// The matrix and gradient of one pixel; albedos first, then roughness and metallic.
struct Arrow<const C: usize> {
    diagonal: [f64; MAX_UNKNOWNS],
    /// Of roughness with the albedos.
    roughness: [f64; C],
    /// Of metallic with the albedos.
    metallic: [f64; C],
    /// Of roughness with metallic.
    both: f64,
    gradient: [f64; MAX_UNKNOWNS],
    /// 1, or 0 for an unknown that moves by `fixed`.
    free: [f64; MAX_UNKNOWNS],
    fixed: [f64; MAX_UNKNOWNS],
}

impl<const C: usize> Arrow<C> {
    #[inline(always)]
    fn of(sums: &Sums, x: usize) -> Self {
        let mut arrow = Self {
            diagonal: [0.0; MAX_UNKNOWNS],
            roughness: [0.0; C],
            metallic: [0.0; C],
            both: sums.matrix[C + 1][C].0[x],
            gradient: [0.0; MAX_UNKNOWNS],
            free: [0.0; MAX_UNKNOWNS],
            fixed: [0.0; MAX_UNKNOWNS],
        };
        for j in 0..C + 2 {
            arrow.diagonal[j] = sums.matrix[j][j].0[x];
            arrow.gradient[j] = sums.gradient[j].0[x];
        }
        for c in 0..C {
            arrow.roughness[c] = sums.matrix[C][c].0[x];
            arrow.metallic[c] = sums.matrix[C + 1][c].0[x];
        }
        arrow
    }

    /// δ with (A + λ diag A) δ = −g in the free unknowns, where `damped` = 1 + λ.
    #[inline(always)]
    fn solve(&self, damped: f64) -> [f64; MAX_UNKNOWNS] {
        let (r, m) = (C, C + 1);
        let Self { free, fixed, .. } = self;
        // Of a fixed unknown the equation is δ = fixed, and its share moves to the right side.
        let mut right = [0.0; MAX_UNKNOWNS];
        let mut pivot = [0.0; MAX_UNKNOWNS];
        let (mut by_r, mut by_m) = (0.0, 0.0);
        for c in 0..C {
            let share = self.roughness[c] * fixed[r] + self.metallic[c] * fixed[m];
            right[c] = free[c] * (-self.gradient[c] - share) + fixed[c];
            by_r += self.roughness[c] * fixed[c];
            by_m += self.metallic[c] * fixed[c];
        }
        by_r += self.both * fixed[m];
        by_m += self.both * fixed[r];
        right[r] = free[r] * (-self.gradient[r] - by_r) + fixed[r];
        right[m] = free[m] * (-self.gradient[m] - by_m) + fixed[m];
        for j in 0..C + 2 {
            pivot[j] = if free[j] > 0.0 {
                damped * self.diagonal[j]
            } else {
                1.0
            };
        }
        let least = [LEAST_PIVOT * pivot[r], LEAST_PIVOT * pivot[m]];
        let mut both = free[r] * free[m] * self.both;
        let (mut of_r, mut of_m) = ([0.0; C], [0.0; C]);
        for c in 0..C {
            let inverse = 1.0 / pivot[c];
            let with_r = free[r] * free[c] * self.roughness[c];
            let with_m = free[m] * free[c] * self.metallic[c];
            of_r[c] = with_r * inverse;
            of_m[c] = with_m * inverse;
            pivot[r] -= of_r[c] * with_r;
            pivot[m] -= of_m[c] * with_m;
            both -= of_r[c] * with_m;
            right[r] -= of_r[c] * right[c];
            right[m] -= of_m[c] * right[c];
            right[c] *= inverse;
        }
        let inverse = 1.0 / pivot[r].max(least[0]);
        let of_both = both * inverse;
        pivot[m] = (pivot[m] - of_both * both).max(least[1]);
        let mut step = [0.0; MAX_UNKNOWNS];
        step[m] = (right[m] - of_both * right[r]) / pivot[m];
        step[r] = right[r] * inverse - of_both * step[m];
        for c in 0..C {
            step[c] = right[c] - of_r[c] * step[r] - of_m[c] * step[m];
        }
        step
    }

    /// By how much the squares fall with a step: −2gᵀδ − δᵀAδ.
    #[inline(always)]
    fn decrease(&self, step: &[f64; MAX_UNKNOWNS]) -> f64 {
        let (r, m) = (C, C + 1);
        let mut sum = 0.0;
        for j in 0..C + 2 {
            sum += step[j] * (2.0 * self.gradient[j] + self.diagonal[j] * step[j]);
        }
        for c in 0..C {
            sum += 2.0 * step[c] * (self.roughness[c] * step[r] + self.metallic[c] * step[m]);
        }
        -(sum + 2.0 * self.both * step[r] * step[m])
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A matrix of 4 samples a channel, a gradient, and who is free.
    fn example(seed: u32) -> Arrow<3> {
        let mut state = seed;
        let mut random = || {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            f64::from(state >> 8) / f64::from(1 << 24) - 0.5
        };
        let mut sums = Sums::default();
        for sample in 0..12 {
            let mut row = [0.0; MAX_UNKNOWNS];
            for j in [sample % 3, 3, 4] {
                row[j] = random();
            }
            let residual = random();
            for i in 0..MAX_UNKNOWNS {
                sums.gradient[i].0[0] += row[i] * residual;
                for j in 0..=i {
                    sums.matrix[i][j].0[0] += row[i] * row[j];
                }
            }
        }
        let mut arrow = Arrow::of(&sums, 0);
        for j in 0..MAX_UNKNOWNS {
            let is_free = random() > -0.2;
            arrow.free[j] = if is_free { 1.0 } else { 0.0 };
            arrow.fixed[j] = if is_free { 0.0 } else { random() };
        }
        arrow
    }

    fn entry(arrow: &Arrow<3>, i: usize, j: usize) -> f64 {
        match (i.max(j), i.min(j)) {
            (a, b) if a == b => arrow.diagonal[a],
            (4, 3) => arrow.both,
            (3, c) => arrow.roughness[c],
            (4, c) => arrow.metallic[c],
            _ => 0.0,
        }
    }

    #[test]
    fn a_step_solves_the_damped_equations_of_the_free_unknowns() {
        for seed in 0..200 {
            let arrow = example(seed);
            let step = arrow.solve(1.3);
            for i in 0..MAX_UNKNOWNS {
                if arrow.free[i] == 0.0 {
                    assert_eq!(step[i], arrow.fixed[i]);
                    continue;
                }
                let mut left = 0.3 * arrow.diagonal[i] * step[i];
                for j in 0..MAX_UNKNOWNS {
                    left += entry(&arrow, i, j) * step[j];
                }
                assert!((left + arrow.gradient[i]).abs() < 1e-12, "{seed}: {i}");
            }
        }
    }

    #[test]
    fn the_predicted_decrease_is_that_of_the_quadratic() {
        for seed in 0..20 {
            let arrow = example(seed);
            let step = arrow.solve(1.01);
            let mut decrease = 0.0;
            for i in 0..MAX_UNKNOWNS {
                decrease -= 2.0 * arrow.gradient[i] * step[i];
                for j in 0..MAX_UNKNOWNS {
                    decrease -= step[i] * entry(&arrow, i, j) * step[j];
                }
            }
            assert!((decrease - arrow.decrease(&step)).abs() < 1e-12);
        }
    }

    #[test]
    fn what_nothing_depends_on_stays_where_it_is() {
        let mut point = Point {
            materials: Materials {
                albedo: [Plane([0.5; BLOCK]); 3],
                roughness: Plane([0.5; BLOCK]),
                metallic: Plane([0.5; BLOCK]),
            },
            ..Point::default()
        };
        point.sums.matrix[0][0] = Plane([4.0; BLOCK]);
        point.sums.gradient[0] = Plane([1.0; BLOCK]);
        let mut trial = Materials::default();
        let mut predicted = Doubles::default();
        Instructions::best().run(Step {
            point: &point,
            metallic_known: false,
            damping: &Doubles::default(),
            active: &Plane([1.0; BLOCK]),
            trial: &mut trial,
            predicted: &mut predicted,
        });
        let found: Vec<f64> = trial.planes().map(|plane| plane.0[7]).collect();
        assert_eq!(found, [0.25, 0.5, 0.5, 0.5, 0.5]);
        assert_eq!(predicted.0[7], 0.25);
    }
}
