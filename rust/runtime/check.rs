//! Checks of what callers hand over; every refusal names the array, the expected and the found.

use glam::DVec3;

use super::{Error, Result};

/// Samples (pixels times pictures) at most; more are refused.
pub(crate) const MAX_SAMPLES: usize = 1 << 31;

/// A sample says that radiance is at least this.
pub const AT_LEAST: u8 = 1;
/// A sample says that radiance is at most this.
pub const AT_MOST: u8 = 2;

/// Distance of a unit vector's length from 1 above which it is refused: ones that were normalised
/// in float32 pass.
const UNIT_TOLERANCE: f64 = 1e-5;

pub(crate) fn length(name: &'static str, expected: usize, found: usize) -> Result<()> {
    if expected == found {
        return Ok(());
    }
    Err(Error::argument(name, format!("{expected} numbers"), found))
}

/// As many pixels in each, their vectors of unit length; how many.
pub(crate) fn pixels(normals: &[DVec3], views: &[DVec3], materials: usize) -> Result<usize> {
    length("views", normals.len(), views.len())?;
    length("materials", normals.len(), materials)?;
    unit_vectors("normals", normals)?;
    unit_vectors("views", views)?;
    Ok(normals.len())
}

/// Pixels times `count` pictures, lights or lamps, which must not be too many.
pub(crate) fn samples(
    name: &'static str,
    kind: &str,
    count: usize,
    pixels: usize,
) -> Result<usize> {
    let samples = pixels.checked_mul(count).filter(|&s| s <= MAX_SAMPLES);
    samples.ok_or_else(|| {
        let expected = format!("at most {MAX_SAMPLES} pixels times {kind}");
        Error::argument(name, expected, format!("{count} {kind} of {pixels} pixels"))
    })
}

/// Largest radiance and light that are taken: up to here they do not overflow when they are
/// multiplied, squared and summed in float32.
pub(crate) const LARGEST_F32: f64 = 1e16;
/// Largest number that is taken where it is multiplied with weights or their derivatives, which are
/// below 10³, and summed in float64.
pub(crate) const LARGEST_F64: f64 = 1e304;

/// Finite, and no larger than a limit.
pub(crate) fn moderate<T: Copy + Into<f64>>(
    name: &'static str,
    values: &[T],
    limit: f64,
) -> Result<()> {
    moderate_from(name, 0, values, limit)
}

/// The same of a part of an array, from its number `first` on.
pub(crate) fn moderate_from<T: Copy + Into<f64>>(
    name: &'static str,
    first: usize,
    values: &[T],
    limit: f64,
) -> Result<()> {
    // Written so that NaN fails.
    let is_moderate = |&v: &T| v.into().abs() <= limit;
    let Some(i) = values.iter().position(|v| !is_moderate(v)) else {
        return Ok(());
    };
    let value: f64 = values[i].into();
    let i = first + i;
    Err(if value.is_finite() {
        let expected = format!("numbers up to {limit:e} in size");
        Error::argument(name, expected, format!("{value:e} at {i}"))
    } else {
        Error::argument(name, "finite numbers", format!("{value} at {i}"))
    })
}

/// Refuses the first value that is not `good`, with what is `shown` of it.
fn each<T>(
    name: &'static str,
    values: &[T],
    expected: &str,
    good: impl Fn(&T) -> bool,
    shown: impl Fn(&T) -> String,
) -> Result<()> {
    let Some(i) = values.iter().position(|value| !good(value)) else {
        return Ok(());
    };
    let found = format!("{} at {i}", shown(&values[i]));
    Err(Error::argument(name, expected, found))
}

pub(crate) fn unit_interval<T: Copy + Into<f64>>(name: &'static str, values: &[T]) -> Result<()> {
    let good = |&v: &T| (0.0..=1.0).contains(&v.into());
    each(name, values, "numbers in [0, 1]", good, |&v| {
        v.into().to_string()
    })
}

/// From 0, and no larger than a limit.
pub(crate) fn not_negative(name: &'static str, values: &[f64], limit: f64) -> Result<()> {
    moderate(name, values, limit)?;
    each(
        name,
        values,
        "numbers from 0",
        |&v| v >= 0.0,
        f64::to_string,
    )
}

/// Indices of `count` things.
pub(crate) fn indices(name: &'static str, count: usize, indices: &[usize]) -> Result<()> {
    match indices.iter().find(|&&i| i >= count) {
        None => Ok(()),
        Some(i) => Err(Error::argument(name, format!("indices below {count}"), i)),
    }
}

/// Weights must lie in \[0, 1\] and not all be zero. Returns their sum.
pub(crate) fn weights(name: &'static str, values: &[f32]) -> Result<f64> {
    unit_interval(name, values)?;
    let sum = values.iter().map(|&v| f64::from(v)).sum();
    if sum > 0.0 {
        return Ok(sum);
    }
    Err(Error::argument(name, "some weight above 0", "all zero"))
}

pub(crate) fn unit_vectors(name: &'static str, vectors: &[DVec3]) -> Result<()> {
    // Written so that NaN fails.
    let good = |v: &DVec3| (v.length() - 1.0).abs() <= UNIT_TOLERANCE;
    let shown = |v: &DVec3| format!("{v} of length {}", v.length());
    each(name, vectors, "unit vectors", good, shown)
}
