//! Numpy arrays as they come in: checked, and read where they are or copied.

use std::borrow::Cow;

use glam::DVec3;
use numpy::ndarray::{ArrayView, Dimension};
use numpy::{
    Element, PyArrayDescrMethods, PyReadonlyArray, PyReadonlyArray1, PyReadonlyArray2,
    PyUntypedArray, PyUntypedArrayMethods, dtype,
};
use pyo3::prelude::*;

use super::InputError;
use crate::shade::Material;
use crate::{Error, Result, check};

/// The values in C order, whatever the array's strides.
pub(super) fn copied<T: Element + Copy, D: Dimension>(array: &PyReadonlyArray<'_, T, D>) -> Vec<T> {
    let view: ArrayView<T, D> = array.as_array();
    view.iter().copied().collect()
}

/// An argument as an array of `T` with as many dimensions as `D`; a refusal names it.
pub(super) fn array<'py, T: Element, D: Dimension>(
    name: &'static str,
    argument: &Bound<'py, PyAny>,
) -> PyResult<PyReadonlyArray<'py, T, D>> {
    argument.extract().map_err(|_| {
        let expected = dtype::<T>(argument.py());
        let found = match argument.cast::<PyUntypedArray>() {
            Err(_) => argument.get_type().to_string(),
            Ok(array) if array.dtype().is_equiv_to(&expected) => {
                format!("shape {:?}", array.shape())
            }
            Ok(array) => array.dtype().to_string(),
        };
        let dimensions = D::NDIM.map_or_else(String::new, |n| format!(" in {n} dimensions"));
        InputError::new_err(format!(
            "{name}: expected an array of {expected}{dimensions}, found {found}"
        ))
    })
}

/// The values of an array in C order: its own memory where they lie like that, else a copy.
pub(super) struct Contiguous<'a, T: Clone>(Cow<'a, [T]>);

impl<'a, T: Element + Copy> Contiguous<'a, T> {
    pub(super) fn of<D: Dimension>(array: &'a PyReadonlyArray<'_, T, D>) -> Self {
        Self(match array.as_slice() {
            Ok(values) => Cow::Borrowed(values),
            Err(_) => Cow::Owned(copied(array)),
        })
    }

    pub(super) fn values(&self) -> &[T] {
        &self.0
    }
}

/// Rows of an (M, 3) array.
pub(super) fn vectors(name: &'static str, array: &PyReadonlyArray2<'_, f64>) -> Result<Vec<DVec3>> {
    shape(
        name,
        &[array.as_array().nrows(), 3],
        array.as_array().shape(),
    )?;
    Ok(array
        .as_array()
        .rows()
        .into_iter()
        .map(|v| DVec3::new(v[0], v[1], v[2]))
        .collect())
}

/// Materials from (M, 3), (M,) and (M,) arrays, checked to lie in \[0, 1\].
pub(super) fn materials(
    albedo: &PyReadonlyArray2<'_, f64>,
    roughness: &PyReadonlyArray1<'_, f64>,
    metallic: &PyReadonlyArray1<'_, f64>,
) -> Result<Vec<Material>> {
    let pixels = albedo.as_array().nrows();
    shape("albedo", &[pixels, 3], albedo.as_array().shape())?;
    shape("roughness", &[pixels], roughness.as_array().shape())?;
    shape("metallic", &[pixels], metallic.as_array().shape())?;
    let (albedo, roughness, metallic) = (copied(albedo), copied(roughness), copied(metallic));
    check::unit_interval("albedo", &albedo)?;
    check::unit_interval("roughness", &roughness)?;
    check::unit_interval("metallic", &metallic)?;
    let rows = albedo.as_chunks::<3>().0.iter();
    let material = |((&albedo, roughness), metallic)| Material {
        albedo,
        roughness,
        metallic,
    };
    Ok(rows.zip(roughness).zip(metallic).map(material).collect())
}

pub(super) fn shape(name: &'static str, expected: &[usize], found: &[usize]) -> Result<()> {
    if expected == found {
        return Ok(());
    }
    Err(Error::argument(
        name,
        format!("shape {expected:?}"),
        format!("shape {found:?}"),
    ))
}
