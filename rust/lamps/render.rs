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

/// Numbers of a lamp and channel with their derivatives: radiance under unit light, vectors by the
/// normal and by the light's direction, in their tangent planes, and by its own albedo, by roughness
/// and by metallic.
pub const WITH_SLOPES: usize = 10;

/// Radiance of every pixel under unit light of each of its lamps: (pixel, lamp, channel).
///
/// `threads` = 0 means one for each processor; the result does not depend on it.
pub fn lamp_radiance(pixels: Lamplit, threads: usize) -> Result<Vec<f64>> {
    of_lamps::<1, false>(pixels, threads)
}

/// The same with its derivatives: (pixel, lamp, channel, [`WITH_SLOPES`]).
pub fn lamp_slopes(pixels: Lamplit, threads: usize) -> Result<Vec<f64>> {
    of_lamps::<WITH_SLOPES, true>(pixels, threads)
}

fn of_lamps<const NUMBERS: usize, const SLOPES: bool>(
    pixels: Lamplit,
    threads: usize,
) -> Result<Vec<f64>> {
    let lamps = pixels.check()?;
    let mut found = zeros("directions", pixels.directions.len() * 3 * NUMBERS)?;
    if lamps == 0 {
        return Ok(found);
    }
    let instructions = Instructions::best();
    let pieces = (found.chunks_mut(PIECE * lamps * 3 * NUMBERS).enumerate()).collect();
    pool::map(threads, pieces, |(piece, found): (usize, &mut [f64])| {
        instructions.run(OfLamps::<NUMBERS, SLOPES> {
            pixels,
            lamps,
            first: piece * PIECE,
            found: found.as_chunks_mut().0,
        });
    });
    Ok(found)
}

/// Pixels from the first on, as many as there is room for.
struct OfLamps<'a, const NUMBERS: usize, const SLOPES: bool> {
    pixels: Lamplit<'a>,
    lamps: usize,
    first: usize,
    found: &'a mut [[f64; NUMBERS]],
}

impl<const NUMBERS: usize, const SLOPES: bool> Kernel for OfLamps<'_, NUMBERS, SLOPES> {
    type Output = ();

    #[inline(always)]
    fn run<I: Isa>(self, isa: I) {
        let (pixels, lamps) = (self.pixels, self.lamps);
        for (p, found) in (self.first..).zip(self.found.chunks_mut(3 * lamps)) {
            let [normal, view] = [pixels.normals[p], pixels.views[p]];
            let surface = Surface::<SLOPES>::new(pixels.model, normal, view, &pixels.materials[p]);
            let directions = &pixels.directions[p * lamps..(p + 1) * lamps];
            if !SLOPES && !pixels.extents.is_empty() {
                for (k, found) in found.as_chunks_mut::<3>().0.iter_mut().enumerate() {
                    let extent = pixels.extents[p * lamps + k];
                    *found = surface
                        .of_disk(directions[k], extent)
                        .map(|of| [of; NUMBERS]);
                }
                continue;
            }
            let of_lanes = directions.chunks(LANES).zip(found.chunks_mut(3 * LANES));
            for (directions, found) in of_lanes {
                let mut sides = [[0.0; LANES]; 3];
                for (i, direction) in directions.iter().enumerate() {
                    (sides[0][i], sides[1][i], sides[2][i]) = (*direction).into();
                }
                let mut numbers = [[[0.0; LANES]; NUMBERS]; 3];
                for at in 0..LANES / <I as Vectors<f64>>::LANES {
                    let of = |lanes: &Lanes| Wide(isa, I::of(lanes)[at]);
                    let light = [of(&sides[0]), of(&sides[1]), of(&sides[2])];
                    let (lit, unit) = surface.reflected_of(light);
                    let (by_normal, by_direction) = match SLOPES {
                        true => (unit.by_normal(), unit.by_direction()),
                        false => ([light; 3], [light; 3]),
                    };
                    for c in 0..3 {
                        let ([x, y, z], [u, v, w]) = (by_normal[c], by_direction[c]);
                        let by = [unit.by_albedo[c], unit.by_roughness[c], unit.by_metallic[c]];
                        let all = [unit.radiance[c], x, y, z, u, v, w, by[0], by[1], by[2]];
                        for j in 0..NUMBERS {
                            I::of_mut(&mut numbers[c][j])[at] = (lit * all[j]).1;
                        }
                    }
                }
                for i in 0..directions.len() {
                    for c in 0..3 {
                        for j in 0..NUMBERS {
                            found[3 * i + c][j] = numbers[c][j][i];
                        }
                    }
                }
            }
        }
    }
}
