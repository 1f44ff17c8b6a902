//! Time of the core's parts: `cargo bench`. Compare rows of one run with each other.

use std::hint::black_box;

use criterion::{BenchmarkId, Criterion, Throughput, criterion_group, criterion_main};
use glam::DVec3;
use pbrfit::ggx;
use pbrfit::problem::{Options, Pictures, Problem};
use pbrfit::shade::{Frame, Material, shade, shade_vjp};

const PICTURES: usize = 16;

fn bands(c: &mut Criterion) {
    let mut group = c.benchmark_group("bands");
    for (name, r) in [("closed form", 0.3), ("series", 0.7)] {
        group.bench_function(name, |b| b.iter(|| ggx::bands(black_box(r))));
    }
    group.finish();
}

fn pixel(c: &mut Criterion) {
    let frame = Frame::new(DVec3::new(0.0, 0.6, 0.8), DVec3::Z);
    let material = Material {
        albedo: [0.7, 0.5, 0.3],
        roughness: 0.5,
        metallic: 0.4,
    };
    let cotangent = [[1.0; 16]; 3];
    let mut group = c.benchmark_group("pixel in float64");
    group.bench_function("shade", |b| b.iter(|| shade(black_box(&frame), &material)));
    group.bench_function("shade_vjp", |b| {
        b.iter(|| shade_vjp(black_box(&frame), &material, &cotangent))
    });
    group.finish();
}

fn objective(c: &mut Criterion) {
    let mut group = c.benchmark_group("objective, 16 pictures");
    group.sample_size(20);
    for side in [64, 128, 256, 512] {
        for threads in [1, 2] {
            let (problem, x) = example(side * side, threads);
            let mut gradient = vec![0.0; problem.size()];
            group.throughput(Throughput::Elements((side * side * PICTURES * 3) as u64));
            let id = |what: &str| {
                BenchmarkId::new(format!("{what}, {threads} threads"), format!("{side}²"))
            };
            group.bench_function(id("value_and_grad"), |b| {
                b.iter(|| {
                    problem
                        .value_and_grad(black_box(&x), &mut gradient)
                        .unwrap()
                })
            });
        }
    }
    group.finish();
}

/// A problem with varied normals and materials; nothing depends on its being a picture of anything.
fn example(pixels: usize, threads: usize) -> (Problem, Vec<f64>) {
    let wave = |i: usize, a: f64| 0.5 + 0.45 * (a * i as f64).sin();
    let normals: Vec<DVec3> = (0..pixels)
        .map(|p| DVec3::new(wave(p, 0.7) - 0.5, wave(p, 1.3) - 0.5, 1.0).normalize())
        .collect();
    let views = vec![DVec3::Z; pixels];
    let images: Vec<f32> = (0..PICTURES * pixels * 3)
        .map(|i| wave(i, 2.1) as f32)
        .collect();
    let given = Pictures {
        images: &images,
        pictures: PICTURES,
        channels: 3,
        weights: None,
        normals: &normals,
        views: &views,
    };
    let options = Options {
        threads,
        ..Options::default()
    };
    let problem = Problem::new(&given, options).unwrap();
    let x = (0..problem.size()).map(|i| wave(i, 0.31)).collect();
    (problem, x)
}

criterion_group!(benches, bands, pixel, objective);
criterion_main!(benches);
