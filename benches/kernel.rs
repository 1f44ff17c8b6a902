//! Time of the core's parts: `cargo bench --bench kernel`. Compare rows of one run with each other.

use std::hint::black_box;

use criterion::measurement::WallTime;
use criterion::{
    BenchmarkGroup, BenchmarkId, Criterion, Throughput, criterion_group, criterion_main,
};
use glam::DVec3;
use pbrfit::pixel::pixel_fit::Search;
use pbrfit::problem::render::render;
use pbrfit::problem::targets::Targets;
use pbrfit::problem::{Options, Pictures, Problem};
use pbrfit::reflectance::band_table::TABLE;
use pbrfit::reflectance::ggx;
use pbrfit::reflectance::model::Model;
use pbrfit::reflectance::paper::Paper;
use pbrfit::reflectance::planes::Material;
use pbrfit::reflectance::shade::{Frame, shade, shade_vjp};
use pbrfit::runtime::simd::{Instructions, Isa, Kernel};
use pbrfit::schur::Elimination;

/// Bands of one roughness: exact, and from the table that the fast path uses.
fn bands(c: &mut Criterion) {
    struct Rows<'a>(&'a [f64]);
    impl Kernel for Rows<'_> {
        type Output = f64;

        #[inline(always)]
        fn run<I: Isa>(self, isa: I) -> f64 {
            let mut sum = 0.0;
            for &r in self.0 {
                sum += TABLE.row(isa, r).0[7];
            }
            sum
        }
    }

    const COUNT: usize = 1000;
    let mut group = c.benchmark_group("bands, 1000 of them");
    for (name, from, to) in [("closed form", 0.05, 0.4), ("series", 0.4, 1.0)] {
        let roughness: Vec<f64> = (0..COUNT)
            .map(|i| from + (to - from) * wave(i, 0.7))
            .collect();
        group.bench_function(name, |b| {
            b.iter(|| {
                let of = |&r| ggx::bands(r).slope[3];
                roughness.iter().map(of).sum::<f64>()
            });
        });
        group.bench_function(format!("table instead of {name}"), |b| {
            b.iter(|| Instructions::best().run(Rows(black_box(&roughness))));
        });
    }
    group.finish();
}

fn pixel(c: &mut Criterion) {
    let frame = Frame::<Paper>::new(DVec3::new(0.0, 0.6, 0.8), DVec3::Z);
    let material = Material {
        albedo: [0.7, 0.5, 0.3],
        roughness: 0.5,
        metallic: 0.4,
    };
    let cotangent = [[1.0; 16]; 3];
    let mut group = c.benchmark_group("pixel in float64");
    group.bench_function("shade", |b| b.iter(|| shade(black_box(&frame), &material)));
    let (normal, view) = (DVec3::new(0.0, 0.6, 0.8), DVec3::Z);
    group.bench_function("shade_vjp", |b| {
        b.iter(|| shade_vjp::<Paper, 3>(black_box(normal), view, &material, &cotangent));
    });
    group.finish();
}

/// By number of pixels and threads: cost should be linear in pixels.
fn sizes(c: &mut Criterion) {
    let mut group = c.benchmark_group("value_and_grad, 16 pictures");
    group.sample_size(20);
    for side in [64, 128, 256, 512, 1024] {
        let example = Example::new(side * side, 16);
        for threads in [1, 2] {
            let options = Options {
                threads,
                ..Options::default()
            };
            let name = format!("{threads} threads");
            example.bench(&mut group, &name, &format!("{side}²"), options);
        }
    }
    group.finish();
}

/// By number of pictures: cost should be linear, beside a part that every pixel costs once.
fn pictures(c: &mut Criterion) {
    let mut group = c.benchmark_group("value_and_grad, 256², 2 threads, pictures");
    group.sample_size(20);
    for pictures in [1, 4, 5, 16, 17, 64] {
        let options = Options {
            threads: 2,
            ..Options::default()
        };
        Example::new(256 * 256, pictures).bench(&mut group, "", &pictures.to_string(), options);
    }
    group.finish();
}

/// Both models: they differ in what every pixel costs once, not in what a picture costs.
fn models(c: &mut Criterion) {
    let mut group = c.benchmark_group("value_and_grad, 512², 2 threads, by model and pictures");
    group.sample_size(20);
    for pictures in [4, 16, 64] {
        let example = Example::new(512 * 512, pictures);
        for model in [Model::Paper, Model::Principled] {
            let options = Options {
                model,
                threads: 2,
                ..Options::default()
            };
            let name = format!("{model:?}");
            example.bench(&mut group, &name, &pictures.to_string(), options);
        }
    }
    group.finish();
}

/// What is known or absent should cost nothing.
fn parts(c: &mut Criterion) {
    let mut group = c.benchmark_group("value_and_grad, 256², 16 pictures, 1 thread");
    group.sample_size(20);
    let one = || Options {
        threads: 1,
        ..Options::default()
    };
    let full = Example::new(256 * 256, 16);
    full.bench(&mut group, "parts", "all", one());
    let options = Options {
        lighting: Some(full.x[5 * 256 * 256..].to_vec()),
        ..one()
    };
    full.bench(&mut group, "parts", "known lights", options);
    let options = Options {
        metallic: Some(0.0),
        ..one()
    };
    full.bench(&mut group, "parts", "known metallic", options);
    let options = Options {
        sh_order: 2,
        ..one()
    };
    full.bench(&mut group, "parts", "order 2", options);
    let free_normals = || Options {
        free_normals: true,
        ..one()
    };
    let turned = full.turned();
    turned.bench(&mut group, "parts", "free normals", free_normals());
    let grey = Example::with_channels(256 * 256, 16, 1);
    let turned = grey.turned();
    turned.bench(
        &mut group,
        "parts",
        "one channel, free normals",
        free_normals(),
    );
    grey.bench(&mut group, "parts", "one channel", one());
    let weighted = Example {
        weights: Some(vec![1.0; 256 * 256 * 16 * 3]),
        ..full.clone()
    };
    weighted.bench(&mut group, "parts", "weights", one());
    for instructions in Instructions::all() {
        let options = Options {
            instructions,
            ..one()
        };
        full.bench(&mut group, "instructions", instructions.name(), options);
    }
    group.finish();
}

/// The best material of every pixel with known lights, part by part: what is in a row is in the next,
/// too. The pictures are rendered from materials, so that descents have somewhere to arrive.
fn pixel_fit(c: &mut Criterion) {
    let mut group = c.benchmark_group("fit_materials, 128², 16 pictures, 1 thread");
    group.sample_size(10);
    let mut example = Example::new(128 * 128, 16);
    let pixels = example.normals.len();
    let lighting = example.x.split_off(5 * pixels);
    let radiance = render(
        &example.normals,
        &example.views,
        &example.materials(),
        &lighting,
        (Model::Paper, None),
        1,
    );
    example.images = radiance.unwrap().iter().map(|&v| v as f32).collect();
    let options = Options {
        threads: 1,
        lighting: Some(lighting),
        ..Options::default()
    };
    let problem = example.problem(options);
    let grey = vec![0.5; problem.size()];
    let everything: Vec<usize> = (0..pixels).collect();
    let nodes = |count: usize| -> Vec<f64> {
        let last = (count - 1) as f64;
        (0..count).map(|i| i as f64 / last).collect()
    };
    group.throughput(Throughput::Elements(pixels as u64));
    for (name, grid, steps, exact_steps) in [
        ("products", None, 0, 0),
        ("and 10 steps from what was given", None, 10, 0),
        ("and a grid of 8 × 4", Some((8, 4)), 10, 0),
        ("or a grid of 12 × 6", Some((12, 6)), 10, 0),
        ("and a step on residuals", Some((12, 6)), 10, 1),
    ] {
        let (roughness, metallic) = grid.map_or_else(Default::default, |(rows, columns)| {
            (nodes(rows + 1).split_off(1), nodes(columns))
        });
        let search = Search {
            roughness: &roughness,
            metallic: &metallic,
            starts: 1,
            steps,
            exact_steps,
            held_normals: false,
            prior: None,
        };
        group.bench_function(name, |b| {
            b.iter(|| problem.fit_materials(&grey, &everything, &search).unwrap());
        });
    }
    group.finish();
}

/// Where fits spend their time, in floating-point operations (a multiply-add is two) of the paper's
/// model with 16 pictures and 3 channels: Gelem/s are GFLOP/s, to be held against what
/// `cargo bench --bench machine -- --threads 1` says. That is float32; float64 reaches half.
fn operations(c: &mut Criterion) {
    // Of a sample: its projections; then products, residual and derivatives, normal equations.
    const SAMPLES: usize = 16 * 3;
    const PROJECTIONS: usize = 2 * (9 + 16);
    const PRODUCTS: usize = SAMPLES * (PROJECTIONS + 6 + 2 * 21);
    const EQUATIONS: usize = SAMPLES * (PROJECTIONS + 2 * 20 + 5 + 2 * 10);
    // W v, R and Rᵀ, and the sum over pixels.
    const PRODUCT: usize = SAMPLES * (2 * 16 + 2 * 3 + 2 * 3 + 2 * 16);
    const GRADIENT: usize = SAMPLES * (2 * 3 + 2 * 16);
    const ROWS: usize = SAMPLES * (3 + 2 * 6);
    // Of a channel: products of one roughness; χ² of one node, and its least, from five starts by
    // three Newton steps; squares from products with their gradient and matrix.
    const ROUGHNESS: usize = 3 * 76;
    const NODE: usize = 3 * (34 + 10 + 5 * 8 + 3 * 15 + 16) + 15;
    const FORM: usize = 3 * (2 * 60 + 110);
    // Residuals, what they add to the light, and both with W; then without gradient.
    const RESIDUALS: usize = SAMPLES * (2 * 16 + 3 + 2 * 16) + 3 * (2 * PROJECTIONS);
    const SQUARES: usize = SAMPLES * (2 * 16 + 3) + 3 * PROJECTIONS;

    let mut group = c.benchmark_group("operations, 128², 16 pictures, 1 thread");
    group.sample_size(10);
    let example = Example::new(128 * 128, 16);
    let pixels: Vec<usize> = (0..example.normals.len()).collect();
    let problem = example.problem(Options {
        threads: 1,
        ..Options::default()
    });
    let x = &example.x;
    let moves: Vec<f64> = (0..16 * 16 * 3).map(|i| wave(i, 0.9) - 0.5).collect();
    let how = Elimination::default();
    let nodes = |first: f64, count: usize| -> Vec<f64> {
        let step = (1.0 - first) / (count - 1) as f64;
        (0..count).map(|i| first + step * i as f64).collect()
    };
    fn search<'a>(grid: [&'a [f64]; 2], exact_steps: usize) -> Search<'a> {
        Search {
            roughness: grid[0],
            metallic: grid[1],
            starts: usize::from(!grid[0].is_empty()),
            steps: 0,
            exact_steps,
            held_normals: false,
            prior: None,
        }
    }
    let mut bench = |name: &str, operations: usize, run: &dyn Fn()| {
        group.throughput(Throughput::Elements((operations * pixels.len()) as u64));
        group.bench_function(name, |b| b.iter(run));
    };
    let few = [nodes(0.08, 12), nodes(0.0, 6)];
    let few = [&few[0][..], &few[1]];
    let fit_materials = |search| {
        black_box(problem.fit_materials(x, &pixels, &search).unwrap());
    };
    bench("fit_materials: products", PRODUCTS + 2 * FORM, &|| {
        fit_materials(search([&[], &[]], 0));
    });
    let grid = 12 * ROUGHNESS + (72 + 1) * NODE + FORM;
    bench(
        "fit_materials: and 12 × 6 nodes",
        PRODUCTS + 2 * FORM + grid,
        &|| {
            fit_materials(search(few, 0));
        },
    );
    // From their own materials all pixels make one step, and none is sure to be better than x.
    let exact = 3 * FORM + 2 * RESIDUALS + SQUARES;
    bench(
        "fit_materials: products and a step on residuals",
        PRODUCTS + 2 * FORM + exact,
        &|| {
            fit_materials(search([&[], &[]], 1));
        },
    );
    let many = [nodes(0.03, 33), nodes(0.0, 7)];
    let count = PRODUCTS + 33 * ROUGHNESS + 33 * 7 * NODE;
    bench("material_grid, 33 × 7 nodes", count, &|| {
        black_box(
            problem
                .material_grid(x, &pixels, &many[0], &many[1])
                .unwrap(),
        );
    });
    let eliminated = EQUATIONS + ROWS + GRADIENT;
    bench("kept_system", eliminated, &|| {
        black_box(problem.kept_system(x, &pixels, &how).unwrap());
    });
    let kept = problem.kept_system(x, &pixels, &how).unwrap();
    bench("kept_system: product, in float32", PRODUCT, &|| {
        black_box(kept.product(&moves).unwrap());
    });
    bench("normal_equations", EQUATIONS, &|| {
        black_box(problem.normal_equations(x, &pixels).unwrap());
    });
    group.finish();
}

/// What second order needs of the pixels, with given normals and with free ones: these have two
/// unknowns more, and each trial of a fit makes directions and basis functions anew.
fn free_normals_of_pixels(c: &mut Criterion) {
    let mut group =
        c.benchmark_group("pixels with given or free normals, 128², 16 pictures, 1 thread");
    group.sample_size(10);
    let example = Example::new(128 * 128, 16);
    let everything: Vec<usize> = (0..example.normals.len()).collect();
    let few: Vec<usize> = everything.iter().copied().step_by(16).collect();
    let how = Elimination {
        damping: 1e-3,
        ..Elimination::default()
    };
    let search = Search {
        roughness: &[],
        metallic: &[],
        starts: 0,
        steps: 0,
        exact_steps: 8,
        held_normals: false,
        prior: None,
    };
    for (name, example, free_normals) in [
        ("given", example.clone(), false),
        ("free", example.turned(), true),
    ] {
        let problem = example.problem(Options {
            threads: 1,
            free_normals,
            ..Options::default()
        });
        let x = &example.x;
        group.throughput(Throughput::Elements(everything.len() as u64));
        group.bench_function(BenchmarkId::new("normal equations", name), |b| {
            b.iter(|| problem.normal_equations(x, &everything).unwrap());
        });
        group.bench_function(BenchmarkId::new("kept system", name), |b| {
            b.iter(|| problem.kept_system(x, &everything, &how).unwrap());
        });
        group.bench_function(BenchmarkId::new("8 steps of materials", name), |b| {
            b.iter(|| problem.fit_materials(x, &everything, &search).unwrap());
        });
        group.throughput(Throughput::Elements(few.len() as u64));
        group.bench_function(
            BenchmarkId::new("schur_complement, of 1024 pixels", name),
            |b| {
                b.iter(|| problem.schur_complement(x, &few, &how).unwrap());
            },
        );
    }
    group.finish();
}

/// Forward only, in double precision.
fn forward(c: &mut Criterion) {
    let mut group = c.benchmark_group("render");
    group.sample_size(20);
    for (side, pictures) in [(256, 1), (256, 16), (512, 16)] {
        let example = Example::new(side * side, pictures);
        let pixels = example.normals.len();
        let materials = example.materials();
        let lighting = &example.x[5 * pixels..];
        group.throughput(Throughput::Elements((pixels * pictures * 3) as u64));
        for threads in [1, 2] {
            let id = BenchmarkId::new(
                format!("{threads} threads"),
                format!("{side}², {pictures} lights"),
            );
            group.bench_function(id, |b| {
                b.iter(|| {
                    render(
                        &example.normals,
                        &example.views,
                        &materials,
                        lighting,
                        (Model::Paper, None),
                        threads,
                    )
                    .unwrap()
                });
            });
        }
    }
    group.finish();
}

/// Pictures of varied normals and materials; nothing depends on their being pictures of anything.
#[derive(Clone)]
struct Example {
    pictures: usize,
    channels: usize,
    normals: Vec<DVec3>,
    views: Vec<DVec3>,
    images: Vec<f32>,
    weights: Option<Vec<f32>>,
    x: Vec<f64>,
}

fn wave(i: usize, a: f64) -> f64 {
    0.5 + 0.45 * (a * i as f64).sin()
}

impl Example {
    fn new(pixels: usize, pictures: usize) -> Self {
        Self::with_channels(pixels, pictures, 3)
    }

    fn with_channels(pixels: usize, pictures: usize, channels: usize) -> Self {
        let normal = |p| DVec3::new(wave(p, 0.7) - 0.5, wave(p, 1.3) - 0.5, 1.0).normalize();
        let samples = pixels * pictures * channels;
        Self {
            pictures,
            channels,
            normals: (0..pixels).map(normal).collect(),
            views: vec![DVec3::Z; pixels],
            images: (0..samples).map(|i| wave(i, 2.1) as f32).collect(),
            weights: None,
            x: (0..(channels + 2) * pixels + pictures * 16 * channels)
                .map(|i| wave(i, 0.31))
                .collect(),
        }
    }

    /// With tangent offsets in x.
    fn turned(&self) -> Self {
        let pixels = self.normals.len();
        let mut turned = self.clone();
        let end = (self.channels + 2) * pixels;
        let offsets = (0..2 * pixels).map(|i| 0.4 * (wave(i, 0.17) - 0.5));
        turned.x.splice(end..end, offsets);
        turned
    }

    /// Of three channels.
    fn materials(&self) -> Vec<Material> {
        let pixels = self.normals.len();
        let material = |p: usize| Material {
            albedo: [0, 1, 2].map(|c| self.x[c * pixels + p]),
            roughness: self.x[3 * pixels + p],
            metallic: self.x[4 * pixels + p],
        };
        (0..pixels).map(material).collect()
    }

    fn problem(&self, options: Options) -> Problem {
        let (pixels, threads) = (self.normals.len(), options.threads);
        let mut images = Targets::new(pixels, self.pictures, self.channels, threads).unwrap();
        for picture in self.images.chunks(pixels * self.channels) {
            images.push(picture).unwrap();
        }
        let given = Pictures {
            images,
            weights: self.weights.as_deref(),
            normals: &self.normals,
            views: &self.views,
            transfer: None,
        };
        Problem::new(given, options).unwrap()
    }

    fn bench(
        &self,
        group: &mut BenchmarkGroup<'_, WallTime>,
        function: &str,
        parameter: &str,
        options: Options,
    ) {
        let problem = self.problem(options);
        let x = &self.x[..problem.size()];
        let mut gradient = vec![0.0; problem.size()];
        group.throughput(Throughput::Elements(self.images.len() as u64));
        group.bench_function(BenchmarkId::new(function, parameter), |b| {
            b.iter(|| problem.value_and_grad(black_box(x), &mut gradient).unwrap());
        });
    }
}

criterion_group!(
    benches,
    bands,
    pixel,
    sizes,
    pictures,
    models,
    parts,
    pixel_fit,
    operations,
    free_normals_of_pixels,
    forward
);
criterion_main!(benches);
