//! `pbrfit._core`: what is unfinished, and an end that does not wait for the interpreter.

use std::path::PathBuf;

use pyo3::prelude::*;

use crate::runtime::ending::{self, Unfinished};

pub(super) fn register(module: &Bound<'_, PyModule>) -> PyResult<()> {
    module.add_function(wrap_pyfunction!(unfinished, module)?)?;
    module.add_function(wrap_pyfunction!(finished, module)?)?;
    module.add_function(wrap_pyfunction!(hold_end, module)?)?;
    module.add_function(wrap_pyfunction!(allow_end, module)?)?;
    module.add_function(wrap_pyfunction!(last_word, module)?)?;
    module.add_function(wrap_pyfunction!(end_when_told, module)?)
}

/// Notes what an end has to take away, and what to put back: (set aside, its name).
#[pyfunction]
#[pyo3(signature = (temporary, aside = None, parents = Vec::new()))]
fn unfinished(
    py: Python<'_>,
    temporary: PathBuf,
    aside: Option<(PathBuf, PathBuf)>,
    parents: Vec<PathBuf>,
) -> u64 {
    py.detach(|| {
        ending::unfinished(Unfinished {
            temporary,
            aside,
            parents,
        })
    })
}

/// What `unfinished` noted under this number is not there any more.
#[pyfunction]
fn finished(py: Python<'_>, number: u64) {
    py.detach(|| ending::finished(number));
}

/// The process is not ended until `allow_end`, or for a quarter of a second.
#[pyfunction]
fn hold_end(py: Python<'_>) {
    py.detach(ending::hold_end);
}

#[pyfunction]
fn allow_end(py: Python<'_>) {
    py.detach(ending::allow_end);
}

/// Whether the caller may tell the user why the process ends.
#[pyfunction]
fn last_word(py: Python<'_>) -> bool {
    py.detach(ending::last_word)
}

/// The number of a file for `signal.set_wakeup_fd`; None where processes are not told by signals.
#[cfg(unix)]
#[pyfunction]
fn end_when_told(grace: f64, word: String, signals: Vec<i32>) -> PyResult<Option<i32>> {
    let grace = std::time::Duration::try_from_secs_f64(grace)
        .map_err(|error| super::InputError::new_err(format!("grace: {error}")))?;
    Ok(Some(ending::watch(grace, word, signals)?))
}

#[cfg(not(unix))]
#[pyfunction]
#[expect(unused_variables)]
fn end_when_told(grace: f64, word: String, signals: Vec<i32>) -> Option<i32> {
    None
}
