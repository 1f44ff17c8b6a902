//! Normals and materials of single pixels under known lamps.

use std::ops::Range;

use glam::DVec3;

use super::descent::{Descent, Free};
use super::samples::{AT_MOST, Lights, Point, Samples, UNKNOWNS};
use crate::pixel::pixel_fit::PRIOR_MAX;
use crate::reflectance::model::{Model, with_model};
use crate::reflectance::planes::Material;
use crate::reflectance::tangent_offset::{OFFSET_MAX, OFFSETS, tangents};
use crate::runtime::check::LARGEST_F32;
use crate::runtime::memory::{collect, zeros};
use crate::runtime::{Error, Result, check, pool};

/// Pixels in a piece of work.
const PIECE: usize = 128;

/// Largest weight of a sample that is taken: its product with the square of any residual is finite.
const WEIGHT_MAX: f64 = 1e100;

/// Numbers that a pixel is told by: tangent offsets, albedos, roughness, metallic.
pub const NUMBERS: usize = UNKNOWNS;

/// Of each unknown in the order of the equations, its place in that of [`NUMBERS`].
pub(super) const PLACES: [usize; UNKNOWNS] = [2, 3, 4, 5, 6, 0, 1];

/// What is known of P pixels in N pictures under K lamps.
#[derive(Clone, Debug)]
pub struct LampPictures {
    /// Linear radiance: (pixel, picture).
    pub pictures: Vec<[f64; 3]>,
    /// 0, or [`AT_LEAST`](super::samples::AT_LEAST) or [`AT_MOST`](super::samples::AT_MOST): (pixel,
    /// picture).
    pub limits: Option<Vec<[u8; 3]>>,
    /// Unit vectors from the surface to the camera.
    pub views: Vec<DVec3>,
    /// Unit vectors from the surface to the lamps: (pixel, lamp), or (lamp) alike of all pixels.
    pub directions: Vec<DVec3>,
    /// What the lamps bring, radiance of a white diffuse surface that faces them: likewise.
    pub intensities: Vec<[f64; 3]>,
    /// The picture that each lamp lights, in rising order: (lamp).
    pub picture_of: Vec<usize>,
    /// The first coefficient of the SH light of each picture beside its lamps.
    pub ambient: Vec<[f64; 3]>,
    /// What makes radiance of materials.
    pub model: Model,
    /// 0 means one for each processor.
    pub threads: usize,
}

/// How pixels are fitted.
#[derive(Clone, Copy, Debug)]
pub struct LampFit<'a> {
    /// Unit normals that tangent offsets are of.
    pub base_normals: &'a [DVec3],
    /// Means of Gaussian priors Σ precision (x − mean)²: (pixel), by [`NUMBERS`].
    pub prior_mean: &'a [[f64; NUMBERS]],
    /// Their precisions, 0 for none.
    pub prior_precision: &'a [[f64; NUMBERS]],
    /// What moves beside the albedo.
    pub free: Free,
    /// Steps at most.
    pub iterations: usize,
}

/// Pixels where their fits ended.
#[derive(Clone, Debug)]
pub struct LampFitted {
    /// Unit normals.
    pub normals: Vec<DVec3>,
    /// In \[0, 1\].
    pub materials: Vec<Material>,
    /// Σ w residual² with the prior.
    pub costs: Vec<f64>,
}

/// The best normal and material of each pixel near a start, never worse than it, by weights of the
/// squared residuals, 0 where there are no data: (pixel, picture).
///
/// Pixels do not know of each other. The result does not depend on the number of threads.
pub fn fit_under_lamps(
    given: &LampPictures,
    weights: &[[f64; 3]],
    start_normals: &[DVec3],
    materials: &[Material],
    how: LampFit,
) -> Result<LampFitted> {
    let pixels = materials.len();
    check::length("base_normals", pixels, how.base_normals.len())?;
    check::length("prior_mean", pixels, how.prior_mean.len())?;
    check::length("prior_precision", pixels, how.prior_precision.len())?;
    let lights = given.check("start_normals", weights, start_normals, materials)?;
    check::moderate("prior_mean", how.prior_mean.as_flattened(), PRIOR_MAX)?;
    let precision = how.prior_precision.as_flattened();
    check::not_negative("prior_precision", precision, PRIOR_MAX)?;
    check::unit_vectors("base_normals", how.base_normals)?;
    let offsets = start_offsets(how.base_normals, start_normals)?;
    let mut fitted = LampFitted {
        normals: zeros("start_normals", pixels)?,
        materials: collect("albedo", pixels, materials.iter().copied())?,
        costs: zeros("pictures", pixels)?,
    };
    let descent = |p: usize| Descent {
        samples: Samples::new(given, weights, &lights, p)
            .with_prior(&how.prior_mean[p], &how.prior_precision[p]),
        base: how.base_normals[p].normalize(),
        start: Point {
            offset: offsets[p],
            normal: start_normals[p],
            material: materials[p],
        },
        free: how.free,
    };
    let pieces = (fitted.normals.chunks_mut(PIECE))
        .zip(fitted.materials.chunks_mut(PIECE))
        .zip(fitted.costs.chunks_mut(PIECE))
        .enumerate()
        .collect();
    pool::map(
        given.threads,
        pieces,
        |(piece, ((normals, materials), costs))| {
            for i in 0..normals.len() {
                let descent = descent(piece * PIECE + i);
                let ended = with_model!(given.model, M => descent.run::<M>(how.iterations));
                normals[i] = ended.point.normal;
                materials[i] = ended.point.material;
                costs[i] = ended.cost;
            }
        },
    );
    Ok(fitted)
}

/// The tangent offset of each start: with n·n₀ > 0, a = n·t₁/n·n₀ and b = n·t₂/n·n₀.
fn start_offsets(base: &[DVec3], start: &[DVec3]) -> Result<Vec<[f64; OFFSETS]>> {
    let mut offsets = zeros("start_normals", start.len())?;
    for (p, offset) in offsets.iter_mut().enumerate() {
        let base = base[p].normalize();
        let along = start[p].dot(base);
        *offset = tangents(base).map(|t| start[p].dot(t) / along);
        // Written so that NaN fails.
        let within = |x: f64| x.abs() <= OFFSET_MAX;
        if !(along > 0.0 && within(offset[0]) && within(offset[1])) {
            let expected = "normals less than 90 degrees from base_normals";
            let found = format!(
                "{:.1} degrees at {p}",
                along.clamp(-1.0, 1.0).acos().to_degrees()
            );
            return Err(Error::argument("start_normals", expected, found));
        }
    }
    Ok(offsets)
}

impl LampPictures {
    pub(super) fn check(
        &self,
        name: &'static str,
        weights: &[[f64; 3]],
        normals: &[DVec3],
        materials: &[Material],
    ) -> Result<Lights> {
        let (pixels, pictures) = (materials.len(), self.ambient.len());
        let samples = check::samples("pictures", "pictures", pictures, pixels)?;
        check::length("pictures", samples, self.pictures.len())?;
        check::length("weights", samples, weights.len())?;
        if let Some(limits) = &self.limits {
            check::length("limits", samples, limits.len())?;
            let limits = limits.as_flattened();
            if let Some(i) = limits.iter().position(|&limit| limit > AT_MOST) {
                let found = format!("{} at {i}", limits[i]);
                return Err(Error::argument("limits", "0, 1 or 2", found));
            }
        }
        check::length("views", pixels, self.views.len())?;
        check::length(name, pixels, normals.len())?;
        let lamps = self.picture_of.len();
        if self.directions.len() != lamps {
            let of_lamps = check::samples("directions", "lamps", lamps, pixels)?;
            check::length("directions", of_lamps, self.directions.len())?;
        }
        check::length("intensities", self.directions.len(), self.intensities.len())?;
        check::moderate("pictures", self.pictures.as_flattened(), LARGEST_F32)?;
        check::not_negative("weights", weights.as_flattened(), WEIGHT_MAX)?;
        check::moderate("intensities", self.intensities.as_flattened(), LARGEST_F32)?;
        check::moderate("ambient", self.ambient.as_flattened(), LARGEST_F32)?;
        check::unit_vectors("views", &self.views)?;
        check::unit_vectors("directions", &self.directions)?;
        check::unit_vectors(name, normals)?;
        check::indices("picture_of", pictures, &self.picture_of)?;
        if !self.picture_of.is_sorted() {
            let expected = "numbers in rising order";
            return Err(Error::argument("picture_of", expected, "others"));
        }
        Ok(Lights::new(&self.picture_of, &self.ambient))
    }

    /// Where the lamps of a pixel are in what may be alike of all.
    pub(super) fn lamps_of(&self, p: usize) -> Range<usize> {
        let lamps = self.picture_of.len();
        let alike = self.directions.len() == lamps;
        let first = if alike { 0 } else { p * lamps };
        first..first + lamps
    }
}
