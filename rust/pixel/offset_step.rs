//! How far the tangent offset of a normal moves in one step of a fit.

use crate::reflectance::tangent_offset::OFFSETS;

/// Longest step of a tangent offset (a, b), a tangent: 17 degrees from the given normal. A longer one
/// is shortened, because the sum of squares is far from quadratic beyond.
pub(crate) const OFFSET_STEP_MAX: f64 = 0.3;

/// Longest tangent offset that a step leads to, tan 60°, unless it was longer before: then that
/// length.
pub(crate) const OFFSET_AFTER_STEP_MAX: f64 = 1.732_050_807_568_877_2;

/// The share of a step that is within reach, and where it leads.
///
/// Where it would lead too far from the given normal the offset is shortened, its direction kept.
#[inline(always)]
pub(crate) fn limit_offset_step(
    offset: [f64; OFFSETS],
    step: [f64; OFFSETS],
) -> (f64, [f64; OFFSETS]) {
    let length = |v: [f64; OFFSETS]| (v[0] * v[0] + v[1] * v[1]).sqrt();
    let share = shorter(length(step), OFFSET_STEP_MAX);
    let (before, far) = (length(offset), [0, 1].map(|t| offset[t] + share * step[t]));
    let longest = if before > OFFSET_AFTER_STEP_MAX {
        before
    } else {
        OFFSET_AFTER_STEP_MAX
    };
    let kept = shorter(length(far), longest);
    (share, far.map(|far| kept * far))
}

/// What makes a length at most `longest`: 1 or less.
#[inline(always)]
fn shorter(length: f64, longest: f64) -> f64 {
    if length > longest {
        longest / length
    } else {
        1.0
    }
}
