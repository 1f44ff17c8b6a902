//! Of what `transport/sampling` keeps to itself.

use super::*;
use std::f64::consts::{PI, TAU};

const COUNT: usize = 2048;

/// Normals and views: seen from above, aslant, at the horizon and from below.
fn looks() -> impl Iterator<Item = (Vec3A, Vec3A)> {
    let normal = Vec3A::new(0.48, 0.6, 0.64);
    let (x, _) = normal.any_orthonormal_pair();
    [0.0f32, 20.0, 45.0, 70.0, 85.0, 90.0, 100.0]
        .map(move |degrees| {
            let (sin, cos) = degrees.to_radians().sin_cos();
            (normal, cos * normal + sin * x)
        })
        .into_iter()
}

fn sum(rays: &Rays, f: impl Fn(Vec3A) -> f32) -> f64 {
    let (mut sum, mut count) = (0.0, 0);
    rays.each(|direction, weight| {
        assert!((direction.length() - 1.0).abs() < 1e-5);
        assert!(rays.normal.dot(direction) > 0.0);
        assert!(weight.is_finite() && weight > 0.0);
        sum += f64::from(weight * f(direction));
        count += 1;
    });
    let cosine = COSINE_SHARES * rays.count / SHARES;
    assert!((cosine..=rays.count).contains(&count), "{count} rays");
    sum
}

/// The lobe over its directions above the horizon, by the midpoint rule about the mirror
/// direction, with the lobe's own distribution along the angle.
fn lobe_above(roughness: f64, normal: Vec3A, view: Vec3A) -> f64 {
    const POLAR: usize = 500;
    const AROUND: usize = 200;
    let mirror = 2.0 * normal.dot(view) * normal - view;
    let along = f64::from(normal.dot(mirror));
    let across = (1.0 - along * along).max(0.0).sqrt();
    let e = roughness.powi(4);
    let (low, high) = (1.0 / (1.0 + e), 0.5 / e);
    let mut above = 0;
    for i in 0..POLAR {
        let u = (i as f64 + 0.5) / POLAR as f64;
        let z = (1.0 + e - 1.0 / (low + u * (high - low))) / (1.0 - e);
        let radius = (1.0 - z * z).max(0.0).sqrt();
        for j in 0..AROUND {
            let turn = TAU * (j as f64 + 0.5) / AROUND as f64;
            above += usize::from(along * z + across * radius * turn.cos() > 0.0);
        }
    }
    4.0 / (1.0 + e) * above as f64 / (POLAR * AROUND) as f64
}

#[test]
fn the_cosine_integrates_to_pi() {
    for (normal, view) in looks() {
        for seed in 0..5 {
            let rays = Rays::new(normal, view, COUNT, seed);
            let found = sum(&rays, |direction| normal.dot(direction));
            assert!((found - PI).abs() < 5e-3 * PI, "{found} for view {view}");
        }
    }
}

#[test]
fn lobes_integrate_to_their_share_above_the_horizon() {
    for (normal, view) in looks() {
        let mirror = 2.0 * normal.dot(view) * normal - view;
        for roughness in [0.15, 0.2, 0.3, 0.4, 0.5, 0.7, 0.9] {
            let expected = lobe_above(roughness, normal, view);
            let rays = Rays::new(normal, view, COUNT, 3);
            let found = sum(&rays, |direction| {
                let u = mirror.dot(direction);
                if u > 0.0 {
                    radial(roughness as f32, u)
                } else {
                    0.0
                }
            });
            assert!(
                (found - expected).abs() < 0.03 * 4.0,
                "{found}, expected {expected}, for view {view}, roughness {roughness}"
            );
        }
    }
}

/// Y_k over the whole half space against n·ω, by bands: A_l Y_k(n).
#[test]
fn harmonics_integrate_against_the_cosine_as_they_should() {
    use crate::reflectance::sh::{BAND_OF, COSINE_TRANSFER, basis};
    for (normal, view) in looks() {
        let rays = Rays::new(normal, view, COUNT, 8);
        let at_normal: [f32; 16] = basis(normal.to_array());
        for k in 0..16 {
            let found = sum(&rays, |direction| {
                let y: [f32; 16] = basis(direction.to_array());
                normal.dot(direction) * y[k]
            });
            let expected = COSINE_TRANSFER[BAND_OF[k]] * f64::from(at_normal[k]);
            let holds = (found - expected).abs() < 0.02;
            assert!(holds, "{found}, expected {expected}");
        }
    }
}

#[test]
fn rays_follow_from_their_seed() {
    let all = |seed: u64| {
        let mut found = Vec::new();
        let rays = Rays::new(Vec3A::Z, Vec3A::new(0.6, 0.0, 0.8), 60, seed);
        rays.each(|direction, weight| found.push((direction.to_array(), weight)));
        found
    };
    assert_eq!(all(5), all(5));
    for seed in [0, 4, 6, u64::MAX] {
        assert_ne!(all(5), all(seed));
    }
}
