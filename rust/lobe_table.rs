//! What a microfacet lobe answers to the ten harmonics of its pixel's frame, from a table.
//!
//! `tools/lobe_table.py` integrates the lobe (docs/model.md) and fits bicubic B-splines, which are
//! smooth to the second derivative, over s(r) and t(n·v), both of the form
//!
//! ```text
//! s(r) = w(1+c) r/(r+c) + (1−w) r          ds/dr = w(1+c)c/(r+c)² + 1−w
//! ```
//!
//! so that knots are dense where lobes change fast, and slopes by r and n·v stay finite at 0. All
//! functions of a knot lie side by side, where one vector instruction serves several of them.

use std::sync::LazyLock;

use crate::simd::{Instructions, Isa, Kernel, Vectors};

/// Functions: a_j and b_j over sinᵐ of the view angle, j = 0 to 9 each, the mean albedo Ē and κ.
pub const VALUES: usize = 22;

/// Numbers stored at a knot, two of them nothing.
const STORED: usize = 24;
/// Cells from r = 0 to 1, and from n·v = 0 to 1; there is a knot more, and one beyond each end.
const CELLS: [usize; 2] = [52, 36];
/// c of both coordinates, and w.
const BEND: [f64; 2] = [0.15625, 0.01953125];
const BENT: [f64; 2] = [0.8125, 0.625];
const KNOTS: [usize; 2] = [CELLS[0] + 3, CELLS[1] + 3];
/// What the file begins with: a name, and the numbers above.
const HEADER: usize = 32;

static FILE: &[u8; HEADER + 4 * STORED * KNOTS[0] * KNOTS[1]] = include_bytes!("lobe_table.bin");

/// All functions, or a derivative of them; the last two are nothing.
#[derive(Clone, Copy, Debug)]
#[repr(C, align(64))]
pub struct Row(pub [f64; STORED]);

impl Default for Row {
    fn default() -> Self {
        Self([0.0; STORED])
    }
}

/// The splines; made once, in about a millisecond.
pub static TABLE: LazyLock<LobeTable> = LazyLock::new(LobeTable::new);

/// See the [module](self).
#[derive(Debug)]
pub struct LobeTable {
    knots: Vec<Row>,
}

/// One coordinate's share: the first of four knots, their weights, and the weights' slopes.
#[derive(Clone, Copy, Debug)]
struct Place {
    first: usize,
    weights: [f64; 4],
    slopes: [f64; 4],
}

impl Place {
    /// Of coordinate 0, roughness, or 1, n·v.
    ///
    /// With w = (1−u)³, 3u³−6u²+4, −3u³+3u²+3u+1 and u³, all over 6, u from 0 to 1 in a cell.
    #[inline(always)]
    fn new(coordinate: usize, value: f64) -> Self {
        let (cells, c, w) = (CELLS[coordinate], BEND[coordinate], BENT[coordinate]);
        let scale = cells as f64;
        let inverse = 1.0 / (value + c);
        let bent = w * (1.0 + c) * inverse;
        let along = scale * (bent + 1.0 - w) * value;
        let slope = scale * (bent * c * inverse + 1.0 - w);
        let first = (along as usize).min(cells - 1);
        let u = along - first as f64;
        let rest = 1.0 - u;
        let (u2, rest2) = (u * u, rest * rest);
        const SIXTH: f64 = 1.0 / 6.0;
        Self {
            first,
            weights: [
                SIXTH * rest2 * rest,
                SIXTH * (3.0 * u2 * (u - 2.0) + 4.0),
                SIXTH * (3.0 * rest2 * (rest - 2.0) + 4.0),
                SIXTH * u2 * u,
            ],
            slopes: [
                -0.5 * slope * rest2,
                0.5 * slope * u * (3.0 * u - 4.0),
                0.5 * slope * rest * (4.0 - 3.0 * rest),
                0.5 * slope * u2,
            ],
        }
    }
}

impl LobeTable {
    fn new() -> Self {
        let knots = FILE[HEADER..]
            .as_chunks::<{ 4 * STORED }>()
            .0
            .iter()
            .map(|knot| {
                let mut row = Row([0.0; STORED]);
                for (value, bytes) in row.0.iter_mut().zip(knot.as_chunks::<4>().0) {
                    *value = f32::from_le_bytes(*bytes).into();
                }
                row
            });
        Self {
            knots: knots.collect(),
        }
    }

    /// All functions at roughness r and the clamped n·v, their slopes by r and, where they are asked
    /// for, by n·v.
    #[inline(always)]
    pub fn rows<I: Vectors<f64>>(&self, isa: I, r: f64, cosine: f64, by_cosine: bool) -> [Row; 3] {
        let (at_r, at_x) = (Place::new(0, r), Place::new(1, cosine));
        let mut rows = [Row([0.0; STORED]); 3];
        let [value, by_r, by_x] = &mut rows;
        for i in 0..4 {
            let knots = &self.knots[(at_r.first + i) * KNOTS[1] + at_x.first..][..4];
            let (weight, slope) = (isa.splat(at_r.weights[i]), isa.splat(at_r.slopes[i]));
            for v in 0..STORED / I::LANES {
                let mut across = isa.splat(0.0);
                for j in 0..4 {
                    let knot = I::of(&knots[j].0)[v];
                    across = isa.mul_add(isa.splat(at_x.weights[j]), knot, across);
                }
                let value = &mut I::of_mut(&mut value.0)[v];
                *value = isa.mul_add(weight, across, *value);
                let by_r = &mut I::of_mut(&mut by_r.0)[v];
                *by_r = isa.mul_add(slope, across, *by_r);
                if by_cosine {
                    let mut across = isa.splat(0.0);
                    for j in 0..4 {
                        let knot = I::of(&knots[j].0)[v];
                        across = isa.mul_add(isa.splat(at_x.slopes[j]), knot, across);
                    }
                    let by_x = &mut I::of_mut(&mut by_x.0)[v];
                    *by_x = isa.mul_add(weight, across, *by_x);
                }
            }
        }
        rows
    }
}

/// All functions at one place, with their slopes by r and by n·v.
pub fn values(r: f64, cosine: f64) -> [[f64; VALUES]; 3] {
    Instructions::best().run(One { r, cosine })
}

struct One {
    r: f64,
    cosine: f64,
}

impl Kernel for One {
    type Output = [[f64; VALUES]; 3];

    #[inline(always)]
    fn run<I: Isa>(self, isa: I) -> Self::Output {
        TABLE
            .rows(isa, self.r, self.cosine, true)
            .map(|row| std::array::from_fn(|f| row.0[f]))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_file_was_made_with_the_same_numbers() {
        let number = |i: usize| f64::from(f32::from_le_bytes(FILE[i..i + 4].try_into().unwrap()));
        let count = |i: usize| u32::from_le_bytes(FILE[i..i + 4].try_into().unwrap()) as usize;
        assert_eq!(&FILE[..8], b"PBRLOBE1");
        assert_eq!([count(8), count(12)], CELLS);
        assert_eq!([number(16), number(24)], BEND);
        assert_eq!([number(20), number(28)], BENT);
    }
}
