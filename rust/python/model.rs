//! `pbrfit._core`: the forward model on flat arrays.

use pyo3::prelude::*;
use pyo3::types::PyBytes;

use super::arrays::{ANY, Out, Pixels, given, out, rows, values, vectors};
use super::surroundings::given as given_transfer;
use crate::problem::render::render as render_pixels;
use crate::reflectance::lobe_table;
use crate::reflectance::model::{Model, with_model};
use crate::reflectance::reflection::Reflection;
use crate::reflectance::shade::{Frame, shade as shade_pixel, shade_vjp as pull_back_pixel};
use crate::reflectance::{ggx, sh};
use crate::runtime::check;
use crate::runtime::memory::collect;

#[pyfunction]
pub(super) fn sh_basis<'py>(
    py: Python<'py>,
    directions: &Bound<'py, PyAny>,
) -> PyResult<Out<'py, 2>> {
    let directions = vectors("directions", directions, ANY)?;
    let basis = py.detach(|| {
        check::unit_vectors("directions", &directions)?;
        let basis = directions.iter().map(|&d| sh::basis(d.to_array()));
        collect("directions", directions.len(), basis)
    })?;
    rows(py, "directions", basis.into_iter())
}

#[pyfunction]
pub(super) fn ggx_band_weights<'py>(
    py: Python<'py>,
    r: &Bound<'py, PyAny>,
) -> PyResult<(Out<'py, 2>, Out<'py, 2>)> {
    let r = values::<f64, 1>("r", r, [ANY])?;
    let bands = py.detach(|| {
        check::unit_interval("r", &r)?;
        collect("r", r.len(), r.iter().map(|&r| ggx::bands(r)))
    })?;
    let weights = rows(py, "r", bands.iter().map(|b| b.weight))?;
    Ok((weights, rows(py, "r", bands.iter().map(|b| b.slope))?))
}

#[pyfunction]
pub(super) fn lobe_functions<'py>(
    py: Python<'py>,
    r: &Bound<'py, PyAny>,
    cosine: &Bound<'py, PyAny>,
) -> PyResult<(Out<'py, 2>, Out<'py, 2>, Out<'py, 2>)> {
    let (r, shape) = given::<f64, 1>("r", r, [ANY])?;
    let cosine = values::<f64, 1>("cosine", cosine, shape)?;
    let found = py.detach(|| {
        check::unit_interval("r", &r)?;
        check::unit_interval("cosine", &cosine)?;
        let places = r.iter().zip(&cosine);
        let found = places.map(|(&r, &cosine)| lobe_table::values(r, cosine));
        collect("r", r.len(), found)
    })?;
    let column = |i: usize| rows(py, "r", found.iter().map(|row| row[i]));
    Ok((column(0)?, column(1)?, column(2)?))
}

#[pyfunction]
#[pyo3(name = "lobe_table")]
pub(super) fn lobe_table_file(py: Python<'_>) -> Bound<'_, PyBytes> {
    PyBytes::new(py, lobe_table::FILE)
}

/// Pixels whose directions are of unit length.
fn unit_pixels(given: [&Bound<'_, PyAny>; 5]) -> PyResult<Pixels> {
    let pixels = Pixels::new(["normal", "view"], given)?;
    check::unit_vectors("normal", &pixels.normals)?;
    check::unit_vectors("view", &pixels.views)?;
    Ok(pixels)
}

#[pyfunction]
#[pyo3(signature = (normal, view, albedo, roughness, metallic, model = "paper"))]
pub(super) fn shade<'py>(
    py: Python<'py>,
    normal: &Bound<'py, PyAny>,
    view: &Bound<'py, PyAny>,
    albedo: &Bound<'py, PyAny>,
    roughness: &Bound<'py, PyAny>,
    metallic: &Bound<'py, PyAny>,
    model: &str,
) -> PyResult<Out<'py, 3>> {
    let model: Model = model.parse()?;
    let pixels = unit_pixels([normal, view, albedo, roughness, metallic])?;
    let weights = py.detach(|| {
        let each = pixels
            .normals
            .iter()
            .zip(&pixels.views)
            .zip(&pixels.materials);
        with_model!(model, M => {
            let weights = each.map(|((&n, &v), m)| shade_pixel(&Frame::<M>::new(n, v), m));
            collect("normal", pixels.count(), weights)
        })
    })?;
    let weights = weights.into_flattened().into_flattened();
    Ok(out(py, weights, [pixels.count(), 3, sh::COEFFICIENTS]))
}

#[pyfunction]
#[pyo3(signature = (normal, view, albedo, roughness, metallic, cotangent, model = "paper"))]
#[expect(clippy::too_many_arguments)]
pub(super) fn shade_vjp<'py>(
    py: Python<'py>,
    normal: &Bound<'py, PyAny>,
    view: &Bound<'py, PyAny>,
    albedo: &Bound<'py, PyAny>,
    roughness: &Bound<'py, PyAny>,
    metallic: &Bound<'py, PyAny>,
    cotangent: &Bound<'py, PyAny>,
    model: &str,
) -> PyResult<(Out<'py, 2>, Out<'py, 1>, Out<'py, 1>, Out<'py, 2>)> {
    let model: Model = model.parse()?;
    let pixels = unit_pixels([normal, view, albedo, roughness, metallic])?;
    let shape = [pixels.count(), 3, sh::COEFFICIENTS];
    let cotangent = values::<f64, 3>("cotangent", cotangent, shape)?;
    let gradients = py.detach(|| {
        check::moderate("cotangent", &cotangent, check::LARGEST_F64)?;
        let weights = cotangent.as_chunks::<{ sh::COEFFICIENTS }>().0;
        let weights = weights.as_chunks::<3>().0;
        let directions = pixels.normals.iter().zip(&pixels.views);
        let each = directions.zip(&pixels.materials).zip(weights);
        with_model!(model, M => {
            let gradients = each.map(|(((&n, &v), m), w)| pull_back_pixel::<M, 3>(n, v, m, w));
            collect("normal", pixels.count(), gradients)
        })
    })?;
    let of_materials = || gradients.iter().map(|(material, _)| material);
    let count = [pixels.count()];
    Ok((
        rows(py, "albedo", of_materials().map(|m| m.albedo))?,
        out(py, of_materials().map(|m| m.roughness).collect(), count),
        out(py, of_materials().map(|m| m.metallic).collect(), count),
        rows(
            py,
            "normal",
            gradients.iter().map(|(_, normal)| normal.to_array()),
        )?,
    ))
}

#[pyfunction]
#[pyo3(signature = (normals, views, albedo, roughness, metallic, lighting, threads, model = "paper", transfer = None, bounced = None))]
#[expect(clippy::too_many_arguments)]
pub(super) fn render<'py>(
    py: Python<'py>,
    normals: &Bound<'py, PyAny>,
    views: &Bound<'py, PyAny>,
    albedo: &Bound<'py, PyAny>,
    roughness: &Bound<'py, PyAny>,
    metallic: &Bound<'py, PyAny>,
    lighting: &Bound<'py, PyAny>,
    threads: usize,
    model: &str,
    transfer: Option<&Bound<'py, PyAny>>,
    bounced: Option<&Bound<'py, PyAny>>,
) -> PyResult<Out<'py, 3>> {
    let model: Model = model.parse()?;
    let given_pixels = [normals, views, albedo, roughness, metallic];
    let pixels = Pixels::new(["normals", "views"], given_pixels)?;
    let expected = [ANY, sh::COEFFICIENTS, 3];
    let (lighting, [lights, ..]) = given::<f64, 3>("lighting", lighting, expected)?;
    check::samples("lighting", "lights", lights, pixels.count())?;
    let rows = with_model!(model, M => 1 + M::ROWS);
    let transfer = given_transfer(transfer, bounced, [pixels.count(), rows, lights * 3])?;
    let surface = (model, transfer.as_ref());
    let (normals, views) = (&pixels.normals, &pixels.views);
    let materials = &pixels.materials;
    let images =
        py.detach(|| render_pixels(normals, views, materials, &lighting, surface, threads))?;
    Ok(out(py, images, [lights, pixels.count(), 3]))
}
