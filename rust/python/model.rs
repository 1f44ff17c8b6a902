//! `pbrfit._core`: the forward model on flat arrays.

use numpy::ndarray::{Array1, Array2, Array3};
use numpy::{
    IntoPyArray, PyArray1, PyArray2, PyArray3, PyReadonlyArray1, PyReadonlyArray2, PyReadonlyArray3,
};
use pyo3::prelude::*;

use super::arrays::{copied, materials, shape, vectors};
use crate::render::render as render_pixels;
use crate::shade::{Frame, Weights, shade as shade_pixel, shade_vjp as pull_back_pixel};
use crate::{Result, check, ggx, sh};

pub(super) fn register(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add_function(wrap_pyfunction!(sh_basis, module)?)?;
    module.add_function(wrap_pyfunction!(ggx_band_weights, module)?)?;
    module.add_function(wrap_pyfunction!(shade, module)?)?;
    module.add_function(wrap_pyfunction!(shade_vjp, module)?)?;
    module.add_function(wrap_pyfunction!(render, module)?)
}

#[pyfunction]
fn sh_basis<'py>(
    py: Python<'py>,
    directions: PyReadonlyArray2<'py, f64>,
) -> PyResult<Bound<'py, PyArray2<f64>>> {
    let directions = vectors("directions", &directions)?;
    let basis = py.detach(|| {
        check::unit_vectors("directions", &directions)?;
        Ok::<_, crate::Error>(directions.iter().flat_map(|&d| sh::basis(d)).collect())
    })?;
    Ok(array2(basis, sh::COEFFICIENTS).into_pyarray(py))
}

#[pyfunction]
#[expect(clippy::type_complexity)]
fn ggx_band_weights<'py>(
    py: Python<'py>,
    roughness: PyReadonlyArray1<'py, f64>,
) -> PyResult<(Bound<'py, PyArray2<f64>>, Bound<'py, PyArray2<f64>>)> {
    let roughness = copied(&roughness);
    let bands = py.detach(|| {
        check::unit_interval("r", &roughness)?;
        Ok::<_, crate::Error>(roughness.iter().map(|&r| ggx::bands(r)).collect::<Vec<_>>())
    })?;
    let flat = |of: fn(&ggx::Bands) -> [f64; 4]| array2(bands.iter().flat_map(of).collect(), 4);
    Ok((
        flat(|b| b.weight).into_pyarray(py),
        flat(|b| b.slope).into_pyarray(py),
    ))
}

#[pyfunction]
fn shade<'py>(
    py: Python<'py>,
    normal: PyReadonlyArray2<'py, f64>,
    view: PyReadonlyArray2<'py, f64>,
    albedo: PyReadonlyArray2<'py, f64>,
    roughness: PyReadonlyArray1<'py, f64>,
    metallic: PyReadonlyArray1<'py, f64>,
) -> PyResult<Bound<'py, PyArray3<f64>>> {
    let materials = materials(&albedo, &roughness, &metallic)?;
    let frames = frames(&normal, &view, materials.len())?;
    let weights = py.detach(|| {
        let weights = frames
            .iter()
            .zip(&materials)
            .map(|(f, m)| shade_pixel(f, m));
        weights.collect::<Vec<Weights>>()
    });
    let flat = weights.into_iter().flatten().flatten().collect();
    Ok(array3(flat, [materials.len(), 3, sh::COEFFICIENTS]).into_pyarray(py))
}

#[pyfunction]
#[expect(clippy::type_complexity)]
fn shade_vjp<'py>(
    py: Python<'py>,
    normal: PyReadonlyArray2<'py, f64>,
    view: PyReadonlyArray2<'py, f64>,
    albedo: PyReadonlyArray2<'py, f64>,
    roughness: PyReadonlyArray1<'py, f64>,
    metallic: PyReadonlyArray1<'py, f64>,
    cotangent: PyReadonlyArray3<'py, f64>,
) -> PyResult<(
    Bound<'py, PyArray2<f64>>,
    Bound<'py, PyArray1<f64>>,
    Bound<'py, PyArray1<f64>>,
)> {
    let materials = materials(&albedo, &roughness, &metallic)?;
    let frames = frames(&normal, &view, materials.len())?;
    let expected = [materials.len(), 3, sh::COEFFICIENTS];
    shape("cotangent", &expected, cotangent.as_array().shape())?;
    let cotangent = copied(&cotangent);
    let gradients = py.detach(|| {
        check::finite("cotangent", &cotangent)?;
        let weights = cotangent
            .as_chunks::<{ sh::COEFFICIENTS }>()
            .0
            .as_chunks::<3>()
            .0;
        let pixels = frames.iter().zip(&materials).zip(weights);
        Ok::<_, crate::Error>(
            pixels
                .map(|((f, m), w)| pull_back_pixel(f, m, w))
                .collect::<Vec<_>>(),
        )
    })?;
    let albedo = array2(gradients.iter().flat_map(|g| g.albedo).collect(), 3);
    let roughness: Array1<f64> = gradients.iter().map(|g| g.roughness).collect();
    let metallic: Array1<f64> = gradients.iter().map(|g| g.metallic).collect();
    Ok((
        albedo.into_pyarray(py),
        roughness.into_pyarray(py),
        metallic.into_pyarray(py),
    ))
}

#[pyfunction]
#[expect(clippy::too_many_arguments)]
fn render<'py>(
    py: Python<'py>,
    normals: PyReadonlyArray2<'py, f64>,
    views: PyReadonlyArray2<'py, f64>,
    albedo: PyReadonlyArray2<'py, f64>,
    roughness: PyReadonlyArray1<'py, f64>,
    metallic: PyReadonlyArray1<'py, f64>,
    lighting: PyReadonlyArray3<'py, f64>,
    threads: usize,
) -> PyResult<Bound<'py, PyArray3<f64>>> {
    let materials = materials(&albedo, &roughness, &metallic)?;
    let (normals, views) = (vectors("normals", &normals)?, vectors("views", &views)?);
    let lights = lighting.as_array().shape()[0];
    shape(
        "lighting",
        &[lights, sh::COEFFICIENTS, 3],
        lighting.as_array().shape(),
    )?;
    let lighting = copied(&lighting);
    let images = py.detach(|| render_pixels(&normals, &views, &materials, &lighting, threads))?;
    Ok(array3(images, [lights, materials.len(), 3]).into_pyarray(py))
}

fn frames(
    normal: &PyReadonlyArray2<'_, f64>,
    view: &PyReadonlyArray2<'_, f64>,
    pixels: usize,
) -> Result<Vec<Frame>> {
    let (normal, view) = (vectors("normal", normal)?, vectors("view", view)?);
    shape("normal", &[pixels, 3], &[normal.len(), 3])?;
    shape("view", &[pixels, 3], &[view.len(), 3])?;
    check::unit_vectors("normal", &normal)?;
    check::unit_vectors("view", &view)?;
    Ok(normal
        .into_iter()
        .zip(view)
        .map(|(n, v)| Frame::new(n, v))
        .collect())
}

fn array2(values: Vec<f64>, columns: usize) -> Array2<f64> {
    let rows = values.len() / columns;
    Array2::from_shape_vec((rows, columns), values).expect("whole rows")
}

pub(super) fn array3<T>(values: Vec<T>, shape: [usize; 3]) -> Array3<T> {
    Array3::from_shape_vec(shape, values).expect("the shape's own number of values")
}
