//! The fast objective against the model in float64, and against itself at other thread counts.

use glam::DVec3;
use pbrfit::problem::Problem;
use pbrfit::render::render;
use pbrfit::shade::{Frame, Material, shade, shade_vjp};

struct Example {
    pictures: usize,
    normals: Vec<DVec3>,
    views: Vec<DVec3>,
    images: Vec<f32>,
    x: Vec<f64>,
}

impl Example {
    fn new(pixels: usize, pictures: usize) -> Self {
        let wave = |i: usize, a: f64| 0.5 + 0.45 * (a * (i + 1) as f64).sin();
        let direction = |p: usize, a: f64| {
            DVec3::new(wave(p, a) - 0.5, wave(p, 1.9 * a) - 0.5, 0.6).normalize()
        };
        Self {
            pictures,
            normals: (0..pixels).map(|p| direction(p, 0.7)).collect(),
            views: (0..pixels).map(|p| direction(p, 0.011)).collect(),
            images: (0..pictures * pixels * 3)
                .map(|i| wave(i, 2.1) as f32)
                .collect(),
            x: (0..5 * pixels + pictures * 48)
                .map(|i| wave(i, 0.313))
                .collect(),
        }
    }

    fn problem(&self, threads: usize) -> Problem {
        Problem::new(
            &self.images,
            self.pictures,
            &self.normals,
            &self.views,
            threads,
        )
        .unwrap()
    }

    fn material(&self, p: usize) -> Material {
        let n = self.normals.len();
        let plane = |i: usize| self.x[i * n + p];
        Material {
            albedo: [plane(0), plane(1), plane(2)],
            roughness: plane(3),
            metallic: plane(4),
        }
    }

    /// Loss and gradient by the definition, pixel by pixel in float64.
    fn reference(&self) -> (f64, Vec<f64>) {
        let pixels = self.normals.len();
        let samples = (3 * pixels * self.pictures) as f64;
        let lighting = &self.x[5 * pixels..];
        let mut loss = 0.0;
        let mut gradient = vec![0.0; self.x.len()];
        for p in 0..pixels {
            let frame = Frame::new(self.normals[p], self.views[p]);
            let w = shade(&frame, &self.material(p));
            let mut by_weights = [[0.0; 16]; 3];
            for i in 0..self.pictures {
                for c in 0..3 {
                    let radiance: f64 = (0..16)
                        .map(|k| w[c][k] * lighting[(i * 16 + k) * 3 + c])
                        .sum();
                    let e = radiance - f64::from(self.images[(i * pixels + p) * 3 + c]);
                    loss += e * e / samples;
                    for k in 0..16 {
                        let by_radiance = 2.0 * e / samples;
                        by_weights[c][k] += by_radiance * lighting[(i * 16 + k) * 3 + c];
                        gradient[5 * pixels + (i * 16 + k) * 3 + c] += by_radiance * w[c][k];
                    }
                }
            }
            let g = shade_vjp(&frame, &self.material(p), &by_weights);
            let planes = [
                g.albedo[0],
                g.albedo[1],
                g.albedo[2],
                g.roughness,
                g.metallic,
            ];
            for (i, value) in planes.into_iter().enumerate() {
                gradient[i * pixels + p] = value;
            }
        }
        (loss, gradient)
    }
}

fn norm(values: impl Iterator<Item = f64>) -> f64 {
    values.map(|v| v * v).sum::<f64>().sqrt()
}

#[test]
fn agrees_with_the_definition() {
    for (pixels, pictures) in [(1, 1), (15, 2), (16, 3), (17, 4), (300, 5), (4_500, 9)] {
        let example = Example::new(pixels, pictures);
        let mut gradient = vec![0.0; example.x.len()];
        let loss = example
            .problem(2)
            .value_and_grad(&example.x, &mut gradient)
            .unwrap();
        let (true_loss, true_gradient) = example.reference();
        assert!(
            (loss - true_loss).abs() <= 1e-6 * true_loss,
            "{pixels} pixels, {pictures} pictures: loss {loss}, expected {true_loss}"
        );
        for (name, block) in [
            ("albedo", 0..3 * pixels),
            ("roughness", 3 * pixels..4 * pixels),
            ("metallic", 4 * pixels..5 * pixels),
            ("lighting", 5 * pixels..example.x.len()),
        ] {
            let off = norm(block.clone().map(|i| gradient[i] - true_gradient[i]));
            let size = norm(block.map(|i| true_gradient[i]));
            assert!(
                off <= 1e-5 * size,
                "{name}, {pixels} × {pictures}: off by {off:e} of {size:e}"
            );
        }
    }
}

#[test]
fn same_bits_at_any_thread_count() {
    let example = Example::new(20_000, 3);
    let evaluate = |threads: usize| {
        let problem = example.problem(threads);
        let mut gradient = vec![0.0; example.x.len()];
        let loss = problem.value_and_grad(&example.x, &mut gradient).unwrap();
        let images = problem.render(&example.x).unwrap();
        (
            loss,
            gradient,
            images,
            problem.light_equations(&example.x).unwrap(),
        )
    };
    let one = evaluate(1);
    for threads in [2, 3, 8] {
        assert!(
            one == evaluate(threads),
            "{threads} threads differ from one"
        );
    }
}

#[test]
fn fast_rendering_agrees_with_float64() {
    let example = Example::new(77, 5);
    let fast = example.problem(1).render(&example.x).unwrap();
    let materials: Vec<Material> = (0..77).map(|p| example.material(p)).collect();
    let slow = render(
        &example.normals,
        &example.views,
        &materials,
        &example.x[5 * 77..],
        1,
    )
    .unwrap();
    assert_eq!(fast.len(), slow.len());
    for (f, s) in fast.iter().zip(&slow) {
        assert!(
            (f64::from(*f) - s).abs() <= 2e-6 * s.abs().max(1.0),
            "{f} is not {s}"
        );
    }
}

#[test]
fn best_lights_explain_rendered_pictures() {
    let mut example = Example::new(500, 2);
    example.images = example.problem(1).render(&example.x).unwrap();
    let equations = example.problem(1).light_equations(&example.x).unwrap();
    for (c, e) in equations.iter().enumerate() {
        for i in 0..example.pictures {
            for j in 0..16 {
                let product: f64 = (0..16)
                    .map(|k| e.gram[j][k] * example.x[5 * 500 + (i * 16 + k) * 3 + c])
                    .sum();
                assert!(
                    (product - e.right[i][j]).abs() <= 1e-5 * e.right[i][j].abs().max(1.0),
                    "channel {c}, picture {i}, row {j}: {product} is not {}",
                    e.right[i][j]
                );
            }
        }
    }
}

#[test]
fn refusals_name_the_array() {
    let example = Example::new(20, 2);
    let new = |images: &[f32], normals: &[DVec3], views: &[DVec3]| {
        Problem::new(images, 2, normals, views, 1)
            .unwrap_err()
            .to_string()
    };
    let Example {
        images,
        normals,
        views,
        ..
    } = &example;
    assert!(new(&images[1..], normals, views).starts_with("images: expected 120 numbers"));
    assert!(new(images, normals, &views[1..]).starts_with("views: expected 20"));
    let mut bad = images.clone();
    bad[7] = f32::NAN;
    assert_eq!(
        new(&bad, normals, views),
        "images: expected finite numbers, found NaN at 7"
    );
    let mut bad = normals.clone();
    bad[3] = DVec3::ZERO;
    assert!(
        new(images, &bad, views).starts_with("normals: expected unit vectors, found [0, 0, 0]")
    );
    assert!(new(&[], &[], &[]).starts_with("images: expected at least one picture and one pixel"));

    let problem = example.problem(1);
    let evaluate = |x: &[f64]| {
        problem
            .value_and_grad(x, &mut vec![0.0; x.len()])
            .unwrap_err()
            .to_string()
    };
    assert!(evaluate(&example.x[1..]).starts_with("x: expected"));
    let mut bad = example.x.clone();
    bad[3 * 20] = 1.0 + 1e-12;
    assert!(evaluate(&bad).contains("expected numbers in [0, 1]"));
    bad[3 * 20] = f64::INFINITY;
    assert!(evaluate(&bad).starts_with("x: expected finite numbers"));
}
