//! Many pixels under lamps.

use glam::DVec3;

use super::number::Wide;
use super::samples::{LANES, Lanes};
use super::surface::Surface;
use crate::reflectance::model::Model;
use crate::reflectance::planes::Material;
use crate::runtime::memory::zeros;
use crate::runtime::simd::{Instructions, Isa, Kernel, Vectors};
use crate::runtime::{Error, Result, check, pool};

/// Pixels in a piece of work.
const PIECE: usize = 1024;

/// Largest angular radius of a lamp, radians: beyond, it is no lamp but a sky, for panoramas.
pub const LARGEST_EXTENT: f64 = std::f64::consts::FRAC_PI_4;

/// Pixels, each with directions of its own.
#[derive(Clone, Copy, Debug)]
pub struct Lamplit<'a> {
    /// Unit vectors.
    pub normals: &'a [DVec3],
    /// Unit vectors from the surface to the camera.
    pub views: &'a [DVec3],
    /// What they are made of.
    pub materials: &'a [Material],
    /// Unit vectors from the surface to the lamps: (pixel, lamp).
    pub directions: &'a [DVec3],
    /// Angular radii of the lamps, radians, (pixel, lamp); empty = points.
    pub extents: &'a [f64],
    /// What makes radiance of materials.
    pub model: Model,
}

impl Lamplit<'_> {
    /// Lamps of each pixel.
    fn check(&self) -> Result<usize> {
        let pixels = check::pixels(self.normals, self.views, self.materials.len())?;
        let count = self.directions.len();
        let lamps = count.checked_div(pixels).unwrap_or(0);
        let expected = check::samples("directions", "lamps", lamps, pixels)?;
        check::length("directions", expected, count)?;
        check::unit_vectors("directions", self.directions)?;
        if !self.extents.is_empty() {
            check::length("extents", count, self.extents.len())?;
            let mut extents = self.extents.iter();
            if let Some(found) = extents.find(|&e| !(0.0..=LARGEST_EXTENT).contains(e)) {
                return Err(Error::argument("extents", "0 to π/4 radians", found));
            }
        }
        Ok(lamps)
    }
}

/// Radiance of every pixel under unit light of each of its lamps: (pixel, lamp, channel).
///
/// `threads` = 0 means one for each processor; the result does not depend on it.
pub fn lamp_radiance(pixels: Lamplit, threads: usize) -> Result<Vec<[f64; 3]>> {
    let lamps = pixels.check()?;
    let mut found = zeros("directions", pixels.directions.len())?;
    if lamps == 0 {
        return Ok(found);
    }
    let instructions = Instructions::best();
    let pieces = (found.chunks_mut(PIECE * lamps).enumerate()).collect();
    pool::map(
        threads,
        pieces,
        |(piece, found): (usize, &mut [[f64; 3]])| {
            instructions.run(OfLamps {
                pixels,
                lamps,
                first: piece * PIECE,
                found,
            });
        },
    );
    Ok(found)
}

/// Pixels from the first on, as many as there is room for.
struct OfLamps<'a> {
    pixels: Lamplit<'a>,
    lamps: usize,
    first: usize,
    found: &'a mut [[f64; 3]],
}

impl Kernel for OfLamps<'_> {
    type Output = ();

    #[inline(always)]
    fn run<I: Isa>(self, isa: I) {
        let (pixels, lamps) = (self.pixels, self.lamps);
        for (p, found) in (self.first..).zip(self.found.chunks_mut(lamps)) {
            let [normal, view] = [pixels.normals[p], pixels.views[p]];
            let surface = Surface::<false>::new(pixels.model, normal, view, &pixels.materials[p]);
            let directions = &pixels.directions[p * lamps..(p + 1) * lamps];
            if !pixels.extents.is_empty() {
                for (k, found) in found.iter_mut().enumerate() {
                    *found = surface.of_disk(directions[k], pixels.extents[p * lamps + k]);
                }
                continue;
            }
            for (directions, found) in directions.chunks(LANES).zip(found.chunks_mut(LANES)) {
                let mut sides = [[0.0; LANES]; 3];
                for (i, direction) in directions.iter().enumerate() {
                    (sides[0][i], sides[1][i], sides[2][i]) = (*direction).into();
                }
                let mut radiance = [[0.0; LANES]; 3];
                for at in 0..LANES / <I as Vectors<f64>>::LANES {
                    let of = |lanes: &Lanes| Wide(isa, I::of(lanes)[at]);
                    let light = [of(&sides[0]), of(&sides[1]), of(&sides[2])];
                    let (lit, unit) = surface.reflected_of(light);
                    for c in 0..3 {
                        I::of_mut(&mut radiance[c])[at] = (lit * unit.radiance[c]).1;
                    }
                }
                for i in 0..directions.len() {
                    found[i] = [radiance[0][i], radiance[1][i], radiance[2][i]];
                }
            }
        }
    }
}
