//! `pbrfit._core.Problem`: the pictures, and the loss over them.

use std::sync::{Mutex, MutexGuard};

use glam::DVec3;
use numpy::{
    IntoPyArray, PyArray1, PyArray2, PyArray3, PyArray4, PyArrayMethods, PyUntypedArrayMethods,
    get_array_module,
};
use pyo3::prelude::*;

use super::arrays::{Contiguous, array, collect, copied, shape, try_copied, vectors, writable};
use super::images::Images;
use super::model::{array2, array3, matrix};
use super::surroundings::given as given_transfer;
use crate::pixel::pixel_fit::{GaussianPrior, Search};
use crate::problem::robust::Robust;
use crate::problem::{Options, Pictures, Problem};
use crate::reflectance::model::{Model, with_model};
use crate::reflectance::reflection::Reflection;
use crate::runtime::{Error, check, pool};
use crate::schur::kept::KeptSystem;
use crate::schur::{Clusters, Elimination, PriorTerm};

pub(super) fn register(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add_class::<PyProblem>()?;
    module.add_class::<PyKeptSystem>()
}

/// A robust loss by its name and scale.
fn of_name((name, scale): (String, f64)) -> Result<Robust, Error> {
    match name.as_str() {
        "huber" => Ok(Robust::Huber(scale)),
        "cauchy" => Ok(Robust::Cauchy(scale)),
        _ => Err(Error::argument("robust", "huber or cauchy", name)),
    }
}

#[pyclass(frozen, name = "Problem", module = "pbrfit._core")]
struct PyProblem {
    problem: Problem,
    /// The last copy of x, or of its first part: its memory serves again.
    copy: Mutex<Vec<f64>>,
}

#[pymethods]
impl PyProblem {
    #[new]
    #[pyo3(signature = (
        images, normals, views, threads = 0, *,
        weights = None, sh_order = 3, metallic = None, lighting = None, free_normals = false, model = "paper",
        transfer = None, bounced = None
    ))]
    #[expect(clippy::too_many_arguments)]
    fn new(
        images: &Bound<'_, PyAny>,
        normals: &Bound<'_, PyAny>,
        views: &Bound<'_, PyAny>,
        threads: usize,
        weights: Option<&Bound<'_, PyAny>>,
        sh_order: usize,
        metallic: Option<f64>,
        lighting: Option<&Bound<'_, PyAny>>,
        free_normals: bool,
        model: &str,
        transfer: Option<&Bound<'_, PyAny>>,
        bounced: Option<&Bound<'_, PyAny>>,
    ) -> PyResult<Self> {
        let images = Images::of(images)?;
        let normals = array("normals", normals)?;
        let views = array("views", views)?;
        let [pictures, pixels, channels] = images.shape;
        // Before anything is copied: a broadcast array may pretend to more than any memory holds.
        check::samples(pictures, pixels)?;
        let rows = normals.shape()[0];
        shape("normals", &[rows, 3], normals.shape())?;
        shape("views", &[rows, 3], views.shape())?;
        shape("images", &[pictures, rows, channels], &images.shape)?;
        let samples = [pictures, pixels, channels];
        let weights = weights
            .map(|weights| array::<f32, numpy::IxDyn>("weights", weights))
            .transpose()?;
        if let Some(weights) = &weights {
            let of_samples = &samples[..if weights.shape().len() == 2 { 2 } else { 3 }];
            shape("weights", of_samples, weights.shape())?;
        }
        let lighting = lighting
            .map(|lighting| array::<f64, numpy::Ix3>("lighting", lighting))
            .transpose()?;
        if let (Some(lighting), 2 | 3) = (&lighting, sh_order) {
            let coefficients = (sh_order + 1).pow(2);
            shape(
                "lighting",
                &[pictures, coefficients, channels],
                lighting.shape(),
            )?;
        }
        let (normals, views) = (vectors("normals", &normals)?, vectors("views", &views)?);
        let weights = weights
            .as_ref()
            .map(|weights| Contiguous::try_of("weights", weights))
            .transpose()?;
        let model: Model = model.parse()?;
        let rows = with_model!(model, M => 1 + M::ROWS);
        let transfer = given_transfer(transfer, bounced, [pixels, rows, pictures * channels])?;
        let options = Options {
            sh_order,
            metallic,
            lighting: lighting
                .map(|lighting| try_copied("lighting", &lighting))
                .transpose()?,
            free_normals,
            model,
            threads,
            ..Options::default()
        };
        // The one long call that keeps the interpreter lock: it reads the caller's arrays where they
        // are, and nobody may change them meanwhile. Copies to work from would add to the memory.
        let given = Pictures {
            images: images.targets(threads)?,
            weights: weights.as_ref().map(Contiguous::values),
            normals: &normals,
            views: &views,
            transfer,
        };
        Ok(Self {
            problem: Problem::new(given, options)?,
            copy: Mutex::default(),
        })
    }

    #[getter]
    fn size(&self) -> usize {
        self.problem.size()
    }

    #[getter]
    fn pixels(&self) -> usize {
        self.problem.pixels()
    }

    #[getter]
    fn pictures(&self) -> usize {
        self.problem.pictures()
    }

    #[getter]
    fn channels(&self) -> usize {
        self.problem.channels()
    }

    #[getter]
    fn coefficients(&self) -> usize {
        self.problem.coefficients()
    }

    #[pyo3(signature = (x, robust = None, out = None))]
    fn value_and_grad<'py>(
        &self,
        py: Python<'py>,
        x: &Bound<'py, PyAny>,
        robust: Option<(String, f64)>,
        out: Option<&Bound<'py, PyAny>>,
    ) -> PyResult<(f64, Bound<'py, PyArray1<f64>>)> {
        let robust = robust.map(of_name).transpose()?;
        let x = self.x(x)?;
        let x = x.values();
        // numpy's memory, because numpy asks the system for large pages: with a vector of ours the
        // first touch of each small page takes a third of the time at 1024². By numpy's function,
        // which raises MemoryError where `PyArray1::zeros` panics.
        let gradient = match out {
            Some(out) => writable("out", out, self.problem.size())?,
            None => get_array_module(py)?
                .call_method1("zeros", (self.problem.size(),))?
                .cast_into::<PyArray1<f64>>()?,
        };
        let mut access = gradient.readwrite();
        let values = access.as_slice_mut()?;
        let value = py.detach(|| self.problem.value_and_grad(x, robust, values))?;
        drop(access);
        Ok((value, gradient))
    }

    fn residuals<'py>(
        &self,
        py: Python<'py>,
        x: &Bound<'py, PyAny>,
        pixels: &Bound<'py, PyAny>,
    ) -> PyResult<Bound<'py, PyArray3<f32>>> {
        let (x, pixels) = (self.x(x)?, indices("pixels", pixels)?);
        let x = x.values();
        let residuals = py.detach(|| self.problem.residuals(x, &pixels))?;
        let shape = [
            self.problem.pictures(),
            pixels.len(),
            self.problem.channels(),
        ];
        Ok(array3(residuals, shape).into_pyarray(py))
    }

    fn normals<'py>(
        &self,
        py: Python<'py>,
        maps: &Bound<'py, PyAny>,
    ) -> PyResult<Bound<'py, PyArray2<f64>>> {
        let maps = self.copied("maps", maps, self.problem.maps())?;
        let maps = maps.values();
        let rows = py.detach(|| {
            let normals = self.problem.normals(maps)?;
            collect(
                "normals",
                normals.len(),
                normals.iter().map(DVec3::to_array),
            )
        })?;
        Ok(array2(rows).into_pyarray(py))
    }

    #[expect(clippy::type_complexity)]
    fn light_equations<'py>(
        &self,
        py: Python<'py>,
        maps: &Bound<'py, PyAny>,
    ) -> PyResult<(Bound<'py, PyArray4<f64>>, Bound<'py, PyArray3<f64>>)> {
        let maps = self.copied("maps", maps, self.problem.maps())?;
        let maps = maps.values();
        let equations = py.detach(|| self.problem.light_equations(maps))?;
        let (channels, k) = (self.problem.channels(), self.problem.coefficients());
        let gram: Vec<f64> = equations.iter().flat_map(|e| &e.gram).copied().collect();
        let right: Vec<f64> = equations.iter().flat_map(|e| &e.right).copied().collect();
        let grams = gram.len() / (channels * k * k);
        let gram = numpy::ndarray::Array4::from_shape_vec([channels, grams, k, k], gram)
            .expect("Gram matrices of every channel");
        Ok((
            gram.into_pyarray(py),
            array3(right, [channels, self.problem.pictures(), k]).into_pyarray(py),
        ))
    }

    fn material_grid<'py>(
        &self,
        py: Python<'py>,
        x: &Bound<'py, PyAny>,
        pixels: &Bound<'py, PyAny>,
        roughness: &Bound<'py, PyAny>,
        metallic: &Bound<'py, PyAny>,
    ) -> PyResult<Bound<'py, PyArray3<f32>>> {
        let (x, pixels) = (self.x(x)?, indices("pixels", pixels)?);
        let x = x.values();
        let roughness = copied(&array::<f64, numpy::Ix1>("roughness", roughness)?);
        let metallic = copied(&array::<f64, numpy::Ix1>("metallic", metallic)?);
        let grid = py.detach(|| {
            self.problem
                .material_grid(x, &pixels, &roughness, &metallic)
        })?;
        let shape = [pixels.len(), roughness.len(), metallic.len()];
        Ok(array3(grid, shape).into_pyarray(py))
    }

    #[pyo3(signature = (
        x, pixels, roughness, metallic, *,
        starts = 1, steps = 10, exact_steps = 1, mean = None, precision = None,
        held_normals = false
    ))]
    #[expect(clippy::too_many_arguments, clippy::type_complexity)]
    fn fit_materials<'py>(
        &self,
        py: Python<'py>,
        x: &Bound<'py, PyAny>,
        pixels: &Bound<'py, PyAny>,
        roughness: &Bound<'py, PyAny>,
        metallic: &Bound<'py, PyAny>,
        starts: usize,
        steps: usize,
        exact_steps: usize,
        mean: Option<&Bound<'py, PyAny>>,
        precision: Option<&Bound<'py, PyAny>>,
        held_normals: bool,
    ) -> PyResult<(Bound<'py, PyArray2<f64>>, Bound<'py, PyArray1<f64>>)> {
        let (x, pixels) = (self.x(x)?, indices("pixels", pixels)?);
        let x = x.values();
        let roughness = copied(&array::<f64, numpy::Ix1>("roughness", roughness)?);
        let metallic = copied(&array::<f64, numpy::Ix1>("metallic", metallic)?);
        let (q, d) = (pixels.len(), self.problem.unknowns_of_pixel());
        let of_pixels = |name, argument: Option<&Bound<'py, PyAny>>| {
            let Some(argument) = argument else {
                return Ok(None);
            };
            let values = array::<f64, numpy::Ix2>(name, argument)?;
            shape(name, &[q, d - self.problem.channels()], values.shape())?;
            PyResult::Ok(Some(try_copied(name, &values)?))
        };
        let (mean, precision) = (of_pixels("mean", mean)?, of_pixels("precision", precision)?);
        let prior = match (&mean, &precision) {
            (None, None) => None,
            (Some(mean), Some(precision)) => Some(GaussianPrior { mean, precision }),
            (Some(_), None) => return Err(missing("precision", "mean")),
            (None, Some(_)) => return Err(missing("mean", "precision")),
        };
        let search = Search {
            roughness: &roughness,
            metallic: &metallic,
            starts,
            steps,
            exact_steps,
            held_normals,
            prior,
        };
        let fitted = py.detach(|| self.problem.fit_materials(x, &pixels, &search))?;
        Ok((
            matrix(fitted.materials, [q, d]).into_pyarray(py),
            fitted.sum_sq_residuals.into_pyarray(py),
        ))
    }

    #[expect(clippy::type_complexity)]
    fn best_albedo<'py>(
        &self,
        py: Python<'py>,
        x: &Bound<'py, PyAny>,
        pixels: &Bound<'py, PyAny>,
    ) -> PyResult<(Bound<'py, PyArray2<f64>>, Bound<'py, PyArray1<f64>>)> {
        let (x, pixels) = (self.x(x)?, indices("pixels", pixels)?);
        let x = x.values();
        let best = py.detach(|| self.problem.best_albedo(x, &pixels))?;
        let shape = [pixels.len(), self.problem.channels()];
        Ok((
            matrix(best.albedo, shape).into_pyarray(py),
            best.sum_sq_residuals.into_pyarray(py),
        ))
    }

    #[expect(clippy::type_complexity)]
    fn normal_equations<'py>(
        &self,
        py: Python<'py>,
        x: &Bound<'py, PyAny>,
        pixels: &Bound<'py, PyAny>,
    ) -> PyResult<(
        Bound<'py, PyArray3<f64>>,
        Bound<'py, PyArray2<f64>>,
        Bound<'py, PyArray1<f64>>,
    )> {
        let (x, pixels) = (self.x(x)?, indices("pixels", pixels)?);
        let x = x.values();
        let found = py.detach(|| self.problem.normal_equations(x, &pixels))?;
        let (p, d) = (pixels.len(), self.problem.unknowns_of_pixel());
        Ok((
            array3(found.matrices, [p, d, d]).into_pyarray(py),
            matrix(found.gradient, [p, d]).into_pyarray(py),
            found.sum_sq_residuals.into_pyarray(py),
        ))
    }

    #[expect(clippy::type_complexity)]
    fn derivatives<'py>(
        &self,
        py: Python<'py>,
        x: &Bound<'py, PyAny>,
        pixels: &Bound<'py, PyAny>,
    ) -> PyResult<(
        Bound<'py, PyArray4<f64>>,
        Bound<'py, PyArray3<f64>>,
        Bound<'py, PyArray3<f64>>,
    )> {
        let (x, pixels) = (self.x(x)?, indices("pixels", pixels)?);
        let x = x.values();
        let found = py.detach(|| self.problem.derivatives(x, &pixels))?;
        let problem = &self.problem;
        let (p, n, c) = (pixels.len(), problem.pictures(), problem.channels());
        let derivatives = if problem.free_normals() { 5 } else { 3 };
        let by_material =
            numpy::ndarray::Array4::from_shape_vec([p, n, c, derivatives], found.by_material)
                .expect("derivatives of every sample");
        Ok((
            by_material.into_pyarray(py),
            array3(found.by_light, [p, c, problem.coefficients()]).into_pyarray(py),
            array3(found.weights, [p, n, c]).into_pyarray(py),
        ))
    }

    fn moves_with_lights<'py>(
        &self,
        py: Python<'py>,
        x: &Bound<'py, PyAny>,
        pixels: &Bound<'py, PyAny>,
        covariances: &Bound<'py, PyAny>,
        modes: &Bound<'py, PyAny>,
    ) -> PyResult<Bound<'py, PyArray2<f64>>> {
        let (x, pixels) = (self.x(x)?, indices("pixels", pixels)?);
        let x = x.values();
        let problem = &self.problem;
        let (p, d) = (pixels.len(), problem.unknowns_of_pixel());
        let covariances = array::<f64, numpy::Ix3>("covariances", covariances)?;
        shape("covariances", &[p, d, d], covariances.shape())?;
        let covariances = try_copied("covariances", &covariances)?;
        let modes = array::<f64, numpy::Ix4>("modes", modes)?;
        let count = modes.shape()[0];
        let (n, k, c) = (
            problem.pictures(),
            problem.coefficients(),
            problem.channels(),
        );
        shape("modes", &[count, n, k, c], modes.shape())?;
        let modes = try_copied("modes", &modes)?;
        let moves = py.detach(|| problem.moves_with_lights(x, &pixels, &covariances, &modes))?;
        Ok(matrix(moves, [p, d]).into_pyarray(py))
    }

    #[pyo3(signature = (x, pixels, *, damping = 0.0, mono = false, precision = None, deviation = None, cluster = None))]
    #[expect(clippy::type_complexity, clippy::too_many_arguments)]
    fn schur_complement<'py>(
        &self,
        py: Python<'py>,
        x: &Bound<'py, PyAny>,
        pixels: &Bound<'py, PyAny>,
        damping: f64,
        mono: bool,
        precision: Option<&Bound<'py, PyAny>>,
        deviation: Option<&Bound<'py, PyAny>>,
        cluster: Option<(Bound<'py, PyAny>, usize)>,
    ) -> PyResult<(Bound<'py, PyArray2<f64>>, Bound<'py, PyArray1<f64>>)> {
        let (x, pixels) = (self.x(x)?, indices("pixels", pixels)?);
        let x = x.values();
        let prior = self.prior(pixels.len(), precision, deviation, cluster)?;
        let how = elimination(damping, mono, prior.as_ref());
        let found = py.detach(|| self.problem.schur_complement(x, &pixels, &how))?;
        let size = found.gradient.len();
        Ok((
            matrix(found.matrix, [size, size]).into_pyarray(py),
            found.gradient.into_pyarray(py),
        ))
    }

    #[pyo3(signature = (x, pixels, v, *, damping = 0.0, mono = false, precision = None, deviation = None, cluster = None))]
    #[expect(clippy::type_complexity, clippy::too_many_arguments)]
    fn schur_product<'py>(
        &self,
        py: Python<'py>,
        x: &Bound<'py, PyAny>,
        pixels: &Bound<'py, PyAny>,
        v: &Bound<'py, PyAny>,
        damping: f64,
        mono: bool,
        precision: Option<&Bound<'py, PyAny>>,
        deviation: Option<&Bound<'py, PyAny>>,
        cluster: Option<(Bound<'py, PyAny>, usize)>,
    ) -> PyResult<(Bound<'py, PyArray1<f64>>, Bound<'py, PyArray1<f64>>)> {
        let (x, pixels) = (self.x(x)?, indices("pixels", pixels)?);
        let x = x.values();
        let v = copied(&array::<f64, numpy::Ix1>("v", v)?);
        let prior = self.prior(pixels.len(), precision, deviation, cluster)?;
        let how = elimination(damping, mono, prior.as_ref());
        let found = py.detach(|| self.problem.schur_product(x, &pixels, &v, &how))?;
        Ok((
            found.product.into_pyarray(py),
            found.gradient.into_pyarray(py),
        ))
    }

    #[pyo3(signature = (x, pixels, *, damping = 0.0, mono = false, precision = None, deviation = None, cluster = None))]
    #[expect(clippy::too_many_arguments)]
    fn kept_system(
        &self,
        py: Python<'_>,
        x: &Bound<'_, PyAny>,
        pixels: &Bound<'_, PyAny>,
        damping: f64,
        mono: bool,
        precision: Option<&Bound<'_, PyAny>>,
        deviation: Option<&Bound<'_, PyAny>>,
        cluster: Option<(Bound<'_, PyAny>, usize)>,
    ) -> PyResult<PyKeptSystem> {
        let (x, pixels) = (self.x(x)?, indices("pixels", pixels)?);
        let x = x.values();
        let prior = self.prior(pixels.len(), precision, deviation, cluster)?;
        let how = elimination(damping, mono, prior.as_ref());
        let kept = py.detach(|| self.problem.kept_system(x, &pixels, &how))?;
        Ok(PyKeptSystem(kept))
    }

    #[pyo3(signature = (x, pixels, v, *, damping = 0.0, mono = false, precision = None, deviation = None, cluster = None))]
    #[expect(clippy::too_many_arguments)]
    fn back_substitute<'py>(
        &self,
        py: Python<'py>,
        x: &Bound<'py, PyAny>,
        pixels: &Bound<'py, PyAny>,
        v: &Bound<'py, PyAny>,
        damping: f64,
        mono: bool,
        precision: Option<&Bound<'py, PyAny>>,
        deviation: Option<&Bound<'py, PyAny>>,
        cluster: Option<(Bound<'py, PyAny>, usize)>,
    ) -> PyResult<Bound<'py, PyArray2<f64>>> {
        let (x, pixels) = (self.x(x)?, indices("pixels", pixels)?);
        let x = x.values();
        let v = copied(&array::<f64, numpy::Ix1>("v", v)?);
        let prior = self.prior(pixels.len(), precision, deviation, cluster)?;
        let how = elimination(damping, mono, prior.as_ref());
        let materials = py.detach(|| self.problem.back_substitute(x, &pixels, &v, &how))?;
        let shape = [pixels.len(), self.problem.unknowns_of_pixel()];
        Ok(matrix(materials, shape).into_pyarray(py))
    }
}

#[pyclass(frozen, name = "KeptSystem", module = "pbrfit._core")]
struct PyKeptSystem(KeptSystem);

#[pymethods]
impl PyKeptSystem {
    #[getter]
    fn gradient<'py>(&self, py: Python<'py>) -> Bound<'py, PyArray1<f64>> {
        PyArray1::from_slice(py, self.0.gradient())
    }

    fn product<'py>(
        &self,
        py: Python<'py>,
        v: &Bound<'py, PyAny>,
    ) -> PyResult<Bound<'py, PyArray1<f64>>> {
        let v = copied(&array::<f64, numpy::Ix1>("v", v)?);
        Ok(py.detach(|| self.0.product(&v))?.into_pyarray(py))
    }
}

fn elimination(damping: f64, mono: bool, prior: Option<&Prior>) -> Elimination<'_> {
    Elimination {
        damping,
        mono,
        prior: prior.map(|prior| PriorTerm {
            precision: &prior.precision,
            deviation: &prior.deviation,
            clusters: (prior.cluster.as_ref())
                .map(|&(ref of_pixels, count)| Clusters { of_pixels, count }),
        }),
    }
}

/// A Gaussian prior of some pixels: (pixels, unknowns without albedo), and their clusters.
struct Prior {
    precision: Vec<f64>,
    deviation: Vec<f64>,
    cluster: Option<(Vec<usize>, usize)>,
}

/// See [`PyProblem::copied`].
struct Copied<'a> {
    kept: Option<MutexGuard<'a, Vec<f64>>>,
    own: Vec<f64>,
}

impl Copied<'_> {
    fn values(&self) -> &[f64] {
        self.kept.as_deref().unwrap_or(&self.own)
    }
}

impl PyProblem {
    fn x(&self, x: &Bound<'_, PyAny>) -> PyResult<Copied<'_>> {
        self.copied("x", x, self.problem.size())
    }

    /// A copy to work from, in the memory of the last one unless another thread uses that.
    fn copied(
        &self,
        name: &'static str,
        values: &Bound<'_, PyAny>,
        size: usize,
    ) -> PyResult<Copied<'_>> {
        let values = array::<f64, numpy::Ix1>(name, values)?;
        shape(name, &[size], values.shape())?;
        let values = Contiguous::try_of(name, &values)?;
        let mut copied = Copied {
            kept: self.copy.try_lock().ok(),
            own: Vec::new(),
        };
        let copy = copied.kept.as_deref_mut().unwrap_or(&mut copied.own);
        if copy.len() != size {
            copy.clear();
        }
        copy.try_reserve_exact(size - copy.len())
            .map_err(|_| Error::Memory(name))?;
        pool::copy(self.problem.threads(), values.values(), copy);
        Ok(copied)
    }

    fn prior(
        &self,
        pixels: usize,
        precision: Option<&Bound<'_, PyAny>>,
        deviation: Option<&Bound<'_, PyAny>>,
        cluster: Option<(Bound<'_, PyAny>, usize)>,
    ) -> PyResult<Option<Prior>> {
        let (precision, deviation) = match (precision, deviation) {
            (None, None) if cluster.is_none() => return Ok(None),
            (Some(precision), Some(deviation)) => (precision, deviation),
            (Some(_), None) => return Err(missing("deviation", "precision")),
            (None, Some(_)) => return Err(missing("precision", "deviation")),
            (None, None) => return Err(missing("precision", "cluster")),
        };
        let shared = self.problem.unknowns_of_pixel() - self.problem.channels();
        let values = |name, argument| {
            let values = array::<f64, numpy::Ix2>(name, argument)?;
            shape(name, &[pixels, shared], values.shape())?;
            PyResult::Ok(copied(&values))
        };
        Ok(Some(Prior {
            precision: values("precision", precision)?,
            deviation: values("deviation", deviation)?,
            cluster: cluster
                .map(|(of_pixels, count)| PyResult::Ok((indices("cluster", &of_pixels)?, count)))
                .transpose()?,
        }))
    }
}

fn missing(name: &'static str, other: &str) -> PyErr {
    Error::argument(name, format!("an array beside {other}"), "None").into()
}

/// Pixels, or clusters, by number.
fn indices(name: &'static str, given: &Bound<'_, PyAny>) -> PyResult<Vec<usize>> {
    let given = array::<u64, numpy::Ix1>(name, given)?;
    Ok(copied(&given).into_iter().map(|p| p as usize).collect())
}
