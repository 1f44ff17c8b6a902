//! A multigrid cycle for Poisson's equation whose weights jump.
//!
//! Every other row and column makes the next coarser grid, down to one pixel. Where weights jump, a
//! surface is interrupted, and nothing may be interpolated across: so weights of interpolation are
//! those of the equation itself (J. Dendy, "Black box multigrid", Journal of Computational Physics 48,
//! 1982). A pixel between two of the coarse grid, left and right, takes
//!
//! ```text
//! u = (w_l u_l + w_r u_r)/(w_l + w_r),    w_l, w_r: sums over the three neighbours on either side,
//! ```
//!
//! one between four the mean of its eight neighbours by their weights. With these shares P of coarse
//! pixels, constants stay constants, and the coarse matrix is Pᵀ A P: its pixels have eight neighbours.

use std::iter::zip;

use super::Couplings;
use crate::runtime::pool;

/// Where neighbours are that a pixel keeps the weights of: rows below, columns to the right. The
/// other four keep those of it.
const NEIGHBOURS: [[isize; 2]; 4] = [[0, 1], [1, 0], [1, 1], [1, -1]];

/// Rows in a piece of work, and pixels from which on it is shared among threads.
const ROWS: usize = 32;
const SHARED: usize = 1 << 14;

/// Steps of u ← u + s D⁻¹(f − A u). Errors of eigenvalue λ of D⁻¹A ≤ 2 keep
/// Π (1 − s λ): of those in [½, 2], which no coarser grid has, at most 0.22, because 1/s are the zeros
/// of the second Chebyshev polynomial there, 5/4 ± 3/(4√2).
const STEPS: [f64; 2] = [0.561_693_591_500_557_6, 1.389_525_920_694_564_3];

/// Shares of the coarse pixels (y/2, x/2), of its right, lower and lower right neighbour.
type Shares = [f64; 4];

/// Grids from fine to coarse.
pub(super) struct Multigrid {
    grids: Vec<Grid>,
    /// Shares of each grid but the last, of the next.
    shares: Vec<Vec<Shares>>,
}

impl Multigrid {
    pub(super) fn new(finest: Grid) -> Self {
        let (mut grids, mut shares) = (vec![finest], Vec::new());
        while let Some(grid) = grids.last()
            && grid.inverse.len() > 1
        {
            let of_coarse = grid.shares();
            grids.push(grid.coarser(&of_coarse));
            shares.push(of_coarse);
        }
        Self { grids, shares }
    }

    pub(super) fn finest(&self) -> &Grid {
        &self.grids[0]
    }

    /// B f, of a symmetric B ≈ A⁻¹.
    pub(super) fn cycle(&self, right: &[f64]) -> Vec<f64> {
        self.cycle_from(0, right)
    }

    fn cycle_from(&self, level: usize, right: &[f64]) -> Vec<f64> {
        let grid = &self.grids[level];
        let Some(shares) = self.shares.get(level) else {
            return vec![right[0] * grid.inverse[0]];
        };
        let mut u = grid.relaxed(STEPS[0], right, None);
        u = grid.relaxed(STEPS[1], right, Some(&u));
        let coarse = &self.grids[level + 1];
        let gathered = coarse.gathered(grid, shares, &grid.residual(right, &u));
        let found = self.cycle_from(level + 1, &gathered);
        u = grid.corrected(&u, shares, coarse, &found);
        u = grid.relaxed(STEPS[1], right, Some(&u));
        grid.relaxed(STEPS[0], right, Some(&u))
    }
}

/// The equation on one grid.
pub(super) struct Grid {
    rows: usize,
    columns: usize,
    /// Weights of pixels and `NEIGHBOURS`; empty where there are none.
    weights: [Vec<f64>; 4],
    held: Vec<f64>,
    /// D⁻¹: D_a = h_a + Σ_b |w_ab|. It is the diagonal of A where no weight is negative, as rounding
    /// and jumps make some of coarse grids; and no eigenvalue of D⁻¹A is above 2 then either.
    inverse: Vec<f64>,
    threads: usize,
}

impl Grid {
    pub(super) fn finest(couplings: Couplings, threads: usize) -> Self {
        let [rows, columns] = couplings.shape;
        let Couplings {
            across, down, held, ..
        } = couplings;
        let weights = [across.to_vec(), down.to_vec(), Vec::new(), Vec::new()];
        Self::new(rows, columns, weights, held.to_vec(), threads)
    }

    fn new(
        rows: usize,
        columns: usize,
        weights: [Vec<f64>; 4],
        held: Vec<f64>,
        threads: usize,
    ) -> Self {
        let inverse = Vec::new();
        let mut grid = Self {
            rows,
            columns,
            weights,
            held,
            inverse,
            threads,
        };
        grid.inverse = grid.pixels(|y, x| {
            let weights = grid.around(y, x).map(|(w, _)| w.abs());
            match weights.sum::<f64>() + grid.held[y * columns + x] {
                0.0 => 0.0, // a pixel that nothing moves
                sum => 1.0 / sum,
            }
        });
        grid
    }

    /// A_aa
    fn diagonal(&self, y: usize, x: usize) -> f64 {
        let weights = self.around(y, x).map(|(w, _)| w);
        weights.sum::<f64>() + self.held[y * self.columns + x]
    }

    /// Weights of a pixel's neighbours, and where these are.
    fn around(&self, y: usize, x: usize) -> impl Iterator<Item = (f64, [usize; 2])> {
        let beside = move |[dy, dx]: [isize; 2]| {
            let (y, x) = (y.checked_add_signed(dy)?, x.checked_add_signed(dx)?);
            (y < self.rows && x < self.columns).then_some([y, x])
        };
        let kept = zip(&self.weights, NEIGHBOURS).filter(|(weights, _)| !weights.is_empty());
        kept.flat_map(move |(weights, way)| {
            let there = beside(way).map(|at| (weights[y * self.columns + x], at));
            let back =
                beside(way.map(|d| -d)).map(|at| (weights[at[0] * self.columns + at[1]], at));
            there.into_iter().chain(back)
        })
    }

    /// A value of every pixel (y, x).
    fn pixels<T: Copy + Default + Send>(&self, f: impl Fn(usize, usize) -> T + Sync) -> Vec<T> {
        self.by_rows(|y, row| {
            for (x, value) in row.iter_mut().enumerate() {
                *value = f(y, x);
            }
        })
    }

    /// Values of all pixels, each row made from zeros.
    fn by_rows<T: Copy + Default + Send>(&self, f: impl Fn(usize, &mut [T]) + Sync) -> Vec<T> {
        let mut values = vec![T::default(); self.rows * self.columns];
        let threads = if values.len() < SHARED {
            1
        } else {
            self.threads
        };
        let pieces = values.chunks_mut(ROWS * self.columns).enumerate().collect();
        pool::map(threads, pieces, |(piece, rows): (usize, &mut [T])| {
            for (i, row) in rows.chunks_mut(self.columns).enumerate() {
                f(piece * ROWS + i, row);
            }
        });
        values
    }

    /// A u
    pub(super) fn product(&self, u: &[f64]) -> Vec<f64> {
        self.by_rows(|y, out| self.row_of_product(u, y, out))
    }

    /// f − A u
    pub(super) fn residual(&self, right: &[f64], u: &[f64]) -> Vec<f64> {
        self.by_rows(|y, out| {
            self.row_of_product(u, y, out);
            for (out, f) in zip(out, &right[y * self.columns..]) {
                *out = f - *out;
            }
        })
    }

    /// u + s D⁻¹(f − A u); none is u = 0.
    fn relaxed(&self, step: f64, right: &[f64], u: Option<&[f64]>) -> Vec<f64> {
        self.by_rows(|y, out| {
            let row = y * self.columns..(y + 1) * self.columns;
            if let Some(u) = u {
                self.row_of_product(u, y, out);
            }
            for (i, out) in row.zip(out) {
                *out = u.map_or(0.0, |u| u[i]) + step * self.inverse[i] * (right[i] - *out);
            }
        })
    }

    /// A row of A u.
    fn row_of_product(&self, u: &[f64], y: usize, out: &mut [f64]) {
        let n = self.columns;
        let here = self.row(u, y);
        for ((out, u), h) in zip(zip(&mut *out, here), self.row(&self.held, y)) {
            *out = h * u;
        }
        for (weights, [down, right]) in zip(&self.weights, NEIGHBOURS) {
            if weights.is_empty() {
                continue;
            }
            // Columns of pixels, and of their neighbours.
            let (of, beside) = match right {
                0 => (0..n, 0..n),
                1 => (0..n - 1, 1..n),
                _ => (1..n, 0..n - 1),
            };
            let down = down.unsigned_abs();
            if y + down < self.rows {
                let (w, there) = (self.row(weights, y), self.row(u, y + down));
                couple(
                    &mut out[of.clone()],
                    &here[of.clone()],
                    &w[of.clone()],
                    &there[beside.clone()],
                );
            }
            if y >= down {
                let (w, there) = (self.row(weights, y - down), self.row(u, y - down));
                couple(
                    &mut out[beside.clone()],
                    &here[beside],
                    &w[of.clone()],
                    &there[of],
                );
            }
        }
    }

    fn row<'a>(&self, values: &'a [f64], y: usize) -> &'a [f64] {
        &values[y * self.columns..][..self.columns]
    }

    /// Shares of coarse pixels in every pixel.
    fn shares(&self) -> Vec<Shares> {
        let between = |y: usize, x: usize| match (y % 2, x % 2) {
            (0, 0) => [1.0, 0.0, 0.0, 0.0],
            (0, _) => {
                let [left, right] = self.halves(y, x, 1);
                [left, right, 0.0, 0.0]
            }
            _ => {
                let [above, below] = self.halves(y, x, 0);
                [above, 0.0, below, 0.0]
            }
        };
        self.pixels(|y, x| {
            if y % 2 == 0 || x % 2 == 0 {
                return between(y, x);
            }
            let mut shares = [0.0; 4];
            for (w, [b, a]) in self.around(y, x) {
                let corner = 2 * (b / 2 - y / 2) + (a / 2 - x / 2);
                for (share, of) in zip(&mut shares[corner..], between(b, a)) {
                    *share += w.max(0.0) * of;
                }
            }
            shares_of_one(shares)
        })
    }

    /// Shares of the two coarse pixels before and behind one between them, along an axis.
    fn halves(&self, y: usize, x: usize, axis: usize) -> [f64; 2] {
        let mut halves = [0.0; 2];
        for (w, at) in self.around(y, x) {
            let (here, there) = ([y, x][axis], at[axis]);
            if there != here {
                halves[usize::from(there > here)] += w.max(0.0);
            }
        }
        shares_of_one(halves)
    }

    /// The grid of every other row and column: Pᵀ A P, of which weights are kept, and what is held.
    fn coarser(&self, shares: &[Shares]) -> Self {
        let (rows, columns) = (self.rows.div_ceil(2), self.columns.div_ceil(2));
        let empty = [(); 4].map(|()| Vec::new());
        let threads = self.threads;
        let shell = Self {
            rows,
            columns,
            weights: empty,
            held: Vec::new(),
            inverse: Vec::new(),
            threads,
        };
        let found = shell.pixels(|y, x| {
            // The pixel's row of Pᵀ A P, from the neighbour above left on.
            let mut row = [0.0; 9];
            let mut held = 0.0;
            for (own, [b, a]) in self.fine(shares, y, x) {
                let mut add = |[b, a]: [usize; 2], factor: f64| {
                    for (k, share) in shares[b * self.columns + a].into_iter().enumerate() {
                        let place = 3 * (b / 2 + k / 2 + 1 - y) + (a / 2 + k % 2 + 1 - x);
                        // No share is beyond the neighbours.
                        if share != 0.0 {
                            row[place] += own * share * factor;
                        }
                    }
                };
                add([b, a], self.diagonal(b, a));
                for (w, at) in self.around(b, a) {
                    add(at, -w);
                }
                held += own * self.held[b * self.columns + a];
            }
            // Right, below, below right and below left.
            [-row[5], -row[7], -row[8], -row[6], held]
        });
        let [across, down, right, left, held] =
            std::array::from_fn(|k| found.iter().map(|values| values[k]).collect());
        Self::new(rows, columns, [across, down, right, left], held, threads)
    }

    /// Pixels of a finer grid that have a share of a pixel, and the share.
    fn fine(
        &self,
        shares: &[Shares],
        y: usize,
        x: usize,
    ) -> impl Iterator<Item = (f64, [usize; 2])> {
        let near = |at: usize, end: usize| (2 * at).saturating_sub(1)..(2 * at + 2).min(end);
        let places =
            near(y, self.rows).flat_map(move |b| near(x, self.columns).map(move |a| [b, a]));
        places.map(move |[b, a]| {
            let corner = 2 * (y - b / 2) + (x - a / 2);
            (shares[b * self.columns + a][corner], [b, a])
        })
    }

    /// u + P v, of values on the coarser grid.
    fn corrected(&self, u: &[f64], shares: &[Shares], coarse: &Self, values: &[f64]) -> Vec<f64> {
        self.by_rows(|y, out| {
            let above = coarse.row(values, y / 2);
            let below = coarse.row(values, (y / 2 + 1).min(coarse.rows - 1));
            let of_row = &shares[y * self.columns..];
            for (x, ((out, u), of)) in zip(zip(out, self.row(u, y)), of_row).enumerate() {
                let [a, b] = [x / 2, (x / 2 + 1).min(coarse.columns - 1)];
                *out =
                    u + of[0] * above[a] + of[1] * above[b] + of[2] * below[a] + of[3] * below[b];
            }
        })
    }

    /// Pᵀ r, of a residual on the finer grid.
    fn gathered(&self, fine: &Grid, shares: &[Shares], residual: &[f64]) -> Vec<f64> {
        self.pixels(|y, x| {
            let parts = fine.fine(shares, y, x);
            parts
                .map(|(share, [b, a])| share * residual[b * fine.columns + a])
                .sum()
        })
    }
}

/// Weights divided by their sum; the first alone where rounding has left none.
fn shares_of_one<const N: usize>(weights: [f64; N]) -> [f64; N] {
    match weights.iter().sum::<f64>() {
        sum if sum > 0.0 => weights.map(|w| w / sum),
        _ => std::array::from_fn(|k| f64::from(k == 0)),
    }
}

/// Adds what weights make of differences between pixels and their neighbours.
fn couple(out: &mut [f64], here: &[f64], weights: &[f64], there: &[f64]) {
    for (((out, u), w), beside) in zip(zip(zip(out, here), weights), there) {
        *out += w * (u - beside);
    }
}
