//! The last steps of a pixel's fit, on its residuals one by one, in passes over the pictures.
//!
//! Where normals are free they turn here: each trial makes directions, basis functions and
//! derivatives anew.

use crate::block::{BLOCK, Materials, Plane};
use crate::descent::{Descent, Point, Pull, Squares};
use crate::problem::Problem;
use crate::samples::{Block, Sums, UNKNOWNS};
use crate::sh::COEFFICIENTS;
use crate::simd::Instructions;
use crate::turns::Tilts;

/// Of the squares: a decrease that sums of squares cannot tell from rounding.
const FLOOR: f64 = 1e-14;
/// Damping of the first step where materials are nearly the best already, and of one that turns
/// normals, which are not.
const DAMPING: f64 = 1e-9;
const TURNING_DAMPING: f64 = 1e-3;

type Doubles = Plane<f64>;

/// Up to [`BLOCK`] pixels, and where they stand.
pub(crate) struct ResidualSteps<'a, const C: usize, const D: usize, const U: usize> {
    isa: Instructions,
    metallic_known: bool,
    squares: Exact<'a, C, D>,
    /// The best yet; its tilts stay where they were unless they are among the U unknowns.
    pub(crate) best: Box<Point<C, U>>,
    trial: Box<Point<C, U>>,
}

/// Squares from residuals.
struct Exact<'a, const C: usize, const D: usize> {
    lights: &'a [[f64; COEFFICIENTS]],
    block: Block<'a, C, D>,
}

impl<const C: usize, const D: usize, const U: usize> Squares<C, U> for Exact<'_, C, D> {
    fn take(&mut self, materials: &Materials<C>, tilts: &Tilts, sums: &mut Sums<U>) {
        *sums = Sums::default();
        self.block.take(materials, tilts);
        self.block.add_samples(self.lights, sums);
    }
}

impl<'a, const C: usize, const D: usize, const U: usize> ResidualSteps<'a, C, D, U> {
    pub(crate) fn new(problem: &'a Problem, lights: &'a [[f64; COEFFICIENTS]]) -> Self {
        Self {
            isa: problem.instructions(),
            metallic_known: problem.known_metallic().is_some(),
            squares: Exact {
                lights,
                block: Block::new(problem),
            },
            best: Box::default(),
            trial: Box::default(),
        }
    }

    /// Takes up pixels with the tilts of `maps` and materials: `materials`, or the `other` ones where
    /// these are better. They are tried only where their plane is 1.
    pub(crate) fn begin(
        &mut self,
        maps: &[f64],
        pixels: &[usize],
        tilts: &Tilts,
        pull: Option<&Pull>,
        materials: &Materials<C>,
        (other, tried): (&Materials<C>, &Doubles),
    ) {
        self.squares.block.place(maps, pixels);
        for (point, materials) in [(&mut self.best, materials), (&mut self.trial, other)] {
            point.materials.clone_from(materials);
            point.tilts = *tilts;
        }
        self.best.take(self.isa, &mut self.squares, pull);
        if tried.0.iter().all(|&tried| tried == 0.0) {
            return;
        }
        self.trial.take(self.isa, &mut self.squares, pull);
        for x in 0..BLOCK {
            if tried.0[x] == 0.0 {
                self.trial.cost.0[x] = f64::INFINITY;
            }
        }
        self.best.keep_lower(self.isa, &self.trial);
    }

    /// At most `steps` steps of the `used` pixels.
    pub(crate) fn run(&mut self, used: &Doubles, pull: Option<&Pull>, steps: usize) {
        let mut floor = Doubles::default();
        for x in 0..BLOCK {
            floor.0[x] = FLOOR * self.best.cost.0[x];
        }
        Descent {
            isa: self.isa,
            pull,
            metallic_known: self.metallic_known,
            floor: &floor,
            damping: if U > UNKNOWNS {
                TURNING_DAMPING
            } else {
                DAMPING
            },
            trial: &mut self.trial,
        }
        .run(&mut self.squares, &mut self.best, *used, steps);
    }
}
