//! Poisson's equation on grids of all shapes, with weights that jump.

use pbrfit::poisson::{Couplings, solve};

use super::Numbers;

/// Rows and columns; weights over so many powers of ten.
const CASES: [([usize; 2], f64); 6] = [
    ([1, 1], 0.0),
    ([1, 37], 1.0),
    ([40, 1], 1.0),
    ([2, 3], 1.0),
    ([16, 17], 0.0),
    ([23, 12], 3.0),
];

struct Case {
    shape: [usize; 2],
    across: Vec<f64>,
    down: Vec<f64>,
    held: Vec<f64>,
    u: Vec<f64>,
}

impl Case {
    fn new(shape: [usize; 2], powers: f64, held: f64) -> Self {
        let mut random = Numbers(7);
        let mut all = |f: fn(f64, f64) -> f64, by: f64| {
            (0..shape[0] * shape[1])
                .map(|_| f(by, random.between(0.0, 1.0)))
                .collect()
        };
        let weight = |powers: f64, x: f64| 10_f64.powf(-powers * x);
        Self {
            shape,
            across: all(weight, powers),
            down: all(weight, powers),
            held: all(|held, x| if x > 0.7 { held } else { 0.0 }, held),
            u: all(|_, x| x, 0.0),
        }
    }

    /// A u, pair by pair.
    fn right(&self) -> Vec<f64> {
        let ([rows, columns], u) = (self.shape, &self.u);
        let mut right: Vec<_> = u.iter().zip(&self.held).map(|(u, h)| u * h).collect();
        for a in 0..u.len() {
            let beside = (a % columns + 1 < columns).then_some((self.across[a], a + 1));
            let below = (a / columns + 1 < rows).then_some((self.down[a], a + columns));
            for (w, b) in beside.into_iter().chain(below) {
                right[a] += w * (u[a] - u[b]);
                right[b] += w * (u[b] - u[a]);
            }
        }
        right
    }

    fn solved(&self, enough: f64, threads: usize) -> Vec<f64> {
        let Self {
            shape,
            across,
            down,
            held,
            u,
        } = self;
        let couplings = Couplings {
            shape: *shape,
            across,
            down,
            held,
        };
        solve(
            couplings,
            &self.right(),
            &vec![0.3; u.len()],
            enough,
            threads,
        )
        .unwrap()
    }
}

#[test]
fn what_made_the_right_side_is_found() {
    for (shape, powers) in CASES {
        let mut case = Case::new(shape, powers, 0.5);
        case.held[0] = 0.5;
        for (found, u) in case.solved(1e-28, 1).iter().zip(&case.u) {
            assert!((found - u).abs() < 1e-9, "{shape:?}: {found} for {u}");
        }
    }
}

#[test]
fn it_is_found_but_for_a_constant_where_no_pixel_is_held() {
    for (shape, powers) in CASES {
        let case = Case::new(shape, powers, 0.0);
        let found = case.solved(1e-28, 1);
        for (of, u) in found.iter().zip(&case.u) {
            assert!(
                (of - found[0] - (u - case.u[0])).abs() < 1e-9,
                "{shape:?}: {of} for {u}"
            );
        }
    }
}

#[test]
fn threads_change_no_bit() {
    let case = Case::new([150, 140], 2.0, 0.1);
    assert_eq!(case.solved(1e-12, 1), case.solved(1e-12, 3));
}

#[test]
fn a_weight_below_zero_is_refused() {
    let mut case = Case::new([3, 4], 0.0, 1.0);
    case.down[5] = -1.0;
    let Case {
        shape,
        across,
        down,
        held,
        u,
    } = &case;
    let couplings = Couplings {
        shape: *shape,
        across,
        down,
        held,
    };
    let error = solve(couplings, u, u, 0.0, 1).unwrap_err().to_string();
    assert_eq!(error, "down: expected numbers from 0, found -1 at 5");
}
