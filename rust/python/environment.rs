//! `pbrfit._core.Environment`: a panorama as light.

use numpy::ndarray::{Array3, Array4};
use numpy::{IntoPyArray, Ix3, PyArray2, PyArray3, PyArray4, PyUntypedArrayMethods};
use pyo3::prelude::*;

use super::arrays::{array, collect, shape, try_copied};
use super::model::{Pixels, array2};
use crate::environment::blurred::{Blurred, Grid};
use crate::environment::lobes::{CELLS, LOBES, nodes};
use crate::environment::render::render_environment;
use crate::runtime::check;

pub(super) fn register(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add_function(wrap_pyfunction!(environment_lobes, module)?)?;
    module.add_class::<PyEnvironment>()
}

/// (roughness, n·v, lobe, 4): angle, level, a and b of the lobes.
#[pyfunction]
fn environment_lobes<'py>(py: Python<'py>, model: &str) -> PyResult<Bound<'py, PyArray4<f32>>> {
    let numbers = nodes(model.parse()?).iter().flatten().copied().collect();
    let shape = (CELLS[0] + 1, CELLS[1] + 1, LOBES, 4);
    let table = Array4::from_shape_vec(shape, numbers).expect("as many");
    Ok(table.into_pyarray(py))
}

#[pyclass(frozen, name = "Environment", module = "pbrfit._core")]
struct PyEnvironment {
    light: Blurred,
}

#[pymethods]
impl PyEnvironment {
    #[new]
    fn new(py: Python<'_>, pixels: &Bound<'_, PyAny>, threads: usize) -> PyResult<Self> {
        let pixels = array::<f32, Ix3>("pixels", pixels)?;
        let rows = pixels.shape()[0];
        shape("pixels", &[rows, 2 * rows, 3], pixels.shape())?;
        let pixels = try_copied("pixels", &pixels)?;
        let light = py.detach(|| {
            check::moderate("pixels", &pixels, check::LARGEST_F32)?;
            Blurred::new(pixels.as_chunks().0, rows, threads)
        })?;
        Ok(Self { light })
    }

    /// The panorama by growing blur, and its two hemispheres: (rows, columns, 3) each.
    fn levels<'py>(&self, py: Python<'py>) -> Vec<Bound<'py, PyArray3<f32>>> {
        let grids = self.light.levels.iter().chain(&self.light.hemispheres);
        grids.map(|grid| of_grid(py, grid)).collect()
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
    ) -> PyResult<Bound<'py, PyArray2<f64>>> {
        let model = model.parse()?;
        let pixels = Pixels::new(
            ("normals", normals),
            ("views", views),
            albedo,
            roughness,
            metallic,
        )?;
        check::moderate("turn", &[turn], check::LARGEST_F64)?;
        let Pixels {
            normals,
            views,
            materials,
            ..
        } = &pixels;
        let light = &self.light;
        let image = py.detach(|| {
            render_environment(normals, views, materials, light, turn, threads, model)
        })?;
        let rows = image.as_chunks::<3>().0.iter().copied();
        Ok(array2(collect("normals", pixels.count(), rows)?).into_pyarray(py))
    }
}

fn of_grid<'py>(py: Python<'py>, grid: &Grid) -> Bound<'py, PyArray3<f32>> {
    let numbers = grid.texels.iter().flatten().copied().collect();
    let shape = (grid.columns / 2, grid.columns, 3);
    Array3::from_shape_vec(shape, numbers)
        .expect("as many")
        .into_pyarray(py)
}
