//! Arrays whose size a caller decides: an error, and no abort, where there is not enough memory.

use super::{Error, Result};

/// `count` default values; `name` is the array in the error's message.
pub(crate) fn zeros<T: Clone + Default>(name: &'static str, count: usize) -> Result<Vec<T>> {
    // Asked for twice: whether there is memory, and then as zeros, which the system hands out page
    // by page to the threads that write there.
    collect(name, count, std::iter::empty::<T>())?;
    Ok(vec![T::default(); count])
}

/// Values, `count` of them; `name` as of [`zeros`].
pub(crate) fn collect<T>(
    name: &'static str,
    count: usize,
    values: impl IntoIterator<Item = T>,
) -> Result<Vec<T>> {
    let mut collected = Vec::new();
    collected
        .try_reserve_exact(count)
        .map_err(|_| Error::Memory(name))?;
    collected.extend(values);
    Ok(collected)
}
