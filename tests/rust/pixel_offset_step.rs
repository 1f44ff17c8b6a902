//! Of what `pixel/offset_step` keeps to itself.

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
