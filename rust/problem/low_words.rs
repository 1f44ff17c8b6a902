//! Low words: what float32 leaves of numbers that came in float64, as much again in float32, 48 bits
//! together.
//!
//! The fast evaluation reads targets and directions in float32, and has no use for more. A fit that
//! is exact needs more of both: rounded directions alone move radiance by 10⁻⁷ of itself.

use glam::DVec3;

use crate::reflectance::planes::directions;
use crate::reflectance::planes::{BLOCK, Plane};
use crate::runtime::Result;
use crate::runtime::memory::zeros;

/// The nearest float32, and what is left of the number.
pub(crate) fn high_and_low(value: f64) -> (f32, f32) {
    let high_words = value as f32;
    (high_words, (value - f64::from(high_words)) as f32)
}

/// The low words of the directions of a block of pixels.
#[derive(Clone, Debug, Default)]
pub(crate) struct DirectionLowWords {
    normal: [Plane; 3],
    mirror: [Plane; 3],
}

impl DirectionLowWords {
    /// Takes up a pixel of the block.
    pub(crate) fn set(&mut self, pixel: usize, normal: DVec3, view: DVec3) {
        let (_, mirror) = directions(normal, view);
        for axis in 0..3 {
            self.normal[axis].0[pixel] = high_and_low(normal[axis]).1;
            self.mirror[axis].0[pixel] = high_and_low(mirror[axis]).1;
        }
    }

    /// To be added to the rounded normal and mirror direction of a pixel.
    pub(crate) fn get(&self, pixel: usize) -> [DVec3; 2] {
        [&self.normal, &self.mirror]
            .map(|planes| DVec3::from([0, 1, 2].map(|axis| f64::from(planes[axis].0[pixel]))))
    }
}

/// The low words of the directions of some pixels, by block.
pub(crate) fn of_directions(normals: &[DVec3], views: &[DVec3]) -> Result<Vec<DirectionLowWords>> {
    let blocks = normals.len().div_ceil(BLOCK);
    let mut low_words: Vec<DirectionLowWords> = zeros("normals", blocks)?;
    for (p, (&normal, &view)) in normals.iter().zip(views).enumerate() {
        low_words[p / BLOCK].set(p % BLOCK, normal, view);
    }
    Ok(low_words)
}
