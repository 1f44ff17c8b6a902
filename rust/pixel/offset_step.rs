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

#[cfg(test)]
mod tests {
    use super::*;

    fn length(v: [f64; OFFSETS]) -> f64 {
        v[0].hypot(v[1])
    }

    #[test]
    fn steps_within_reach_are_taken_whole() {
        assert_eq!(
            limit_offset_step([0.5, -0.25], [0.125, 0.25]),
            (1.0, [0.625, 0.0])
        );
        assert_eq!(limit_offset_step([0.1, 0.0], [OFFSET_STEP_MAX, 0.0]).0, 1.0);
    }

    #[test]
    fn long_steps_keep_their_direction() {
        let (share, there) = limit_offset_step([0.1, 0.2], [3.0, -4.0]);
        assert!((share - OFFSET_STEP_MAX / 5.0).abs() < 1e-15);
        let step = [there[0] - 0.1, there[1] - 0.2];
        assert!((length(step) - OFFSET_STEP_MAX).abs() < 1e-15);
        assert!((step[0] * 4.0 + step[1] * 3.0).abs() < 1e-15);
    }

    #[test]
    fn tilts_grow_to_the_longest_or_stay_as_long_as_they_were() {
        let (_, there) = limit_offset_step([OFFSET_AFTER_STEP_MAX - 0.1, 0.0], [0.2, 0.0]);
        assert!((length(there) - OFFSET_AFTER_STEP_MAX).abs() < 1e-15);
        let (_, there) = limit_offset_step([0.0, 5.0], [0.2, 0.1]);
        assert!((length(there) - 5.0).abs() < 1e-14);
        let (_, there) = limit_offset_step([0.0, 5.0], [0.0, -0.1]);
        assert_eq!(there, [0.0, 4.9]);
        assert_eq!(limit_offset_step([3.0, 4.0], [0.0; 2]), (1.0, [3.0, 4.0]));
    }
}
