//! The pictures of one scene, and the loss over them with its gradient by every unknown.

use glam::DVec3;

use crate::sh::COEFFICIENTS;
use crate::shade::{Factors, Frame, Material};
use crate::tile::{self, LANES, Lanes, LightPartials, PARTIAL_LANES, TileFactors, TileFrame};
use crate::{Error, Result, check, pool};

/// Tiles in a block: so many pixels are summed in float32 before float64 takes over.
const TILES: usize = 16;
const BLOCK: usize = TILES * LANES;
/// At most so many pieces of work. Their borders depend on the pixel count alone, and their
/// results are added in order, so every sum is the same at any number of threads.
const MAX_CHUNKS: usize = 64;

/// The pictures, prepared for repeated evaluation.
///
/// Unknowns are one vector, x = \[albedo R, G, B (a plane of `pixels` each) | roughness | metallic |
/// lighting (picture, coefficient, channel)\]. The loss is the mean over pixels, pictures and
/// channels of (I − T)².
#[derive(Debug)]
pub struct Problem {
    pixels: usize,
    pictures: usize,
    threads: usize,
    frames: Vec<TileFrame>,
    /// (tile, channel, picture)
    targets: Vec<Lanes>,
}

/// The least-squares problem for the lights when materials are known, one channel.
#[derive(Clone, Debug, PartialEq)]
pub struct LightEquations {
    /// Wᵀ W.
    pub gram: [[f64; COEFFICIENTS]; COEFFICIENTS],
    /// Tᵀ W, a row for each picture.
    pub right: Vec<[f64; COEFFICIENTS]>,
}

impl Problem {
    /// Copies and checks the pictures.
    ///
    /// `images` is (picture, pixel, channel), linear radiance; `normals` and `views` hold unit
    /// vectors, one a pixel. `threads` = 0 means one for each processor.
    pub fn new(
        images: &[f32],
        pictures: usize,
        normals: &[DVec3],
        views: &[DVec3],
        threads: usize,
    ) -> Result<Self> {
        let pixels = normals.len();
        if pixels == 0 || pictures == 0 {
            return Err(Error::argument(
                "images",
                "at least one picture and one pixel",
                format!("{pictures} pictures of {pixels} pixels"),
            ));
        }
        check::length("images", pictures * pixels * 3, images.len())?;
        check::length("views", pixels, views.len())?;
        check::finite("images", images)?;
        check::unit_vectors("normals", normals)?;
        check::unit_vectors("views", views)?;

        let tiles = pixels.div_ceil(LANES);
        let mut frames = vec![TileFrame::empty(); tiles];
        let mut targets = vec![[0.0; LANES]; tiles * 3 * pictures];
        for p in 0..pixels {
            let (t, lane) = (p / LANES, p % LANES);
            frames[t].set(lane, &Frame::new(normals[p], views[p]));
            for i in 0..pictures {
                for c in 0..3 {
                    targets[(t * 3 + c) * pictures + i][lane] = images[(i * pixels + p) * 3 + c];
                }
            }
        }
        Ok(Self {
            pixels,
            pictures,
            threads,
            frames,
            targets,
        })
    }

    /// Number of pixels.
    pub fn pixels(&self) -> usize {
        self.pixels
    }

    /// Number of pictures.
    pub fn pictures(&self) -> usize {
        self.pictures
    }

    /// Number of unknowns.
    pub fn size(&self) -> usize {
        5 * self.pixels + self.pictures * COEFFICIENTS * 3
    }

    /// The loss at x; its gradient is written to `gradient`.
    pub fn value_and_grad(&self, x: &[f64], gradient: &mut [f64]) -> Result<f64> {
        let x = Unknowns::new(self, x)?;
        check::length("gradient", self.size(), gradient.len())?;
        let lights = x.lights();
        let samples = 3.0 * (self.pixels * self.pictures) as f64;
        let scale = 2.0 / samples;
        let (maps, by_lighting) = gradient.split_at_mut(5 * self.pixels);
        let pieces = self
            .chunks()
            .zip(chunks_of_planes(maps, self.pixels, self.chunk()));
        let partials = pool::map(self.threads, pieces.collect(), |(first, mut out)| {
            self.evaluate_chunk(&x, &lights, first, scale, &mut out)
        });

        let mut loss = 0.0;
        by_lighting.fill(0.0);
        for partial in &partials {
            loss += partial.squares;
            for (c, of_channel) in partial.by_lights.chunks(self.pictures).enumerate() {
                for (i, of_picture) in of_channel.iter().enumerate() {
                    for k in 0..COEFFICIENTS {
                        by_lighting[(i * COEFFICIENTS + k) * 3 + c] += scale * of_picture[k];
                    }
                }
            }
        }
        if !loss.is_finite() {
            // Lights so large that float32 overflows.
            return Err(Error::argument("x", "a point with a finite loss", loss));
        }
        Ok(loss / samples)
    }

    /// The pictures that x predicts: (picture, pixel, channel).
    pub fn render(&self, x: &[f64]) -> Result<Vec<f32>> {
        let x = Unknowns::new(self, x)?;
        let lights = x.lights();
        let n = self.pictures;
        let rendered = pool::map(self.threads, self.chunks().collect(), |first| {
            let tiles = first / LANES..(first + self.chunk()).min(self.pixels).div_ceil(LANES);
            let mut out = vec![[0.0; LANES]; tiles.len() * 3 * n];
            for (t, out) in tiles.zip(out.chunks_mut(3 * n)) {
                let mut factors = [TileFactors::ZERO; 3];
                for (lane, p) in self.pixels_of_tile(t).enumerate() {
                    let of_pixel = Factors::new(self.frames[t].cosine[lane], &x.material(p));
                    for c in 0..3 {
                        factors[c].set(lane, &of_pixel, c);
                    }
                }
                for c in 0..3 {
                    let w = tile::weights(&self.frames[t], &factors[c]);
                    tile::radiance(&w, &lights[c * n..][..n], &mut out[c * n..][..n]);
                }
            }
            out
        });
        let mut images = vec![0.0; n * self.pixels * 3];
        for (t, radiance) in rendered
            .iter()
            .flat_map(|out| out.chunks(3 * n))
            .enumerate()
        {
            for (lane, p) in self.pixels_of_tile(t).enumerate() {
                for c in 0..3 {
                    for i in 0..n {
                        images[(i * self.pixels + p) * 3 + c] = radiance[c * n + i][lane];
                    }
                }
            }
        }
        Ok(images)
    }

    /// The normal equations of the lights, channel by channel, for the materials in x. Sums run in
    /// float64, because the lights' condition number squares here.
    pub fn light_equations(&self, x: &[f64]) -> Result<[LightEquations; 3]> {
        let x = Unknowns::new(self, x)?;
        let n = self.pictures;
        let zero = LightEquations {
            gram: [[0.0; COEFFICIENTS]; COEFFICIENTS],
            right: vec![[0.0; COEFFICIENTS]; n],
        };
        let partials = pool::map(self.threads, self.chunks().collect(), |first| {
            let mut sums = [zero.clone(), zero.clone(), zero.clone()];
            for p in first..(first + self.chunk()).min(self.pixels) {
                let (t, lane) = (p / LANES, p % LANES);
                let weights = crate::shade::shade(&self.frames[t].get(lane), &x.material(p));
                for (c, sum) in sums.iter_mut().enumerate() {
                    let w = &weights[c];
                    for j in 0..COEFFICIENTS {
                        for k in 0..=j {
                            sum.gram[j][k] += w[j] * w[k];
                        }
                    }
                    for (i, right) in sum.right.iter_mut().enumerate() {
                        let target = f64::from(self.targets[(t * 3 + c) * n + i][lane]);
                        for k in 0..COEFFICIENTS {
                            right[k] += target * w[k];
                        }
                    }
                }
            }
            sums
        });
        let mut total = [zero.clone(), zero.clone(), zero];
        for partial in partials {
            for (total, partial) in total.iter_mut().zip(partial) {
                add(total.gram.as_flattened_mut(), partial.gram.as_flattened());
                add(total.right.as_flattened_mut(), partial.right.as_flattened());
            }
        }
        for LightEquations { gram, .. } in &mut total {
            for j in 0..COEFFICIENTS {
                for k in 0..j {
                    gram[k][j] = gram[j][k];
                }
            }
        }
        Ok(total)
    }

    /// Pixels in a piece of work: whole blocks.
    fn chunk(&self) -> usize {
        BLOCK * self.pixels.div_ceil(BLOCK * MAX_CHUNKS)
    }

    /// First pixel of every piece of work.
    fn chunks(&self) -> impl Iterator<Item = usize> {
        (0..self.pixels).step_by(self.chunk())
    }

    fn pixels_of_tile(&self, t: usize) -> std::ops::Range<usize> {
        t * LANES..((t + 1) * LANES).min(self.pixels)
    }

    /// Loss and gradient of one piece of work, a block at a time: the factors of the block's
    /// pixels; then, channel by channel, the matrix products; then the material derivatives.
    fn evaluate_chunk(
        &self,
        x: &Unknowns,
        lights: &[[f32; COEFFICIENTS]],
        first: usize,
        scale: f64,
        by_material: &mut [&mut [f64]; 5],
    ) -> Partial {
        let n = self.pictures;
        let mut partial = Partial {
            squares: 0.0,
            by_lights: vec![[0.0; COEFFICIENTS]; 3 * n],
        };
        let mut by_lights: Vec<LightPartials> = vec![[[0.0; PARTIAL_LANES]; COEFFICIENTS]; n];
        let end = (first + self.chunk()).min(self.pixels);
        for block in (first..end).step_by(BLOCK) {
            let pixels = block..(block + BLOCK).min(end);
            let tiles = block / LANES..pixels.end.div_ceil(LANES);

            let mut factors = Vec::with_capacity(BLOCK);
            let mut tile_factors = [[TileFactors::ZERO; TILES]; 3];
            for (q, p) in pixels.clone().enumerate() {
                let (t, lane) = (p / LANES, p % LANES);
                let of_pixel = Factors::new(self.frames[t].cosine[lane], &x.material(p));
                for c in 0..3 {
                    tile_factors[c][q / LANES].set(lane, &of_pixel, c);
                }
                factors.push(of_pixel);
            }

            let mut by_diffuse = [[[0.0; LANES]; TILES]; 3];
            let mut band_sums = [[[[0.0; LANES]; 4]; TILES]; 3];
            for c in 0..3 {
                let mut squares = [0.0; LANES];
                by_lights.fill([[0.0; PARTIAL_LANES]; COEFFICIENTS]);
                for (q, t) in tiles.clone().enumerate() {
                    let w = tile::weights(&self.frames[t], &tile_factors[c][q]);
                    let mut by_weights = [[0.0; LANES]; COEFFICIENTS];
                    tile::residuals(
                        &w,
                        &lights[c * n..][..n],
                        &self.targets[(t * 3 + c) * n..][..n],
                        &mut by_weights,
                        &mut by_lights,
                        &mut squares,
                    );
                    (by_diffuse[c][q], band_sums[c][q]) =
                        tile::reduce(&self.frames[t], &by_weights);
                }
                partial.squares += sum(&squares);
                for (total, of_block) in partial.by_lights[c * n..].iter_mut().zip(&by_lights) {
                    for k in 0..COEFFICIENTS {
                        total[k] += sum(&of_block[k]);
                    }
                }
            }

            for (q, p) in pixels.enumerate() {
                let (t, lane) = (q / LANES, p % LANES);
                let gradient = factors[q].pull_back(
                    &x.material(p),
                    &[0, 1, 2].map(|c| f64::from(by_diffuse[c][t][lane])),
                    &[0, 1, 2].map(|c| band_sums[c][t].map(|s| f64::from(s[lane]))),
                );
                let [r, g, b] = gradient.albedo;
                let planes = [r, g, b, gradient.roughness, gradient.metallic];
                for (plane, value) in by_material.iter_mut().zip(planes) {
                    plane[p - first] = scale * value;
                }
            }
        }
        partial
    }
}

/// What one piece of work adds to the sums over pixels.
struct Partial {
    /// Σ (I − T)²
    squares: f64,
    /// Derivatives of ½ Σ (I − T)² by the lights: (channel, picture).
    by_lights: Vec<[f64; COEFFICIENTS]>,
}

/// The vector of unknowns, taken apart.
struct Unknowns<'a> {
    pixels: usize,
    maps: &'a [f64],
    lighting: &'a [f64],
}

impl<'a> Unknowns<'a> {
    fn new(problem: &Problem, x: &'a [f64]) -> Result<Self> {
        check::length("x", problem.size(), x.len())?;
        check::finite("x", x)?;
        let (maps, lighting) = x.split_at(5 * problem.pixels);
        check::unit_interval("x (albedo, roughness, metallic)", maps)?;
        Ok(Self {
            pixels: problem.pixels,
            maps,
            lighting,
        })
    }

    fn material(&self, p: usize) -> Material {
        let plane = |i: usize| self.maps[i * self.pixels + p];
        Material {
            albedo: [plane(0), plane(1), plane(2)],
            roughness: plane(3),
            metallic: plane(4),
        }
    }

    /// The lights in float32: (channel, picture).
    fn lights(&self) -> Vec<[f32; COEFFICIENTS]> {
        let pictures = self.lighting.as_chunks::<{ COEFFICIENTS * 3 }>().0;
        let of_channel = |c: usize| {
            pictures
                .iter()
                .map(move |l| std::array::from_fn(|k| l[k * 3 + c] as f32))
        };
        (0..3).flat_map(of_channel).collect()
    }
}

/// Five planes of `pixels` values each, cut into pieces of `chunk` pixels.
fn chunks_of_planes(
    maps: &mut [f64],
    pixels: usize,
    chunk: usize,
) -> impl Iterator<Item = [&mut [f64]; 5]> {
    let mut planes = maps.chunks_mut(pixels).map(|plane| plane.chunks_mut(chunk));
    let mut planes: [_; 5] = std::array::from_fn(|_| planes.next().expect("five planes"));
    (0..pixels.div_ceil(chunk)).map(move |_| {
        planes
            .each_mut()
            .map(|plane| plane.next().expect("equal planes"))
    })
}

fn sum(partials: &[f32]) -> f64 {
    partials.iter().map(|&s| f64::from(s)).sum()
}

fn add(total: &mut [f64], partial: &[f64]) {
    for (t, p) in total.iter_mut().zip(partial) {
        *t += p;
    }
}
