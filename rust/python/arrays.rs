//! Copies of numpy arrays: what crosses the boundary belongs to Rust from then on.

use glam::DVec3;
use numpy::ndarray::{ArrayView, Dimension};
use numpy::{Element, PyReadonlyArray, PyReadonlyArray1, PyReadonlyArray2};

use crate::shade::Material;
use crate::{Error, Result, check};

/// The values in C order, whatever the array's strides.
pub(super) fn copied<T: Element + Copy, D: Dimension>(array: &PyReadonlyArray<'_, T, D>) -> Vec<T> {
    let view: ArrayView<T, D> = array.as_array();
    view.iter().copied().collect()
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
