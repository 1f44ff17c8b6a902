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

use crate::reflectance::planes::{BLOCK, Plane};
use crate::reflectance::sh::Real;
use crate::runtime::simd::{Isa, Vectors};

/// Functions: a_j and b_j over sinᵐ of the view angle, j = 0 to 9 each, the mean albedo Ē and κ.
pub const VALUES: usize = 22;

/// Planes from those of the functions to those of their slopes by r, and on to those by n·v: whole
/// groups of four.
pub const SECTION: usize = 24;
/// Numbers at a knot of the file, two of them nothing.
const IN_FILE: usize = 24;
/// Numbers at a knot in memory: whole vectors of any width.
const STORED: usize = 32;
/// Cells from r = 0 to 1, and from n·v = 0 to 1; there is a knot more, and one beyond each end.
const CELLS: [usize; 2] = [52, 44];
/// c of both coordinates, roughness and n·v.
const BEND: [f64; 2] = [0.15625, 0.01953125];
/// w of both coordinates.
const BENT: [f64; 2] = [0.8125, 0.5];
/// Knots of both coordinates.
const KNOTS: [usize; 2] = [CELLS[0] + 3, CELLS[1] + 3];
/// Bytes that the file begins with: a name, and the numbers above.
const HEADER: usize = 32;

/// The table as `tools/lobe_table.py` wrote it.
pub static FILE: &[u8; HEADER + 4 * IN_FILE * KNOTS[0] * KNOTS[1]] =
    include_bytes!("lobe_table.bin");

/// All functions, or a derivative of them; what follows them is nothing.
#[derive(Clone, Copy, Debug)]
#[repr(C, align(64))]
pub struct Row<T>(pub [T; STORED]);

impl<T: Real> Default for Row<T> {
    fn default() -> Self {
        Self([T::default(); STORED])
    }
}

/// The splines in one precision.
#[derive(Debug)]
pub struct LobeTable<T> {
    knots: Vec<Row<T>>,
}

/// The splines; made once, in about a millisecond.
static SINGLE: LazyLock<LobeTable<f32>> = LazyLock::new(|| LobeTable::new(|value| value));
static DOUBLE: LazyLock<LobeTable<f64>> = LazyLock::new(|| LobeTable::new(f64::from));

/// Makes the tables, if nobody has yet.
pub fn prepare() {
    LazyLock::force(&SINGLE);
    LazyLock::force(&DOUBLE);
}

/// Numbers that the splines are evaluated in.
pub trait Tabled: Real {
    /// Fills in all functions of a block of pixels at roughness r and the clamped n·v, their slopes
    /// by r and, where they are asked for, by n·v: three [`SECTION`]s.
    fn look_up<I: Isa>(
        isa: I,
        roughness: &Plane<f64>,
        cosine: &Plane<f64>,
        by_cosine: bool,
        functions: &mut [Plane<Self>],
    );

    /// Rows for columns.
    fn transposed(square: [[Self; 4]; 4]) -> [[Self; 4]; 4];
}

macro_rules! tabled {
    ($t:ty, $table:ident, $matrix:ty) => {
        impl Tabled for $t {
            #[inline(always)]
            fn look_up<I: Isa>(
                isa: I,
                roughness: &Plane<f64>,
                cosine: &Plane<f64>,
                by_cosine: bool,
                functions: &mut [Plane<Self>],
            ) {
                let at_r = Places::<$t>::new::<true>(ROUGHNESS, roughness);
                let at_x = if by_cosine {
                    Places::<$t>::new::<true>(COSINE, cosine)
                } else {
                    Places::<$t>::new::<false>(COSINE, cosine)
                };
                let (value, slopes) = functions.split_at_mut(SECTION);
                let (by_r, by_x) = slopes.split_at_mut(SECTION);
                let weights = [&at_r.weights, &at_r.slopes];
                let table = &*$table;
                table.fill(isa, [&at_r, &at_x], weights, &at_x.weights, [value, by_r]);
                if by_cosine {
                    let weights = [&at_r.weights];
                    table.fill(isa, [&at_r, &at_x], weights, &at_x.slopes, [by_x]);
                }
            }

            #[inline(always)]
            fn transposed(square: [[Self; 4]; 4]) -> [[Self; 4]; 4] {
                <$matrix>::from_cols_array_2d(&square)
                    .transpose()
                    .to_cols_array_2d()
            }
        }
    };
}

// glam's matrices, because it transposes them in registers.
tabled!(f32, SINGLE, glam::Mat4);
tabled!(f64, DOUBLE, glam::DMat4);

/// Number of the coordinate roughness.
const ROUGHNESS: usize = 0;
/// Number of the coordinate n·v.
const COSINE: usize = 1;

/// What each pixel takes of four knots in a row of one coordinate.
struct Places<T> {
    /// The first of the knots.
    first: [i32; BLOCK],
    weights: [Plane<T>; 4],
    /// Derivatives of the weights by the coordinate.
    slopes: [Plane<T>; 4],
}

/// The first of four knots in a row of one coordinate, their weights and the derivatives of these.
///
/// With u from 0 to 1 in a cell, the weights are (1−u)³, 3u³−6u²+4, −3u³+3u²+3u+1 and u³, over 6.
#[inline(always)]
fn place<T: Real>(coordinate: usize, value: T) -> (i32, [T; 4], [T; 4]) {
    let of = T::from_f64;
    let (cells, c, w) = (CELLS[coordinate], BEND[coordinate], BENT[coordinate]);
    let scale = cells as f64;
    let inverse = of(1.0) / (value + of(c));
    let bent = of(scale * w * (1.0 + c)) * inverse;
    let along = (bent + of(scale * (1.0 - w))) * value;
    let mut slope = bent * of(c) * inverse + of(scale * (1.0 - w));
    // A mirror's knots are alike, but of their differences rounding would leave something: a slope of
    // 10⁻¹⁴, by which Newton's method would move as far as it can.
    if coordinate == ROUGHNESS && value.to_f64() <= 0.0 {
        slope = of(0.0);
    }
    let first = along.truncated().min(cells as i32 - 1);
    let u = along - of(f64::from(first));
    let rest = of(1.0) - u;
    let (u2, rest2) = (u * u, rest * rest);
    let (sixth, half, four_sixths) = (of(1.0 / 6.0), of(0.5), of(4.0 / 6.0));
    let weights = [
        sixth * rest2 * rest,
        half * u2 * (u - of(2.0)) + four_sixths,
        half * rest2 * (rest - of(2.0)) + four_sixths,
        sixth * u2 * u,
    ];
    let slope = half * slope;
    let slopes = [
        of(0.0) - slope * rest2,
        slope * u * (of(3.0) * u - of(4.0)),
        slope * rest * (of(4.0) - of(3.0) * rest),
        slope * u2,
    ];
    (first, weights, slopes)
}

impl<T: Real> Places<T> {
    /// Without slopes, these stay 0.
    #[inline(always)]
    fn new<const SLOPES: bool>(coordinate: usize, values: &Plane<f64>) -> Self {
        let mut places = Self {
            first: [0; BLOCK],
            weights: Default::default(),
            slopes: Default::default(),
        };
        for x in 0..BLOCK {
            let (first, weights, slopes) = place(coordinate, T::from_f64(values.0[x]));
            places.first[x] = first;
            for i in 0..4 {
                places.weights[i].0[x] = weights[i];
                if SLOPES {
                    places.slopes[i].0[x] = slopes[i];
                }
            }
        }
        places
    }
}

/// Pixels looked up before their functions go to planes: a cache line of each plane, or two.
const TOGETHER: usize = 16;

impl<T: Tabled> LobeTable<T> {
    fn new(of: impl Fn(f32) -> T) -> Self {
        let knots = FILE[HEADER..].as_chunks::<{ 4 * IN_FILE }>().0;
        let knots = knots.iter().map(|knot| {
            let mut row = Row::default();
            for (value, bytes) in row.0.iter_mut().zip(knot.as_chunks::<4>().0) {
                *value = of(f32::from_le_bytes(*bytes));
            }
            row
        });
        Self {
            knots: knots.collect(),
        }
    }

    /// Sums over the knots of each pixel's cell, for N sets of weights of the first coordinate.
    #[inline(always)]
    fn fill<I: Vectors<T>, const N: usize>(
        &self,
        isa: I,
        [at_r, at_x]: [&Places<T>; 2],
        down: [&[Plane<T>; 4]; N],
        across: &[Plane<T>; 4],
        functions: [&mut [Plane<T>]; N],
    ) {
        let mut rows = [[Row::default(); TOGETHER]; N];
        for begin in (0..BLOCK).step_by(TOGETHER) {
            for i in 0..TOGETHER {
                let x = begin + i;
                let first = at_r.first[x] as usize * KNOTS[1] + at_x.first[x] as usize;
                let mut knots = [&self.knots[..4]; 4];
                for i in 0..4 {
                    knots[i] = &self.knots[first + i * KNOTS[1]..][..4];
                }
                // In loops: a closure given to `map` is not always inlined.
                let mut across_x = [isa.splat(T::default()); 4];
                let mut down_x = [across_x; N];
                for i in 0..4 {
                    across_x[i] = isa.splat(across[i].0[x]);
                    for n in 0..N {
                        down_x[n][i] = isa.splat(down[n][i].0[x]);
                    }
                }
                // As many vectors as the functions need.
                for v in 0..VALUES.div_ceil(I::LANES) {
                    let mut sums = [isa.splat(T::default()); N];
                    for i in 0..4 {
                        let mut row = isa.mul(across_x[0], I::of(&knots[i][0].0)[v]);
                        for j in 1..4 {
                            row = isa.mul_add(across_x[j], I::of(&knots[i][j].0)[v], row);
                        }
                        for n in 0..N {
                            sums[n] = isa.mul_add(down_x[n][i], row, sums[n]);
                        }
                    }
                    for n in 0..N {
                        I::of_mut(&mut rows[n][i].0)[v] = sums[n];
                    }
                }
            }
            for n in 0..N {
                to_planes(&rows[n], begin, functions[n]);
            }
        }
    }
}

/// From pixel by pixel to function by function, in squares of four.
///
/// Never inlined, and so compiled for what all processors have: with AVX-512 the compiler would make
/// scatters of it, which take several times as long.
#[inline(never)]
fn to_planes<T: Tabled>(rows: &[Row<T>; TOGETHER], begin: usize, functions: &mut [Plane<T>]) {
    let groups = functions[..SECTION].as_chunks_mut::<4>().0;
    for (group, planes) in groups.iter_mut().enumerate() {
        for i in (0..TOGETHER).step_by(4) {
            let some = [0, 1, 2, 3].map(|j| rows[i + j].0.as_chunks::<4>().0[group]);
            for (plane, values) in planes.iter_mut().zip(T::transposed(some)) {
                plane.0[begin + i..][..4].copy_from_slice(&values);
            }
        }
    }
}

/// All functions at one roughness and clamped n·v, with their slopes by r and by n·v.
#[inline(always)]
pub fn values(r: f64, cosine: f64) -> [[f64; VALUES]; 3] {
    let (row, down, down_slopes) = place::<f64>(ROUGHNESS, r);
    let (column, across, across_slopes) = place::<f64>(COSINE, cosine);
    let mut values = [[0.0; VALUES]; 3];
    for i in 0..4 {
        for j in 0..4 {
            let knot = &DOUBLE.knots[(row as usize + i) * KNOTS[1] + column as usize + j].0;
            for f in 0..VALUES {
                values[0][f] += down[i] * across[j] * knot[f];
                values[1][f] += down_slopes[i] * across[j] * knot[f];
                values[2][f] += down[i] * across_slopes[j] * knot[f];
            }
        }
    }
    values
}

#[cfg(test)]
#[path = "../../tests/rust/reflectance_lobe_table.rs"]
mod tests;
