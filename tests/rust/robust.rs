//! Cauchy's loss of single residuals against its definition in float64.

use pbrfit::problem::robust::ApplyRobustLoss;
use pbrfit::reflectance::planes::{BLOCK, Plane};
use pbrfit::runtime::simd::Instructions;

/// φ(e) and φ'(e)/2 of float32 residuals, one at a time.
fn tamed(scale: f64, residuals: &[f32], instructions: Instructions) -> Vec<(f64, f64)> {
    let mut found = Vec::new();
    for (i, &e) in residuals.iter().enumerate() {
        let at = i % BLOCK;
        let mut planes = [Plane::default()];
        planes[0].0[at] = e;
        let value = instructions.run(ApplyRobustLoss {
            scale,
            sample_weights: &[],
            residuals: &mut planes,
        });
        found.push((value, f64::from(planes[0].0[at])));
    }
    found
}

/// From far below the scale to far beyond it, both signs, and the corner with its neighbours.
fn residuals(scale: f64) -> Vec<f32> {
    let corner = scale as f32;
    let mut sizes = vec![corner.next_down(), corner, corner.next_up()];
    for i in -60..=150 {
        sizes.extend((0..7).map(|j| corner * 10f32.powf((i as f32 + j as f32 / 7.0) / 10.0)));
    }
    sizes.retain(|&size| size < 1e18); // of pictures up to 1e16
    sizes.iter().flat_map(|&size| [size, -size]).collect()
}

#[test]
fn it_agrees_with_its_definition() {
    for d in [1e-3, 0.5, 1e3] {
        let residuals = residuals(d);
        for instructions in Instructions::all() {
            let found = tamed(d, &residuals, instructions);
            for (&e, (value, half_slope)) in residuals.iter().zip(found) {
                let z = (f64::from(e) / d).powi(2);
                let (true_value, true_half_slope) = (d * d * z.ln_1p(), f64::from(e) / (1.0 + z));
                let off = (value / true_value - 1.0).abs();
                let slope_off = (half_slope / true_half_slope - 1.0).abs();
                assert!(
                    off < 4e-7 && slope_off < 4e-7,
                    "{}: at {e:e} with scale {d} off by {off:e}, slope by {slope_off:e} of itself",
                    instructions.name()
                );
            }
        }
    }
    let nothing = tamed(0.1, &[0.0, -0.0], Instructions::best());
    assert_eq!(nothing, [(0.0, 0.0); 2]);
}

#[test]
fn weights_multiply_value_and_slope() {
    let e = Plane([0.25; BLOCK]);
    let run = |weights: &[Plane]| {
        let mut planes = [e, e];
        let value = Instructions::best().run(ApplyRobustLoss {
            scale: 0.1,
            sample_weights: weights,
            residuals: &mut planes,
        });
        (value, planes.map(|plane| plane.0))
    };
    let (all, [slopes, _]) = run(&[]);
    let (some, [halved, none]) = run(&[Plane([0.5; BLOCK]), Plane([0.0; BLOCK])]);
    assert!((some / all - 0.25).abs() < 1e-6);
    assert_eq!(halved, slopes.map(|slope| 0.5 * slope));
    assert_eq!(none, [0.0; BLOCK]);
}
