//! `pbrfit._core`: light of lamps on flat arrays.

use glam::DVec3;
use pyo3::prelude::*;

use super::arrays::{
    ANY, Out, Pixels, given, indices, optional, out, rows, shape, values, vectors, vectors_of,
};
use crate::lamps::descent::Free;
use crate::lamps::judge::{LampNoise, judge};
use crate::lamps::pixel_fit::{LampFit, LampPictures, NUMBERS, fit_under_lamps as fit_pixels};
use crate::lamps::render::{Lamplit, lamp_radiance as radiance_of_pixels};
use crate::lamps::system::{Movable, OF_PIXEL, ROWS, lamp_system as system_of_pixels};
use crate::runtime::check;

#[pyfunction]
#[pyo3(signature = (normals, views, albedo, roughness, metallic, directions, threads, model = "paper", extents = None))]
#[expect(clippy::too_many_arguments)]
pub(super) fn lamp_radiance<'py>(
    py: Python<'py>,
    normals: &Bound<'py, PyAny>,
    views: &Bound<'py, PyAny>,
    albedo: &Bound<'py, PyAny>,
    roughness: &Bound<'py, PyAny>,
    metallic: &Bound<'py, PyAny>,
    directions: &Bound<'py, PyAny>,
    threads: usize,
    model: &str,
    extents: Option<&Bound<'py, PyAny>>,
) -> PyResult<Out<'py, 3>> {
    let given = [normals, views, albedo, roughness, metallic];
    let pixels = Pixels::new(["normals", "views"], given)?;
    let (lamps, directions) = lamp_vectors("directions", directions, pixels.count())?;
    let extents = optional("extents", extents, [directions.len()])?.unwrap_or_default();
    let lamplit = Lamplit {
        normals: &pixels.normals,
        views: &pixels.views,
        materials: &pixels.materials,
        directions: &directions,
        extents: &extents,
        model: model.parse()?,
    };
    let radiance = py.detach(|| radiance_of_pixels(lamplit, threads))?;
    Ok(out(
        py,
        radiance.into_flattened(),
        [pixels.count(), lamps, 3],
    ))
}

#[pyfunction]
#[pyo3(signature = (
    pictures, weights, limits, views, directions, intensities, picture_of, ambient, base_normals,
    start_normals, albedo, roughness, metallic, prior_mean, prior_precision, free_normals,
    free_metallic, free_roughness, iterations, threads, model = "paper"
))]
#[expect(clippy::too_many_arguments)]
pub(super) fn fit_under_lamps<'py>(
    py: Python<'py>,
    pictures: &Bound<'py, PyAny>,
    weights: &Bound<'py, PyAny>,
    limits: Option<&Bound<'py, PyAny>>,
    views: &Bound<'py, PyAny>,
    directions: &Bound<'py, PyAny>,
    intensities: &Bound<'py, PyAny>,
    picture_of: &Bound<'py, PyAny>,
    ambient: &Bound<'py, PyAny>,
    base_normals: &Bound<'py, PyAny>,
    start_normals: &Bound<'py, PyAny>,
    albedo: &Bound<'py, PyAny>,
    roughness: &Bound<'py, PyAny>,
    metallic: &Bound<'py, PyAny>,
    prior_mean: &Bound<'py, PyAny>,
    prior_precision: &Bound<'py, PyAny>,
    free_normals: bool,
    free_metallic: bool,
    free_roughness: bool,
    iterations: usize,
    threads: usize,
    model: &str,
) -> PyResult<(
    Out<'py, 2>,
    Out<'py, 2>,
    Out<'py, 1>,
    Out<'py, 1>,
    Out<'py, 1>,
    Out<'py, 3>,
)> {
    let names = ["start_normals", "views"];
    let start = Pixels::new(names, [start_normals, views, albedo, roughness, metallic])?;
    let pixels = start.count();
    let lights = [directions, intensities, picture_of, ambient];
    let known = Samples::new(&start, [pictures, weights], limits, lights)?;
    let base_normals = vectors("base_normals", base_normals, pixels)?;
    let prior_mean = values::<f64, 2>("prior_mean", prior_mean, [pixels, NUMBERS])?;
    let prior_precision = values::<f64, 2>("prior_precision", prior_precision, [pixels, NUMBERS])?;
    let priors = [prior_mean.as_chunks().0, prior_precision.as_chunks().0];
    let known = known.pictures(&start, &base_normals, priors);
    let how = LampFit {
        free: Free {
            normals: free_normals,
            metallic: free_metallic,
            roughness: free_roughness,
        },
        iterations,
        model: model.parse()?,
        threads,
    };
    let fitted = py.detach(|| fit_pixels(known, &start.normals, &start.materials, how))?;
    let materials = || fitted.materials.iter();
    let information = fitted.information.into_flattened().into_flattened();
    Ok((
        rows(
            py,
            "start_normals",
            fitted.normals.iter().map(DVec3::to_array),
        )?,
        rows(py, "albedo", materials().map(|m| m.albedo))?,
        out(py, materials().map(|m| m.roughness).collect(), [pixels]),
        out(py, materials().map(|m| m.metallic).collect(), [pixels]),
        out(py, fitted.costs, [pixels]),
        out(py, information, [pixels, NUMBERS, NUMBERS]),
    ))
}

#[pyfunction]
#[pyo3(signature = (
    pictures, weights, limits, views, directions, intensities, picture_of, ambient, normals, albedo,
    roughness, metallic, strengths, by_place, threads, model = "paper"
))]
#[expect(clippy::too_many_arguments)]
pub(super) fn lamp_system<'py>(
    py: Python<'py>,
    pictures: &Bound<'py, PyAny>,
    weights: &Bound<'py, PyAny>,
    limits: Option<&Bound<'py, PyAny>>,
    views: &Bound<'py, PyAny>,
    directions: &Bound<'py, PyAny>,
    intensities: &Bound<'py, PyAny>,
    picture_of: &Bound<'py, PyAny>,
    ambient: &Bound<'py, PyAny>,
    normals: &Bound<'py, PyAny>,
    albedo: &Bound<'py, PyAny>,
    roughness: &Bound<'py, PyAny>,
    metallic: &Bound<'py, PyAny>,
    strengths: &Bound<'py, PyAny>,
    by_place: &Bound<'py, PyAny>,
    threads: usize,
    model: &str,
) -> PyResult<(Out<'py, 2>, Out<'py, 3>, Out<'py, 3>)> {
    let given = [normals, views, albedo, roughness, metallic];
    let at = Pixels::new(["normals", "views"], given)?;
    let lights = [directions, intensities, picture_of, ambient];
    let known = Samples::new(&at, [pictures, weights], limits, lights)?;
    let (pixels, lamps) = (at.count(), known.picture_of.len());
    let strengths = values::<f64, 2>("strengths", strengths, [pixels, lamps])?;
    let by_place = values::<f64, 3>("by_place", by_place, [pixels, lamps, 4])?;
    let movable = Movable {
        strengths: &strengths,
        by_place: by_place.as_chunks().0,
    };
    let no_prior = vec![[0.0; NUMBERS]; pixels];
    let given = known.pictures(&at, &at.normals, [&no_prior, &no_prior]);
    let (at, model) = ((&at.normals, &at.materials), model.parse()?);
    let found = py.detach(|| system_of_pixels(given, movable, at.0, at.1, model, threads))?;
    let columns = 6 * lamps + known.ambient.len();
    let own = found.own.into_flattened().into_flattened();
    Ok((
        out(py, found.shared, [columns, columns]),
        out(py, own, [pixels, ROWS, OF_PIXEL]),
        out(py, found.mixed, [pixels, ROWS, columns]),
    ))
}

#[pyfunction]
#[pyo3(signature = (
    pictures, weights, limits, views, directions, intensities, picture_of, ambient, normals, albedo,
    roughness, metallic, floor, growth, proportional, least, shadows, threads, model = "paper"
))]
#[expect(clippy::too_many_arguments)]
pub(super) fn judge_samples<'py>(
    py: Python<'py>,
    pictures: &Bound<'py, PyAny>,
    weights: &Bound<'py, PyAny>,
    limits: Option<&Bound<'py, PyAny>>,
    views: &Bound<'py, PyAny>,
    directions: &Bound<'py, PyAny>,
    intensities: &Bound<'py, PyAny>,
    picture_of: &Bound<'py, PyAny>,
    ambient: &Bound<'py, PyAny>,
    normals: &Bound<'py, PyAny>,
    albedo: &Bound<'py, PyAny>,
    roughness: &Bound<'py, PyAny>,
    metallic: &Bound<'py, PyAny>,
    floor: f64,
    growth: f64,
    proportional: bool,
    least: f64,
    shadows: &Bound<'py, PyAny>,
    threads: usize,
    model: &str,
) -> PyResult<(Out<'py, 2>, Out<'py, 1>, Out<'py, 4>)> {
    let given = [normals, views, albedo, roughness, metallic];
    let at = Pixels::new(["normals", "views"], given)?;
    let lights = [directions, intensities, picture_of, ambient];
    let known = Samples::new(&at, [pictures, weights], limits, lights)?;
    let (pixels, count) = (at.count(), known.ambient.len() / 3);
    let shadows = values::<f64, 1>("shadows", shadows, [count])?;
    let noise = LampNoise {
        floor,
        growth,
        proportional,
        least,
        shadows: &shadows,
    };
    let no_prior = vec![[0.0; NUMBERS]; pixels];
    let given = known.pictures(&at, &at.normals, [&no_prior, &no_prior]);
    let (surfaces, model) = ((&at.normals, &at.materials), model.parse()?);
    let found = py.detach(|| judge(given, noise, surfaces.0, surfaces.1, model, threads))?;
    Ok((
        out(py, found.odds, [pixels, count]),
        out(py, found.likelihoods, [pixels]),
        out(
            py,
            found.weights.into_flattened().into_flattened(),
            [pixels, count, 2, 3],
        ),
    ))
}

/// What pictures show of pixels, and the lights.
struct Samples {
    of_pictures: [Vec<f64>; 2],
    limits: Option<Vec<u8>>,
    directions: Vec<DVec3>,
    intensities: Vec<f64>,
    picture_of: Vec<usize>,
    ambient: Vec<f64>,
}

impl Samples {
    /// From pictures and weights, and directions, intensities, `picture_of` and ambient light.
    fn new(
        pixels: &Pixels,
        [pictures, weights]: [&Bound<'_, PyAny>; 2],
        limits: Option<&Bound<'_, PyAny>>,
        [directions, intensities, picture_of, ambient]: [&Bound<'_, PyAny>; 4],
    ) -> PyResult<Self> {
        let pixels = pixels.count();
        let (ambient, [count, _]) = given::<f64, 2>("ambient", ambient, [ANY, 3])?;
        let samples = [pixels, count, 3];
        let pictures = values::<f64, 3>("pictures", pictures, samples)?;
        let weights = values::<f64, 3>("weights", weights, samples)?;
        let limits = optional::<u8, 3>("limits", limits, samples)?;
        let (lamps, directions) = lamp_vectors("directions", directions, pixels)?;
        let intensities = values::<f64, 3>("intensities", intensities, [pixels, lamps, 3])?;
        let picture_of = indices("picture_of", picture_of)?;
        shape("picture_of", &[lamps], &[picture_of.len()])?;
        Ok(Self {
            of_pictures: [pictures, weights],
            limits,
            directions,
            intensities,
            picture_of,
            ambient,
        })
    }

    fn pictures<'a>(
        &'a self,
        pixels: &'a Pixels,
        base_normals: &'a [DVec3],
        [prior_mean, prior_precision]: [&'a [[f64; NUMBERS]]; 2],
    ) -> LampPictures<'a> {
        LampPictures {
            pictures: self.of_pictures[0].as_chunks().0,
            weights: self.of_pictures[1].as_chunks().0,
            limits: self.limits.as_ref().map(|limits| limits.as_chunks().0),
            views: &pixels.views,
            directions: &self.directions,
            intensities: self.intensities.as_chunks().0,
            picture_of: &self.picture_of,
            ambient: self.ambient.as_chunks().0,
            base_normals,
            prior_mean,
            prior_precision,
        }
    }
}

/// A vector for each lamp of each pixel, and how many lamps there are.
fn lamp_vectors(
    name: &'static str,
    argument: &Bound<'_, PyAny>,
    pixels: usize,
) -> PyResult<(usize, Vec<DVec3>)> {
    let (values, [_, lamps, _]) = given::<f64, 3>(name, argument, [pixels, ANY, 3])?;
    let count = check::samples(name, "lamps", lamps, pixels)?;
    Ok((lamps, vectors_of(name, count, &values)?))
}
