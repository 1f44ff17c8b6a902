//! Arrays of numpy: in, checked and read where they are or copied; and out.

use std::borrow::Cow;

use bytemuck::cast_slice;
use glam::DVec3;
use numpy::ndarray::{Array, ArrayView, Dim, Dimension, IntoDimension};
use numpy::{
    Element, IntoPyArray, Ix1, Ix2, PyArray, PyArray1, PyArrayDescrMethods, PyArrayMethods,
    PyReadonlyArray, PyUntypedArray, PyUntypedArrayMethods, dtype,
};
use pyo3::prelude::*;

use super::InputError;
use crate::reflectance::planes::Material;
use crate::runtime::check::MAX_SAMPLES;
use crate::runtime::memory::collect;
use crate::runtime::{Error, Result, check};

/// In a shape: as long as the array is.
pub(super) const ANY: usize = usize::MAX;

/// An array that is handed out.
pub(super) type Out<'py, const N: usize, T = f64> = Bound<'py, PyArray<T, Dim<[usize; N]>>>;

/// The values of an array in C order, and its shape, which has to be the expected one.
pub(super) fn given<T: Element + Copy, const N: usize>(
    name: &'static str,
    argument: &Bound<'_, PyAny>,
    expected: [usize; N],
) -> PyResult<(Vec<T>, [usize; N])>
where
    Dim<[usize; N]>: Dimension,
{
    let array = array::<T, Dim<[usize; N]>>(name, argument)?;
    let mut found = expected;
    found.copy_from_slice(array.shape());
    let expected: [usize; N] = std::array::from_fn(|i| match expected[i] {
        ANY => found[i],
        length => length,
    });
    shape(name, &expected, &found)?;
    Ok((copied(name, &array)?, found))
}

/// The values alone.
pub(super) fn values<T: Element + Copy, const N: usize>(
    name: &'static str,
    argument: &Bound<'_, PyAny>,
    expected: [usize; N],
) -> PyResult<Vec<T>>
where
    Dim<[usize; N]>: Dimension,
{
    Ok(given(name, argument, expected)?.0)
}

/// Those of an argument that may be None.
pub(super) fn optional<T: Element + Copy, const N: usize>(
    name: &'static str,
    argument: Option<&Bound<'_, PyAny>>,
    expected: [usize; N],
) -> PyResult<Option<Vec<T>>>
where
    Dim<[usize; N]>: Dimension,
{
    let values = argument.map(|argument| values(name, argument, expected));
    values.transpose()
}

/// As an array of some shape.
pub(super) fn out<T: Element, const N: usize>(
    py: Python<'_>,
    values: Vec<T>,
    shape: [usize; N],
) -> Out<'_, N, T>
where
    Dim<[usize; N]>: Dimension,
    [usize; N]: IntoDimension<Dim = Dim<[usize; N]>>,
{
    let array = Array::from_shape_vec(shape.into_dimension(), values);
    array
        .expect("the shape's own number of values")
        .into_pyarray(py)
}

/// Rows of N numbers as an array (M, N).
pub(super) fn rows<'py, const N: usize>(
    py: Python<'py>,
    name: &'static str,
    rows: impl ExactSizeIterator<Item = [f64; N]>,
) -> PyResult<Out<'py, 2>> {
    let count = rows.len();
    let rows = collect(name, count, rows)?;
    Ok(out(py, rows.into_flattened(), [count, N]))
}

/// The values in C order, whatever the array's strides; an error where there is not enough memory, for
/// a broadcast array can pretend to any size.
pub(super) fn copied<T: Element + Copy, D: Dimension>(
    name: &'static str,
    array: &PyReadonlyArray<'_, T, D>,
) -> Result<Vec<T>> {
    let view: ArrayView<T, D> = array.as_array();
    match view.as_slice() {
        Some(values) => collect(name, values.len(), values.iter().copied()),
        None => collect(name, view.len(), view.iter().copied()),
    }
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
            _ => Cow::Owned(copied(name, array)?),
        }))
    }

    pub(super) fn values(&self) -> &[T] {
        &self.0
    }
}

/// Vectors from an array (M, 3), of `count` rows or any.
pub(super) fn vectors(
    name: &'static str,
    argument: &Bound<'_, PyAny>,
    count: usize,
) -> PyResult<Vec<DVec3>> {
    let (values, [count, _]) = given::<f64, 2>(name, argument, [count, 3])?;
    Ok(vectors_of(name, count, &values)?)
}

/// So many vectors from their coordinates.
pub(super) fn vectors_of(name: &'static str, count: usize, values: &[f64]) -> Result<Vec<DVec3>> {
    let vectors = values.as_chunks().0.iter();
    collect(name, count, vectors.map(|&v| DVec3::from_array(v)))
}

/// Rows of an (M, 3) array: its own memory where they lie there one after the other, else a copy.
pub(super) fn vector_rows<'a>(
    name: &'static str,
    array: &'a PyReadonlyArray<'_, f64, Ix2>,
) -> Result<Cow<'a, [DVec3]>> {
    Ok(match Contiguous::try_of(name, array)?.0 {
        Cow::Borrowed(values) => Cow::Borrowed(cast_slice(values)),
        Cow::Owned(values) => Cow::Owned(vectors_of(name, array.shape()[0], &values)?),
    })
}

/// What is given for each pixel.
pub(super) struct Pixels {
    pub(super) normals: Vec<DVec3>,
    pub(super) views: Vec<DVec3>,
    /// In \[0, 1\].
    pub(super) materials: Vec<Material>,
}

impl Pixels {
    /// From normals and views, so called, (M, 3), albedo (M, 3), roughness (M,) and metallic (M,).
    pub(super) fn new(
        names: [&'static str; 2],
        [normals, views, albedo, roughness, metallic]: [&Bound<'_, PyAny>; 5],
    ) -> PyResult<Self> {
        let materials = materials([albedo, roughness, metallic], ANY)?;
        Ok(Self {
            normals: vectors(names[0], normals, materials.len())?,
            views: vectors(names[1], views, materials.len())?,
            materials,
        })
    }

    pub(super) fn count(&self) -> usize {
        self.materials.len()
    }
}

/// Albedo (M, 3), roughness (M,) and metallic (M,), in \[0, 1\], of `count` materials or any.
pub(super) fn materials(
    [albedo, roughness, metallic]: [&Bound<'_, PyAny>; 3],
    count: usize,
) -> PyResult<Vec<Material>> {
    let (albedo, [count, _]) = given::<f64, 2>("albedo", albedo, [count, 3])?;
    let roughness = values::<f64, 1>("roughness", roughness, [count])?;
    let metallic = values::<f64, 1>("metallic", metallic, [count])?;
    check::unit_interval("albedo", &albedo)?;
    check::unit_interval("roughness", &roughness)?;
    check::unit_interval("metallic", &metallic)?;
    let albedo = albedo.as_chunks::<3>().0;
    let material = |i: usize| Material {
        albedo: albedo[i],
        roughness: roughness[i],
        metallic: metallic[i],
    };
    Ok(collect("albedo", count, (0..count).map(material))?)
}

/// Indices out of an array of uint64.
pub(super) fn indices(name: &'static str, argument: &Bound<'_, PyAny>) -> PyResult<Vec<usize>> {
    let indices = values::<u64, 1>(name, argument, [ANY])?;
    Ok(indices.into_iter().map(|i| i as usize).collect())
}

pub(super) fn shape(name: &'static str, expected: &[usize], found: &[usize]) -> Result<()> {
    if expected == found {
        return Ok(());
    }
    let [expected, found] = [expected, found].map(|shape| format!("shape {shape:?}"));
    Err(Error::argument(name, expected, found))
}
