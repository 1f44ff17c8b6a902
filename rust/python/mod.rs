//! The one place that names pyo3 and numpy: arrays in, arrays out.
//!
//! Every function copies its input before it releases the interpreter lock: a borrowed numpy array
//! could be changed by another thread meanwhile. Only making a `Problem` keeps the lock instead.

mod arrays;
mod ending;
mod environment;
mod image_file;
mod images;
mod lamps;
mod model;
mod poisson;
mod problem;
mod surroundings;

use std::sync::LazyLock;

use numpy::PyArray1;
use pyo3::create_exception;
use pyo3::exceptions::{PyMemoryError, PyOSError, PyValueError};
use pyo3::prelude::*;

use crate::environment::lobes;
use crate::reflectance::{band_table, lobe_table};
use crate::runtime::Error;

create_exception!(
    pbrfit._core,
    InputError,
    PyValueError,
    "Unusable input: the message names the file or array, what was expected and what was found."
);

impl From<Error> for PyErr {
    fn from(error: Error) -> Self {
        match error {
            Error::Argument { .. } | Error::Content { .. } => {
                InputError::new_err(error.to_string())
            }
            Error::Memory(_) => PyMemoryError::new_err(error.to_string()),
            Error::Io { path, source } => {
                // OSError(errno, text, path) lets Python choose FileNotFoundError and its kin.
                let code = source.raw_os_error();
                match code {
                    Some(code) => {
                        // Rust adds the code to the words; Python has it apart.
                        let words = source.to_string();
                        let words = words.trim_end_matches(&format!(" (os error {code})"));
                        PyOSError::new_err((code, words.to_owned(), path.display().to_string()))
                    }
                    None => PyOSError::new_err(format!("{}: {source}", path.display())),
                }
            }
        }
    }
}

/// The extension module `pbrfit._core`.
#[pymodule]
mod _core {
    use super::*;

    #[pymodule_export]
    use super::InputError;
    #[pymodule_export]
    use super::ending::{allow_end, end_when_told, finished, hold_end, last_word, unfinished};
    #[pymodule_export]
    use super::environment::{PyEnvironment, environment_lobes};
    #[pymodule_export]
    use super::image_file::{
        Raster, average_light, decode_exr, decode_icc, decode_raster, encode_png, image_format,
        tiff_pages, write_exr, write_png,
    };
    #[pymodule_export]
    use super::lamps::{PyLampSamples, lamp_radiance};
    #[pymodule_export]
    use super::model::{
        ggx_band_weights, lobe_functions, lobe_table_file, render, sh_basis, shade, shade_vjp,
    };
    #[pymodule_export]
    use super::poisson::poisson_heights;
    #[pymodule_export]
    use super::problem::{PyKeptSystem, PyProblem};
    #[pymodule_export]
    use super::surroundings::PySurroundings;

    #[pymodule_init]
    fn init(module: &Bound<'_, PyModule>) -> PyResult<()> {
        // Under the interpreter lock, without which nobody forks: a child that was forked while
        // another thread makes the table would wait for it for ever.
        LazyLock::force(&band_table::TABLE);
        lobe_table::prepare();
        lobes::prepare();
        // Numpy's functions are looked up when first used, where a Ctrl-C would become a panic.
        module.py().import("numpy")?;
        PyArray1::<f64>::zeros(module.py(), 0, false);
        Ok(())
    }
}
