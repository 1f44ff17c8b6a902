//! Of what `pixel/arrowhead` keeps to itself.

use super::*;
use crate::pixel::samples::FREE_UNKNOWNS;

/// A matrix of 4 samples a channel, a gradient, and who is free.
fn example<const U: usize>(seed: u32) -> Arrowhead<3, U> {
    let mut state = seed;
    let mut random = || {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        f64::from(state >> 8) / f64::from(1 << 24) - 0.5
    };
    let mut sums = Sums::default();
    for sample in 0..12 {
        let mut row = [0.0; U];
        for j in std::iter::once(sample % 3).chain(3..U) {
            row[j] = random();
        }
        let residual = random();
        for i in 0..U {
            sums.gradient[i].0[0] += row[i] * residual;
            for j in 0..=i {
                sums.matrix[i][j].0[0] += row[i] * row[j];
            }
        }
    }
    let mut arrowhead = Arrowhead::of(&sums, 0);
    for j in 0..U {
        let is_free = random() > -0.2;
        arrowhead.free[j] = if is_free { 1.0 } else { 0.0 };
        arrowhead.fixed[j] = if is_free { 0.0 } else { random() };
    }
    arrowhead
}

fn entry<const U: usize>(arrowhead: &Arrowhead<3, U>, i: usize, j: usize) -> f64 {
    match (i.max(j), i.min(j)) {
        (a, b) if a == b => arrowhead.diagonal[a],
        (0..3, _) => 0.0,
        (f, c) if c < 3 => arrowhead.arms[f - 3][c],
        (f, g) => arrowhead.dense[f - 3][g - 3],
    }
}

/// And its predicted decrease is that of the quadratic.
#[test]
fn a_step_solves_the_damped_equations_of_the_free_unknowns() {
    solves_the_damped_equations::<UNKNOWNS>();
    solves_the_damped_equations::<FREE_UNKNOWNS>();
}

fn solves_the_damped_equations<const U: usize>() {
    for seed in 0..200 {
        let arrowhead = example::<U>(seed);
        let step = arrowhead.solve(1.3);
        let mut decrease = 0.0;
        for i in 0..U {
            let change: f64 = (0..U).map(|j| entry(&arrowhead, i, j) * step[j]).sum();
            decrease -= step[i] * (2.0 * arrowhead.gradient[i] + change);
            if arrowhead.free[i] == 0.0 {
                assert_eq!(step[i], arrowhead.fixed[i]);
                continue;
            }
            let left = 0.3 * arrowhead.diagonal[i] * step[i] + change;
            assert!((left + arrowhead.gradient[i]).abs() < 1e-12, "{seed}: {i}");
        }
        assert!(
            (decrease - arrowhead.decrease(&step)).abs() < 1e-12,
            "{seed}"
        );
    }
}
