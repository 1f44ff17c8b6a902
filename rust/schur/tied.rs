//! Offsets of a Gaussian prior that clusters of pixels share: unknowns beside the lights.

use super::kernels::Lanes;
use crate::reflectance::planes::{BLOCK, Doubles};

/// Sums by the shared unknowns: the lights of every sample, then the offsets.
#[derive(Clone, Debug, Default)]
pub(super) struct SharedSums {
    pub(super) lights: Vec<Lanes>,
    pub(super) offsets: Vec<f64>,
}

/// What ties the pixels of a block to the offsets of their clusters. F unknowns have a prior.
#[derive(Clone, Debug)]
pub(super) struct Tied<const U: usize> {
    /// Of each pixel.
    pub(super) clusters: Vec<usize>,
    /// Which they are, by f.
    pub(super) unknowns: Vec<usize>,
    /// a, by f.
    pub(super) precision: Vec<Doubles>,
    /// a (v − c − o), by f.
    pub(super) pull: Vec<Doubles>,
    /// U a, column f of U times a, by f.
    pub(super) columns: Vec<[Doubles; U]>,
}

impl<const U: usize> Tied<U> {
    /// Calls with f, the place of an offset, and the pixel.
    fn each(&self, mut visit: impl FnMut(usize, usize, usize)) {
        for f in 0..self.unknowns.len() {
            for (x, cluster) in self.clusters.iter().enumerate() {
                visit(f, cluster * self.unknowns.len() + f, x);
            }
        }
    }

    /// Subtracts U a o from `whitened`, for offsets o.
    pub(super) fn subtract(&self, offsets: &[f64], whitened: &mut [Doubles; U]) {
        self.each(|f, place, x| {
            for row in self.unknowns[f]..U {
                whitened[row].0[x] -= self.columns[f][row].0[x] * offsets[place];
            }
        });
    }

    /// Adds a (o + Uᵀ y).
    pub(super) fn add_product(&self, offsets: &[f64], y: &[Doubles; U], sums: &mut [f64]) {
        self.each(|f, place, x| {
            sums[place] += self.precision[f].0[x] * offsets[place] + self.onto(f, x, y);
        });
    }

    /// Adds a (Uᵀ y − (v − c − o)).
    pub(super) fn add_gradient(&self, y: &[Doubles; U], sums: &mut [f64]) {
        self.each(|f, place, x| sums[place] += self.onto(f, x, y) - self.pull[f].0[x]);
    }

    fn onto(&self, f: usize, x: usize, y: &[Doubles; U]) -> f64 {
        (self.unknowns[f]..U)
            .map(|row| self.columns[f][row].0[x] * y[row].0[x])
            .sum()
    }

    /// Puts −U a into `columns` (offset, unknown after the first `skipped`, pixel), and adds a to
    /// `diagonal`.
    pub(super) fn fill(
        &self,
        skipped: usize,
        unknowns: usize,
        columns: &mut [f64],
        diagonal: &mut [f64],
    ) {
        self.each(|f, place, x| {
            diagonal[place] += self.precision[f].0[x];
            for row in self.unknowns[f]..skipped + unknowns {
                let first = (place * unknowns + row - skipped) * BLOCK;
                columns[first + x] = -self.columns[f][row].0[x];
            }
        });
    }
}
