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
    let (albedo, roughness, metallic) =
        (albedo.as_array(), roughness.as_array(), metallic.as_array());
    let pixels = albedo.nrows();
    shape("albedo", &[pixels, 3], albedo.shape())?;
    shape("roughness", &[pixels], roughness.shape())?;
    shape("metallic", &[pixels], metallic.shape())?;
    let material =
        |((albedo, &roughness), &metallic): ((numpy::ndarray::ArrayView1<f64>, _), _)| Material {
            albedo: [albedo[0], albedo[1], albedo[2]],
            roughness,
            metallic,
        };
    let materials: Vec<Material> = albedo
        .rows()
        .into_iter()
        .zip(roughness)
        .zip(metallic)
        .map(material)
        .collect();
    let all = |of: fn(&Material) -> f64| materials.iter().map(of).collect::<Vec<_>>();
    let albedo: Vec<f64> = materials.iter().flat_map(|m| m.albedo).collect();
    check::unit_interval("albedo", &albedo)?;
    check::unit_interval("roughness", &all(|m| m.roughness))?;
    check::unit_interval("metallic", &all(|m| m.metallic))?;
    Ok(materials)
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
