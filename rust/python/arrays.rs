//! Numpy arrays as they come in: checked, and read where they are or copied.

use std::borrow::Cow;

use bytemuck::cast_slice;
use glam::DVec3;
use numpy::ndarray::{ArrayView, Dimension};
use numpy::{
    Element, Ix1, PyArray1, PyArrayDescrMethods, PyArrayMethods, PyReadonlyArray, PyReadonlyArray1,
    PyReadonlyArray2, PyUntypedArray, PyUntypedArrayMethods, dtype,
};
use pyo3::prelude::*;

use super::InputError;
use crate::reflectance::planes::Material;
use crate::runtime::check::MAX_SAMPLES;
use crate::runtime::{Error, Result, check};

/// The values in C order, whatever the array's strides.
pub(super) fn copied<T: Element + Copy, D: Dimension>(array: &PyReadonlyArray<'_, T, D>) -> Vec<T> {
    let view: ArrayView<T, D> = array.as_array();
    view.iter().copied().collect()
}

/// The same where there may not be enough memory: a broadcast array can pretend to any size.
pub(super) fn try_copied<T: Element + Copy, D: Dimension>(
    name: &'static str,
    array: &PyReadonlyArray<'_, T, D>,
) -> Result<Vec<T>> {
    let view: ArrayView<T, D> = array.as_array();
    collect(name, view.len(), view.iter().copied())
}

/// `count` values as a vector, or an error where memory does not suffice.
pub(super) fn collect<T>(
    name: &'static str,
    count: usize,
    values: impl IntoIterator<Item = T>,
) -> Result<Vec<T>> {
    let mut collected = Vec::new();
    collected
        .try_reserve_exact(count)
        .map_err(|_| Error::Memory(name))?;
    collected.extend(values);
    Ok(collected)
}

/// An argument to write `length` numbers into, in one piece; a refusal names it.
pub(super) fn writable<'py>(
    name: &'static str,
    argument: &Bound<'py, PyAny>,
    length: usize,
) -> PyResult<Bound<'py, PyArray1<f64>>> {
    shape(name, &[length], array::<f64, Ix1>(name, argument)?.shape())?;
    let given = argument.cast::<PyArray1<f64>>()?;
    match given.try_readwrite() {
        Ok(access) if access.as_slice().is_ok() => Ok(given.clone()),
        Ok(_) => Err(Error::argument(name, "numbers in one piece", "steps between them").into()),
        Err(_) => {
            Err(Error::argument(name, "an array that may be written", "one that may not").into())
        }
    }
}

/// An argument as an array of `T` with as many dimensions as `D`; a refusal names it.
pub(super) fn array<'py, T: Element, D: Dimension>(
    name: &'static str,
    argument: &Bound<'py, PyAny>,
) -> PyResult<PyReadonlyArray<'py, T, D>> {
    let refused = |_| {
        let expected = dtype::<T>(argument.py());
        let found = match argument.cast::<PyUntypedArray>() {
            Err(_) => argument
                .get_type()
                .fully_qualified_name()
                .map_or_else(|_| "something else".into(), |name| name.to_string()),
            Ok(array) if array.dtype().is_equiv_to(&expected) => {
                format!("shape {:?}", array.shape())
            }
            Ok(array) => array.dtype().to_string(),
        };
        let dimensions = match D::NDIM {
            None => String::new(),
            Some(1) => " in 1 dimension".into(),
            Some(n) => format!(" in {n} dimensions"),
        };
        InputError::new_err(format!(
            "{name}: expected an array of {expected}{dimensions}, found {found}"
        ))
    };
    let array: PyReadonlyArray<'py, T, D> = argument.extract().map_err(refused)?;
    let mut axes = array.shape().iter().zip(array.strides());
    let broadcast = axes.any(|(&length, &stride)| length > 1 && stride == 0);
    if broadcast && array.len() > MAX_SAMPLES {
        // There is no memory behind it, and there may be none for a copy.
        return Err(InputError::new_err(format!(
            "{name}: expected at most {MAX_SAMPLES} numbers in a broadcast array, found shape {:?}",
            array.shape()
        )));
    }
    if array.is_aligned() {
        return Ok(array);
    }
    // A field of a packed record, or a view of bytes: strides in bytes, which we cannot follow.
    argument.call_method0("copy")?.extract().map_err(refused)
}

/// The values of an array in C order: its own memory where they lie like that, else a copy.
pub(super) struct Contiguous<'a, T: Clone>(Cow<'a, [T]>);

impl<'a, T: Element + Copy> Contiguous<'a, T> {
    /// An error where there is not enough memory for a copy.
    pub(super) fn try_of<D: Dimension>(
        name: &'static str,
        array: &'a PyReadonlyArray<'_, T, D>,
    ) -> Result<Self> {
        // The slice of an array in Fortran order would have the values in that order.
        Ok(Self(match array.as_slice() {
            Ok(values) if array.is_c_contiguous() => Cow::Borrowed(values),
            _ => Cow::Owned(try_copied(name, array)?),
        }))
    }

    pub(super) fn values(&self) -> &[T] {
        &self.0
    }
}

/// Rows of an (M, 3) array: its own memory where they lie there one after the other, else a copy.
pub(super) fn vectors<'a>(
    name: &'static str,
    array: &'a PyReadonlyArray2<'_, f64>,
) -> Result<Cow<'a, [DVec3]>> {
    let rows = array.shape()[0];
    shape(name, &[rows, 3], array.shape())?;
    Ok(match Contiguous::try_of(name, array)?.0 {
        Cow::Borrowed(values) => Cow::Borrowed(cast_slice(values)),
        Cow::Owned(values) => {
            let vectors = values.as_chunks().0.iter();
            Cow::Owned(collect(name, rows, vectors.map(|&v| DVec3::from_array(v)))?)
        }
    })
}

/// Materials from (M, 3), (M,) and (M,) arrays, checked to lie in \[0, 1\].
pub(super) fn materials(
    albedo: &PyReadonlyArray2<'_, f64>,
    roughness: &PyReadonlyArray1<'_, f64>,
    metallic: &PyReadonlyArray1<'_, f64>,
) -> Result<Vec<Material>> {
    let pixels = albedo.shape()[0];
    shape("albedo", &[pixels, 3], albedo.shape())?;
    shape("roughness", &[pixels], roughness.shape())?;
    shape("metallic", &[pixels], metallic.shape())?;
    let albedo = Contiguous::try_of("albedo", albedo)?;
    let roughness = Contiguous::try_of("roughness", roughness)?;
    let metallic = Contiguous::try_of("metallic", metallic)?;
    check::unit_interval("albedo", albedo.values())?;
    check::unit_interval("roughness", roughness.values())?;
    check::unit_interval("metallic", metallic.values())?;
    let rows = albedo.values().as_chunks::<3>().0.iter();
    let material = |((&albedo, &roughness), &metallic)| Material {
        albedo,
        roughness,
        metallic,
    };
    let materials = rows
        .zip(roughness.values())
        .zip(metallic.values())
        .map(material);
    collect("albedo", pixels, materials)
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
