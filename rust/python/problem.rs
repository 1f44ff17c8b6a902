//! `pbrfit._core.Problem`: the pictures, and the loss over them.

use std::ops::Deref;
use std::sync::{Mutex, MutexGuard};

use glam::DVec3;
use numpy::{IxDyn, PyArray1, PyArrayMethods, PyUntypedArrayMethods, get_array_module};
use pyo3::exceptions::PyTypeError;
use pyo3::prelude::*;
use pyo3::types::PyDict;

use super::arrays::{
    ANY, Contiguous, Out, array, given, indices, optional, out, rows, shape, values, vector_rows,
    writable,
};
use super::images::Images;
use super::surroundings::given as given_transfer;
use crate::pixel::pixel_fit::{GaussianPrior, Search};
use crate::problem::{Options, Pictures, Problem};
use crate::reflectance::model::{Model, with_model};
use crate::reflectance::reflection::Reflection;
use crate::runtime::{Error, check, pool};
use crate::schur::kept::KeptSystem;
use crate::schur::{Clusters, Elimination, PriorTerm};

#[pyclass(frozen, name = "Problem", module = "pbrfit._core")]
pub(super) struct PyProblem {
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
        let samples @ [pictures, pixels, channels] = images.shape;
        // Before anything is copied: a broadcast array may pretend to more than any memory holds.
        check::samples("images", "pictures", pictures, pixels)?;
        let rows = normals.shape()[0];
        shape("normals", &[rows, 3], normals.shape())?;
        shape("views", &[rows, 3], views.shape())?;
        shape("images", &[pictures, rows, channels], &images.shape)?;
        let weights = weights
            .map(|weights| array::<f32, IxDyn>("weights", weights))
            .transpose()?;
        if let Some(weights) = &weights {
            let of_samples = &samples[..if weights.shape().len() == 2 { 2 } else { 3 }];
            shape("weights", of_samples, weights.shape())?;
        }
        let coefficients = match sh_order {
            2 | 3 => (sh_order + 1).pow(2),
            _ => ANY, // refused below
        };
        let lighting = optional("lighting", lighting, [pictures, coefficients, channels])?;
        let (normals, views) = (
            vector_rows("normals", &normals)?,
            vector_rows("views", &views)?,
        );
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
            lighting,
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

    #[pyo3(signature = (x, out = None))]
    fn value_and_grad<'py>(
        &self,
        py: Python<'py>,
        x: &Bound<'py, PyAny>,
        out: Option<&Bound<'py, PyAny>>,
    ) -> PyResult<(f64, Bound<'py, PyArray1<f64>>)> {
        let x = self.x(x)?;
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
        let value = py.detach(|| self.problem.value_and_grad(&x, values))?;
        drop(access);
        Ok((value, gradient))
    }

    fn residuals<'py>(
        &self,
        py: Python<'py>,
        x: &Bound<'py, PyAny>,
        pixels: &Bound<'py, PyAny>,
    ) -> PyResult<Out<'py, 3, f32>> {
        let (x, pixels) = self.at(x, pixels)?;
        let residuals = py.detach(|| self.problem.residuals(&x, &pixels))?;
        let (pictures, channels) = (self.problem.pictures(), self.problem.channels());
        Ok(out(py, residuals, [pictures, pixels.len(), channels]))
    }

    fn normals<'py>(&self, py: Python<'py>, maps: &Bound<'py, PyAny>) -> PyResult<Out<'py, 2>> {
        let maps = self.copied("maps", maps, self.problem.maps())?;
        let normals = py.detach(|| self.problem.normals(&maps))?;
        rows(py, "normals", normals.iter().map(DVec3::to_array))
    }

    fn light_equations<'py>(
        &self,
        py: Python<'py>,
        maps: &Bound<'py, PyAny>,
    ) -> PyResult<(Out<'py, 4>, Out<'py, 3>)> {
        let maps = self.copied("maps", maps, self.problem.maps())?;
        let equations = py.detach(|| self.problem.light_equations(&maps))?;
        let (channels, k) = (self.problem.channels(), self.problem.coefficients());
        let gram: Vec<f64> = equations.iter().flat_map(|e| &e.gram).copied().collect();
        let right: Vec<f64> = equations.iter().flat_map(|e| &e.right).copied().collect();
        let grams = gram.len() / (channels * k * k);
        Ok((
            out(py, gram, [channels, grams, k, k]),
            out(py, right, [channels, self.problem.pictures(), k]),
        ))
    }

    fn material_grid<'py>(
        &self,
        py: Python<'py>,
        x: &Bound<'py, PyAny>,
        pixels: &Bound<'py, PyAny>,
        roughness: &Bound<'py, PyAny>,
        metallic: &Bound<'py, PyAny>,
    ) -> PyResult<Out<'py, 3, f32>> {
        let (x, pixels) = self.at(x, pixels)?;
        let (roughness, [r]) = given("roughness", roughness, [ANY])?;
        let (metallic, [m]) = given("metallic", metallic, [ANY])?;
        let grid = py.detach(|| {
            self.problem
                .material_grid(&x, &pixels, &roughness, &metallic)
        })?;
        Ok(out(py, grid, [pixels.len(), r, m]))
    }

    #[pyo3(signature = (
        x, pixels, roughness, metallic, *,
        starts = 1, steps = 10, exact_steps = 1, mean = None, precision = None,
        held_normals = false
    ))]
    #[expect(clippy::too_many_arguments)]
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
    ) -> PyResult<(Out<'py, 2>, Out<'py, 1>)> {
        let (x, pixels) = self.at(x, pixels)?;
        let roughness = values("roughness", roughness, [ANY])?;
        let metallic = values("metallic", metallic, [ANY])?;
        let (q, d) = (pixels.len(), self.problem.unknowns_of_pixel());
        let shape = [q, d - self.problem.channels()];
        let mean = optional("mean", mean, shape)?;
        let precision = optional("precision", precision, shape)?;
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
        let [materials, sum_sq_residuals] =
            py.detach(|| self.problem.fit_materials(&x, &pixels, &search))?;
        Ok((out(py, materials, [q, d]), out(py, sum_sq_residuals, [q])))
    }

    fn best_albedo<'py>(
        &self,
        py: Python<'py>,
        x: &Bound<'py, PyAny>,
        pixels: &Bound<'py, PyAny>,
    ) -> PyResult<(Out<'py, 2>, Out<'py, 1>)> {
        let (x, pixels) = self.at(x, pixels)?;
        let [albedo, sum_sq_residuals] = py.detach(|| self.problem.best_albedo(&x, &pixels))?;
        Ok((
            out(py, albedo, [pixels.len(), self.problem.channels()]),
            out(py, sum_sq_residuals, [pixels.len()]),
        ))
    }

    fn normal_equations<'py>(
        &self,
        py: Python<'py>,
        x: &Bound<'py, PyAny>,
        pixels: &Bound<'py, PyAny>,
    ) -> PyResult<(Out<'py, 3>, Out<'py, 2>, Out<'py, 1>)> {
        let (x, pixels) = self.at(x, pixels)?;
        let [matrices, gradient, sum_sq_residuals] =
            py.detach(|| self.problem.normal_equations(&x, &pixels))?;
        let (p, d) = (pixels.len(), self.problem.unknowns_of_pixel());
        Ok((
            out(py, matrices, [p, d, d]),
            out(py, gradient, [p, d]),
            out(py, sum_sq_residuals, [p]),
        ))
    }

    fn derivatives<'py>(
        &self,
        py: Python<'py>,
        x: &Bound<'py, PyAny>,
        pixels: &Bound<'py, PyAny>,
    ) -> PyResult<(Out<'py, 4>, Out<'py, 3>, Out<'py, 3>)> {
        let (x, pixels) = self.at(x, pixels)?;
        let problem = &self.problem;
        let [by_material, by_light, weights] = py.detach(|| problem.derivatives(&x, &pixels))?;
        let (p, n, c) = (pixels.len(), problem.pictures(), problem.channels());
        let derivatives = if problem.options.free_normals { 5 } else { 3 };
        Ok((
            out(py, by_material, [p, n, c, derivatives]),
            out(py, by_light, [p, c, problem.coefficients()]),
            out(py, weights, [p, n, c]),
        ))
    }

    fn moves_with_lights<'py>(
        &self,
        py: Python<'py>,
        x: &Bound<'py, PyAny>,
        pixels: &Bound<'py, PyAny>,
        covariances: &Bound<'py, PyAny>,
        modes: &Bound<'py, PyAny>,
    ) -> PyResult<(Out<'py, 2>, Out<'py, 2>)> {
        let (x, pixels) = self.at(x, pixels)?;
        let problem = &self.problem;
        let (p, d) = (pixels.len(), problem.unknowns_of_pixel());
        let covariances = values::<f64, 3>("covariances", covariances, [p, d, d])?;
        let (n, k, c) = (
            problem.pictures(),
            problem.coefficients(),
            problem.channels(),
        );
        let modes = values::<f64, 4>("modes", modes, [ANY, n, k, c])?;
        let found = py.detach(|| problem.moves_with_lights(&x, &pixels, &covariances, &modes))?;
        let [moves, effects] = found.map(|of_all| out(py, of_all, [p, d]));
        Ok((moves, effects))
    }

    #[pyo3(signature = (x, pixels, **options))]
    fn schur_complement<'py>(
        &self,
        py: Python<'py>,
        x: &Bound<'py, PyAny>,
        pixels: &Bound<'py, PyAny>,
        options: Option<&Bound<'py, PyDict>>,
    ) -> PyResult<(Out<'py, 2>, Out<'py, 1>)> {
        let (x, pixels) = self.at(x, pixels)?;
        let options = self.options(options, pixels.len())?;
        let found = py.detach(|| self.problem.schur_complement(&x, &pixels, &options))?;
        let size = found.gradient.len();
        Ok((
            out(py, found.matrix, [size, size]),
            out(py, found.gradient, [size]),
        ))
    }

    #[pyo3(signature = (x, pixels, **options))]
    fn kept_system<'py>(
        &self,
        py: Python<'py>,
        x: &Bound<'py, PyAny>,
        pixels: &Bound<'py, PyAny>,
        options: Option<&Bound<'py, PyDict>>,
    ) -> PyResult<PyKeptSystem> {
        let (x, pixels) = self.at(x, pixels)?;
        let options = self.options(options, pixels.len())?;
        let kept = py.detach(|| self.problem.kept_system(&x, &pixels, &options))?;
        Ok(PyKeptSystem(kept))
    }

    #[pyo3(signature = (x, pixels, v, **options))]
    fn back_substitute<'py>(
        &self,
        py: Python<'py>,
        x: &Bound<'py, PyAny>,
        pixels: &Bound<'py, PyAny>,
        v: &Bound<'py, PyAny>,
        options: Option<&Bound<'py, PyDict>>,
    ) -> PyResult<Out<'py, 2>> {
        let (x, pixels) = self.at(x, pixels)?;
        let v = values("v", v, [ANY])?;
        let options = self.options(options, pixels.len())?;
        let materials = py.detach(|| self.problem.back_substitute(&x, &pixels, &v, &options))?;
        let shape = [pixels.len(), self.problem.unknowns_of_pixel()];
        Ok(out(py, materials, shape))
    }
}

#[pyclass(frozen, name = "KeptSystem", module = "pbrfit._core")]
pub(super) struct PyKeptSystem(KeptSystem);

#[pymethods]
impl PyKeptSystem {
    #[getter]
    fn gradient<'py>(&self, py: Python<'py>) -> Out<'py, 1> {
        PyArray1::from_slice(py, self.0.gradient())
    }

    fn product<'py>(&self, py: Python<'py>, v: &Bound<'py, PyAny>) -> PyResult<Out<'py, 1>> {
        let (v, shape) = given("v", v, [ANY])?;
        Ok(out(py, py.detach(|| self.0.product(&v))?, shape))
    }
}

/// See [`PyProblem::copied`].
struct Copied<'a> {
    kept: Option<MutexGuard<'a, Vec<f64>>>,
    own: Vec<f64>,
}

impl Deref for Copied<'_> {
    type Target = [f64];

    fn deref(&self) -> &[f64] {
        self.kept.as_deref().unwrap_or(&self.own)
    }
}

impl PyProblem {
    fn x(&self, x: &Bound<'_, PyAny>) -> PyResult<Copied<'_>> {
        self.copied("x", x, self.problem.size())
    }

    /// x, and some pixels by number.
    fn at(
        &self,
        x: &Bound<'_, PyAny>,
        pixels: &Bound<'_, PyAny>,
    ) -> PyResult<(Copied<'_>, Vec<usize>)> {
        Ok((self.x(x)?, indices("pixels", pixels)?))
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
        pool::copy(self.problem.options.threads, values.values(), copy);
        Ok(copied)
    }

    /// The options of all methods that eliminate pixels.
    fn options(&self, given: Option<&Bound<'_, PyDict>>, pixels: usize) -> PyResult<Elimination> {
        let mut options = Elimination::default();
        let of_prior = self.problem.unknowns_of_pixel() - self.problem.channels();
        let shape = [pixels, of_prior];
        let (mut precision, mut deviation, mut clusters) = (None, None, None);
        for (name, value) in given.into_iter().flatten() {
            match name.extract::<&str>()? {
                "damping" => options.damping = value.extract()?,
                "mono" => options.mono = value.extract()?,
                _ if value.is_none() => (),
                "precision" => precision = Some(values("precision", &value, shape)?),
                "deviation" => deviation = Some(values("deviation", &value, shape)?),
                "cluster" => {
                    let (of_pixels, count): (Bound<'_, PyAny>, usize) = value.extract()?;
                    let of_pixels = indices("cluster", &of_pixels)?;
                    clusters = Some(Clusters { of_pixels, count });
                }
                other => {
                    let message = format!("unexpected keyword argument '{other}'");
                    return Err(PyTypeError::new_err(message));
                }
            }
        }
        options.prior = match (precision, deviation) {
            (None, None) if clusters.is_none() => None,
            (Some(precision), Some(deviation)) => Some(PriorTerm {
                precision,
                deviation,
                clusters,
            }),
            (Some(_), None) => return Err(missing("deviation", "precision")),
            (None, Some(_)) => return Err(missing("precision", "deviation")),
            (None, None) => return Err(missing("precision", "cluster")),
        };
        Ok(options)
    }
}

fn missing(name: &'static str, other: &str) -> PyErr {
    Error::argument(name, format!("an array beside {other}"), "None").into()
}
