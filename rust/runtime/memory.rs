//! Arrays whose size a caller decides: an error, and no abort, where there is not enough memory.

use super::{Error, Result};

/// `count` default values; `name` is the array in the error's message.
pub(crate) fn zeros<T: Clone + Default>(name: &'static str, count: usize) -> Result<Vec<T>> {
    let mut values = Vec::new();
    values
        .try_reserve_exact(count)
        .map_err(|_| Error::Memory(name))?;
    values.resize(count, T::default());
    Ok(values)
}
