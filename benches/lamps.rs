//! Time of light from lamps, and of samples under it: `cargo bench --bench lamps`. Compare rows
//! of one run with each other.

use criterion::{BenchmarkId, Criterion, Throughput, criterion_group, criterion_main};
use glam::DVec3;
use pbrfit::lamps::descent::Free;
use pbrfit::lamps::judge::{LampNoise, judge};
use pbrfit::lamps::pixel_fit::{LampFit, LampPictures, NUMBERS, fit_under_lamps};
use pbrfit::lamps::render::{Lamplit, lamp_radiance};
use pbrfit::lamps::system::{Movable, lamp_system};
use pbrfit::reflectance::model::Model;
use pbrfit::reflectance::planes::Material;

const PIXELS: usize = 4096;
const LAMPS: usize = 12;
const MODELS: [Model; 2] = [Model::Paper, Model::Principled];

/// Varied numbers from 0 to 1.
fn wave(i: usize, frequency: f64) -> f64 {
    0.5 + 0.5 * (i as f64 * frequency).sin()
}

struct Example {
    normals: Vec<DVec3>,
    views: Vec<DVec3>,
    materials: Vec<Material>,
    directions: Vec<DVec3>,
}

impl Example {
    fn new() -> Self {
        let tilted = |i: usize, tilt: f64| {
            let (x, y) = (wave(i, 0.71) - 0.5, wave(i, 1.37) - 0.5);
            DVec3::new(tilt * x, tilt * y, 1.0).normalize()
        };
        Self {
            normals: (0..PIXELS).map(|i| tilted(i, 1.0)).collect(),
            views: (0..PIXELS).map(|i| tilted(3 * i, 0.3)).collect(),
            materials: (0..PIXELS)
                .map(|i| Material {
                    albedo: [0.1 + 0.8 * wave(i, 0.3), 0.5, 0.1 + 0.8 * wave(i, 2.3)],
                    roughness: 0.2 + 0.7 * wave(i, 1.1),
                    metallic: wave(i, 0.9),
                })
                .collect(),
            directions: (0..PIXELS * LAMPS).map(|i| tilted(7 * i, 2.0)).collect(),
        }
    }

    fn lamplit(&self, model: Model) -> Lamplit<'_> {
        Lamplit {
            normals: &self.normals,
            views: &self.views,
            materials: &self.materials,
            directions: &self.directions,
            extents: &[],
            model,
        }
    }
}

/// By pixel and lamp.
fn light(c: &mut Criterion) {
    let mut group = c.benchmark_group("lamps, 1 thread, by pixel and lamp");
    group.sample_size(20);
    group.throughput(Throughput::Elements((PIXELS * LAMPS) as u64));
    let example = Example::new();
    for model in MODELS {
        group.bench_function(
            BenchmarkId::new("lamp_radiance", format!("{model:?}")),
            |b| {
                b.iter(|| lamp_radiance(example.lamplit(model), 1).unwrap());
            },
        );
    }
    group.finish();
}

/// By pixel, in 12 pictures with a lamp each, noise in the pictures, with and without SH light: fits from
/// one start, then equations and likelihoods at what is planted.
fn samples(c: &mut Criterion) {
    let mut group = c.benchmark_group("12 pictures under lamps, by pixel");
    group.sample_size(10);
    group.throughput(Throughput::Elements(PIXELS as u64));
    let example = Example::new();
    let white = vec![[1.0; 3]; PIXELS * LAMPS];
    let no_prior = vec![[0.0; NUMBERS]; PIXELS];
    let start = Material {
        albedo: [0.5; 3],
        roughness: 0.5,
        metallic: 0.3,
    };
    let how = LampFit {
        base_normals: &example.normals,
        prior_mean: &no_prior,
        prior_precision: &no_prior,
        free: Free {
            normals: true,
            metallic: true,
            roughness: true,
        },
        iterations: 20,
    };
    let noise = LampNoise {
        floor: 0.01,
        growth: 0.01,
        proportional: false,
        least: 1e-4,
        shadows: &[0.1; LAMPS],
    };
    let at = (&example.normals[..], &example.materials[..]);
    for model in MODELS {
        let mut pictures = lamp_radiance(example.lamplit(model), 0).unwrap();
        for (i, radiance) in pictures.iter_mut().enumerate() {
            for value in radiance {
                *value *= 0.99 + 0.02 * wave(i, 1.93);
            }
        }
        for (name, ambient, threads) in [
            ("lamps", 0.0, 1),
            ("SH light", 0.05, 1),
            ("SH light", 0.05, 2),
        ] {
            let given = LampPictures {
                pictures: pictures.clone(),
                limits: None,
                views: example.views.clone(),
                directions: example.directions.clone(),
                intensities: white.clone(),
                picture_of: (0..LAMPS).collect(),
                ambient: vec![[ambient; 3]; LAMPS],
                model,
                threads,
            };
            let id = |what: &str| {
                let what = format!("{what}, {name}, {threads} threads");
                BenchmarkId::new(what, format!("{model:?}"))
            };
            group.bench_function(id("fit, 20 steps at most"), |b| {
                let start = [start; PIXELS];
                b.iter(|| fit_under_lamps(&given, &white, at.0, &start, how).unwrap());
            });
            for of_lights in [true, false] {
                let movable = Movable {
                    strengths: &vec![1.0; PIXELS * LAMPS],
                    by_place: &vec![[1.0, 0.0, 0.0, 0.0]; PIXELS * LAMPS],
                    of_lights,
                };
                let what = if of_lights {
                    "system"
                } else {
                    "system of pixels"
                };
                group.bench_function(id(what), |b| {
                    b.iter(|| lamp_system(&given, &white, movable, at.0, at.1).unwrap());
                });
            }
            group.bench_function(id("judge"), |b| {
                b.iter(|| judge(&given, &white, noise, at.0, at.1).unwrap());
            });
        }
    }
    group.finish();
}

criterion_group!(benches, light, samples);
criterion_main!(benches);
