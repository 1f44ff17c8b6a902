//! Poisson's equation on a picture.

use pyo3::prelude::*;

use super::arrays::{ANY, Out, given, out, values};
use crate::poisson::{self, Couplings};

/// Heights (H, W) from (H, W) arrays.
#[pyfunction]
#[expect(clippy::too_many_arguments)]
pub(super) fn poisson_heights<'py>(
    py: Python<'py>,
    across: &Bound<'py, PyAny>,
    down: &Bound<'py, PyAny>,
    held: &Bound<'py, PyAny>,
    right: &Bound<'py, PyAny>,
    start: &Bound<'py, PyAny>,
    enough: f64,
    threads: usize,
) -> PyResult<Out<'py, 2>> {
    let (across, shape) = given::<f64, 2>("across", across, [ANY; 2])?;
    let down = values("down", down, shape)?;
    let held = values("held", held, shape)?;
    let right = values("right", right, shape)?;
    let start = values("start", start, shape)?;
    let found = py.detach(|| {
        let (across, down, held) = (&across, &down, &held);
        let couplings = Couplings {
            shape,
            across,
            down,
            held,
        };
        poisson::solve(couplings, &right, &start, enough, threads)
    })?;
    Ok(out(py, found, shape))
}
