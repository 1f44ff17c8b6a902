//! The band weights of [`ggx::bands`] from a table, for blocks of pixels.
//!
//! The logarithm and the long series of the exact functions would be a third of an evaluation. The
//! table holds polynomials instead: 16 cells to the octave of roughness, so that a cell follows
//! from the leading bits of r, and in each cell the eight functions (h_l and dh_l/dr) as degree 7
//! in the cell's own variable, side by side, where one vector instruction serves them all. The
//! functions' nearest singularity, at r = 0, is 33 half-widths from the middle of a cell, so the
//! series ends below 10⁻¹⁴.

use std::f64::consts::PI;
use std::sync::LazyLock;

use crate::reflectance::ggx::{self, Bands};
use crate::runtime::simd::Vectors;

/// Functions in a row: h₀ to h₃, then their derivatives.
pub const FUNCTIONS: usize = 8;

/// Roughness 2⁻⁶ from which the table is used. Below, pixels are rare and the closed form is at its
/// best.
const LOWEST: f64 = 0.015625;
/// Octaves of roughness from there to 1.
const OCTAVES: usize = 6;
/// Binary logarithm of the cells in an octave.
const CELLS_BITS: u32 = 4;
/// Cells in all.
const CELLS: usize = OCTAVES << CELLS_BITS;
/// Coefficients of a cell's polynomials, degree 7.
const TERMS: usize = 8;
/// Shift that leaves the exponent and the first bits of the mantissa.
const SHIFT: u32 = 52 - CELLS_BITS;

/// One function after another, [`FUNCTIONS`] of them.
#[derive(Clone, Copy, Debug)]
#[repr(C, align(64))]
pub struct Row(pub [f64; FUNCTIONS]);

/// The polynomials; made once, from the exact functions, in less than a millisecond.
pub static TABLE: LazyLock<BandTable> = LazyLock::new(BandTable::new);

/// See the [module](self).
#[derive(Debug)]
pub struct BandTable {
    cells: Vec<[Row; TERMS]>,
}

impl BandTable {
    fn new() -> Self {
        let cells = (0..CELLS)
            .map(|cell| {
                let (middle, half) = extent(cell);
                polynomial(|s| exact(middle + half * s))
            })
            .collect();
        Self { cells }
    }

    /// All functions at roughness r in \[0, 1\].
    #[inline(always)]
    pub fn row<I: Vectors<f64>>(&self, isa: I, r: f64) -> Row {
        if r < LOWEST {
            return exact(r);
        }
        let (cell, s) = locate(r);
        let s = isa.splat(s);
        let terms = &self.cells[cell];
        let mut result = terms[TERMS - 1];
        let sums = I::of_mut(&mut result.0);
        for term in terms[..TERMS - 1].iter().rev() {
            for (sum, &c) in sums.iter_mut().zip(I::of(&term.0)) {
                *sum = isa.mul_add(*sum, s, c);
            }
        }
        result
    }
}

/// The cell of a roughness, and where it lies in the cell, from −1 to 1. Without rounding: both are
/// read off the bits.
#[inline(always)]
fn locate(r: f64) -> (usize, f64) {
    let bits = r.to_bits().min(1f64.to_bits() - 1); // 1 is the end of the last cell
    let cell = (bits >> SHIFT) - (LOWEST.to_bits() >> SHIFT);
    let begin = f64::from_bits(bits >> SHIFT << SHIFT);
    // 2ᵉ ≤ r < 2ᵉ⁺¹: the exponent of 1/half-width is CELLS_BITS + 1 − e.
    let exponent = bits >> 52;
    let inverse = f64::from_bits((2 * 1023 + u64::from(CELLS_BITS) + 1 - exponent) << 52);
    (cell as usize, (r - begin) * inverse - 1.0)
}

/// Middle and half-width of a cell.
fn extent(cell: usize) -> (f64, f64) {
    let begin = |cell| f64::from_bits(((LOWEST.to_bits() >> SHIFT) + cell as u64) << SHIFT);
    let (begin, end) = (begin(cell), begin(cell + 1));
    (0.5 * (begin + end), 0.5 * (end - begin))
}

#[cold]
#[inline(never)]
fn exact(r: f64) -> Row {
    let Bands { weight, slope } = ggx::bands(r);
    let mut row = [0.0; FUNCTIONS];
    row[..4].copy_from_slice(&weight);
    row[4..].copy_from_slice(&slope);
    Row(row)
}

/// Coefficients of sʲ of the polynomial through the values at the Chebyshev nodes of \[−1, 1\].
fn polynomial(values: impl Fn(f64) -> Row) -> [Row; TERMS] {
    let n = TERMS as f64;
    let node = |i: usize| PI * (i as f64 + 0.5) / n;
    let samples: [Row; TERMS] = std::array::from_fn(|i| values(node(i).cos()));
    // T_j as coefficients of powers: T_{j+1} = 2 s T_j − T_{j−1}.
    let mut chebyshev = [[0.0; TERMS]; TERMS];
    chebyshev[0][0] = 1.0;
    chebyshev[1][1] = 1.0;
    for j in 2..TERMS {
        for power in 0..TERMS {
            let below = if power > 0 {
                chebyshev[j - 1][power - 1]
            } else {
                0.0
            };
            chebyshev[j][power] = 2.0 * below - chebyshev[j - 2][power];
        }
    }
    let mut powers = [Row([0.0; FUNCTIONS]); TERMS];
    for f in 0..FUNCTIONS {
        for j in 0..TERMS {
            let scale = if j == 0 { 1.0 / n } else { 2.0 / n };
            let sum: f64 = (0..TERMS)
                .map(|i| samples[i].0[f] * (j as f64 * node(i)).cos())
                .sum();
            for power in 0..TERMS {
                powers[power].0[f] += scale * sum * chebyshev[j][power];
            }
        }
    }
    powers
}
