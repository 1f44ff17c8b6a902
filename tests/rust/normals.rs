//! Slopes of the basis and of masking, and the two numbers that turn a normal.

use super::Numbers;
use glam::DVec3;
use pbrfit::reflectance::ggx::{self, MIN_COSINE};
use pbrfit::reflectance::sh;
use pbrfit::reflectance::tangent_offset;

/// df/dt at 0 to fourth order.
fn slope(step: f64, f: impl Fn(f64) -> f64) -> f64 {
    let high_words = (f(step) - f(-step)) / (2.0 * step);
    let far = (f(2.0 * step) - f(-2.0 * step)) / (4.0 * step);
    (4.0 * high_words - far) / 3.0
}

fn assert_close(what: &str, found: f64, expected: f64, tolerance: f64) {
    // Written so that NaN fails.
    assert!(
        (found - expected).abs() <= tolerance,
        "{what}: {found} is not {expected}, off by {:e}",
        found - expected
    );
}

/// Normals everywhere, at the poles, and on both sides of where the tangents change their formula.
fn normals() -> Vec<DVec3> {
    let mut numbers = Numbers(1);
    let mut normals: Vec<_> = (0..200).map(|_| numbers.direction()).collect();
    normals.extend([DVec3::Z, -DVec3::Z, DVec3::X, -DVec3::Y]);
    for z in [-0.98999, -0.99, -0.99001, -0.999_999] {
        let rho = f64::sqrt(1.0 - z * z);
        normals.push(DVec3::new(0.6 * rho, -0.8 * rho, z));
    }
    normals
}

#[test]
fn slopes_of_the_basis_are_those_of_its_polynomials() {
    for direction in normals() {
        let slopes = sh::slopes(direction.to_array());
        for axis in 0..3 {
            for k in 0..sh::COEFFICIENTS {
                let along = |t: f64| {
                    let mut at = direction.to_array();
                    at[axis] += t;
                    sh::basis(at)[k]
                };
                let expected = slope(1e-3, along);
                assert_close(&format!("Y_{k}/{axis}"), slopes[k][axis], expected, 1e-11);
            }
        }
    }
}

#[test]
fn slopes_of_masking_and_fresnel_by_the_cosine() {
    for x in [2.0 * MIN_COSINE, 0.01, 0.3, 0.9, 1.0] {
        assert_close(
            "schlick",
            ggx::schlick_by_cosine(x),
            slope(1e-4 * x, |t| ggx::schlick(x + t)),
            1e-9,
        );
        for r in [0.0, 0.1, 0.5, 1.0] {
            let found = ggx::smith_g1_by_cosine(x, r);
            let expected = slope(1e-4 * x, |t| ggx::smith_g1(x + t, r).0);
            assert_close("G1", found, expected, 1e-9 * found.max(1.0 / x));
        }
    }
}

#[test]
fn tangents_are_orthonormal() {
    for normal in normals() {
        let [t1, t2] = tangent_offset::tangents(normal);
        for (a, b, expected) in [
            (t1, t1, 1.0),
            (t2, t2, 1.0),
            (t1, t2, 0.0),
            (t1, normal, 0.0),
            (t2, normal, 0.0),
        ] {
            assert_close(&format!("at {normal}"), a.dot(b), expected, 1e-13);
        }
    }
}

#[test]
fn tangents_at_plus_z_are_the_axes_and_change_little_beside_it() {
    assert_eq!(tangent_offset::tangents(DVec3::Z), [DVec3::X, DVec3::Y]);
    let beside = DVec3::new(1e-3, -2e-3, 1.0).normalize();
    let [t1, t2] = tangent_offset::tangents(beside);
    assert!(t1.distance(DVec3::X) < 3e-3 && t2.distance(DVec3::Y) < 3e-3);
}

#[test]
fn a_tilt_of_zero_is_the_given_normal_and_its_size_the_tangent_of_the_angle() {
    for given in normals() {
        assert!(
            tangent_offset::offset_normal(given, [0.0; 2])
                .normal
                .distance(given)
                < 1e-15
        );
        for (a, b) in [(0.3, -0.4), (0.0, 2.0), (-tangent_offset::OFFSET_MAX, 0.0)] {
            let normal = tangent_offset::offset_normal(given, [a, b]).normal;
            assert_close("length", normal.length(), 1.0, 1e-15);
            let angle = normal.cross(given).length().atan2(normal.dot(given));
            assert_close("angle", angle, f64::hypot(a, b).atan(), 1e-13);
        }
    }
}

#[test]
fn derivatives_of_the_normal_by_its_tilt() {
    for given in normals() {
        for at in [[0.0, 0.0], [0.2, -0.1], [-1.5, 3.0]] {
            let found = tangent_offset::offset_normal(given, at).by_offset;
            for t in 0..2 {
                for axis in 0..3 {
                    let along = |step: f64| {
                        let mut offset = at;
                        offset[t] += step;
                        tangent_offset::offset_normal(given, offset).normal[axis]
                    };
                    assert_close("dn", found[t][axis], slope(1e-3, along), 1e-10);
                }
            }
        }
    }
}
