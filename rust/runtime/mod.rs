//! What everything stands on: errors, checks of arguments, threads, vector instructions, and an end
//! that does not wait. It knows nothing of pictures.

pub(crate) mod check;
#[cfg_attr(not(all(unix, feature = "python")), expect(dead_code))] // nobody ends
pub(crate) mod ending;
mod error;
pub(crate) mod memory;
pub(crate) mod pool;
pub mod simd;

pub use self::error::{Error, Result};
