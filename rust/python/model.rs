//! `pbrfit._core`: the forward model on flat arrays.

use glam::DVec3;
use numpy::ndarray::{Array1, Array2, Array3};
use numpy::{
    IntoPyArray, Ix1, Ix2, Ix3, PyArray1, PyArray2, PyArray3, PyReadonlyArray,
    PyUntypedArrayMethods,
};
use pyo3::prelude::*;
use pyo3::types::PyBytes;

use super::arrays::{array, collect, materials, shape, try_copied, vectors};
use super::surroundings::given as given_transfer;
use crate::problem::render::render as render_pixels;
use crate::reflectance::lobe_table;
use crate::reflectance::model::{Model, with_model};
use crate::reflectance::planes::Material;
use crate::reflectance::reflection::{Reflection, Weights};
use crate::reflectance::shade::{
    Frame, FrameWithSlopes, shade as shade_pixel, shade_vjp_by_normal as pull_back_pixel,
};
use crate::reflectance::{ggx, sh};
use crate::runtime::check::MAX_SAMPLES;
use crate::runtime::{Error, Result, check};

pub(super) fn register(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add_function(wrap_pyfunction!(sh_basis, module)?)?;
    module.add_function(wrap_pyfunction!(ggx_band_weights, module)?)?;
    module.add_function(wrap_pyfunction!(lobe_functions, module)?)?;
    module.add_function(wrap_pyfunction!(lobe_table_file, module)?)?;
    module.add_function(wrap_pyfunction!(shade, module)?)?;
    module.add_function(wrap_pyfunction!(shade_vjp, module)?)?;
    module.add_function(wrap_pyfunction!(render, module)?)
}

#[pyfunction]
fn sh_basis<'py>(
    py: Python<'py>,
    directions: &Bound<'py, PyAny>,
) -> PyResult<Bound<'py, PyArray2<f64>>> {
    let directions = array("directions", directions)?;
    let directions = vectors("directions", &directions)?.into_owned();
    let basis = py.detach(|| {
        check::unit_vectors("directions", &directions)?;
        let rows = directions.iter().map(|&d| sh::basis(d.to_array()));
        collect("directions", directions.len(), rows)
    })?;
    Ok(array2(basis).into_pyarray(py))
}

#[pyfunction]
#[expect(clippy::type_complexity)]
fn ggx_band_weights<'py>(
    py: Python<'py>,
    r: &Bound<'py, PyAny>,
) -> PyResult<(Bound<'py, PyArray2<f64>>, Bound<'py, PyArray2<f64>>)> {
    let r = array::<f64, Ix1>("r", r)?;
    let r = try_copied("r", &r)?;
    let (weights, slopes) = py.detach(|| {
        check::unit_interval("r", &r)?;
        let bands = collect("r", r.len(), r.iter().map(|&r| ggx::bands(r)))?;
        Ok::<_, Error>((
            collect("r", r.len(), bands.iter().map(|b| b.weight))?,
            collect("r", r.len(), bands.iter().map(|b| b.slope))?,
        ))
    })?;
    Ok((
        array2(weights).into_pyarray(py),
        array2(slopes).into_pyarray(py),
    ))
}

#[pyfunction]
#[expect(clippy::type_complexity)]
fn lobe_functions<'py>(
    py: Python<'py>,
    r: &Bound<'py, PyAny>,
    cosine: &Bound<'py, PyAny>,
) -> PyResult<(
    Bound<'py, PyArray2<f64>>,
    Bound<'py, PyArray2<f64>>,
    Bound<'py, PyArray2<f64>>,
)> {
    let r = array::<f64, Ix1>("r", r)?;
    let cosine = array::<f64, Ix1>("cosine", cosine)?;
    shape("cosine", r.shape(), cosine.shape())?;
    let (r, cosine) = (try_copied("r", &r)?, try_copied("cosine", &cosine)?);
    let rows = py.detach(|| {
        check::unit_interval("r", &r)?;
        check::unit_interval("cosine", &cosine)?;
        let rows = r.iter().zip(&cosine);
        collect(
            "r",
            r.len(),
            rows.map(|(&r, &cosine)| lobe_table::values(r, cosine)),
        )
    })?;
    let column = |i: usize| collect("r", rows.len(), rows.iter().map(|row| row[i]));
    Ok((
        array2(column(0)?).into_pyarray(py),
        array2(column(1)?).into_pyarray(py),
        array2(column(2)?).into_pyarray(py),
    ))
}

#[pyfunction]
#[pyo3(name = "lobe_table")]
fn lobe_table_file(py: Python<'_>) -> Bound<'_, PyBytes> {
    PyBytes::new(py, lobe_table::file())
}

#[pyfunction]
#[pyo3(signature = (normal, view, albedo, roughness, metallic, model = "paper"))]
fn shade<'py>(
    py: Python<'py>,
    normal: &Bound<'py, PyAny>,
    view: &Bound<'py, PyAny>,
    albedo: &Bound<'py, PyAny>,
    roughness: &Bound<'py, PyAny>,
    metallic: &Bound<'py, PyAny>,
    model: &str,
) -> PyResult<Bound<'py, PyArray3<f64>>> {
    let model: Model = model.parse()?;
    let pixels = Pixels::new(
        ("normal", normal),
        ("view", view),
        albedo,
        roughness,
        metallic,
    )?;
    let weights = py.detach(|| {
        pixels.check()?;
        with_model!(model, M => pixels.shade::<M>())
    })?;
    let shape = [pixels.count(), 3, sh::COEFFICIENTS];
    let weights = weights.into_flattened().into_flattened();
    Ok(array3(weights, shape).into_pyarray(py))
}

#[pyfunction]
#[pyo3(signature = (normal, view, albedo, roughness, metallic, cotangent, model = "paper"))]
#[expect(clippy::too_many_arguments, clippy::type_complexity)]
fn shade_vjp<'py>(
    py: Python<'py>,
    normal: &Bound<'py, PyAny>,
    view: &Bound<'py, PyAny>,
    albedo: &Bound<'py, PyAny>,
    roughness: &Bound<'py, PyAny>,
    metallic: &Bound<'py, PyAny>,
    cotangent: &Bound<'py, PyAny>,
    model: &str,
) -> PyResult<(
    Bound<'py, PyArray2<f64>>,
    Bound<'py, PyArray1<f64>>,
    Bound<'py, PyArray1<f64>>,
    Bound<'py, PyArray2<f64>>,
)> {
    let model: Model = model.parse()?;
    let pixels = Pixels::new(
        ("normal", normal),
        ("view", view),
        albedo,
        roughness,
        metallic,
    )?;
    let cotangent = array::<f64, Ix3>("cotangent", cotangent)?;
    let expected = [pixels.count(), 3, sh::COEFFICIENTS];
    shape("cotangent", &expected, cotangent.shape())?;
    let cotangent = try_copied("cotangent", &cotangent)?;
    let gradients = py.detach(|| {
        pixels.check()?;
        check::moderate("cotangent", &cotangent, check::LARGEST_F64)?;
        let weights = cotangent
            .as_chunks::<{ sh::COEFFICIENTS }>()
            .0
            .as_chunks::<3>()
            .0;
        with_model!(model, M => pixels.pull_back::<M>(weights))
    })?;
    let (materials, normals) = (
        || gradients.iter().map(|g| g.0),
        gradients.iter().map(|g| g.1),
    );
    let albedo = collect("albedo", pixels.count(), materials().map(|g| g.albedo))?;
    let roughness: Array1<f64> = materials().map(|g| g.roughness).collect();
    let metallic: Array1<f64> = materials().map(|g| g.metallic).collect();
    let normal = collect("normal", pixels.count(), normals.map(|g| g.to_array()))?;
    Ok((
        array2(albedo).into_pyarray(py),
        roughness.into_pyarray(py),
        metallic.into_pyarray(py),
        array2(normal).into_pyarray(py),
    ))
}

#[pyfunction]
#[pyo3(signature = (normals, views, albedo, roughness, metallic, lighting, threads, model = "paper", transfer = None, bounced = None))]
#[expect(clippy::too_many_arguments)]
fn render<'py>(
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
) -> PyResult<Bound<'py, PyArray3<f64>>> {
    let model: Model = model.parse()?;
    let pixels = Pixels::new(
        ("normals", normals),
        ("views", views),
        albedo,
        roughness,
        metallic,
    )?;
    let lighting = array::<f64, Ix3>("lighting", lighting)?;
    let lights = lighting.shape()[0];
    shape("lighting", &[lights, sh::COEFFICIENTS, 3], lighting.shape())?;
    not_too_many("lighting", lights, pixels.count())?;
    let lighting = try_copied("lighting", &lighting)?;
    let rows = with_model!(model, M => 1 + M::ROWS);
    let transfer = given_transfer(transfer, bounced, [pixels.count(), rows, lights * 3])?;
    let surface = (model, transfer.as_ref());
    let Pixels {
        normals,
        views,
        materials,
        ..
    } = &pixels;
    let images =
        py.detach(|| render_pixels(normals, views, materials, &lighting, surface, threads))?;
    Ok(array3(images, [lights, pixels.count(), 3]).into_pyarray(py))
}

/// Pictures of so many pixels under so many lights must be possible.
pub(super) fn not_too_many(name: &'static str, lights: usize, pixels: usize) -> Result<()> {
    let samples = lights.saturating_mul(pixels);
    if samples > MAX_SAMPLES {
        let expected = format!("at most {MAX_SAMPLES} lights times pixels");
        return Err(Error::argument(name, expected, samples));
    }
    Ok(())
}

/// Copies of what is given for each pixel.
pub(super) struct Pixels {
    names: [&'static str; 2],
    pub(super) normals: Vec<DVec3>,
    pub(super) views: Vec<DVec3>,
    pub(super) materials: Vec<Material>,
}

impl Pixels {
    /// From arrays of as many rows each; the first two by their names.
    pub(super) fn new(
        normals: (&'static str, &Bound<'_, PyAny>),
        views: (&'static str, &Bound<'_, PyAny>),
        albedo: &Bound<'_, PyAny>,
        roughness: &Bound<'_, PyAny>,
        metallic: &Bound<'_, PyAny>,
    ) -> PyResult<Self> {
        let names = [normals.0, views.0];
        let normals: PyReadonlyArray<'_, f64, Ix2> = array(normals.0, normals.1)?;
        let views: PyReadonlyArray<'_, f64, Ix2> = array(views.0, views.1)?;
        let materials = materials(
            &array("albedo", albedo)?,
            &array("roughness", roughness)?,
            &array("metallic", metallic)?,
        )?;
        shape(names[0], &[materials.len(), 3], normals.shape())?;
        shape(names[1], &[materials.len(), 3], views.shape())?;
        Ok(Self {
            names,
            normals: vectors(names[0], &normals)?.into_owned(),
            views: vectors(names[1], &views)?.into_owned(),
            materials,
        })
    }

    pub(super) fn count(&self) -> usize {
        self.materials.len()
    }

    fn check(&self) -> Result<()> {
        check::unit_vectors(self.names[0], &self.normals)?;
        check::unit_vectors(self.names[1], &self.views)
    }

    fn shade<M: Reflection>(&self) -> Result<Vec<Weights>> {
        let weights = self
            .each()
            .map(|(n, v, m)| shade_pixel(&Frame::<M>::new(n, v), m));
        collect("normal", self.count(), weights)
    }

    fn pull_back<M: Reflection>(&self, cotangent: &[Weights]) -> Result<Vec<(Material, DVec3)>> {
        let pairs = self.each().zip(cotangent);
        let gradients =
            pairs.map(|((n, v, m), w)| pull_back_pixel(&FrameWithSlopes::<M>::new(n, v), m, w));
        collect("normal", self.count(), gradients)
    }

    /// Normal, view direction and material.
    fn each(&self) -> impl Iterator<Item = (DVec3, DVec3, &Material)> {
        let directions = self.normals.iter().zip(&self.views);
        directions
            .zip(&self.materials)
            .map(|((&n, &v), m)| (n, v, m))
    }
}

pub(super) fn array2<const N: usize>(rows: Vec<[f64; N]>) -> Array2<f64> {
    Array2::from(rows)
}

pub(super) fn array3<T>(values: Vec<T>, shape: [usize; 3]) -> Array3<T> {
    Array3::from_shape_vec(shape, values).expect("the shape's own number of values")
}

pub(super) fn matrix<T>(values: Vec<T>, shape: [usize; 2]) -> Array2<T> {
    Array2::from_shape_vec(shape, values).expect("the shape's own number of values")
}
