//! `pbrfit._core.Lbfgs`: vectors are read and written where numpy keeps them.
//!
//! It keeps the interpreter lock, so nobody changes the arrays that it works on. Copies would be a
//! third of a solver's memory, and each call takes less time than an evaluation.

use numpy::{Ix1, PyArray1, PyArray2, PyReadonlyArray1, PyReadwriteArray1, ToPyArray};
use pyo3::prelude::*;

use super::InputError;
use super::arrays::{Contiguous, array};
use super::model::matrix;
use super::penalties::indices;
use crate::lbfgs::Lbfgs;

pub(super) fn register(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add_class::<PyLbfgs>()
}

type Argument<'a, 'py> = &'a Bound<'py, PyAny>;
type Vector<'py> = PyReadonlyArray1<'py, f64>;

#[pyclass(name = "Lbfgs", module = "pbrfit._core")]
struct PyLbfgs(Lbfgs);

#[pymethods]
impl PyLbfgs {
    #[new]
    #[pyo3(signature = (ends, lower, upper, corrections, threads = 0))]
    fn new(
        ends: Argument<'_, '_>,
        lower: Argument<'_, '_>,
        upper: Argument<'_, '_>,
        corrections: usize,
        threads: usize,
    ) -> PyResult<Self> {
        let (lower, upper) = (vector("lower", lower)?, vector("upper", upper)?);
        let lower = Contiguous::try_of("lower", &lower)?;
        let upper = Contiguous::try_of("upper", &upper)?;
        let (lower, upper) = (lower.values(), upper.values());
        let ends = indices("ends", ends)?;
        Ok(Self(Lbfgs::new(&ends, lower, upper, corrections, threads)?))
    }

    #[getter]
    fn size(&self) -> usize {
        self.0.size()
    }

    #[getter]
    fn pairs(&self) -> usize {
        self.0.pairs()
    }

    fn clear_pairs(&mut self) {
        self.0.clear_pairs();
    }

    fn add_pair(
        &mut self,
        x: Argument<'_, '_>,
        new_x: Argument<'_, '_>,
        gradient: Argument<'_, '_>,
        new_gradient: Argument<'_, '_>,
    ) -> PyResult<bool> {
        let (x, new_x) = (vector("x", x)?, vector("new_x", new_x)?);
        let gradient = vector("gradient", gradient)?;
        let new_gradient = vector("new_gradient", new_gradient)?;
        let x = [values("x", &x)?, values("new_x", &new_x)?];
        let gradient = [
            values("gradient", &gradient)?,
            values("new_gradient", &new_gradient)?,
        ];
        Ok(self.0.add_pair(x, gradient)?)
    }

    #[expect(clippy::type_complexity)]
    fn products<'py>(
        &mut self,
        py: Python<'py>,
        x: Argument<'_, 'py>,
        gradient: Argument<'_, 'py>,
    ) -> PyResult<(
        Bound<'py, PyArray2<f64>>,
        Bound<'py, PyArray2<f64>>,
        Bound<'py, PyArray1<f64>>,
        f64,
    )> {
        let (x, gradient) = (vector("x", x)?, vector("gradient", gradient)?);
        let gradient = values("gradient", &gradient)?;
        let found = self.0.products(values("x", &x)?, gradient)?;
        let shape = [2 * self.0.pairs(); 2];
        Ok((
            matrix(found.all, shape).to_pyarray(py),
            matrix(found.free, shape).to_pyarray(py),
            found.by_gradient.to_pyarray(py),
            found.gradient,
        ))
    }

    fn direction(
        &self,
        x: Argument<'_, '_>,
        gradient: Argument<'_, '_>,
        descent: f64,
        coefficients: Argument<'_, '_>,
        out: Argument<'_, '_>,
    ) -> PyResult<f64> {
        let (x, gradient) = (vector("x", x)?, vector("gradient", gradient)?);
        let coefficients = vector("coefficients", coefficients)?;
        let mut out = writable(out)?;
        Ok(self.0.direction(
            values("x", &x)?,
            values("gradient", &gradient)?,
            descent,
            values("coefficients", &coefficients)?,
            out.as_slice_mut().map_err(|_| gaps("out"))?,
        )?)
    }

    fn moved(
        &self,
        x: Argument<'_, '_>,
        direction: Argument<'_, '_>,
        length: f64,
        out: Argument<'_, '_>,
    ) -> PyResult<()> {
        let (x, direction) = (vector("x", x)?, vector("direction", direction)?);
        let mut out = writable(out)?;
        let direction = values("direction", &direction)?;
        let out = out.as_slice_mut().map_err(|_| gaps("out"))?;
        Ok(self.0.moved(values("x", &x)?, direction, length, out)?)
    }

    fn dot(&self, a: Argument<'_, '_>, b: Argument<'_, '_>) -> PyResult<f64> {
        let (a, b) = (vector("a", a)?, vector("b", b)?);
        Ok(self.0.dot(values("a", &a)?, values("b", &b)?)?)
    }
}

fn vector<'py>(name: &'static str, argument: Argument<'_, 'py>) -> PyResult<Vector<'py>> {
    array::<f64, Ix1>(name, argument)
}

/// The array's own memory: a copy would be made again in every iteration.
fn values<'a>(name: &'static str, array: &'a Vector<'_>) -> PyResult<&'a [f64]> {
    array.as_slice().map_err(|_| gaps(name))
}

fn writable<'py>(out: Argument<'_, 'py>) -> PyResult<PyReadwriteArray1<'py, f64>> {
    let refused = "out: expected a writable array of float64 apart from the others, found another";
    let array = out.extract();
    array.map_err(|_| InputError::new_err(refused))
}

fn gaps(name: &'static str) -> PyErr {
    InputError::new_err(format!(
        "{name}: expected a contiguous array, found one with gaps"
    ))
}
