//! `pbrfit._core.Problem`: the pictures, and the loss over them.

use numpy::{
    IntoPyArray, PyArray1, PyArray3, PyReadonlyArray1, PyReadonlyArray2, PyReadonlyArray3,
};
use pyo3::prelude::*;

use super::arrays::{copied, shape, vectors};
use super::model::array3;
use crate::problem::Problem;
use crate::sh::COEFFICIENTS;

pub(super) fn register(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add_class::<PyProblem>()
}

#[pyclass(frozen, name = "Problem", module = "pbrfit._core")]
struct PyProblem(Problem);

#[pymethods]
impl PyProblem {
    #[new]
    #[pyo3(signature = (images, normals, views, threads = 0))]
    fn new(
        py: Python<'_>,
        images: PyReadonlyArray3<'_, f32>,
        normals: PyReadonlyArray2<'_, f64>,
        views: PyReadonlyArray2<'_, f64>,
        threads: usize,
    ) -> PyResult<Self> {
        let (normals, views) = (vectors("normals", &normals)?, vectors("views", &views)?);
        let pictures = images.as_array().shape()[0];
        shape(
            "images",
            &[pictures, normals.len(), 3],
            images.as_array().shape(),
        )?;
        let images = copied(&images);
        let problem = py.detach(|| Problem::new(&images, pictures, &normals, &views, threads))?;
        Ok(Self(problem))
    }

    #[getter]
    fn size(&self) -> usize {
        self.0.size()
    }

    #[getter]
    fn pixels(&self) -> usize {
        self.0.pixels()
    }

    #[getter]
    fn pictures(&self) -> usize {
        self.0.pictures()
    }

    fn value_and_grad<'py>(
        &self,
        py: Python<'py>,
        x: PyReadonlyArray1<'py, f64>,
    ) -> PyResult<(f64, Bound<'py, PyArray1<f64>>)> {
        let x = copied(&x);
        let mut gradient = vec![0.0; self.0.size()];
        let value = py.detach(|| self.0.value_and_grad(&x, &mut gradient))?;
        Ok((value, gradient.into_pyarray(py)))
    }

    fn render<'py>(
        &self,
        py: Python<'py>,
        x: PyReadonlyArray1<'py, f64>,
    ) -> PyResult<Bound<'py, PyArray3<f32>>> {
        let x = copied(&x);
        let images = py.detach(|| self.0.render(&x))?;
        Ok(array3(images, [self.0.pictures(), self.0.pixels(), 3]).into_pyarray(py))
    }

    #[expect(clippy::type_complexity)]
    fn light_equations<'py>(
        &self,
        py: Python<'py>,
        x: PyReadonlyArray1<'py, f64>,
    ) -> PyResult<(Bound<'py, PyArray3<f64>>, Bound<'py, PyArray3<f64>>)> {
        let x = copied(&x);
        let equations = py.detach(|| self.0.light_equations(&x))?;
        let gram = equations
            .iter()
            .flat_map(|e| e.gram.as_flattened())
            .copied()
            .collect();
        let right = equations
            .iter()
            .flat_map(|e| e.right.as_flattened())
            .copied()
            .collect();
        Ok((
            array3(gram, [3, COEFFICIENTS, COEFFICIENTS]).into_pyarray(py),
            array3(right, [3, self.0.pictures(), COEFFICIENTS]).into_pyarray(py),
        ))
    }
}
