//! `pbrfit._core.Surroundings`: triangles that light meets.

use glam::DVec3;
use pyo3::prelude::*;

use super::arrays::{ANY, Out, given as given_array, optional, out, values, vectors};
use crate::reflectance::model::{Model, with_model};
use crate::reflectance::reflection::Reflection;
use crate::reflectance::sh::COEFFICIENTS;
use crate::runtime::{Error, check};
use crate::transport::surroundings::{LARGEST, Surroundings};
use crate::transport::table::{Origins, Radiance, Transfer, transfer};

#[pyclass(frozen, name = "Surroundings", module = "pbrfit._core")]
pub(super) struct PySurroundings {
    surroundings: Surroundings,
}

#[pymethods]
impl PySurroundings {
    #[new]
    fn new(
        py: Python<'_>,
        triangles: &Bound<'_, PyAny>,
        surfaces: &Bound<'_, PyAny>,
    ) -> PyResult<Self> {
        let (corners, _) = given_array::<f32, 3>("triangles", triangles, [ANY, 3, 3])?;
        let surfaces = values::<u8, 1>("surfaces", surfaces, [ANY])?;
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
    ) -> PyResult<Out<'py, 1, f32>> {
        let origins = vectors("origins", origins, ANY)?;
        let directions = vectors("directions", directions, ANY)?;
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
        Ok(out(py, distances, [origins.len()]))
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
    ) -> PyResult<(Out<'py, 3, f32>, Option<Out<'py, 3, f32>>)> {
        let model: Model = model.parse()?;
        let points = vectors("points", points, ANY)?;
        let normals = vectors("normals", normals, ANY)?;
        let views = vectors("views", views, ANY)?;
        let seeds = values::<u64, 1>("seeds", seeds, [ANY])?;
        let radiance = radiance
            .map(|radiance| given_array::<f32, 3>("radiance", radiance, [ANY; 3]))
            .transpose()?;
        let nearest = optional::<u32, 1>("nearest", nearest, [ANY])?.unwrap_or_default();
        let origins = Origins {
            points: &points,
            normals: &normals,
            views: &views,
            seeds: &seeds,
        };
        let given = (radiance.as_ref()).map(|(samples, [height, width, _])| Radiance {
            samples,
            size: [*height, *width],
            half_width,
            nearest: &nearest,
        });
        let found =
            py.detach(|| transfer(&self.surroundings, origins, model, rays, given, threads))?;
        let rows = with_model!(model, M => 1 + M::ROWS);
        let bounced =
            radiance.map(|(_, [.., values])| out(py, found.bounced, [points.len(), rows, values]));
        Ok((
            out(py, found.rows, [points.len(), rows, COEFFICIENTS]),
            bounced,
        ))
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
    let [pixels, rows, brought] = expected;
    let bounced = optional("bounced", bounced, [pixels, rows, brought])?;
    Ok(Some(Transfer {
        rows: values("transfer", transfer, [pixels, rows, COEFFICIENTS])?,
        bounced: bounced.unwrap_or_default(),
    }))
}
