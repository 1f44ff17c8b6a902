//! A panorama, blurred by round lobes of growing width.
//!
//! Level j is the panorama L convolved with the von Mises–Fisher lobe of width σ_j = 2^j σ_0,
//!
//! ```text
//! L_j(d) = ∫ K_j(l·d) L(l) dl      K_j(c) ∝ exp((c − 1)/σ_j²),  ∫ K_j dl = 1
//! ```
//!
//! on an equirectangular grid whose texels are σ_j/2 wide: 1024 × 512 for j = 0, half of it for each
//! next. Two more maps are for lobes that the horizon cuts: the irradiance over π, K ∝ max(0, c), and
//! that of an even hemisphere, K ∝ min(1, 5 max(0, c)). A sum over the grid with positive
//! weights that sum to 1 keeps light positive, and a grey panorama grey.
//!
//! Texels of the source and the interpolation between those of a level blur too, by the variances
//! h²/12 and h²/6 an axis of a box and of a tent; so much less is left for the sum.

use std::f64::consts::PI;

use glam::DVec3;

use crate::runtime::{Error, Result, check, pool};

/// Columns of the sharpest level.
pub const COLUMNS: usize = 1024;
/// Levels of growing blur.
pub const LEVELS: usize = 8;
/// σ_0, two texels of the sharpest level, radians.
pub const SHARPEST: f64 = 2.0 * (2.0 * PI / COLUMNS as f64);
/// Hemispheres have the grid of this level.
const HEMISPHERE_LEVEL: usize = 3;
/// n·l up to which the even hemisphere grows.
const HORIZON: f64 = 0.2;
/// Where the sum ends, in σ: what is left of the lobe there is below 10⁻⁴.
const REACH: f64 = 4.5;

/// An equirectangular grid of radiance: (row, column, channel), the top row first.
#[derive(Clone, Debug, PartialEq)]
pub struct Grid {
    /// Twice as many as rows.
    pub columns: usize,
    /// Linear radiance.
    pub texels: Vec<[f32; 3]>,
}

/// See the module.
#[derive(Clone, Debug, PartialEq)]
pub struct Blurred {
    /// From sharp to blurred.
    pub levels: [Grid; LEVELS],
    /// Of an even hemisphere, up to n·l = 0.2 growing; and irradiance over π, the radiance of a
    /// white matt surface.
    pub hemispheres: [Grid; 2],
}

impl Blurred {
    /// From an equirectangular panorama of rows × 2 rows pixels.
    pub fn new(texels: &[[f32; 3]], rows: usize, threads: usize) -> Result<Self> {
        check::length("pixels", rows * rows * 2, texels.len())?;
        if rows == 0 {
            return Err(Error::argument("pixels", "one row or more", rows));
        }
        let mut source = resampled(texels, rows);
        let mut levels = [const { None }; LEVELS];
        let mut hemispheres = None;
        for (j, level) in levels.iter_mut().enumerate() {
            let width = SHARPEST * (1 << j) as f64;
            let texel = 2.0 * PI / source.columns as f64;
            let variance = width * width - texel * texel * (1.0 / 12.0 + 1.0 / 6.0);
            let lobe = |cosine: f64| ((cosine - 1.0) / variance).exp();
            *level = Some(convolved(&source, lobe, REACH * width, threads));
            if j == HEMISPHERE_LEVEL {
                let even = |cosine: f64| (cosine.max(0.0) / HORIZON).min(1.0);
                let matt = |cosine: f64| cosine.max(0.0);
                hemispheres = Some([
                    convolved(&source, even, PI, threads),
                    convolved(&source, matt, PI, threads),
                ]);
            }
            source = halved(&source);
        }
        Ok(Self {
            levels: levels.map(|level| level.expect("all are made")),
            hemispheres: hemispheres.expect("one of the levels"),
        })
    }

    /// Radiance from `direction`, blurred by 2^level σ_0: linear between texels and levels.
    #[inline]
    pub fn radiance(&self, direction: DVec3, level: f64) -> [f64; 3] {
        let level = level.clamp(0.0, (LEVELS - 1) as f64);
        let low = (level as usize).min(LEVELS - 2);
        let part = level - low as f64;
        let place = Place::of(direction);
        let (sharp, soft) = (self.levels[low].at(place), self.levels[low + 1].at(place));
        [0, 1, 2].map(|c| (1.0 - part) * sharp[c] + part * soft[c])
    }

    /// The two hemispheres about `normal`.
    #[inline]
    pub fn hemispheres(&self, normal: DVec3) -> [[f64; 3]; 2] {
        let place = Place::of(normal);
        self.hemispheres.each_ref().map(|grid| grid.at(place))
    }
}

/// Where on a panorama, in parts of its width from its left and of its height from its top.
#[derive(Clone, Copy, Debug)]
struct Place {
    across: f64,
    down: f64,
}

impl Place {
    /// d = (sin φ cos θ, sin θ, −cos φ cos θ), with φ = 0 in the middle and θ = π/2 at the top.
    #[inline]
    fn of(d: DVec3) -> Self {
        Self {
            across: 0.5 + d.x.atan2(-d.z) / (2.0 * PI),
            down: 0.5 - d.y.clamp(-1.0, 1.0).asin() / PI,
        }
    }
}

impl Grid {
    fn rows(&self) -> usize {
        self.columns / 2
    }

    /// Linear between the centres of texels; across the edge at the sides, held at top and bottom.
    #[inline]
    fn at(&self, place: Place) -> [f64; 3] {
        let (rows, columns) = (self.rows(), self.columns);
        let x = place.across * columns as f64 - 0.5 + columns as f64;
        let y = (place.down * rows as f64 - 0.5).clamp(0.0, (rows - 1) as f64);
        let (left, top) = (x as usize, (y as usize).min(rows - 2));
        let (right_part, lower_part) = (x - left as f64, y - top as f64);
        let (left, right) = (left % columns, (left + 1) % columns);
        let texel = |row: usize, column: usize| self.texels[row * columns + column];
        let corners = [
            (texel(top, left), (1.0 - lower_part) * (1.0 - right_part)),
            (texel(top, right), (1.0 - lower_part) * right_part),
            (texel(top + 1, left), lower_part * (1.0 - right_part)),
            (texel(top + 1, right), lower_part * right_part),
        ];
        [0, 1, 2].map(|c| {
            let weighted = corners.map(|(texel, weight)| weight * f64::from(texel[c]));
            (weighted[0] + weighted[1]) + (weighted[2] + weighted[3])
        })
    }
}

/// Part of the sphere between the upper and the lower edge of a row, times 1/2.
fn area(row: usize, rows: usize) -> f64 {
    let edge = |i: usize| (PI * (0.5 - i as f64 / rows as f64)).sin();
    0.5 * (edge(row) - edge(row + 1))
}

/// What of `from` cells goes into each of `to`, along an axis: first cell and weights, which sum
/// to 1. Fewer cells are means by length, more are linear between centres.
fn shares(from: usize, to: usize, wraps: bool) -> Vec<(isize, Vec<f64>)> {
    let ratio = from as f64 / to as f64;
    (0..to)
        .map(|i| {
            if ratio >= 1.0 {
                let (start, end) = (i as f64 * ratio, (i + 1) as f64 * ratio);
                let first = start as usize;
                let last = (end.ceil() as usize).min(from);
                let overlap = |cell: usize| {
                    (end.min((cell + 1) as f64) - start.max(cell as f64)).max(0.0) / ratio
                };
                (first as isize, (first..last).map(overlap).collect())
            } else {
                let mut centre = (i as f64 + 0.5) * ratio - 0.5;
                if !wraps {
                    centre = centre.clamp(0.0, (from - 1) as f64);
                }
                let first = centre.floor();
                let part = centre - first;
                (first as isize, vec![1.0 - part, part])
            }
        })
        .collect()
}

/// On the grid of the sharpest level.
fn resampled(texels: &[[f32; 3]], rows: usize) -> Grid {
    let (columns, to_columns, to_rows) = (2 * rows, COLUMNS, COLUMNS / 2);
    let across = shares(columns, to_columns, true);
    let down = shares(rows, to_rows, false);
    let mut narrow = vec![[0.0f64; 3]; rows * to_columns];
    for (row, narrow) in texels.chunks(columns).zip(narrow.chunks_mut(to_columns)) {
        for ((first, weights), texel) in across.iter().zip(narrow) {
            for (i, weight) in weights.iter().enumerate() {
                let from = row[(first + i as isize).rem_euclid(columns as isize) as usize];
                for c in 0..3 {
                    texel[c] += weight * f64::from(from[c]);
                }
            }
        }
    }
    let mut found = vec![[0.0f32; 3]; to_rows * to_columns];
    for ((first, weights), row) in down.iter().zip(found.chunks_mut(to_columns)) {
        let from = |i: usize| ((first + i as isize) as usize).min(rows - 1);
        for (column, texel) in row.iter_mut().enumerate() {
            let mut sum = [0.0; 3];
            for (i, weight) in weights.iter().enumerate() {
                let texel = narrow[from(i) * to_columns + column];
                for c in 0..3 {
                    sum[c] += weight * texel[c];
                }
            }
            *texel = sum.map(|value| value as f32);
        }
    }
    Grid {
        columns: to_columns,
        texels: found,
    }
}

/// With half as many rows and columns: means by solid angle.
fn halved(grid: &Grid) -> Grid {
    let (rows, columns) = (grid.rows(), grid.columns);
    let mut texels = Vec::with_capacity(rows * columns / 4);
    for row in 0..rows / 2 {
        let (upper, lower) = (area(2 * row, rows), area(2 * row + 1, rows));
        let part = upper / (upper + lower);
        for column in 0..columns / 2 {
            let texel = |i: usize, j: usize| grid.texels[(2 * row + i) * columns + 2 * column + j];
            texels.push([0, 1, 2].map(|c| {
                let mean = |i: usize| 0.5 * (f64::from(texel(i, 0)[c]) + f64::from(texel(i, 1)[c]));
                (part * mean(0) + (1.0 - part) * mean(1)) as f32
            }));
        }
    }
    Grid {
        columns: columns / 2,
        texels,
    }
}

/// Means weighted by `lobe` of the cosine, of all within `reach` radians; on the same grid.
fn convolved(grid: &Grid, lobe: impl Fn(f64) -> f64 + Sync, reach: f64, threads: usize) -> Grid {
    let (rows, columns) = (grid.rows(), grid.columns);
    let height = |row: usize| PI * (0.5 - (row as f64 + 0.5) / rows as f64);
    // Rows twice in a row, so that a sum across the edge needs no other index.
    let doubled: Vec<[f64; 3]> = grid
        .texels
        .chunks(columns)
        .flat_map(|row| row.iter().chain(row))
        .map(|texel| texel.map(f64::from))
        .collect();
    let found = pool::map(threads, (0..rows).collect(), |row| {
        let (sine, cosine) = height(row).sin_cos();
        let mut sums = vec![[0.0f64; 3]; columns];
        let mut total = 0.0;
        for other in 0..rows {
            if (height(row) - height(other)).abs() > reach {
                continue;
            }
            let (other_sine, other_cosine) = height(other).sin_cos();
            // γ of columns that are d apart: cos γ = sin sin + cos cos cos Δφ.
            let apart = |d: usize| {
                let turn = (2.0 * PI * d as f64 / columns as f64).cos();
                sine * other_sine + cosine * other_cosine * turn
            };
            let near = |&d: &usize| apart(d) >= reach.min(PI).cos() - 1e-12;
            let count = (0..=columns / 2).take_while(near).count();
            let area = area(other, rows);
            let weights: Vec<f64> = (0..count).map(|d| area * lobe(apart(d))).collect();
            let row = &doubled[other * 2 * columns..][..2 * columns];
            for (d, &weight) in weights.iter().enumerate() {
                // The texel itself, and the one opposite, are there once.
                let both = d != 0 && 2 * d != columns;
                total += if both { 2.0 * weight } else { weight };
                let right = &row[d..d + columns];
                if both {
                    let left = &row[columns - d..2 * columns - d];
                    for ((sum, right), left) in sums.iter_mut().zip(right).zip(left) {
                        for c in 0..3 {
                            sum[c] += weight * (right[c] + left[c]);
                        }
                    }
                } else {
                    for (sum, right) in sums.iter_mut().zip(right) {
                        for c in 0..3 {
                            sum[c] += weight * right[c];
                        }
                    }
                }
            }
        }
        sums.into_iter()
            .map(|sum| sum.map(|value| (value / total) as f32))
            .collect::<Vec<_>>()
    });
    Grid {
        columns,
        texels: found.into_iter().flatten().collect(),
    }
}
