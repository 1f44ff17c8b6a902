//! Derivatives by the normal against central differences, and the two numbers that turn a normal.

use glam::DVec3;
use pbrfit::reflectance::ggx::{self, MIN_COSINE};
use pbrfit::reflectance::paper::Paper;
use pbrfit::reflectance::planes::Material;
use pbrfit::reflectance::reflection::Weights;
use pbrfit::reflectance::sh;
use pbrfit::reflectance::shade::{Frame, shade, shade_vjp};
use pbrfit::reflectance::tangent_offset;

/// Numbers in \[0, 1) that look random.
struct Numbers(u64);

impl Numbers {
    fn next(&mut self) -> f64 {
        // splitmix64 (Steele, Lea, Flood 2014)
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((z ^ (z >> 31)) >> 11) as f64 / (1_u64 << 53) as f64
    }

    fn direction(&mut self) -> DVec3 {
        let (z, angle) = (2.0 * self.next() - 1.0, std::f64::consts::TAU * self.next());
        let rho = (1.0 - z * z).sqrt();
        DVec3::new(rho * angle.cos(), rho * angle.sin(), z)
    }

    fn cotangent(&mut self) -> Weights {
        std::array::from_fn(|_| std::array::from_fn(|_| 2.0 * self.next() - 1.0))
    }
}

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

/// View directions seen from a normal at a cosine.
fn seen_at(numbers: &mut Numbers, cosine: f64) -> (DVec3, DVec3) {
    let normal = numbers.direction();
    let [t1, t2] = tangent_offset::tangents(normal);
    let angle = std::f64::consts::TAU * numbers.next();
    let sine = (1.0 - cosine * cosine).sqrt();
    (
        normal,
        cosine * normal + sine * (angle.cos() * t1 + angle.sin() * t2),
    )
}

fn assert_slope_by_normal(
    normal: DVec3,
    view: DVec3,
    material: &Material,
    numbers: &mut Numbers,
    step: f64,
) {
    let cotangent = numbers.cotangent();
    let (_, by_normal) = shade_vjp::<Paper, 3>(normal, view, material, &cotangent);

    let scalar = |normal: DVec3| {
        let weights = shade(&Frame::<Paper>::new(normal, view), material);
        let pairs = weights.as_flattened().iter().zip(cotangent.as_flattened());
        pairs.map(|(w, g)| w * g).sum::<f64>()
    };
    // No larger than the sum of the sizes of what is added up, which are cotangents up to 1.
    let scale = 1.0_f64.max(by_normal.length());
    assert_close("along n", by_normal.dot(normal), 0.0, 1e-13 * scale);
    for tangent in tangent_offset::tangents(normal) {
        let expected = slope(step, |t| scalar((normal + t * tangent).normalize()));
        assert_close(
            &format!("{material:?} at n·v = {:e}", normal.dot(view)),
            by_normal.dot(tangent),
            expected,
            1e-6 * scale,
        );
    }
}

fn materials(numbers: &mut Numbers) -> Vec<Material> {
    let mut materials = Vec::new();
    for roughness in [0.0, 0.05, 0.3, 1.0, numbers.next()] {
        for metallic in [0.0, 1.0, numbers.next()] {
            materials.push(Material {
                albedo: std::array::from_fn(|_| numbers.next()),
                roughness,
                metallic,
            });
        }
    }
    materials
}

#[test]
fn weights_by_the_normal_for_random_pixels() {
    let mut numbers = Numbers(2);
    for _ in 0..50 {
        for material in materials(&mut numbers) {
            let cosine = 0.01 + 0.99 * numbers.next();
            let (normal, view) = seen_at(&mut numbers, cosine);
            assert_slope_by_normal(normal, view, &material, &mut numbers, 1e-5);
        }
    }
}

#[test]
fn weights_by_the_normal_of_grazing_pixels_and_on_both_sides_of_the_clamp() {
    let mut numbers = Numbers(3);
    for cosine in [
        1e-2, 1e-3, 2e-4, 1.1e-4, 0.9e-4, 0.0, -1e-4, -0.01, -0.5, -1.0, 1.0,
    ] {
        for material in materials(&mut numbers) {
            let (normal, view) = seen_at(&mut numbers, cosine);
            assert_slope_by_normal(normal, view, &material, &mut numbers, 1e-6);
        }
    }
}

#[test]
fn at_the_clamp_itself_fresnel_and_masking_stand_still() {
    let mut numbers = Numbers(4);
    let material = Material {
        albedo: [0.3, 0.5, 0.7],
        roughness: 0.4,
        metallic: 0.5,
    };
    let (normal, view) = (DVec3::Z, DVec3::new((1.0 - 1e-8_f64).sqrt(), 0.0, 1e-4));
    assert_eq!(normal.dot(view), MIN_COSINE);
    let cotangent = numbers.cotangent();
    let scalar = |t: f64| {
        let normal = DVec3::new(t, 0.0, 1.0).normalize();
        let weights = shade(&Frame::<Paper>::new(normal, view), &material);
        let pairs = weights.as_flattened().iter().zip(cotangent.as_flattened());
        pairs.map(|(w, g)| w * g).sum::<f64>()
    };
    let (_, found) = shade_vjp::<Paper, 3>(normal, view, &material, &cotangent);
    // n·v grows with t: from below, where it is raised to the same, and from above.
    let step = 1e-7;
    let below = (scalar(0.0) - scalar(-step)) / step;
    let above = (scalar(step) - scalar(0.0)) / step;
    assert_close("from below", found.x, below, 1e-5);
    assert!((above - below).abs() > 1.0, "{above} is like {below}");
}
