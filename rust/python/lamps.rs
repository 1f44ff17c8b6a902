//! `pbrfit._core`: light of lamps on flat arrays.

use glam::DVec3;
use numpy::ndarray::{Array3, Array4};
use numpy::{IntoPyArray, Ix2, Ix3, PyArray3, PyArray4, PyReadonlyArray, PyUntypedArrayMethods};
use pyo3::prelude::*;

use super::arrays::{array, collect, shape, try_copied, vectors};
use super::model::{Pixels, array3, not_too_many};
use crate::lamps::render::{
    DirectionalLight, Lamplit, lamp_radiance as radiance_of_pixels,
    lamp_slopes as slopes_of_pixels, render_directional as render_directional_pixels,
};

pub(super) fn register(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add_function(wrap_pyfunction!(render_directional, module)?)?;
    module.add_function(wrap_pyfunction!(lamp_radiance, module)?)?;
    module.add_function(wrap_pyfunction!(lamp_slopes, module)?)
}

#[pyfunction]
#[pyo3(signature = (normals, views, albedo, roughness, metallic, directions, colors, threads, model = "paper"))]
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
    let lights = directions.iter().zip(colors.as_chunks::<3>().0);
    let lights: Vec<DirectionalLight> = lights
        .map(|(&direction, &color)| DirectionalLight { direction, color })
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

#[pyfunction]
#[pyo3(signature = (normals, views, albedo, roughness, metallic, directions, threads, model = "paper"))]
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
    let lamplit = Lamplit {
        normals: &pixels.normals,
        views: &pixels.views,
        materials: &pixels.materials,
        directions: &directions,
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
