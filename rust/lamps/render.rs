//! Many pixels under lamps.

use glam::DVec3;

use super::surface::Surface;
use crate::problem::render::pictures;
use crate::reflectance::model::Model;
use crate::reflectance::planes::Material;
use crate::runtime::check::MAX_SAMPLES;
use crate::runtime::memory::zeros;
use crate::runtime::{Error, Result, check, pool};

/// Pixels in a piece of work.
const PIECE: usize = 1024;

/// Largest colour of a light that is taken, a radiance. It does not overflow: a surface reflects at
/// most 10³⁵ times as much.
const LARGEST_COLOR: f64 = 1e260;

/// Light from one direction, infinitely far away.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DirectionalLight {
    /// Unit vector from the surface to the light.
    pub direction: DVec3,
    /// Radiance, linear Rec.709, of a white diffuse surface without Fresnel loss that faces the
    /// light: its irradiance over π.
    pub color: [f64; 3],
    /// Angular radius of the disk that it is, radians; 0 = a point.
    pub extent: f64,
}

/// Largest angular radius of a lamp, radians: beyond, it is no lamp but a sky, for panoramas.
pub const LARGEST_EXTENT: f64 = std::f64::consts::FRAC_PI_4;

fn check_extents(extents: &[f64]) -> Result<()> {
    match extents
        .iter()
        .find(|&&e| !(0.0..=LARGEST_EXTENT).contains(&e))
    {
        None => Ok(()),
        Some(found) => Err(Error::argument("extents", "0 to π/4 radians", found)),
    }
}

/// Radiance of every pixel under every light: (light, pixel, channel).
///
/// `threads` = 0 means one for each processor; the result does not depend on it.
pub fn render_directional(
    normals: &[DVec3],
    views: &[DVec3],
    materials: &[Material],
    lights: &[DirectionalLight],
    threads: usize,
    model: Model,
) -> Result<Vec<f64>> {
    let pixels = check::pixels(normals, views, materials.len())?;
    for light in lights {
        check::unit_vectors("directions", &[light.direction])?;
        check::moderate("colors", &light.color, LARGEST_COLOR)?;
        check_extents(&[light.extent])?;
    }
    pictures(lights.len(), pixels, PIECE, threads, |first, parts| {
        let count = parts.first().map_or(0, |part| part.len() / 3);
        for i in 0..count {
            let p = first + i;
            let surface = Surface::<false>::new(model, normals[p], views[p], &materials[p]);
            for (light, part) in lights.iter().zip(parts.iter_mut()) {
                let unit = surface.reflected_of_disk(light.direction, light.extent);
                for c in 0..3 {
                    part[3 * i + c] = unit[c] * light.color[c];
                }
            }
        }
    })
}

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
        check::length("directions", pixels * lamps, count)?;
        if count > MAX_SAMPLES {
            let expected = format!("at most {MAX_SAMPLES} pixels times lamps");
            return Err(Error::argument("directions", expected, count));
        }
        check::unit_vectors("directions", self.directions)?;
        if !self.extents.is_empty() {
            check::length("extents", self.directions.len(), self.extents.len())?;
            check_extents(self.extents)?;
        }
        Ok(lamps)
    }
}

/// Radiance of every pixel under unit light of each of its lamps: (pixel, lamp, channel).
///
/// `threads` = 0 means one for each processor; the result does not depend on it.
pub fn lamp_radiance(pixels: Lamplit, threads: usize) -> Result<Vec<f64>> {
    let lamps = pixels.check()?;
    let mut radiance = zeros("directions", pixels.directions.len() * 3)?;
    if lamps == 0 {
        return Ok(radiance);
    }
    let pieces = radiance.chunks_mut(PIECE * lamps * 3).enumerate().collect();
    pool::map(threads, pieces, |(piece, radiance): (usize, &mut [f64])| {
        let of_pixels = radiance.as_chunks_mut::<3>().0.chunks_mut(lamps);
        for (p, radiance) in (piece * PIECE..).zip(of_pixels) {
            let [normal, view] = [pixels.normals[p], pixels.views[p]];
            let surface = Surface::<false>::new(pixels.model, normal, view, &pixels.materials[p]);
            for (k, radiance) in radiance.iter_mut().enumerate() {
                let at = p * lamps + k;
                let extent = pixels.extents.get(at).copied().unwrap_or(0.0);
                *radiance = surface.reflected_of_disk(pixels.directions[at], extent);
            }
        }
    });
    Ok(radiance)
}

/// Radiance and its derivatives, each by (pixel, lamp, channel); those by directions also by axis.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct LampSlopes {
    /// Under unit light.
    pub radiance: Vec<f64>,
    /// Vectors in the normals' tangent planes.
    pub by_normal: Vec<f64>,
    /// Vectors in the light directions' tangent planes.
    pub by_direction: Vec<f64>,
    /// Of each channel by its own albedo.
    pub by_albedo: Vec<f64>,
    /// By roughness.
    pub by_roughness: Vec<f64>,
    /// By metallic.
    pub by_metallic: Vec<f64>,
}

/// [`lamp_radiance`] with its derivatives.
pub fn lamp_slopes(pixels: Lamplit, threads: usize) -> Result<LampSlopes> {
    let lamps = pixels.check()?;
    let (scalars, vectors) = (pixels.directions.len() * 3, pixels.directions.len() * 9);
    let mut slopes = LampSlopes {
        radiance: zeros("directions", scalars)?,
        by_normal: zeros("directions", vectors)?,
        by_direction: zeros("directions", vectors)?,
        by_albedo: zeros("directions", scalars)?,
        by_roughness: zeros("directions", scalars)?,
        by_metallic: zeros("directions", scalars)?,
    };
    if lamps == 0 {
        return Ok(slopes);
    }
    let of_piece = PIECE * lamps;
    let scalars = [
        &mut slopes.radiance,
        &mut slopes.by_albedo,
        &mut slopes.by_roughness,
        &mut slopes.by_metallic,
    ];
    let mut scalars = scalars.map(|values| values.as_chunks_mut::<3>().0.chunks_mut(of_piece));
    let vectors = [&mut slopes.by_normal, &mut slopes.by_direction];
    let mut vectors = vectors.map(|values| values.as_chunks_mut::<9>().0.chunks_mut(of_piece));
    let pieces = (0..pixels.normals.len().div_ceil(PIECE))
        .map(|piece| {
            let scalars = scalars
                .each_mut()
                .map(|chunks| chunks.next().expect("as many"));
            let vectors = vectors
                .each_mut()
                .map(|chunks| chunks.next().expect("as many"));
            (piece * PIECE, scalars, vectors)
        })
        .collect();
    type Part<'a, const N: usize> = &'a mut [[f64; N]];
    type Piece<'a> = (usize, [Part<'a, 3>; 4], [Part<'a, 9>; 2]);
    pool::map(threads, pieces, |(first, scalars, vectors): Piece| {
        let [radiance, by_albedo, by_roughness, by_metallic] = scalars;
        let [by_normal, by_direction] = vectors;
        for i in 0..radiance.len() / lamps {
            let p = first + i;
            let [normal, view] = [pixels.normals[p], pixels.views[p]];
            let surface = Surface::<true>::new(pixels.model, normal, view, &pixels.materials[p]);
            for k in 0..lamps {
                let reflected = surface.reflected(pixels.directions[p * lamps + k]);
                let at = i * lamps + k;
                radiance[at] = reflected.radiance;
                by_albedo[at] = reflected.by_albedo;
                by_roughness[at] = reflected.by_roughness;
                by_metallic[at] = reflected.by_metallic;
                by_normal[at] = flat(reflected.by_normal());
                by_direction[at] = flat(reflected.by_direction());
            }
        }
    });
    Ok(slopes)
}

/// By channel, by axis.
fn flat(vectors: [DVec3; 3]) -> [f64; 9] {
    let by_channel = vectors.map(|v| v.to_array());
    std::array::from_fn(|i| by_channel[i / 3][i % 3])
}
