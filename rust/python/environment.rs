//! `pbrfit._core.Environment`: a panorama as light.

use pyo3::prelude::*;

use super::arrays::{ANY, Out, Pixels, given, out, shape};
use crate::environment::blurred::Blurred;
use crate::environment::lobes::{CELLS, LOBES, nodes};
use crate::environment::render::render_environment;
use crate::runtime::check;

/// (roughness, n·v, lobe, 4): angle, level, a and b of the lobes.
#[pyfunction]
pub(super) fn environment_lobes<'py>(py: Python<'py>, model: &str) -> PyResult<Out<'py, 4, f32>> {
    let numbers = nodes(model.parse()?).iter().flatten().copied().collect();
    Ok(out(py, numbers, [CELLS[0] + 1, CELLS[1] + 1, LOBES, 4]))
}

#[pyclass(frozen, name = "Environment", module = "pbrfit._core")]
pub(super) struct PyEnvironment {
    light: Blurred,
}

#[pymethods]
impl PyEnvironment {
    #[new]
    fn new(py: Python<'_>, pixels: &Bound<'_, PyAny>, threads: usize) -> PyResult<Self> {
        let (pixels, found) = given::<f32, 3>("pixels", pixels, [ANY; 3])?;
        let rows = found[0];
        shape("pixels", &[rows, 2 * rows, 3], &found)?;
        let light = py.detach(|| {
            check::moderate("pixels", &pixels, check::LARGEST_F32)?;
            Blurred::new(pixels.as_chunks().0, rows, threads)
        })?;
        Ok(Self { light })
    }

    /// The panorama by growing blur, and its two hemispheres: (rows, columns, 3) each.
    fn levels<'py>(&self, py: Python<'py>) -> Vec<Out<'py, 3, f32>> {
        let grids = self.light.levels.iter().chain(&self.light.hemispheres);
        grids
            .map(|grid| {
                let numbers = grid.texels.iter().flatten().copied().collect();
                out(py, numbers, [grid.columns / 2, grid.columns, 3])
            })
            .collect()
    }

    /// Radiance of pixels, (pixel, channel), under the light turned by so many radians.
    #[expect(clippy::too_many_arguments)]
    fn radiance<'py>(
        &self,
        py: Python<'py>,
        normals: &Bound<'py, PyAny>,
        views: &Bound<'py, PyAny>,
        albedo: &Bound<'py, PyAny>,
        roughness: &Bound<'py, PyAny>,
        metallic: &Bound<'py, PyAny>,
        turn: f64,
        threads: usize,
        model: &str,
    ) -> PyResult<Out<'py, 2>> {
        let model = model.parse()?;
        let given = [normals, views, albedo, roughness, metallic];
        let pixels = Pixels::new(["normals", "views"], given)?;
        check::moderate("turn", &[turn], check::LARGEST_F64)?;
        let (normals, views) = (&pixels.normals, &pixels.views);
        let (materials, light) = (&pixels.materials, &self.light);
        let image = py.detach(|| {
            render_environment(normals, views, materials, light, turn, threads, model)
        })?;
        Ok(out(py, image, [pixels.count(), 3]))
    }
}
