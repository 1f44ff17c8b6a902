//! Bounds in runs of equal ones, and which entries they hold.

use std::iter;

use super::{BLOCK, Mask, Numbers};
use crate::runtime::{Error, Result, check};

/// Equal bounds of consecutive entries.
#[derive(Clone, Copy, Debug)]
pub(super) struct Bounds {
    pub(super) end: usize,
    pub(super) lower: f64,
    pub(super) upper: f64,
}

/// Checked: entries up to the first of `ends` have the first bounds, and so on.
pub(super) fn runs(ends: &[usize], lower: &[f64], upper: &[f64]) -> Result<Vec<Bounds>> {
    check::length("lower", ends.len(), lower.len())?;
    check::length("upper", ends.len(), upper.len())?;
    let before = iter::once(&0).chain(ends);
    if let Some((a, b)) = before.zip(ends).find(|(a, b)| a >= b) {
        let found = format!("{b} after {a}");
        return Err(Error::argument("ends", "rising numbers above 0", found));
    }
    if ends.is_empty() {
        return Err(Error::argument("ends", "at least one", 0));
    }
    let bounds = iter::zip(ends, iter::zip(lower, upper));
    let bounds = bounds.map(|(&end, (&lower, &upper))| Bounds { end, lower, upper });
    let bounds: Vec<_> = bounds.collect();
    // Written so that NaN fails.
    let possible =
        |b: &Bounds| b.lower <= b.upper && b.lower < f64::INFINITY && b.upper > f64::NEG_INFINITY;
    if let Some(crossed) = bounds.iter().find(|b| !possible(b)) {
        let found = format!("{} to {}", crossed.lower, crossed.upper);
        return Err(Error::argument("bounds", "from lower to upper", found));
    }
    Ok(bounds)
}

/// The bounds of one block after the other.
pub(super) struct BlockBounds<'a> {
    pub(super) left: &'a [Bounds],
    pub(super) lower: Numbers,
    pub(super) upper: Numbers,
    /// Those that fill both arrays.
    pub(super) filled: (f64, f64),
}

impl<'a> BlockBounds<'a> {
    #[inline(always)]
    pub(super) fn new(left: &'a [Bounds]) -> Self {
        Self {
            left,
            lower: [0.0; BLOCK],
            upper: [0.0; BLOCK],
            filled: (f64::NAN, f64::NAN),
        }
    }

    /// Fills both arrays for the entries from `first` on.
    #[inline(always)]
    pub(super) fn fill(&mut self, first: usize, count: usize) {
        let mut done = 0;
        while done < count {
            let here = self.left[0];
            let until = (here.end - first).min(count);
            let whole = until - done == BLOCK;
            if !(whole && self.filled == (here.lower, here.upper)) {
                self.lower[done..until].fill(here.lower);
                self.upper[done..until].fill(here.upper);
                self.filled = if whole {
                    (here.lower, here.upper)
                } else {
                    (f64::NAN, f64::NAN)
                };
            }
            done = until;
            if here.end == first + until {
                self.left = &self.left[1..];
            }
        }
    }
}

/// Whether an entry may move: it is inside its bounds, or the gradient pulls it inwards.
#[inline(always)]
pub(super) fn is_free(x: f64, gradient: f64, lower: f64, upper: f64) -> bool {
    !((x <= lower) & (gradient >= 0.0) | (x >= upper) & (gradient <= 0.0))
}

/// Which of the first `count` entries of a block are free.
#[inline(always)]
pub(super) fn free_of(x: &Numbers, gradient: &Numbers, bounds: &BlockBounds, count: usize) -> Mask {
    let mut free = [0; BLOCK];
    for i in 0..BLOCK {
        let (lower, upper) = (bounds.lower[i], bounds.upper[i]);
        free[i] = u8::from(is_free(x[i], gradient[i], lower, upper));
    }
    free[count..].fill(0);
    // Eight bytes of 0 or 1 are gathered into the top byte: each is moved to its own bit.
    let bytes =
        free.as_chunks::<8>().0.iter().map(|&eight| {
            (u64::from_le_bytes(eight).wrapping_mul(0x0102_0408_1020_4080) >> 56) as u8
        });
    bytes
        .rev()
        .fold(0, |mask, byte| mask << 8 | Mask::from(byte))
}
