//! The one error type of the crate.

use std::path::{Path, PathBuf};

/// What can go wrong. Every message is one line that names the array or the
/// file, what was expected and what was found. A panic, by contrast, is a bug.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// An argument has the wrong shape or holds a value that cannot be used.
    #[error("{name}: expected {expected}, found {found}")]
    Argument {
        /// Name of the array or option, as the caller knows it.
        name: &'static str,
        /// What would have been accepted.
        expected: String,
        /// What was there instead.
        found: String,
    },
    /// The machine has not enough memory for an array.
    #[error("{0}: expected memory for a copy, found too little")]
    Memory(&'static str),
    /// A file was read but its content cannot be used.
    #[error("{}: {reason}", path.display())]
    Content {
        /// The file.
        path: PathBuf,
        /// Expected and found, in words.
        reason: String,
    },
    /// The operating system refused to read or write a file.
    #[error("{}: {source}", path.display())]
    Io {
        /// The file.
        path: PathBuf,
        /// The system's own error.
        source: std::io::Error,
    },
}

impl Error {
    /// An [`Error::Argument`] from anything that can be shown.
    pub fn argument(name: &'static str, expected: impl ToString, found: impl ToString) -> Self {
        Self::Argument {
            name,
            expected: expected.to_string(),
            found: found.to_string(),
        }
    }

    /// An [`Error::Io`] about a file.
    pub fn io(path: &Path, source: std::io::Error) -> Self {
        let path = path.to_owned();
        Self::Io { path, source }
    }
}

/// Shorthand for results of this crate.
pub type Result<T> = std::result::Result<T, Error>;
