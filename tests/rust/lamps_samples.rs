//! Of what `lamps/samples` keeps to itself.

use super::*;
use crate::reflectance::model::with_model;
use crate::reflectance::tangent_offset::offset_normal;

/// Half of the slope of the cost by each unknown is the gradient, with several lamps in a picture,
/// SH light, limits that are missed and limits that are kept, and a prior.
#[test]
fn the_gradient_is_half_of_the_slope_of_the_cost() {
    let unit = |x: f64, y: f64| DVec3::new(x, y, 1.0).normalize();
    let directions = [(0.5, 0.1), (-0.3, 0.6), (0.2, -0.8), (-0.9, 0.2)].map(|(x, y)| unit(x, y));
    let intensities = [[1.0, 0.8, 0.6], [0.5; 3], [0.0, 0.0, 2.0], [0.9, 1.1, 1.3]];
    let ambient = [[0.0; 3], [0.6, 0.3, 0.2], [0.0; 3], [0.3, 0.2, 0.1]];
    let lights = Lights::new(&[0, 0, 1, 2], &ambient);
    let base = unit(0.1, 0.2);
    let at = |values: [f64; UNKNOWNS]| {
        let [red, green, blue, roughness, metallic, a, b] = values;
        Point {
            offset: [a, b],
            normal: offset_normal(base, [a, b]).normal,
            material: Material {
                albedo: [red, green, blue],
                roughness,
                metallic,
            },
        }
    };
    let values = [0.3, 0.6, 0.8, 0.45, 0.35, 0.12, -0.07];
    for model in [Model::Paper, Model::Principled] {
        for limit in [0, AT_LEAST, AT_MOST] {
            let given = LampPictures {
                pictures: vec![[0.1, 0.9, 0.2], [0.5; 3], [0.0, 0.6, 2.0], [0.2, 0.1, 0.3]],
                limits: Some(vec![[limit; 3], [0, limit, limit], [limit; 3], [limit; 3]]),
                views: vec![unit(-0.1, 0.1)],
                directions: directions.to_vec(),
                intensities: intensities.to_vec(),
                picture_of: vec![0, 0, 1, 2],
                ambient: ambient.to_vec(),
                model,
                threads: 1,
            };
            let mean = [0.0, 0.1, 0.5, 0.5, 0.5, 0.3, 0.0];
            let weights = [[1.0, 2.0, 0.5], [1.0; 3], [0.0, 3.0, 1.0], [4.0, 1.0, 1.0]];
            let samples = Samples::new(&given, &weights, &lights, 0)
                .with_prior(&mean, &[0.5, 0.6, 0.1, 0.2, 0.0, 0.3, 0.4]);
            let by_offset = offset_normal(base, [0.12, -0.07]).by_offset;
            let point = at(values);
            let (_, equations) =
                with_model!(model, M => samples.equations::<M>(&point, &by_offset));
            let cost = |x: usize, t: f64| {
                let mut moved = values;
                moved[x] += t;
                with_model!(model, M => samples.equations::<M>(&at(moved), &[DVec3::ZERO; 2]).0)
            };
            for x in 0..UNKNOWNS {
                let slope = |h: f64| (cost(x, h) - cost(x, -h)) / (2.0 * h);
                let expected = 0.5 * (4.0 * slope(1e-4) - slope(2e-4)) / 3.0;
                let found = equations.gradient[x];
                assert!(
                    (found - expected).abs() < 1e-8 * (1.0 + expected.abs()),
                    "{model:?}, limits {limit}, unknown {x}: {found} is not {expected}"
                );
            }
        }
    }
}
