//! Of what `reflectance/principled/lobe_rows` keeps to itself.

use std::iter;

use glam::DVec3;

use super::*;
use crate::reflectance::principled::{Principled, ROWS};
use crate::reflectance::reflection::each_entry;

const BANDS_TO_2: usize = 9;
/// m of row j.
const ORDER: [i32; ROWS] = [0, 0, 1, 0, 1, 2, 0, 1, 2, 3];

/// Numbers from −1 to 1, the same ones every time (Marsaglia's xorshift).
fn numbers(seed: u64) -> impl FnMut() -> f64 {
    let mut state = 0x9e37_79b9_7f4a_7c15 ^ seed;
    move || {
        state ^= state << 13;
        state ^= state >> 7;
        state ^= state << 17;
        (state >> 11) as f64 / (1u64 << 52) as f64 - 1.0
    }
}

fn vector(number: &mut impl FnMut() -> f64) -> DVec3 {
    DVec3::new(number(), number(), number())
}

/// Normals and mirror directions, the latter from beside the former down to the horizon.
fn directions() -> impl Iterator<Item = [DVec3; 2]> {
    let mut number = numbers(1);
    let angles = [0.0, 1e-9, 1e-3, 0.3, 1.0, 1.5, std::f64::consts::FRAC_PI_2];
    iter::repeat_with(move || angles.map(|angle| (angle, vector(&mut number), vector(&mut number))))
        .take(20)
        .flatten()
        .map(|(angle, n, other)| {
            let n = n.normalize();
            let aside = n.cross(other).normalize();
            [n, n * angle.cos() + aside * angle.sin()]
        })
}

fn rows_of([n, r]: [DVec3; 2]) -> [f64; MAX_ENTRIES] {
    rows(n.to_array(), r.to_array())
}

/// sᵐ of row j.
fn sine([n, r]: [DVec3; 2], row: usize) -> f64 {
    n.cross(r).length().powi(ORDER[row])
}

/// The rows as a matrix.
fn matrix(entries: &[f64; MAX_ENTRIES]) -> [[f64; COEFFICIENTS]; ROWS] {
    let mut matrix = [[0.0; COEFFICIENTS]; ROWS];
    each_entry::<Principled, COEFFICIENTS>(|k, j, at| matrix[j][k] = entries[at]);
    matrix
}

#[test]
fn rows_are_harmonics_of_the_frame() {
    let mut number = numbers(2);
    for [n, r] in directions() {
        let light = vector(&mut number).normalize();
        let u = r - n * n.dot(r);
        // Where there is no u, rows of m = 0 alone are left, and they need no x.
        let x = u
            .try_normalize()
            .unwrap_or_else(|| n.any_orthonormal_vector());
        let local = [x.dot(light), n.cross(x).dot(light), n.dot(light)];
        let (here, there) = (sh::basis(local), sh::basis(light.to_array()));
        let rows = matrix(&rows_of([n, r]));
        let mut j = 0;
        for l in 0..4 {
            for m in 0..=l {
                let found: f64 = iter::zip(rows[j], there).map(|(row, y)| row * y).sum();
                let expected = sine([n, r], j) * here[l * (l + 1) + m];
                assert!((found - expected).abs() < 1e-14, "{j}: {found} {expected}");
                j += 1;
            }
        }
    }
}

#[test]
fn rows_are_orthogonal_and_as_long_as_their_sine() {
    for at in directions() {
        let rows = matrix(&rows_of(at));
        for i in 0..ROWS {
            for j in 0..ROWS {
                let found: f64 = iter::zip(rows[i], rows[j]).map(|(a, b)| a * b).sum();
                let expected = f64::from(i == j) * sine(at, i) * sine(at, j);
                let holds = (found - expected).abs() < 1e-14;
                assert!(holds, "{i} {j}: {found} {expected}");
            }
        }
    }
}

#[test]
fn along_is_the_slope_of_rows() {
    let mut number = numbers(3);
    for [n, r] in directions() {
        let by = [vector(&mut number), vector(&mut number)];
        let step = 1e-5;
        let moved = |t: f64| rows_of([n + by[0] * t, r + by[1] * t]);
        let (there, back) = (moved(step), moved(-step));
        let found = along([n, r].map(|v| v.to_array()), by.map(|v| v.to_array()));
        for at in 0..MAX_ENTRIES {
            let expected = (there[at] - back[at]) / (2.0 * step);
            assert!(
                (found[at] - expected).abs() < 1e-7,
                "{at}: {} {expected}",
                found[at]
            );
        }
    }
}

fn adjoint_is_the_transpose<const K: usize>() {
    let mut number = numbers(4);
    let mut entries = 0;
    each_entry::<Principled, K>(|_, _, _| entries += 1);
    for at in directions() {
        let by = [vector(&mut number), vector(&mut number)];
        let cotangent: Vec<f64> = iter::repeat_with(&mut number).take(entries).collect();
        let [n, r] = at.map(|v| v.to_array());
        let change = along([n, r], by.map(|v| v.to_array()));
        let expected: f64 = iter::zip(&cotangent, change).map(|(g, d)| g * d).sum();
        // An entry of a coefficient beyond K would be out of bounds.
        let [of_n, of_r] = adjoint::<f64, K>(n, r, |entry| cotangent[entry]);
        let found = DVec3::from(of_n).dot(by[0]) + DVec3::from(of_r).dot(by[1]);
        assert!((found - expected).abs() < 1e-12, "{found} {expected}");
    }
}

#[test]
fn the_adjoint_is_the_transpose() {
    adjoint_is_the_transpose::<COEFFICIENTS>();
    adjoint_is_the_transpose::<BANDS_TO_2>();
}
