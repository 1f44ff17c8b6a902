//! `pbrfit._core.Surroundings`: triangles that light meets.

use glam::DVec3;
use numpy::{IntoPyArray, Ix1, Ix3, PyArray1, PyArray3, PyReadonlyArray, PyUntypedArrayMethods};
use pyo3::prelude::*;

use super::arrays::{array, shape, try_copied, vectors};
use super::model::array3;
use crate::reflectance::model::{Model, with_model};
use crate::reflectance::reflection::Reflection;
use crate::reflectance::sh::COEFFICIENTS;
use crate::runtime::{Error, check};
use crate::transport::surroundings::{LARGEST, Surroundings};
use crate::transport::table::{Origins, Radiance, Transfer, transfer};

pub(super) fn register(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add_class::<PySurroundings>()
}

#[pyclass(frozen, name = "Surroundings", module = "pbrfit._core")]
struct PySurroundings {
    surroundings: Surroundings,
}

/// Rows of pixels, and what is brought to them.
type Tables<'py> = (Bound<'py, PyArray3<f32>>, Option<Bound<'py, PyArray3<f32>>>);

#[pymethods]
impl PySurroundings {
    #[new]
    fn new(
        py: Python<'_>,
        triangles: &Bound<'_, PyAny>,
        surfaces: &Bound<'_, PyAny>,
    ) -> PyResult<Self> {
        let triangles: PyReadonlyArray<'_, f32, Ix3> = array("triangles", triangles)?;
        let count = triangles.shape()[0];
        shape("triangles", &[count, 3, 3], triangles.shape())?;
        let corners = try_copied("triangles", &triangles)?;
        let surfaces = try_copied("surfaces", &array::<u8, Ix1>("surfaces", surfaces)?)?;
        let surroundings = py.detach(|| {
            let corners: &[[f32; 3]] = corners.as_chunks().0;
            Surroundings::new(corners.as_chunks().0, &surfaces)
        })?;
        Ok(Self { surroundings })
    }

    #[getter]
    fn last_surface(&self) -> u8 {
        self.surroundings.last_surface()
    }

    /// Distance to what each ray meets, infinite where it leaves.
    fn distances<'py>(
        &self,
        py: Python<'py>,
        origins: &Bound<'py, PyAny>,
        directions: &Bound<'py, PyAny>,
    ) -> PyResult<Bound<'py, PyArray1<f32>>> {
        let (origins, directions) = (array("origins", origins)?, array("directions", directions)?);
        let origins = vectors("origins", &origins)?.into_owned();
        let directions = vectors("directions", &directions)?.into_owned();
        let distances = py.detach(|| {
            check::length("directions", origins.len(), directions.len())?;
            check::unit_vectors("directions", &directions)?;
            let coordinates: Vec<f64> = origins.iter().flat_map(DVec3::to_array).collect();
            check::moderate("origins", &coordinates, LARGEST)?;
            let rays = origins.iter().zip(&directions);
            crate::Result::Ok(
                rays.map(|(&origin, &direction)| {
                    let [origin, direction] = [origin, direction].map(|v: DVec3| v.as_vec3a());
                    let hit = self.surroundings.hit(origin, direction);
                    hit.map_or(f32::INFINITY, |hit| hit.distance)
                })
                .collect::<Vec<_>>(),
            )
        })?;
        Ok(distances.into_pyarray(py))
    }

    #[pyo3(signature = (
        points, normals, views, seeds, *,
        rays, model, threads = 0, radiance = None, half_width = 0.0, nearest = None
    ))]
    #[expect(clippy::too_many_arguments)]
    fn transfer<'py>(
        &self,
        py: Python<'py>,
        points: &Bound<'py, PyAny>,
        normals: &Bound<'py, PyAny>,
        views: &Bound<'py, PyAny>,
        seeds: &Bound<'py, PyAny>,
        rays: usize,
        model: &str,
        threads: usize,
        radiance: Option<&Bound<'py, PyAny>>,
        half_width: f32,
        nearest: Option<&Bound<'py, PyAny>>,
    ) -> PyResult<Tables<'py>> {
        let model: Model = model.parse()?;
        let points = array("points", points)?;
        let normals = array("normals", normals)?;
        let views = array("views", views)?;
        let [points, normals, views] = [
            vectors("points", &points)?.into_owned(),
            vectors("normals", &normals)?.into_owned(),
            vectors("views", &views)?.into_owned(),
        ];
        let seeds = try_copied("seeds", &array::<u64, Ix1>("seeds", seeds)?)?;
        let radiance = radiance
            .map(|radiance| {
                let radiance = array::<f32, Ix3>("radiance", radiance)?;
                let size = [radiance.shape()[0], radiance.shape()[1]];
                let values = radiance.shape()[2];
                PyResult::Ok((try_copied("radiance", &radiance)?, size, values))
            })
            .transpose()?;
        let nearest = match nearest {
            Some(nearest) => try_copied("nearest", &array::<u32, Ix1>("nearest", nearest)?)?,
            None => Vec::new(),
        };
        let origins = Origins {
            points: &points,
            normals: &normals,
            views: &views,
            seeds: &seeds,
        };
        let given = radiance.as_ref().map(|(samples, size, _)| Radiance {
            samples,
            size: *size,
            half_width,
            nearest: &nearest,
        });
        let found =
            py.detach(|| transfer(&self.surroundings, origins, model, rays, given, threads))?;
        let rows = with_model!(model, M => 1 + M::ROWS);
        let bounced = radiance.map(|(_, _, values)| {
            array3(found.bounced, [points.len(), rows, values]).into_pyarray(py)
        });
        let rows = array3(found.rows, [points.len(), rows, COEFFICIENTS]).into_pyarray(py);
        Ok((rows, bounced))
    }
}

/// A transfer as it comes from Python: rows (pixel, row, 16), and what is brought to each.
pub(super) fn given(
    transfer: Option<&Bound<'_, PyAny>>,
    bounced: Option<&Bound<'_, PyAny>>,
    expected: [usize; 3],
) -> PyResult<Option<Transfer>> {
    let Some(transfer) = transfer else {
        if bounced.is_some() {
            let expected = "rows, beside what is brought to them";
            return Err(Error::argument("transfer", expected, "none").into());
        }
        return Ok(None);
    };
    let [pixels, rows, values] = expected;
    let transfer = array::<f32, Ix3>("transfer", transfer)?;
    shape("transfer", &[pixels, rows, COEFFICIENTS], transfer.shape())?;
    let bounced = bounced
        .map(|bounced| {
            let bounced = array::<f32, Ix3>("bounced", bounced)?;
            shape("bounced", &[pixels, rows, values], bounced.shape())?;
            PyResult::Ok(try_copied("bounced", &bounced)?)
        })
        .transpose()?;
    Ok(Some(Transfer {
        rows: try_copied("transfer", &transfer)?,
        bounced: bounced.unwrap_or_default(),
    }))
}
