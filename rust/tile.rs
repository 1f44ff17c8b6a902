//! Sixteen pixels at a time in float32: the three matrix products that make up an evaluation.
//!
//! For one colour channel, with W (pixel, 16), lights L (picture, 16) and targets T:
//!
//! ```text
//! I = W Lᵀ,   e = I − T,   ∂/∂W = e L,   ∂/∂L = eᵀ W        (of ½ Σ e²)
//! ```
//!
//! W does not depend on the picture, so its derivative is reduced to the material once per pixel.
//! Bodies are plain loops over fixed-size arrays, which the compiler turns into vector code.

use crate::sh::{BAND_OF, COEFFICIENTS};
use crate::shade::{Factors, Frame};

/// Pixels in a tile.
pub const LANES: usize = 16;
/// Partial sums kept apart when a tile is summed over its pixels.
pub const PARTIAL_LANES: usize = 8;
/// Basis functions with a diffuse response: bands 0 to 2.
const DIFFUSE_COEFFICIENTS: usize = 9;
/// Pictures that go through the products together.
const GROUP: usize = 4;

/// One float32 for each pixel of a tile.
pub type Lanes = [f32; LANES];
/// Derivatives by the 16 coefficients of one light, as partial sums over pixels.
pub type LightPartials = [[f32; PARTIAL_LANES]; COEFFICIENTS];

/// The [`Frame`]s of sixteen pixels, side by side. Unused lanes are zero, so that their weights,
/// residuals and derivatives are zero too.
#[derive(Clone, Debug)]
pub struct TileFrame {
    /// Clamped n·v.
    pub cosine: [f64; LANES],
    diffuse: [Lanes; DIFFUSE_COEFFICIENTS],
    mirror: [Lanes; COEFFICIENTS],
}

impl TileFrame {
    /// A tile in which no lane is used yet.
    pub fn empty() -> Self {
        Self {
            cosine: [1.0; LANES],
            diffuse: [[0.0; LANES]; DIFFUSE_COEFFICIENTS],
            mirror: [[0.0; LANES]; COEFFICIENTS],
        }
    }

    /// Puts a pixel into a lane.
    pub fn set(&mut self, lane: usize, frame: &Frame) {
        self.cosine[lane] = frame.cosine;
        for k in 0..DIFFUSE_COEFFICIENTS {
            self.diffuse[k][lane] = frame.diffuse[k] as f32;
        }
        for k in 0..COEFFICIENTS {
            self.mirror[k][lane] = frame.mirror[k] as f32;
        }
    }

    /// The pixel in a lane, as the fast path sees it: basis functions rounded to float32.
    pub fn get(&self, lane: usize) -> Frame {
        let mut diffuse = [0.0; COEFFICIENTS];
        for k in 0..DIFFUSE_COEFFICIENTS {
            diffuse[k] = f64::from(self.diffuse[k][lane]);
        }
        Frame {
            cosine: self.cosine[lane],
            diffuse,
            mirror: self.mirror.map(|y| f64::from(y[lane])),
        }
    }
}

/// One channel's material factors of a tile: kd and ks h_l, rounded once to float32.
#[derive(Clone, Copy, Debug)]
pub struct TileFactors {
    diffuse: Lanes,
    specular: [Lanes; 4],
}

impl TileFactors {
    /// All factors zero.
    pub const ZERO: Self = Self {
        diffuse: [0.0; LANES],
        specular: [[0.0; LANES]; 4],
    };

    /// Puts channel `c` of a pixel's factors into a lane.
    pub fn set(&mut self, lane: usize, factors: &Factors, c: usize) {
        self.diffuse[lane] = factors.diffuse[c] as f32;
        for l in 0..4 {
            self.specular[l][lane] = (factors.specular[c] * factors.bands.weight[l]) as f32;
        }
    }
}

/// The tile's weights for one channel, W transposed: coefficient first.
#[inline]
pub fn weights(frame: &TileFrame, factors: &TileFactors) -> [Lanes; COEFFICIENTS] {
    let mut w = [[0.0; LANES]; COEFFICIENTS];
    for k in 0..COEFFICIENTS {
        let specular = &factors.specular[BAND_OF[k]];
        for x in 0..LANES {
            w[k][x] = specular[x] * frame.mirror[k][x];
        }
    }
    for k in 0..DIFFUSE_COEFFICIENTS {
        for x in 0..LANES {
            w[k][x] += factors.diffuse[x] * frame.diffuse[k][x];
        }
    }
    w
}

/// The adjoint of [`weights`], reduced over the coefficients: for every pixel the derivative by kd
/// and the four band sums that [`Factors::pull_back`] takes.
#[inline]
pub fn reduce(frame: &TileFrame, by_weights: &[Lanes; COEFFICIENTS]) -> (Lanes, [Lanes; 4]) {
    let mut by_diffuse = [0.0; LANES];
    for k in 0..DIFFUSE_COEFFICIENTS {
        for x in 0..LANES {
            by_diffuse[x] += by_weights[k][x] * frame.diffuse[k][x];
        }
    }
    let mut band_sums = [[0.0; LANES]; 4];
    for k in 0..COEFFICIENTS {
        let sum = &mut band_sums[BAND_OF[k]];
        for x in 0..LANES {
            sum[x] += by_weights[k][x] * frame.mirror[k][x];
        }
    }
    (by_diffuse, band_sums)
}

/// Radiance of a tile under each light: I = W Lᵀ.
pub fn radiance(w: &[Lanes; COEFFICIENTS], lights: &[[f32; COEFFICIENTS]], out: &mut [Lanes]) {
    for (light, i) in lights.iter().zip(out) {
        [*i] = radiance_of(w, &[*light]);
    }
}

#[inline]
fn radiance_of<const J: usize>(
    w: &[Lanes; COEFFICIENTS],
    lights: &[[f32; COEFFICIENTS]; J],
) -> [Lanes; J] {
    let mut i = [[0.0; LANES]; J];
    for k in 0..COEFFICIENTS {
        for j in 0..J {
            for x in 0..LANES {
                i[j][x] += lights[j][k] * w[k][x];
            }
        }
    }
    i
}

/// All three products of one tile and channel. Adds to the derivatives of ½ Σ e² and to the
/// partial sums of e².
pub fn residuals(
    w: &[Lanes; COEFFICIENTS],
    lights: &[[f32; COEFFICIENTS]],
    targets: &[Lanes],
    by_weights: &mut [Lanes; COEFFICIENTS],
    by_lights: &mut [LightPartials],
    squares: &mut Lanes,
) {
    let (light_groups, light_rest) = lights.as_chunks::<GROUP>();
    let (target_groups, target_rest) = targets.as_chunks::<GROUP>();
    let (by_light_groups, by_light_rest) = by_lights.as_chunks_mut::<GROUP>();
    for ((l, t), g) in light_groups.iter().zip(target_groups).zip(by_light_groups) {
        group::<GROUP>(w, l, t, by_weights, g, squares);
    }
    for ((l, t), g) in light_rest.iter().zip(target_rest).zip(by_light_rest) {
        let (l, t, g) = (
            std::array::from_ref(l),
            std::array::from_ref(t),
            std::array::from_mut(g),
        );
        group::<1>(w, l, t, by_weights, g, squares);
    }
}

#[inline]
fn group<const J: usize>(
    w: &[Lanes; COEFFICIENTS],
    lights: &[[f32; COEFFICIENTS]; J],
    targets: &[Lanes; J],
    by_weights: &mut [Lanes; COEFFICIENTS],
    by_lights: &mut [LightPartials; J],
    squares: &mut Lanes,
) {
    let mut e = radiance_of(w, lights);
    for j in 0..J {
        for x in 0..LANES {
            e[j][x] -= targets[j][x];
            squares[x] += e[j][x] * e[j][x];
        }
    }
    for k in 0..COEFFICIENTS {
        for j in 0..J {
            for x in 0..LANES {
                by_weights[k][x] += lights[j][k] * e[j][x];
            }
        }
        // Partial sums, not one sum: a horizontal sum here would stop vectorisation.
        for j in 0..J {
            for x in 0..PARTIAL_LANES {
                by_lights[j][k][x] +=
                    e[j][x] * w[k][x] + e[j][x + PARTIAL_LANES] * w[k][x + PARTIAL_LANES];
            }
        }
    }
}
