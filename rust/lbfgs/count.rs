//! The kernel that brings products of columns up to date.

use std::array;
use std::ops::Range;

use super::bounds::{BlockBounds, Bounds, free_of};
use super::vectors::padded;
use super::{BLOCK, LINES, Mask, Numbers};
use crate::runtime::simd::{Ahead, Isa, Kernel, Vectors};

/// Rows of [`Counts`]: the newest s and y over what is free, the gradient over it, the newest over
/// all.
pub(super) const FREE: usize = 0;
pub(super) const GRADIENT: usize = 2;
pub(super) const ALL: usize = 3;
pub(super) const ROWS: usize = 5;

/// Sums of products, without units, of the known columns.
pub(super) struct Counts {
    /// Each with the known columns and, at the end, with the gradient over what is free.
    pub(super) rows: [Vec<f64>; ROWS],
    /// Of columns with each other, over what has come free, less what no longer is; without the
    /// newest: (known, known), the upper triangle.
    pub(super) changes: Vec<f64>,
}

impl Counts {
    pub(super) fn new(known: usize) -> Self {
        Self {
            rows: array::from_fn(|_| vec![0.0; known + 1]),
            changes: vec![0.0; known * known],
        }
    }

    pub(super) fn add(&mut self, other: &Self) {
        let rows = self.rows.iter_mut().zip(&other.rows);
        let all = rows.chain([(&mut self.changes, &other.changes)]);
        for (total, partial) in all.flat_map(|(a, b)| a.iter_mut().zip(b)) {
            *total += partial;
        }
    }
}

pub(super) struct Count<'a> {
    pub(super) state: Option<(&'a [f64], &'a [f64])>,
    pub(super) bounds: &'a [Bounds],
    pub(super) columns: &'a [[f32; BLOCK]],
    pub(super) width: usize,
    pub(super) known: &'a [usize],
    pub(super) newest: Option<[usize; 2]>,
    pub(super) masks: &'a mut [Mask],
    pub(super) range: Range<usize>,
}

impl Kernel for Count<'_> {
    type Output = Counts;

    #[inline(always)]
    fn run<I: Isa>(self, isa: I) -> Counts {
        let lanes = <I as Vectors<f64>>::LANES;
        let known = self.known.len();
        let mut counts = Counts::new(known);
        // The last column is there twice: their number is even.
        let mut sums = vec![0.0; (known + 2) * ROWS * lanes];
        let mut bounds = BlockBounds::new(self.bounds);
        let mut rows = [[0.0; BLOCK]; ROWS];
        let mut entries = vec![0.0; known];
        let blocks = self.columns.chunks_exact(self.width);
        let mut ahead = Ahead::default();
        ahead.push(self.columns);
        ahead.step(2 * self.width * LINES);
        for ((b, mask), columns) in self.masks.iter_mut().enumerate().zip(blocks) {
            let start = b * BLOCK;
            let count = BLOCK.min(self.range.len() - start);
            let mut free = *mask;
            if let Some((x, g)) = self.state {
                bounds.fill(self.range.start + start, count);
                rows[GRADIENT] = padded(&g[start..][..count]);
                let x = padded(&x[start..][..count]);
                free = free_of(&x, &rows[GRADIENT], &bounds, count);
            }
            let mut changed = free ^ *mask;
            while changed != 0 {
                let i = changed.trailing_zeros() as usize;
                changed &= changed - 1;
                let sign = if free >> i & 1 == 1 { 1.0 } else { -1.0 };
                for (entry, &column) in entries.iter_mut().zip(self.known) {
                    *entry = f64::from(columns[column][i]);
                }
                for &newest in self.newest.iter().flatten() {
                    entries[newest] = 0.0;
                }
                for (row, &entry) in entries.iter().enumerate() {
                    let entry = sign * entry;
                    let changes = &mut counts.changes[row * known..][row..known];
                    for (change, other) in changes.iter_mut().zip(&entries[row..]) {
                        *change += entry * other;
                    }
                }
            }
            *mask = free;

            for (row, &newest) in self.newest.iter().flatten().enumerate() {
                rows[ALL + row] = columns[self.known[newest]].map(f64::from);
                rows[FREE + row] = rows[ALL + row];
            }
            if free != Mask::MAX {
                for i in 0..BLOCK {
                    let factor = if free >> i & 1 == 1 { 1.0 } else { 0.0 };
                    for row in &mut rows[..ALL] {
                        row[i] *= factor;
                    }
                }
            }
            // Two columns at a time: rows are loaded half as often.
            for (j, sums) in sums.chunks_exact_mut(2 * ROWS * lanes).enumerate() {
                ahead.step(2 * LINES);
                let pair = [2 * j, 2 * j + 1].map(|j| match self.known.get(j) {
                    Some(&column) => columns[column].map(f64::from),
                    None => rows[GRADIENT],
                });
                add_products(isa, &rows, &pair, sums);
            }
        }
        for (j, sums) in sums.chunks_exact(ROWS * lanes).take(known + 1).enumerate() {
            for (row, parts) in counts.rows.iter_mut().zip(sums.chunks_exact(lanes)) {
                row[j] = parts.iter().sum();
            }
        }
        counts
    }
}

/// Adds the products of each row with two columns, lane by lane.
#[inline(always)]
fn add_products<I: Isa>(isa: I, rows: &[Numbers; ROWS], columns: &[Numbers; 2], sums: &mut [f64]) {
    let sums = <I as Vectors<f64>>::of_mut(sums);
    let [a, b] = [0, 1].map(|c| <I as Vectors<f64>>::of(&columns[c]));
    let rows: [_; ROWS] = array::from_fn(|r| &<I as Vectors<f64>>::of(&rows[r])[..a.len()]);
    let mut t: [_; 2 * ROWS] = array::from_fn(|i| sums[i]);
    for (v, (&a, &b)) in a.iter().zip(b).enumerate() {
        for r in 0..ROWS {
            t[r] = Vectors::<f64>::mul_add(isa, rows[r][v], a, t[r]);
            t[ROWS + r] = Vectors::<f64>::mul_add(isa, rows[r][v], b, t[ROWS + r]);
        }
    }
    sums.copy_from_slice(&t);
}
