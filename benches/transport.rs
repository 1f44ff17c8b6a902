//! Time of rays and of what is made of them: `cargo bench --bench transport`. Compare rows of one
//! run with each other. `pbrfit`'s own tree of boxes stands beside the other one that its crate
//! has, on the same rays.

use std::hint::black_box;
use std::time::Duration;

use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use glam::{DVec3, Vec3A};
use obvhs::BvhBuildParams;
use obvhs::cwbvh::builder::build_cwbvh_from_tris;
use obvhs::ray::{Ray, RayHit};
use obvhs::triangle::Triangle;
use pbrfit::pixel::pixel_fit::Search;
use pbrfit::problem::targets::Targets;
use pbrfit::problem::{Options, Pictures, Problem};
use pbrfit::reflectance::model::Model;
use pbrfit::transport::surroundings::Surroundings;
use pbrfit::transport::table::{Origins, Radiance, Transfer, transfer};

/// Pixels of the picture that the mesh is of, on a side.
const SIDE: usize = 64;
/// Tangent of half of the field of view.
const HALF_WIDTH: f32 = 0.6;
/// Rays of a pixel, as by default.
const RAYS: usize = 2048;
const PICTURES: usize = 16;
const MODELS: [Model; 2] = [Model::Paper, Model::Principled];

/// Boxes, each by its lowest and highest corner; of the first the inside is seen: the room.
const BOXES: [[[f32; 3]; 2]; 7] = [
    [[-2.0, -1.4, -4.0], [2.0, 1.2, 1.5]],
    [[-1.6, -1.4, -3.4], [-0.8, -0.5, -2.8]],
    [[0.2, -1.4, -3.0], [1.4, -0.7, -2.4]],
    [[-0.4, -1.4, -3.9], [0.1, 0.4, -3.5]],
    [[-1.9, -1.4, -2.4], [-1.5, 0.2, -1.9]],
    [[0.5, -0.65, -2.9], [0.9, -0.2, -2.5]],
    [[1.5, -1.4, -3.9], [1.9, 0.7, -3.3]],
];

fn wave(i: usize, a: f64) -> f64 {
    0.5 + 0.45 * (a * i as f64).sin()
}

/// What a picture shows of the room: triangles between neighbouring pixels, the same of the boxes
/// pushed away from the camera, and walls.
struct Room {
    points: Vec<Vec3A>,
    normals: Vec<Vec3A>,
    triangles: Vec<[[f32; 3]; 3]>,
}

impl Room {
    fn new() -> Self {
        let seen: Vec<_> = (0..SIDE * SIDE)
            .map(|p| {
                let place = |i: usize| (2.0 * i as f32 + 1.0) / SIDE as f32 - 1.0;
                let (x, y) = (place(p % SIDE), -place(p / SIDE));
                first_seen(Vec3A::new(HALF_WIDTH * x, HALF_WIDTH * y, -1.0).normalize())
            })
            .collect();
        let points: Vec<_> = seen.iter().map(|&(point, _, _)| point).collect();
        let mut triangles = Vec::new();
        let mut sheet = |points: &[Vec3A], shown: &dyn Fn(usize) -> bool| {
            for p in (0..SIDE * (SIDE - 1)).filter(|p| (p + 1) % SIDE != 0) {
                let corners = [p, p + SIDE, p + SIDE + 1, p + 1];
                if corners.iter().all(|&p| shown(p)) {
                    let [a, b, c, d] = corners.map(|p| points[p].to_array());
                    triangles.extend([[a, b, c], [a, c, d]]);
                }
            }
        };
        sheet(&points, &|_| true);
        let backs: Vec<_> = points.iter().map(|&p| p + 0.3 * p.normalize()).collect();
        sheet(&backs, &|p| seen[p].2 > 0);
        let [low, high] = BOXES[0];
        for axis in 0..3 {
            for (end, side) in [low, high].into_iter().enumerate() {
                if end == 1 && axis > 0 {
                    continue; // open above and behind the camera, so that some rays leave
                }
                let corner = |i: usize, j: usize| {
                    let mut corner = [0.0; 3];
                    corner[axis] = side[axis];
                    corner[(axis + 1) % 3] = [low, high][i][(axis + 1) % 3];
                    corner[(axis + 2) % 3] = [low, high][j][(axis + 2) % 3];
                    corner
                };
                let [a, b, c, d] = [corner(0, 0), corner(1, 0), corner(1, 1), corner(0, 1)];
                triangles.extend([[a, b, c], [a, c, d]]);
            }
        }
        Self {
            normals: seen.iter().map(|&(_, normal, _)| normal).collect(),
            points,
            triangles,
        }
    }

    fn surroundings(&self) -> Surroundings {
        Surroundings::new(&self.triangles, &vec![0; self.triangles.len()]).unwrap()
    }

    /// Some pixels, evenly spread, with where rays of them start.
    fn starts(&self, count: usize) -> impl Iterator<Item = (Vec3A, Vec3A)> {
        (0..count).map(move |i| {
            let p = (2 * i + 1) * SIDE * SIDE / (2 * count);
            let normal = self.normals[p];
            (self.points[p] + 2e-3 * normal, normal)
        })
    }

    /// Rays as pixels send them: one after the other from the same pixel, as the cosine has them.
    fn rays(&self, pixels: usize, of_each: usize) -> Vec<(Vec3A, Vec3A)> {
        self.starts(pixels)
            .flat_map(|(start, normal)| {
                let (x, y) = normal.any_orthonormal_pair();
                (0..of_each).map(move |i| {
                    let u = (i as f32 + 0.5) / of_each as f32;
                    let (sin, cos) = (i as f32 * 2.399_963).sin_cos();
                    let aside = u.sqrt() * (cos * x + sin * y);
                    (start, (1.0 - u).sqrt() * normal + aside)
                })
            })
            .collect()
    }
}

/// What is seen first in a direction: point, normal and box.
fn first_seen(direction: Vec3A) -> (Vec3A, Vec3A, usize) {
    let mut found = (f32::INFINITY, Vec3A::ZERO, 0);
    for (i, [low, high]) in BOXES.iter().enumerate() {
        let (mut near, mut far) = ((0.0, 0), (f32::INFINITY, 0));
        for axis in 0..3 {
            let [a, b] = [low[axis], high[axis]].map(|side| side / direction[axis]);
            if a.min(b) > near.0 {
                near = (a.min(b), axis);
            }
            if a.max(b) < far.0 {
                far = (a.max(b), axis);
            }
        }
        let (distance, axis) = if i == 0 { far } else { near };
        if near.0 < far.0 && distance > 0.0 && distance < found.0 {
            let mut normal = Vec3A::ZERO;
            normal[axis] = -direction[axis].signum();
            found = (distance, normal, i);
        }
    }
    (found.0 * direction, found.1, found.2)
}

/// On one core: what a ray meets first, and whether it meets anything.
fn rays(c: &mut Criterion) {
    let room = Room::new();
    let rays = room.rays(256, 256);
    let surroundings = room.surroundings();
    let triangles: Vec<_> = room
        .triangles
        .iter()
        .map(|corners| {
            let [v0, v1, v2] = corners.map(Vec3A::from);
            Triangle { v0, v1, v2 }
        })
        .collect();
    let mut unused = Duration::default();
    let wide = build_cwbvh_from_tris(&triangles, BvhBuildParams::medium_build(), &mut unused);
    let of_wide: Vec<_> = (wide.primitive_indices.iter())
        .map(|&i| triangles[i as usize])
        .collect();
    let distance_by_wide = |origin: Vec3A, direction: Vec3A| {
        let mut hit = RayHit::none();
        let ray = Ray::new(origin, direction, 0.0, f32::INFINITY);
        wide.ray_traverse(ray, &mut hit, |ray, i| of_wide[i].intersect(ray));
        hit.t
    };
    let differing = (rays.iter())
        .filter(|&&(origin, direction)| {
            let hit = surroundings.hit(origin, direction);
            let distance = hit.map_or(f32::INFINITY, |hit| hit.distance);
            let other = distance_by_wide(origin, direction);
            distance != other && (distance - other).abs() > 1e-3 * distance
        })
        .count();
    assert!(differing < rays.len() / 1000, "{differing} rays differ");
    let blocked_by_wide = |origin: Vec3A, direction: Vec3A| {
        let ray = Ray::new(origin, direction, 0.0, f32::INFINITY);
        !wide.ray_traverse_miss(ray, |ray, i| of_wide[i].intersect(ray))
    };
    let blocked = (rays.iter())
        .filter(|&&(origin, direction)| surroundings.blocks(origin, direction))
        .count();
    let other = (rays.iter())
        .filter(|&&(origin, direction)| blocked_by_wide(origin, direction))
        .count();
    assert!(
        blocked.abs_diff(other) < rays.len() / 1000,
        "{blocked}, {other}"
    );
    println!(
        "{} triangles, {} rays, of which {blocked} meet one",
        room.triangles.len(),
        rays.len()
    );

    let mut group = c.benchmark_group("rays of pixels in a furnished room, one core");
    group.throughput(Throughput::Elements(rays.len() as u64));
    group.sample_size(20);
    group.bench_function("first hit", |b| {
        b.iter(|| {
            rays.iter()
                .filter_map(|&(origin, direction)| surroundings.hit(origin, direction))
                .map(|hit| hit.distance)
                .sum::<f32>()
        });
    });
    group.bench_function("first hit, obvhs CwBvh", |b| {
        b.iter(|| {
            rays.iter()
                .map(|&(origin, direction)| distance_by_wide(origin, direction))
                .filter(|&distance| distance < f32::INFINITY)
                .sum::<f32>()
        });
    });
    group.bench_function("any hit", |b| {
        b.iter(|| {
            rays.iter()
                .filter(|&&(origin, direction)| surroundings.blocks(origin, direction))
                .count()
        });
    });
    group.bench_function("any hit, obvhs CwBvh", |b| {
        b.iter(|| {
            rays.iter()
                .filter(|&&(origin, direction)| blocked_by_wide(origin, direction))
                .count()
        });
    });
    group.finish();
    let mut group = c.benchmark_group("building");
    group.sample_size(20);
    group.bench_function("the tree of boxes", |b| b.iter(|| room.surroundings()));
    group.finish();
}

/// Pixels with their tables, of samples (row, column, picture and channel) or without.
struct Pixels {
    points: Vec<DVec3>,
    normals: Vec<DVec3>,
    views: Vec<DVec3>,
    seeds: Vec<u64>,
}

impl Pixels {
    fn new(room: &Room, count: usize) -> Self {
        let starts: Vec<_> = room.starts(count).collect();
        let double = |v: Vec3A| v.as_dvec3();
        Self {
            points: starts.iter().map(|&(start, _)| double(start)).collect(),
            normals: starts.iter().map(|&(_, normal)| double(normal)).collect(),
            views: (starts.iter())
                .map(|&(start, _)| -double(start).normalize())
                .collect(),
            seeds: (0..count as u64).collect(),
        }
    }

    fn tables(
        &self,
        surroundings: &Surroundings,
        model: Model,
        rays: usize,
        samples: Option<&[f32]>,
        threads: usize,
    ) -> Transfer {
        let origins = Origins {
            points: &self.points,
            normals: &self.normals,
            views: &self.views,
            seeds: &self.seeds,
        };
        let radiance = samples.map(|samples| Radiance {
            samples,
            size: [SIDE, SIDE],
            half_width: HALF_WIDTH,
            nearest: &[],
        });
        transfer(surroundings, origins, model, rays, radiance, threads).unwrap()
    }
}

/// Three channels of every picture.
fn samples() -> Vec<f32> {
    (0..SIDE * SIDE * PICTURES * 3)
        .map(|i| wave(i, 0.7) as f32)
        .collect()
}

/// A pixel's tables from the rays of one pixel, on one core.
fn tables(c: &mut Criterion) {
    let room = Room::new();
    let (surroundings, samples) = (room.surroundings(), samples());
    let pixels = Pixels::new(&room, 64);
    let mut group = c.benchmark_group("tables, 2048 rays a pixel, one core");
    group.throughput(Throughput::Elements(64));
    group.sample_size(10);
    for model in MODELS {
        for (name, given) in [
            ("occlusion", None),
            ("bounce of 16 pictures", Some(&samples)),
        ] {
            let given = given.map(Vec::as_slice);
            group.bench_function(format!("{model:?}, {name}"), |b| {
                b.iter(|| pixels.tables(black_box(&surroundings), model, RAYS, given, 1));
            });
        }
    }
    group.finish();
}

/// What tables cost afterwards: the loss with its gradient, and the best materials.
fn fits(c: &mut Criterion) {
    const PIXELS: usize = SIDE * SIDE - SIDE;
    let room = Room::new();
    let (surroundings, samples) = (room.surroundings(), samples());
    let pixels = Pixels::new(&room, PIXELS);
    let count = PIXELS * PICTURES * 3;
    let images: Vec<_> = (0..count).map(|i| wave(i, 2.1) as f32).collect();
    let x: Vec<_> = (0..5 * PIXELS + PICTURES * 48)
        .map(|i| wave(i, 0.31))
        .collect();
    let everything: Vec<usize> = (0..PIXELS).collect();
    let grid: Vec<f64> = (0..8).map(|i| 0.1 + 0.1 * f64::from(i)).collect();
    let search = Search {
        roughness: &grid,
        metallic: &[0.0, 0.5, 1.0],
        starts: 1,
        steps: 10,
        exact_steps: 1,
        held_normals: false,
        prior: None,
    };
    let mut group = c.benchmark_group("63·64 pixels, 16 pictures, one core");
    group.throughput(Throughput::Elements(PIXELS as u64));
    group.sample_size(10);
    for model in MODELS {
        for (name, rays, given) in [
            ("open", 0, None),
            ("occlusion", 60, None),
            ("bounce", 60, Some(samples.as_slice())),
        ] {
            let transfer = (rays > 0).then(|| pixels.tables(&surroundings, model, rays, given, 0));
            let mut targets = Targets::new(PIXELS, PICTURES, 3, 1).unwrap();
            for picture in images.chunks(PIXELS * 3) {
                targets.push(picture).unwrap();
            }
            let given = Pictures {
                images: targets,
                weights: None,
                normals: &pixels.normals,
                views: &pixels.views,
                transfer,
            };
            let options = Options {
                model,
                threads: 1,
                ..Options::default()
            };
            let problem = Problem::new(given, options).unwrap();
            let mut gradient = vec![0.0; problem.size()];
            group.bench_function(format!("value_and_grad, {model:?}, {name}"), |b| {
                b.iter(|| {
                    problem
                        .value_and_grad(black_box(&x), &mut gradient)
                        .unwrap()
                });
            });
            group.bench_function(format!("fit_materials, {model:?}, {name}"), |b| {
                b.iter(|| {
                    problem
                        .fit_materials(black_box(&x), &everything, &search)
                        .unwrap()
                });
            });
        }
    }
    group.finish();
}

criterion_group!(benches, rays, tables, fits);
criterion_main!(benches);
