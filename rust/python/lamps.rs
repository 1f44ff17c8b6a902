//! `pbrfit._core`: light of lamps on flat arrays.

use glam::DVec3;
use pyo3::prelude::*;

use super::arrays::{
    ANY, Out, Pixels, given, indices, materials, optional, out, rows, shape, values, vectors,
    vectors_of,
};
use crate::lamps::descent::Free;
use crate::lamps::judge::{LampNoise, judge};
use crate::lamps::pixel_fit::{LampFit, LampPictures, NUMBERS, fit_under_lamps};
use crate::lamps::render::{Lamplit, lamp_radiance as radiance_of_pixels};
use crate::lamps::system::{Movable, OF_PIXEL, ROWS, lamp_system};
use crate::reflectance::planes::Material;
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

/// What pictures show of pixels, and the lights.
#[pyclass(name = "LampSamples", module = "pbrfit._core", frozen)]
pub(super) struct PyLampSamples(LampPictures);

/// Normals, albedo, roughness and metallic.
type Surfaces<'py> = [Bound<'py, PyAny>; 4];

#[pymethods]
impl PyLampSamples {
    #[new]
    #[pyo3(signature = (pictures, limits, views, directions, intensities, picture_of, ambient, threads, model = "paper"))]
    #[expect(clippy::too_many_arguments)]
    fn new(
        pictures: &Bound<'_, PyAny>,
        limits: Option<&Bound<'_, PyAny>>,
        views: &Bound<'_, PyAny>,
        directions: &Bound<'_, PyAny>,
        intensities: &Bound<'_, PyAny>,
        picture_of: &Bound<'_, PyAny>,
        ambient: &Bound<'_, PyAny>,
        threads: usize,
        model: &str,
    ) -> PyResult<Self> {
        let views = vectors("views", views, ANY)?;
        let (ambient, [count, _]) = given::<f64, 2>("ambient", ambient, [ANY, 3])?;
        let samples = [views.len(), count, 3];
        let picture_of = indices("picture_of", picture_of)?;
        let (lamps, directions) = lamp_vectors("directions", directions, ANY)?;
        shape("picture_of", &[lamps], &[picture_of.len()])?;
        let alike = directions.len() == lamps;
        let rows = if alike { 1 } else { views.len() };
        check::length("directions", rows * lamps, directions.len())?;
        let limits = optional::<u8, 3>("limits", limits, samples)?;
        Ok(Self(LampPictures {
            pictures: triples("pictures", pictures, samples)?,
            limits: limits.map(|limits| limits.as_chunks().0.to_vec()),
            views,
            directions,
            intensities: triples("intensities", intensities, [rows, lamps, 3])?,
            picture_of,
            ambient: ambient.as_chunks().0.to_vec(),
            model: model.parse()?,
            threads,
        }))
    }

    #[expect(clippy::too_many_arguments)]
    fn fit<'py>(
        &self,
        py: Python<'py>,
        weights: &Bound<'py, PyAny>,
        base_normals: &Bound<'py, PyAny>,
        start: Surfaces<'py>,
        prior: [Bound<'py, PyAny>; 2],
        free: [bool; 3],
        iterations: usize,
    ) -> PyResult<(
        Out<'py, 2>,
        Out<'py, 2>,
        Out<'py, 1>,
        Out<'py, 1>,
        Out<'py, 1>,
    )> {
        let weights = self.weights(weights)?;
        let start = self.surfaces("start_normals", &start)?;
        let pixels = self.0.views.len();
        let base_normals = vectors("base_normals", base_normals, pixels)?;
        let mean = values::<f64, 2>("prior_mean", &prior[0], [pixels, NUMBERS])?;
        let precision = values::<f64, 2>("prior_precision", &prior[1], [pixels, NUMBERS])?;
        let how = LampFit {
            base_normals: &base_normals,
            prior_mean: mean.as_chunks().0,
            prior_precision: precision.as_chunks().0,
            free: Free {
                normals: free[0],
                metallic: free[1],
                roughness: free[2],
            },
            iterations,
        };
        let fitted =
            py.detach(|| fit_under_lamps(&self.0, weights.as_chunks().0, &start.0, &start.1, how))?;
        let of_fitted = || fitted.materials.iter();
        let normals = fitted.normals.iter().map(DVec3::to_array);
        Ok((
            rows(py, "start_normals", normals)?,
            rows(py, "albedo", of_fitted().map(|m| m.albedo))?,
            out(py, of_fitted().map(|m| m.roughness).collect(), [pixels]),
            out(py, of_fitted().map(|m| m.metallic).collect(), [pixels]),
            out(py, fitted.costs, [pixels]),
        ))
    }

    #[pyo3(signature = (weights, surfaces, strengths, by_place, of_lights = true))]
    fn system<'py>(
        &self,
        py: Python<'py>,
        weights: &Bound<'py, PyAny>,
        surfaces: Surfaces<'py>,
        strengths: &Bound<'py, PyAny>,
        by_place: &Bound<'py, PyAny>,
        of_lights: bool,
    ) -> PyResult<(Out<'py, 3>, Out<'py, 3>, Option<Out<'py, 2>>)> {
        let weights = self.weights(weights)?;
        let at = self.surfaces("normals", &surfaces)?;
        let (pixels, lamps) = (self.0.views.len(), self.0.picture_of.len());
        let rows = self.0.directions.len().checked_div(lamps).unwrap_or(0);
        let strengths = values::<f64, 2>("strengths", strengths, [rows, lamps])?;
        let by_place = values::<f64, 3>("by_place", by_place, [rows, lamps, 4])?;
        let movable = Movable {
            strengths: &strengths,
            by_place: by_place.as_chunks().0,
            of_lights,
        };
        let found =
            py.detach(|| lamp_system(&self.0, weights.as_chunks().0, movable, &at.0, &at.1))?;
        let columns = 6 * lamps + 3 * self.0.ambient.len();
        let own = found.own.into_flattened().into_flattened();
        Ok((
            out(py, own, [pixels, ROWS, OF_PIXEL]),
            out(py, found.mixed, [pixels, ROWS, columns]),
            of_lights.then(|| out(py, found.shared, [columns, columns])),
        ))
    }

    fn judge<'py>(
        &self,
        py: Python<'py>,
        weights: &Bound<'py, PyAny>,
        surfaces: Surfaces<'py>,
        noise: (f64, f64, bool, f64),
        shadows: &Bound<'py, PyAny>,
    ) -> PyResult<(Out<'py, 2>, Out<'py, 1>, Out<'py, 4>)> {
        let weights = self.weights(weights)?;
        let at = self.surfaces("normals", &surfaces)?;
        let (pixels, count) = (self.0.views.len(), self.0.ambient.len());
        let shadows = values::<f64, 1>("shadows", shadows, [count])?;
        let noise = LampNoise {
            floor: noise.0,
            growth: noise.1,
            proportional: noise.2,
            least: noise.3,
            shadows: &shadows,
        };
        let found = py.detach(|| judge(&self.0, weights.as_chunks().0, noise, &at.0, &at.1))?;
        let weights = found.weights.into_flattened().into_flattened();
        Ok((
            out(py, found.odds, [pixels, count]),
            out(py, found.likelihoods, [pixels]),
            out(py, weights, [pixels, count, 2, 3]),
        ))
    }
}

impl PyLampSamples {
    /// Normals, called `name`, and materials.
    fn surfaces(
        &self,
        name: &'static str,
        [normals, albedo, roughness, metallic]: &Surfaces,
    ) -> PyResult<(Vec<DVec3>, Vec<Material>)> {
        let materials = materials([albedo, roughness, metallic], self.0.views.len())?;
        Ok((vectors(name, normals, materials.len())?, materials))
    }

    fn weights(&self, weights: &Bound<'_, PyAny>) -> PyResult<Vec<f64>> {
        let samples = [self.0.views.len(), self.0.ambient.len(), 3];
        values("weights", weights, samples)
    }
}

fn triples(
    name: &'static str,
    argument: &Bound<'_, PyAny>,
    expected: [usize; 3],
) -> PyResult<Vec<[f64; 3]>> {
    let values = values::<f64, 3>(name, argument, expected)?;
    Ok(values.as_chunks().0.to_vec())
}

/// A vector for each lamp of each pixel, and how many lamps there are.
fn lamp_vectors(
    name: &'static str,
    argument: &Bound<'_, PyAny>,
    pixels: usize,
) -> PyResult<(usize, Vec<DVec3>)> {
    let (values, [pixels, lamps, _]) = given::<f64, 3>(name, argument, [pixels, ANY, 3])?;
    let count = check::samples(name, "lamps", lamps, pixels)?;
    Ok((lamps, vectors_of(name, count, &values)?))
}
