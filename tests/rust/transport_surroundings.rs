//! Of what `transport/surroundings` keeps to itself.

use super::*;
use crate::transport::tests::Numbers;
use glam::DVec3;

/// Möller and Trumbore's distance in float64, and how far inside of its edges a ray passes:
/// below 0 it misses.
fn crossing(triangle: &[[f32; 3]; 3], origin: Vec3A, direction: Vec3A) -> (f64, f64) {
    let [a, b, c] = triangle.map(|v| DVec3::from(v.map(f64::from)));
    let [origin, direction] = [origin, direction].map(|v| v.as_dvec3());
    let (along, across) = (b - a, c - a);
    let p = direction.cross(across);
    let determinant = along.dot(p);
    let s = origin - a;
    let u = s.dot(p) / determinant;
    let q = s.cross(along);
    let v = direction.dot(q) / determinant;
    let distance = across.dot(q) / determinant;
    let inside = u.min(v).min(1.0 - u - v);
    (distance, if distance > 0.0 { inside } else { -1.0 })
}

fn scattered(numbers: &mut Numbers, count: usize) -> Vec<[[f32; 3]; 3]> {
    let around = |numbers: &mut Numbers, middle: Vec3A, size: f32| {
        (middle + size * Vec3A::from_array(std::array::from_fn(|_| numbers.signed()))).to_array()
    };
    (0..count)
        .map(|_| {
            let middle = Vec3A::from(around(numbers, Vec3A::ZERO, 1.0));
            std::array::from_fn(|_| around(numbers, middle, 0.15))
        })
        .collect()
}

#[test]
fn rays_meet_what_all_triangles_one_by_one_say() {
    let mut numbers = Numbers(1);
    for count in [0, 1, 2, 5, 400] {
        let triangles = scattered(&mut numbers, count);
        let surfaces: Vec<u8> = (0..count).map(|i| (i % 251) as u8).collect();
        let built = Surroundings::new(&triangles, &surfaces).unwrap();
        // The other sides of the same triangles.
        let turned: Vec<_> = triangles.iter().map(|&[a, b, c]| [a, c, b]).collect();
        let turned = Surroundings::new(&turned, &surfaces).unwrap();
        let (mut met, mut missed) = (0, 0);
        for _ in 0..3000 {
            let origin = 1.2 * Vec3A::from_array(std::array::from_fn(|_| numbers.signed()));
            let direction = numbers.direction();
            let of_each: Vec<_> = triangles
                .iter()
                .map(|triangle| crossing(triangle, origin, direction))
                .collect();
            if of_each.iter().any(|(_, inside)| inside.abs() < 1e-4) {
                continue; // along an edge, where rounding decides
            }
            let first = (0..count)
                .filter(|&i| of_each[i].1 > 0.0)
                .min_by(|&i, &j| of_each[i].0.total_cmp(&of_each[j].0));
            for built in [&built, &turned] {
                let hit = built.hit(origin, direction);
                assert_eq!(hit.is_some(), first.is_some());
                assert_eq!(built.blocks(origin, direction), first.is_some());
                if let (Some(hit), Some(first)) = (hit, first) {
                    let expected = of_each[first].0;
                    assert!(
                        (f64::from(hit.distance) - expected).abs() < 1e-4 * (1.0 + expected),
                        "{hit:?}, expected {expected}"
                    );
                    assert_eq!(hit.surface, surfaces[first]);
                }
            }
            met += usize::from(first.is_some());
            missed += usize::from(first.is_none());
        }
        let holds = missed > 100 && (count < 400 || met > 500);
        assert!(holds, "{met}, {missed}");
    }
}

#[test]
fn rays_along_an_axis_meet_what_is_there() {
    let wall = [[[-1.0, -1.0, 2.0], [3.0, -1.0, 2.0], [-1.0, 3.0, 2.0]]];
    let built = Surroundings::new(&wall, &[7]).unwrap();
    let hit = built.hit(Vec3A::ZERO, Vec3A::Z).unwrap();
    assert_eq!((hit.distance, hit.surface), (2.0, 7));
    assert_eq!(built.last_surface(), 7);
    for away in [Vec3A::NEG_Z, Vec3A::X, Vec3A::Y, Vec3A::NEG_X, Vec3A::NEG_Y] {
        assert_eq!(built.hit(Vec3A::ZERO, away), None);
        assert!(!built.blocks(Vec3A::ZERO, away));
    }
}

#[test]
fn unusable_triangles_are_named() {
    let message = |value: f32, surfaces: &[u8]| {
        let triangles = [[[0.0; 3], [1.0, 0.0, value], [0.0, 1.0, 0.0]]];
        let error = Surroundings::new(&triangles, surfaces).unwrap_err();
        error.to_string()
    };
    assert_eq!(message(0.0, &[]), "surfaces: expected 1 numbers, found 0");
    for (value, found) in [(f32::NAN, "NaN"), (f32::INFINITY, "inf"), (4e15, "e15")] {
        let message = message(value, &[0]);
        let holds = message.starts_with("triangles: expected ") && message.contains(found);
        assert!(holds, "{message}");
    }
}
