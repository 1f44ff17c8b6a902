//! The numerical core of pbrfit.
pub mod error;
pub mod image_file;
#[cfg(feature = "python")]
mod python;

pub use error::{Error, Result};
