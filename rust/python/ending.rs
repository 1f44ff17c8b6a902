//! `pbrfit._core`: what is unfinished, and an end that does not wait for the interpreter.

use std::path::PathBuf;

use pyo3::prelude::*;

use crate::runtime::ending::{self, Unfinished};

/// Notes what an end has to take away, and what to put back: (set aside, its name).
#[pyfunction]
#[pyo3(signature = (temporary, aside = None, parents = Vec::new()))]
pub(super) fn unfinished(
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
pub(super) fn finished(py: Python<'_>, number: u64) {
    py.detach(|| ending::finished(number));
}

/// The process is not ended until `allow_end`, or for a quarter of a second.
#[pyfunction]
pub(super) fn hold_end(py: Python<'_>) {
    py.detach(ending::hold_end);
}

#[pyfunction]
pub(super) fn allow_end(py: Python<'_>) {
    py.detach(ending::allow_end);
}

/// Whether the caller may tell the user why the process ends.
#[pyfunction]
pub(super) fn last_word(py: Python<'_>) -> bool {
    py.detach(ending::last_word)
}

/// The number of a file for `signal.set_wakeup_fd`; None where processes are not told by signals.
#[cfg(unix)]
#[pyfunction]
pub(super) fn end_when_told(grace: f64, word: String, signals: Vec<i32>) -> PyResult<Option<i32>> {
    let grace = std::time::Duration::try_from_secs_f64(grace)
        .map_err(|error| super::InputError::new_err(format!("grace: {error}")))?;
    Ok(Some(ending::watch(grace, word, signals)?))
}

#[cfg(not(unix))]
#[pyfunction]
#[expect(unused_variables)]
pub(super) fn end_when_told(grace: f64, word: String, signals: Vec<i32>) -> Option<i32> {
    None
}
