//! `pbrfit._core.Neighbours` and `Groups`: penalties that add their gradient where it is kept.
//!
//! They keep the interpreter lock, so nobody changes the arrays that they work on: a copy would
//! take as long as the work.

use numpy::{Ix1, PyReadwriteArray1};
use pyo3::prelude::*;

use super::InputError;
use super::arrays::{Contiguous, array, shape};
use crate::problem::penalties::{Groups, Neighbours};
use crate::runtime::{self, Error};

pub(super) fn register(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add_class::<PyNeighbours>()?;
    module.add_class::<PyGroups>()
}

#[pyclass(frozen, name = "Neighbours", module = "pbrfit._core")]
struct PyNeighbours(Neighbours);

#[pymethods]
impl PyNeighbours {
    #[new]
    fn new(pixels: usize, first: &Bound<'_, PyAny>, second: &Bound<'_, PyAny>) -> PyResult<Self> {
        let first = indices("first", first)?;
        let second = indices("second", second)?;
        shape("second", &[first.len()], &[second.len()])?;
        let pairs = first.into_iter().zip(second).map(|(a, b)| [a, b]);
        Ok(Self(Neighbours::new(pixels, pairs)?))
    }

    fn add_penalty(
        &self,
        values: &Bound<'_, PyAny>,
        weight: f64,
        gradient: &Bound<'_, PyAny>,
    ) -> PyResult<f64> {
        in_place(values, gradient, |v, g| self.0.add_penalty(v, weight, g))
    }
}

#[pyclass(frozen, name = "Groups", module = "pbrfit._core")]
struct PyGroups(Groups);

#[pymethods]
impl PyGroups {
    #[new]
    fn new(labels: &Bound<'_, PyAny>) -> PyResult<Self> {
        let labels = indices("labels", labels)?;
        let small = labels.iter().map(|&label| u32::try_from(label));
        let small: Result<Vec<u32>, _> = small.collect();
        let too_large = |_| Error::argument("labels", "32-bit labels", "larger ones");
        Ok(Self(Groups::new(small.map_err(too_large)?)?))
    }

    fn add_penalty(
        &self,
        values: &Bound<'_, PyAny>,
        weight: f64,
        gradient: &Bound<'_, PyAny>,
    ) -> PyResult<f64> {
        in_place(values, gradient, |v, g| self.0.add_penalty(v, weight, g))
    }
}

/// Call `add` with the values and with the memory of the gradient.
fn in_place(
    values: &Bound<'_, PyAny>,
    gradient: &Bound<'_, PyAny>,
    add: impl FnOnce(&[f64], &mut [f64]) -> runtime::Result<f64>,
) -> PyResult<f64> {
    let values = array::<f64, Ix1>("values", values)?;
    let values = Contiguous::try_of("values", &values)?;
    let refused = "gradient: expected a writable contiguous array of float64 apart from values";
    let mut gradient: PyReadwriteArray1<'_, f64> = gradient
        .extract()
        .map_err(|_| InputError::new_err(format!("{refused}, found another")))?;
    let gradient = gradient
        .as_slice_mut()
        .map_err(|_| InputError::new_err(format!("{refused}, found one with gaps")))?;
    Ok(add(values.values(), gradient)?)
}

/// Whole numbers from 0, out of an array of int64.
fn indices(name: &'static str, argument: &Bound<'_, PyAny>) -> PyResult<Vec<usize>> {
    let array = array::<i64, Ix1>(name, argument)?;
    let values = Contiguous::try_of(name, &array)?;
    let whole = values.values().iter().map(|&value| {
        usize::try_from(value).map_err(|_| Error::argument(name, "numbers of 0 or more", value))
    });
    Ok(whole.collect::<Result<_, _>>()?)
}
