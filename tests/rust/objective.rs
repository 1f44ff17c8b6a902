//! The fast objective against the model in float64, in every version and instruction set.

use glam::DVec3;
use pbrfit::problem::targets::Targets;
use pbrfit::problem::{Options, Pictures, Problem};
use pbrfit::reflectance::band_table::TABLE;
use pbrfit::reflectance::ggx;
use pbrfit::reflectance::model::Model;
use pbrfit::reflectance::paper::Paper;
use pbrfit::reflectance::planes::Material;
use pbrfit::reflectance::shade::{Frame, shade, shade_vjp};
use pbrfit::reflectance::tangent_offset;
use pbrfit::runtime::simd::{Instructions, Isa, Kernel};
use pbrfit::schur::Elimination;

#[derive(Clone)]
struct Example {
    pictures: usize,
    channels: usize,
    sh_order: usize,
    metallic: Option<f64>,
    known_lights: bool,
    free_normals: bool,
    normals: Vec<DVec3>,
    views: Vec<DVec3>,
    images: Vec<f32>,
    weights: Option<Vec<f32>>,
    /// All maps, then all lights, known or not.
    maps: Vec<f64>,
    /// Two planes; not read unless normals are free.
    offsets: Vec<f64>,
    lighting: Vec<f64>,
}

fn wave(i: usize, a: f64) -> f64 {
    0.5 + 0.45 * (a * (i + 1) as f64).sin()
}

impl Example {
    fn new(pixels: usize, pictures: usize) -> Self {
        Self::with(pixels, pictures, 3, 3)
    }

    fn with(pixels: usize, pictures: usize, channels: usize, sh_order: usize) -> Self {
        let direction = |p: usize, a: f64| {
            DVec3::new(wave(p, a) - 0.5, wave(p, 1.9 * a) - 0.5, 0.6).normalize()
        };
        let coefficients = (sh_order + 1).pow(2);
        Self {
            pictures,
            channels,
            sh_order,
            metallic: None,
            known_lights: false,
            free_normals: false,
            normals: (0..pixels).map(|p| direction(p, 0.7)).collect(),
            views: (0..pixels).map(|p| direction(p, 0.011)).collect(),
            images: (0..pictures * pixels * channels)
                .map(|i| wave(i, 2.1) as f32)
                .collect(),
            weights: None,
            maps: (0..(channels + 2) * pixels)
                .map(|i| wave(i, 0.313))
                .collect(),
            offsets: (0..2 * pixels).map(|i| wave(i, 0.417) - 0.5).collect(),
            lighting: (0..pictures * coefficients * channels)
                .map(|i| wave(i, 0.517))
                .collect(),
        }
    }

    fn problem(&self, threads: usize) -> Problem {
        self.problem_for(threads, Instructions::best())
    }

    fn problem_for(&self, threads: usize, instructions: Instructions) -> Problem {
        let given = Pictures {
            images: self.targets(threads),
            weights: self.weights.as_deref(),
            normals: &self.normals,
            views: &self.views,
            transfer: None,
        };
        let options = Options {
            model: Model::Paper,
            sh_order: self.sh_order,
            metallic: self.metallic,
            lighting: self.known_lights.then(|| self.lighting.clone()),
            free_normals: self.free_normals,
            threads,
            instructions,
        };
        Problem::new(given, options).unwrap()
    }

    fn targets(&self, threads: usize) -> Targets {
        let (pixels, channels) = (self.pixels(), self.channels);
        let mut targets = Targets::new(pixels, self.pictures, channels, threads).unwrap();
        for picture in self.images.chunks(pixels * channels) {
            targets.push(picture).unwrap();
        }
        targets
    }

    fn pixels(&self) -> usize {
        self.normals.len()
    }

    fn coefficients(&self) -> usize {
        (self.sh_order + 1).pow(2)
    }

    /// Entries of x that are materials.
    fn free_materials(&self) -> usize {
        (self.channels + 1 + usize::from(self.metallic.is_none())) * self.pixels()
    }

    /// Entries of x that are maps.
    fn free_maps(&self) -> usize {
        self.free_materials()
            + if self.free_normals {
                self.offsets.len()
            } else {
                0
            }
    }

    fn x(&self) -> Vec<f64> {
        let mut x = self.maps[..self.free_materials()].to_vec();
        if self.free_normals {
            x.extend(&self.offsets);
        }
        if !self.known_lights {
            x.extend(&self.lighting);
        }
        x
    }

    /// With three channels, the missing ones black.
    fn material(&self, p: usize) -> Material {
        let plane = |i: usize| self.maps[i * self.pixels() + p];
        let mut albedo = [0.0; 3];
        for (c, albedo) in albedo[..self.channels].iter_mut().enumerate() {
            *albedo = plane(c);
        }
        Material {
            albedo,
            roughness: plane(self.channels),
            metallic: self.metallic.unwrap_or_else(|| plane(self.channels + 1)),
        }
    }

    fn weight(&self, picture: usize, p: usize, c: usize) -> f64 {
        let sample = picture * self.pixels() + p;
        match &self.weights {
            None => 1.0,
            Some(w) if w.len() == self.pictures * self.pixels() => f64::from(w[sample]),
            Some(w) => f64::from(w[sample * self.channels + c]),
        }
    }

    fn turned(&self, p: usize) -> tangent_offset::OffsetNormal {
        let [a, b] = [0, 1].map(|t| self.offsets[t * self.pixels() + p]);
        tangent_offset::offset_normal(self.normals[p], [a, b])
    }

    /// Loss and gradient by the definition, pixel by pixel in float64; all unknowns, known or not.
    fn reference(&self) -> (f64, Vec<f64>) {
        let (pixels, channels, count) = (self.pixels(), self.channels, self.coefficients());
        let mut total = 0.0;
        let mut loss = 0.0;
        let mut by_maps = vec![0.0; self.maps.len()];
        let mut by_offsets = vec![0.0; self.offsets.len()];
        let mut by_lighting = vec![0.0; self.lighting.len()];
        for p in 0..pixels {
            let turned = self.turned(p);
            let normal = if self.free_normals {
                turned.normal
            } else {
                self.normals[p]
            };
            let (view, material) = (self.views[p], self.material(p));
            let w = shade(&Frame::<Paper>::new(normal, view), &material);
            let mut by_weights = [[0.0; 16]; 3];
            for i in 0..self.pictures {
                for c in 0..channels {
                    let light = |k: usize| (i * count + k) * channels + c;
                    let radiance: f64 = (0..count).map(|k| w[c][k] * self.lighting[light(k)]).sum();
                    let e = radiance - f64::from(self.images[(i * pixels + p) * channels + c]);
                    let omega = self.weight(i, p, c);
                    total += omega;
                    let slope = 2.0 * e;
                    loss += omega * e * e;
                    for k in 0..count {
                        by_weights[c][k] += omega * slope * self.lighting[light(k)];
                        by_lighting[light(k)] += omega * slope * w[c][k];
                    }
                }
            }
            let (g, by_normal) = shade_vjp::<Paper, 3>(normal, view, &material, &by_weights);
            for t in 0..2 {
                by_offsets[t * pixels + p] = by_normal.dot(turned.by_offset[t]);
            }
            for c in 0..channels {
                by_maps[c * pixels + p] = g.albedo[c];
            }
            by_maps[channels * pixels + p] = g.roughness;
            by_maps[(channels + 1) * pixels + p] = g.metallic;
        }
        by_maps.truncate(self.free_materials());
        if self.free_normals {
            by_maps.append(&mut by_offsets);
        }
        if !self.known_lights {
            by_maps.append(&mut by_lighting);
        }
        (loss / total, by_maps.iter().map(|g| g / total).collect())
    }

    /// Fails, naming the part, where the fast objective misses the reference.
    fn check(&self, instructions: Instructions, what: &str) {
        let x = self.x();
        let mut gradient = vec![f64::NAN; x.len()];
        let loss = self
            .problem_for(2, instructions)
            .value_and_grad(&x, &mut gradient)
            .unwrap();
        let (true_loss, true_gradient) = self.reference();
        assert!(
            (loss - true_loss).abs() <= 1e-6 * true_loss,
            "{what}: loss {loss}, expected {true_loss}"
        );
        let n = self.pixels();
        let ends = [
            0,
            self.channels * n,
            (self.channels + 1) * n,
            self.free_materials(),
            self.free_maps(),
            x.len(),
        ];
        for (i, name) in ["albedo", "roughness", "metallic", "offsets", "lighting"]
            .iter()
            .enumerate()
        {
            let block = ends[i]..ends[i + 1];
            let off = norm(block.clone().map(|i| gradient[i] - true_gradient[i]));
            let size = norm(block.map(|i| true_gradient[i]));
            assert!(
                off <= 1e-5 * size,
                "{what}: {name} is off by {off:e} of {size:e}"
            );
        }
    }
}

fn norm(values: impl Iterator<Item = f64>) -> f64 {
    values.map(|v| v * v).sum::<f64>().sqrt()
}

#[test]
fn every_version_agrees_with_the_definition() {
    for instructions in Instructions::all() {
        for bits in 0..128 {
            let bit = |i: usize| bits >> i & 1 == 1;
            let (channels, order) = (if bit(0) { 1 } else { 3 }, if bit(1) { 2 } else { 3 });
            // More pictures than go through the products together.
            let mut example = Example::with(150, 19, channels, order);
            example.metallic = bit(2).then_some(0.3);
            example.known_lights = bit(3);
            example.free_normals = bit(6);
            if bit(4) {
                let of_sample = if bit(5) { channels } else { 1 };
                example.weights = Some(
                    (0..19 * 150 * of_sample)
                        .map(|i| if i % 5 == 0 { 0.0 } else { wave(i, 0.9) as f32 })
                        .collect(),
                );
            }
            let what = format!(
                "{}: {channels} channels, order {order}, metallic {:?}, lights known {}, normals free {}, weights {:?}",
                instructions.name(),
                example.metallic,
                example.known_lights,
                example.free_normals,
                example.weights.as_ref().map(Vec::len),
            );
            example.check(instructions, &what);
        }
    }
}

/// The row of the band table at a roughness.
struct Row(f64);

impl Kernel for Row {
    type Output = [f64; 8];

    #[inline(always)]
    fn run<I: Isa>(self, isa: I) -> [f64; 8] {
        TABLE.row(isa, self.0).0
    }
}

#[test]
fn band_table_agrees_with_the_bands() {
    // Between the cells' borders, on them, beside them, and where the table begins.
    let mut roughness: Vec<f64> = (0..=20_000).map(|i| f64::from(i) / 20_000.0).collect();
    for i in 0..=96 {
        let octave = 2f64.powi(i / 16 - 6);
        let border = octave * (1.0 + f64::from(i % 16) / 16.0);
        roughness.extend([border.next_down(), border, border.next_up().min(1.0)]);
    }
    roughness.extend([0.0, f64::MIN_POSITIVE, 1e-80, 1e-5, 0.4f64.next_down()]);
    for instructions in Instructions::all() {
        for &r in &roughness {
            let exact = ggx::bands(r);
            let row = instructions.run(Row(r));
            for l in 0..4 {
                let (h, slope) = (row[l] - exact.weight[l], row[4 + l] - exact.slope[l]);
                assert!(h.abs() <= 2e-14, "h{l}({r}) is off by {h:e}");
                assert!(slope.abs() <= 1e-13, "h{l}'({r}) is off by {slope:e}");
            }
        }
    }
}

/// Of what cannot come from Python, whose tests have the rest.
#[test]
fn refusals_name_the_array() {
    let example = Example::new(20, 2);
    let refused = |values: &[f32], pixels: usize, pictures: usize, channels: usize| {
        let targets = Targets::new(pixels, pictures, channels, 0);
        let refused = targets.and_then(|mut targets| {
            let mut pictures = values.chunks(pixels * channels);
            pictures.try_for_each(|picture| targets.push(picture))
        });
        refused.unwrap_err().to_string()
    };
    assert!(refused(&example.images[1..], 20, 2, 3).starts_with("images: expected 60 numbers"));
    let mut not_finite = example.images.clone();
    not_finite[67] = f32::NAN;
    assert_eq!(
        refused(&not_finite, 20, 2, 3),
        "images: expected finite numbers, found NaN at 67"
    );
    assert!(
        refused(&[], 0, 2, 3).starts_with("images: expected at least one picture and one pixel")
    );
    assert!(
        refused(&example.images, 20, 1 << 40, 3)
            .starts_with("images: expected at most 2147483648 pixels times pictures")
    );
    assert!(refused(&example.images, 20, 2, 2).starts_with("images: expected 1 or 3 channels"));
    let mut targets = Targets::new(20, 2, 3, 0).unwrap();
    let picture = [0.5; 60];
    targets.push(&picture).unwrap();
    let given = Pictures {
        images: targets.clone(),
        weights: None,
        normals: &example.normals,
        views: &example.views,
        transfer: None,
    };
    let new =
        |given: Pictures, options: Options| Problem::new(given, options).unwrap_err().to_string();
    assert_eq!(
        new(given.clone(), Options::default()),
        "images: expected 2 pictures, found 1"
    );
    targets.push(&picture).unwrap();
    assert_eq!(
        targets.push(&picture).unwrap_err().to_string(),
        "images: expected 2 pictures, found 3"
    );
    let given = Pictures {
        images: targets,
        ..given
    };
    let (views, normals) = (&example.views[1..], &example.normals[1..]);
    for (given, expected) in [
        (
            Pictures {
                views,
                ..given.clone()
            },
            "views: expected 20",
        ),
        (
            Pictures {
                normals,
                ..given.clone()
            },
            "normals: expected 20",
        ),
        (
            Pictures {
                weights: Some(&[1.0; 39]),
                ..given.clone()
            },
            "weights: expected 120 numbers",
        ),
    ] {
        let found = new(given, Options::default());
        assert!(found.starts_with(expected), "{found}");
    }
    let options = Options {
        lighting: Some(vec![1.0; 95]),
        ..Options::default()
    };
    assert!(new(given, options).starts_with("lighting: expected 96 numbers"));
}

/// Matrices, gradients and moves of every second pixel, one after the other.
fn normal_equations(example: &Example, problem: &Problem) -> Vec<f64> {
    let (x, n) = (example.x(), example.pixels());
    let pixels: Vec<usize> = (0..n).step_by(2).collect();
    let unknowns = example.free_maps() / n;
    let covariances: Vec<f64> = (0..pixels.len() * unknowns * unknowns)
        .map(|i| wave(i, 0.9))
        .collect();
    let modes: Vec<f64> = (0..2 * example.lighting.len())
        .map(|i| wave(i, 1.3))
        .collect();
    let equations = problem.normal_equations(&x, &pixels).unwrap();
    let moves = problem.moves_with_lights(&x, &pixels, &covariances, &modes);
    let derivatives = problem.derivatives(&x, &pixels).unwrap();
    let how = Elimination {
        damping: 0.1,
        ..Elimination::default()
    };
    let schur_complement = problem.schur_complement(&x, &pixels, &how).unwrap();
    let back_substitute = problem.back_substitute(&x, &pixels, &modes[..modes.len() / 2], &how);
    [
        equations.concat(),
        derivatives.concat(),
        moves.unwrap().concat(),
        schur_complement.matrix,
        schur_complement.gradient,
        back_substitute.unwrap(),
    ]
    .concat()
}

#[test]
fn normal_equations_agree_in_every_instruction_set() {
    for (channels, sh_order, free_normals) in
        [(1, 3, false), (3, 2, false), (1, 2, true), (3, 3, true)]
    {
        let mut example = Example::with(300, 3, channels, sh_order);
        example.free_normals = free_normals;
        let best = normal_equations(&example, &example.problem(1));
        let size = norm(best.iter().copied());
        for instructions in Instructions::all() {
            let other = normal_equations(&example, &example.problem_for(1, instructions));
            let off = norm(best.iter().zip(&other).map(|(a, b)| a - b));
            assert!(
                off <= 1e-12 * size,
                "{}: off by {off:e} of {size:e}",
                instructions.name()
            );
        }
    }
}
