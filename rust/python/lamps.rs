//! `pbrfit._core`: light of lamps on flat arrays.

use glam::DVec3;
use numpy::ndarray::{Array1, Array3, Array4};
use numpy::{
    Element, IntoPyArray, Ix1, Ix2, Ix3, PyArray1, PyArray2, PyArray3, PyArray4, PyReadonlyArray,
    PyUntypedArrayMethods,
};
use pyo3::prelude::*;

use super::arrays::{array, collect, shape, try_copied, vectors};
use super::model::{Pixels, array2, array3, not_too_many};
use crate::lamps::descent::Free;
use crate::lamps::pixel_fit::{LampFit, LampPictures, NUMBERS, fit_under_lamps as fit_pixels};
use crate::lamps::render::{
    DirectionalLight, Lamplit, lamp_radiance as radiance_of_pixels,
    lamp_slopes as slopes_of_pixels, render_directional as render_directional_pixels,
};
use crate::reflectance::sh::COEFFICIENTS;

pub(super) fn register(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add_function(wrap_pyfunction!(render_directional, module)?)?;
    module.add_function(wrap_pyfunction!(lamp_radiance, module)?)?;
    module.add_function(wrap_pyfunction!(lamp_slopes, module)?)?;
    module.add_function(wrap_pyfunction!(fit_under_lamps, module)?)
}

#[pyfunction]
#[pyo3(signature = (normals, views, albedo, roughness, metallic, directions, colors, threads, model = "paper", extents = None))]
#[expect(clippy::too_many_arguments)]
fn render_directional<'py>(
    py: Python<'py>,
    normals: &Bound<'py, PyAny>,
    views: &Bound<'py, PyAny>,
    albedo: &Bound<'py, PyAny>,
    roughness: &Bound<'py, PyAny>,
    metallic: &Bound<'py, PyAny>,
    directions: &Bound<'py, PyAny>,
    colors: &Bound<'py, PyAny>,
    threads: usize,
    model: &str,
    extents: Option<&Bound<'py, PyAny>>,
) -> PyResult<Bound<'py, PyArray3<f64>>> {
    let model = model.parse()?;
    let pixels = Pixels::new(
        ("normals", normals),
        ("views", views),
        albedo,
        roughness,
        metallic,
    )?;
    let directions = array("directions", directions)?;
    let directions = vectors("directions", &directions)?.into_owned();
    let colors = array::<f64, Ix2>("colors", colors)?;
    shape("colors", &[directions.len(), 3], colors.shape())?;
    not_too_many("directions", directions.len(), pixels.count())?;
    let colors = try_copied("colors", &colors)?;
    let extents = given_extents(extents, directions.len())?;
    let lights: Vec<DirectionalLight> = (directions.iter().zip(colors.as_chunks::<3>().0))
        .enumerate()
        .map(|(i, (&direction, &color))| DirectionalLight {
            direction,
            color,
            extent: extents.get(i).copied().unwrap_or(0.0),
        })
        .collect();
    let Pixels {
        normals,
        views,
        materials,
        ..
    } = &pixels;
    let images = py
        .detach(|| render_directional_pixels(normals, views, materials, &lights, threads, model))?;
    Ok(array3(images, [lights.len(), pixels.count(), 3]).into_pyarray(py))
}

/// Angular radii of lamps; none are points.
fn given_extents(extents: Option<&Bound<'_, PyAny>>, count: usize) -> PyResult<Vec<f64>> {
    let Some(extents) = extents else {
        return Ok(Vec::new());
    };
    let extents = array::<f64, Ix1>("extents", extents)?;
    shape("extents", &[count], extents.shape())?;
    Ok(try_copied("extents", &extents)?)
}

#[pyfunction]
#[pyo3(signature = (normals, views, albedo, roughness, metallic, directions, threads, model = "paper", extents = None))]
#[expect(clippy::too_many_arguments)]
fn lamp_radiance<'py>(
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
) -> PyResult<Bound<'py, PyArray3<f64>>> {
    let model = model.parse()?;
    let pixels = Pixels::new(
        ("normals", normals),
        ("views", views),
        albedo,
        roughness,
        metallic,
    )?;
    let (lamps, directions) = lamp_vectors("directions", directions, pixels.count())?;
    let extents = given_extents(extents, directions.len())?;
    let lamplit = Lamplit {
        normals: &pixels.normals,
        views: &pixels.views,
        materials: &pixels.materials,
        directions: &directions,
        extents: &extents,
        model,
    };
    let radiance = py.detach(|| radiance_of_pixels(lamplit, threads))?;
    Ok(array3(radiance, [pixels.count(), lamps, 3]).into_pyarray(py))
}

#[pyfunction]
#[pyo3(signature = (normals, views, albedo, roughness, metallic, directions, threads, model = "paper"))]
#[expect(clippy::too_many_arguments, clippy::type_complexity)]
fn lamp_slopes<'py>(
    py: Python<'py>,
    normals: &Bound<'py, PyAny>,
    views: &Bound<'py, PyAny>,
    albedo: &Bound<'py, PyAny>,
    roughness: &Bound<'py, PyAny>,
    metallic: &Bound<'py, PyAny>,
    directions: &Bound<'py, PyAny>,
    threads: usize,
    model: &str,
) -> PyResult<(
    Bound<'py, PyArray3<f64>>,
    Bound<'py, PyArray4<f64>>,
    Bound<'py, PyArray4<f64>>,
    Bound<'py, PyArray3<f64>>,
    Bound<'py, PyArray3<f64>>,
    Bound<'py, PyArray3<f64>>,
)> {
    let model = model.parse()?;
    let pixels = Pixels::new(
        ("normals", normals),
        ("views", views),
        albedo,
        roughness,
        metallic,
    )?;
    let (lamps, directions) = lamp_vectors("directions", directions, pixels.count())?;
    let lamplit = Lamplit {
        normals: &pixels.normals,
        views: &pixels.views,
        materials: &pixels.materials,
        directions: &directions,
        extents: &[],
        model,
    };
    let slopes = py.detach(|| slopes_of_pixels(lamplit, threads))?;
    let scalars = |values: Vec<f64>| -> Array3<f64> { array3(values, [pixels.count(), lamps, 3]) };
    let vectors = |values: Vec<f64>| -> Array4<f64> {
        let shape = [pixels.count(), lamps, 3, 3];
        Array4::from_shape_vec(shape, values).expect("the shape's own number of values")
    };
    Ok((
        scalars(slopes.radiance).into_pyarray(py),
        vectors(slopes.by_normal).into_pyarray(py),
        vectors(slopes.by_direction).into_pyarray(py),
        scalars(slopes.by_albedo).into_pyarray(py),
        scalars(slopes.by_roughness).into_pyarray(py),
        scalars(slopes.by_metallic).into_pyarray(py),
    ))
}

/// Normals, albedo, roughness, metallic, cost and information of pixels.
type Fitted<'py> = (
    Bound<'py, PyArray2<f64>>,
    Bound<'py, PyArray2<f64>>,
    Bound<'py, PyArray1<f64>>,
    Bound<'py, PyArray1<f64>>,
    Bound<'py, PyArray1<f64>>,
    Bound<'py, PyArray3<f64>>,
);

#[pyfunction]
#[pyo3(signature = (
    pictures, weights, limits, views, directions, intensities, picture_of, ambient, base_normals,
    start_normals, albedo, roughness, metallic, prior_mean, prior_precision, free_normals,
    free_metallic, free_roughness, iterations, threads, model = "paper"
))]
#[expect(clippy::too_many_arguments)]
fn fit_under_lamps<'py>(
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
) -> PyResult<Fitted<'py>> {
    let model = model.parse()?;
    let start = Pixels::new(
        ("start_normals", start_normals),
        ("views", views),
        albedo,
        roughness,
        metallic,
    )?;
    let pixels = start.count();
    let ambient: PyReadonlyArray<'_, f64, Ix3> = array("ambient", ambient)?;
    let count = ambient.shape()[0];
    shape("ambient", &[count, COEFFICIENTS, 3], ambient.shape())?;
    let ambient = try_copied("ambient", &ambient)?;
    let pictures = Table::<f64>::of("pictures", pictures, [pixels, count, 3])?;
    let weights = Table::<f64>::of("weights", weights, [pixels, count, 3])?;
    let limits = limits
        .map(|limits| Table::<u8>::of("limits", limits, [pixels, count, 3]))
        .transpose()?;
    let (lamps, directions) = lamp_vectors("directions", directions, pixels)?;
    let intensities = Table::<f64>::of("intensities", intensities, [pixels, lamps, 3])?;
    let picture_of = array::<u64, Ix1>("picture_of", picture_of)?;
    shape("picture_of", &[lamps], picture_of.shape())?;
    let picture_of = try_copied("picture_of", &picture_of)?;
    let picture_of: Vec<usize> = picture_of.into_iter().map(|i| i as usize).collect();
    let base_normals = array("base_normals", base_normals)?;
    shape("base_normals", &[pixels, 3], base_normals.shape())?;
    let base_normals = vectors("base_normals", &base_normals)?.into_owned();
    let of_pixels = |name, given| -> PyResult<Vec<f64>> {
        let given: PyReadonlyArray<'_, f64, Ix2> = array(name, given)?;
        shape(name, &[pixels, NUMBERS], given.shape())?;
        Ok(try_copied(name, &given)?)
    };
    let prior_mean = of_pixels("prior_mean", prior_mean)?;
    let prior_precision = of_pixels("prior_precision", prior_precision)?;
    let given = LampPictures {
        pictures: pictures.rows(),
        weights: weights.rows(),
        limits: limits.as_ref().map(Table::rows),
        views: &start.views,
        directions: &directions,
        intensities: intensities.rows(),
        picture_of: &picture_of,
        ambient: ambient.as_chunks::<3>().0.as_chunks().0,
        base_normals: &base_normals,
        prior_mean: prior_mean.as_chunks().0,
        prior_precision: prior_precision.as_chunks().0,
    };
    let how = LampFit {
        free: Free {
            normals: free_normals,
            metallic: free_metallic,
            roughness: free_roughness,
        },
        iterations,
        model,
        threads,
    };
    let fitted = py.detach(|| fit_pixels(given, &start.normals, &start.materials, how))?;
    let normals = fitted.normals.iter().map(DVec3::to_array);
    let albedo = fitted.materials.iter().map(|m| m.albedo);
    let roughness: Array1<f64> = fitted.materials.iter().map(|m| m.roughness).collect();
    let metallic: Array1<f64> = fitted.materials.iter().map(|m| m.metallic).collect();
    let information = fitted.information.into_flattened().into_flattened();
    Ok((
        array2(collect("start_normals", pixels, normals)?).into_pyarray(py),
        array2(collect("albedo", pixels, albedo)?).into_pyarray(py),
        roughness.into_pyarray(py),
        metallic.into_pyarray(py),
        fitted.costs.into_pyarray(py),
        array3(information, [pixels, NUMBERS, NUMBERS]).into_pyarray(py),
    ))
}

/// A copy of an array (pixel, picture or lamp, channel).
struct Table<T>(Vec<T>);

impl<T: Element + Copy> Table<T> {
    fn of(name: &'static str, given: &Bound<'_, PyAny>, expected: [usize; 3]) -> PyResult<Self> {
        let given: PyReadonlyArray<'_, T, Ix3> = array(name, given)?;
        shape(name, &expected, given.shape())?;
        Ok(Self(try_copied(name, &given)?))
    }

    fn rows(&self) -> &[[T; 3]] {
        self.0.as_chunks().0
    }
}

/// A vector for each lamp of each pixel, and how many lamps there are.
fn lamp_vectors(
    name: &'static str,
    given: &Bound<'_, PyAny>,
    pixels: usize,
) -> PyResult<(usize, Vec<DVec3>)> {
    let given: PyReadonlyArray<'_, f64, Ix3> = array(name, given)?;
    let lamps = given.shape()[1];
    shape(name, &[pixels, lamps, 3], given.shape())?;
    not_too_many(name, lamps, pixels)?;
    let values = try_copied(name, &given)?;
    let vectors = values.as_chunks().0.iter();
    let vectors = collect(name, pixels * lamps, vectors.map(|&v| DVec3::from_array(v)))?;
    Ok((lamps, vectors))
}
