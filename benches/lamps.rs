//! Time of light from lamps, and of pixels fitted under it: `cargo bench --bench lamps`. Compare rows
//! of one run with each other.

use criterion::{BenchmarkId, Criterion, Throughput, criterion_group, criterion_main};
use glam::DVec3;
use pbrfit::lamps::descent::Free;
use pbrfit::lamps::pixel_fit::{LampFit, LampPictures, NUMBERS, fit_under_lamps};
use pbrfit::lamps::render::{Lamplit, lamp_radiance};
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

/// By pixel, in 12 pictures with a lamp each, noise in the pictures, with and without SH light.
fn fit(c: &mut Criterion) {
    let mut group = c.benchmark_group("fit_under_lamps, 12 pictures, 20 steps at most, by pixel");
    group.sample_size(10);
    group.throughput(Throughput::Elements(PIXELS as u64));
    let example = Example::new();
    let intensities = vec![[1.0; 3]; PIXELS * LAMPS];
    let picture_of: Vec<usize> = (0..LAMPS).collect();
    let no_prior = vec![[0.0; NUMBERS]; PIXELS];
    let start = Material {
        albedo: [0.5; 3],
        roughness: 0.5,
        metallic: 0.3,
    };
    for model in MODELS {
        let mut radiance = lamp_radiance(example.lamplit(model), 0).unwrap();
        for (i, radiance) in radiance.iter_mut().enumerate() {
            for value in radiance {
                *value *= 0.99 + 0.02 * wave(i, 1.93);
            }
        }
        for (name, ambient) in [("lamps", 0.0), ("lamps and SH light", 0.05)] {
            let sky = [[ambient; 3]; LAMPS];
            for threads in [1, 2] {
                let given = LampPictures {
                    pictures: &radiance,
                    weights: &intensities,
                    limits: None,
                    views: &example.views,
                    directions: &example.directions,
                    intensities: &intensities,
                    picture_of: &picture_of,
                    ambient: &sky,
                    base_normals: &example.normals,
                    prior_mean: &no_prior,
                    prior_precision: &no_prior,
                };
                let how = LampFit {
                    free: Free {
                        normals: true,
                        metallic: true,
                        roughness: true,
                    },
                    iterations: 20,
                    model,
                    threads,
                };
                let id =
                    BenchmarkId::new(format!("{name}, {threads} threads"), format!("{model:?}"));
                let materials = [start; PIXELS];
                group.bench_function(id, |b| {
                    b.iter(|| fit_under_lamps(given, &example.normals, &materials, how).unwrap());
                });
            }
        }
    }
    group.finish();
}

criterion_group!(benches, light, fit);
criterion_main!(benches);
