//! Gauss–Newton: the normal matrix of each pixel's material, and how it is tied to the lights.
//!
//! With radiance I, targets T, weights ω of the samples (picture i, channel c) and θ the unknowns of
//! a pixel, that is albedo by channel, roughness and, unless it is known, metallic:
//!
//! ```text
//! J = ∂I/∂θ          A = Jᵀ Ω J          g = Jᵀ Ω (I − T)
//! ```
//!
//! Radiance is linear in the light, I_ic = Σ_k w_ck L_ick, so the normal matrix of materials and
//! lights together is an arrow. Pixels touch the lights only, and a light of one channel touches
//! none but itself:
//!
//! ```text
//! ⎛ A_p  B_p ⎞       B_p[θ, ick]    = ω_ic J_icθ w_ck
//! ⎝ B_pᵀ  G  ⎠       G[ick, ick']   = Σ_p ω_ic w_ck w_ck'
//! ```
//!
//! A pixel sees five numbers of a light: Σ_k A_l Y_k(n) L_k and, for each band, Σ_{k in l}
//! Y_k(mirror) L_k. Radiance and its derivatives are linear in them, with coefficients that no
//! picture changes ([`FillResponses`]). All of this is float64: the matrices are differenced and
//! inverted afterwards.

use crate::block::{
    BLOCK, Basis, BlockBands, ChannelFactors, Directions, FillBands, FillBasis, FillFactors,
    FillWeights, Materials, Plane, Radiance, SEEN, seen,
};
use crate::ggx::Bands;
use crate::problem::Problem;
use crate::sh::COEFFICIENTS;
use crate::shade::{Factors, Material};
use crate::simd::{Instructions, Isa, Kernel};
use crate::{Error, Result, check, pool};

/// By what radiance is derived in one channel: its albedo, roughness, metallic.
pub const DERIVATIVES: usize = 3;
/// Unknowns of a pixel at most.
pub(crate) const MAX_UNKNOWNS: usize = 5;
/// Blocks of pixels in a piece of work.
const CHUNK: usize = 2;

type Doubles = Plane<f64>;

/// Of some pixels with D unknowns each.
#[derive(Clone, Debug)]
pub struct NormalEquations {
    /// A = Jᵀ Ω J: (pixel, D, D).
    pub matrices: Vec<f64>,
    /// g = Jᵀ Ω (I − T), half of the slope of the sum of squares: (pixel, D).
    pub gradient: Vec<f64>,
    /// Σ ω (I − T)²: (pixel).
    pub squares: Vec<f64>,
}

/// Derivatives of the radiance of some pixels.
#[derive(Clone, Debug)]
pub struct Derivatives {
    /// By albedo (of the same channel), roughness and metallic, known or not: (pixel, picture,
    /// channel, 3).
    pub by_material: Vec<f64>,
    /// By the coefficients of the light, w_ck, the same for all pictures: (pixel, channel, K).
    pub by_light: Vec<f64>,
    /// ω: (pixel, picture, channel).
    pub weights: Vec<f64>,
}

impl Problem {
    /// The normal equations of the materials of some pixels, with the lights held.
    pub fn normal_equations(&self, x: &[f64], pixels: &[usize]) -> Result<NormalEquations> {
        match self.channels() {
            1 => normal_equations::<1>(self, x, pixels),
            _ => normal_equations::<3>(self, x, pixels),
        }
    }

    /// Derivatives of the radiance of some pixels by their materials and by the lights.
    pub fn derivatives(&self, x: &[f64], pixels: &[usize]) -> Result<Derivatives> {
        match self.channels() {
            1 => derivatives::<1>(self, x, pixels),
            _ => derivatives::<3>(self, x, pixels),
        }
    }

    /// How far the materials of some pixels move with the lights: (pixel, D).
    ///
    /// When the lights move by a mode v, the best material of a pixel moves by −C B v, with C its
    /// covariance A⁻¹. The result is the sum of squares of these moves over modes. `covariances` is
    /// (pixel, D, D), `modes` (mode, picture, coefficient, channel).
    pub fn moves_with_lights(
        &self,
        x: &[f64],
        pixels: &[usize],
        covariances: &[f64],
        modes: &[f64],
    ) -> Result<Vec<f64>> {
        match self.channels() {
            1 => moves_with_lights::<1>(self, x, pixels, covariances, modes),
            _ => moves_with_lights::<3>(self, x, pixels, covariances, modes),
        }
    }
}

fn normal_equations<const C: usize>(
    problem: &Problem,
    x: &[f64],
    pixels: &[usize],
) -> Result<NormalEquations> {
    let (maps, lights) = problem.at(x, pixels)?;
    let unknowns = problem.unknowns_of_pixel();
    let mut matrices = zeros(pixels.len() * unknowns * unknowns)?;
    let mut gradient = zeros(pixels.len() * unknowns)?;
    let mut squares = zeros(pixels.len())?;
    let size = CHUNK * BLOCK;
    let pieces = pixels
        .chunks(size)
        .zip(matrices.chunks_mut(size * unknowns * unknowns))
        .zip(gradient.chunks_mut(size * unknowns))
        .zip(squares.chunks_mut(size))
        .collect();
    pool::map(
        problem.threads(),
        pieces,
        |(((pixels, matrices), gradient), squares)| {
            let mut block = Block::<C>::new(problem);
            for (i, pixels) in pixels.chunks(BLOCK).enumerate() {
                block.load(maps, pixels);
                let mut sums = Sums::default();
                block.add_samples(&lights, &mut sums);
                for x in 0..pixels.len() {
                    let p = i * BLOCK + x;
                    sums.store_matrix(x, &mut matrices[p * unknowns * unknowns..], unknowns);
                    for (to, from) in gradient[p * unknowns..][..unknowns]
                        .iter_mut()
                        .zip(&sums.gradient)
                    {
                        *to = from.0[x];
                    }
                    squares[p] = sums.squares.0[x];
                }
            }
        },
    );
    Ok(NormalEquations {
        matrices,
        gradient,
        squares,
    })
}

fn derivatives<const C: usize>(
    problem: &Problem,
    x: &[f64],
    pixels: &[usize],
) -> Result<Derivatives> {
    let (maps, lights) = problem.at(x, pixels)?;
    let samples = problem.pictures() * C;
    let k = problem.coefficients();
    let mut by_material = zeros(pixels.len() * samples * DERIVATIVES)?;
    let mut by_light = zeros(pixels.len() * C * k)?;
    let mut weights = zeros(pixels.len() * samples)?;
    let size = CHUNK * BLOCK;
    let pieces = pixels
        .chunks(size)
        .zip(by_material.chunks_mut(size * samples * DERIVATIVES))
        .zip(by_light.chunks_mut(size * C * k))
        .zip(weights.chunks_mut(size * samples))
        .collect();
    pool::map(
        problem.threads(),
        pieces,
        |(((pixels, by_material), by_light), weights)| {
            let mut block = Block::<C>::new(problem);
            for (i, pixels) in pixels.chunks(BLOCK).enumerate() {
                block.load(maps, pixels);
                block.fill_weights();
                let of_block = by_light[i * BLOCK * C * k..].chunks_mut(k).enumerate();
                for (row, of_row) in of_block.take(pixels.len() * C) {
                    for (to, from) in of_row.iter_mut().zip(&block.weights[row % C]) {
                        *to = from.0[row / C];
                    }
                }
                block.each_sample(&lights, |c, picture, sample| {
                    for x in 0..pixels.len() {
                        let s = (i * BLOCK + x) * samples + picture * C + c;
                        weights[s] = sample.weight.0[x];
                        for j in 0..DERIVATIVES {
                            by_material[s * DERIVATIVES + j] = sample.derivatives[j].0[x];
                        }
                    }
                });
            }
        },
    );
    Ok(Derivatives {
        by_material,
        by_light,
        weights,
    })
}

fn moves_with_lights<const C: usize>(
    problem: &Problem,
    x: &[f64],
    pixels: &[usize],
    covariances: &[f64],
    modes: &[f64],
) -> Result<Vec<f64>> {
    let (maps, lights) = problem.at(x, pixels)?;
    let unknowns = problem.unknowns_of_pixel();
    let of_mode = problem.pictures() * problem.coefficients() * C;
    check::length(
        "covariances",
        pixels.len() * unknowns * unknowns,
        covariances.len(),
    )?;
    check::moderate("modes", modes, check::LARGEST_F64)?;
    if !modes.len().is_multiple_of(of_mode) {
        let expected = format!("{of_mode} numbers a mode");
        return Err(Error::argument("modes", expected, modes.len()));
    }
    let modes: Vec<_> = modes
        .chunks(of_mode)
        .map(|mode| problem.padded_lights(mode))
        .collect();
    let mut moves = zeros(pixels.len() * unknowns)?;
    let size = CHUNK * BLOCK;
    let pieces = pixels
        .chunks(size)
        .zip(covariances.chunks(size * unknowns * unknowns))
        .zip(moves.chunks_mut(size * unknowns))
        .collect();
    pool::map(
        problem.threads(),
        pieces,
        |((pixels, covariances), moves)| {
            let mut block = Block::<C>::new(problem);
            let mut weighted = vec![[Doubles::default(); DERIVATIVES]; C * problem.pictures()];
            let mut radiance = Doubles::default();
            for (i, pixels) in pixels.chunks(BLOCK).enumerate() {
                block.load(maps, pixels);
                block.fill_weights();
                // ω J of every sample, in the order of the lights.
                block.each_sample(&lights, |c, picture, sample| {
                    let to = &mut weighted[c * problem.pictures() + picture];
                    for (to, from) in to.iter_mut().zip(&sample.derivatives) {
                        for x in 0..BLOCK {
                            to.0[x] = sample.weight.0[x] * from.0[x];
                        }
                    }
                });
                for mode in &modes {
                    // B v
                    let mut product = [Doubles::default(); MAX_UNKNOWNS];
                    for (sample, (light, weighted)) in mode.iter().zip(&weighted).enumerate() {
                        let c = sample / problem.pictures();
                        block.isa.run(Radiance {
                            weights: &block.weights[c],
                            light,
                            radiance: &mut radiance,
                        });
                        for (j, row) in unknowns_of_channel::<C>(c).into_iter().enumerate() {
                            block.isa.run(AddProduct {
                                a: &weighted[j],
                                b: &radiance,
                                sum: &mut product[row],
                            });
                        }
                    }
                    for x in 0..pixels.len() {
                        let p = i * BLOCK + x;
                        for row in 0..unknowns {
                            let covariance =
                                &covariances[(p * unknowns + row) * unknowns..][..unknowns];
                            let mut moved = 0.0;
                            for (c, product) in covariance.iter().zip(&product) {
                                moved += c * product.0[x];
                            }
                            moves[p * unknowns + row] += moved * moved;
                        }
                    }
                }
            }
        },
    );
    Ok(moves)
}

/// Where the three derivatives of a channel belong among the unknowns of a pixel. Metallic is the
/// last: where it is known, its row is left out of what is handed out.
pub(crate) fn unknowns_of_channel<const C: usize>(channel: usize) -> [usize; DERIVATIVES] {
    [channel, C, C + 1]
}

pub(crate) fn zeros(count: usize) -> Result<Vec<f64>> {
    let mut numbers = Vec::new();
    numbers
        .try_reserve_exact(count)
        .map_err(|_| Error::Memory("normal equations"))?;
    numbers.resize(count, 0.0);
    Ok(numbers)
}

/// Up to [`BLOCK`] pixels, picked from anywhere, and one of their samples at a time.
pub(crate) struct Block<'a, const C: usize> {
    problem: &'a Problem,
    isa: Instructions,
    /// Where the pixels come from.
    places: Vec<usize>,
    directions: Directions<f64>,
    pub materials: Materials<C>,
    basis: Basis<f64>,
    bands: BlockBands,
    factors: [ChannelFactors<f64>; C],
    /// w_ck
    pub weights: Vec<[Doubles; COEFFICIENTS]>,
    responses: Vec<Responses>,
    /// Targets and weights ω: (channel, picture).
    given: Vec<[Doubles; 2]>,
    sample: Sample,
}

/// By which the numbers that a pixel sees of a light become radiance and its derivatives.
#[derive(Clone, Debug, Default)]
struct Responses {
    radiance: [Doubles; SEEN],
    derivatives: [[Doubles; SEEN]; DERIVATIVES],
}

/// One channel of one picture.
#[derive(Clone, Debug, Default)]
pub(crate) struct Sample {
    /// I − T
    pub residual: Doubles,
    /// ω; 0 where no pixel is.
    pub weight: Doubles,
    /// ∂I/∂(albedo, roughness, metallic)
    pub derivatives: [Doubles; DERIVATIVES],
}

impl<'a, const C: usize> Block<'a, C> {
    pub(crate) fn new(problem: &'a Problem) -> Self {
        Self {
            problem,
            isa: problem.instructions(),
            places: Vec::new(),
            directions: Directions::default(),
            materials: Materials::default(),
            basis: Basis::default(),
            bands: BlockBands::default(),
            factors: std::array::from_fn(|_| ChannelFactors::default()),
            weights: vec![[Doubles::default(); COEFFICIENTS]; C],
            responses: vec![Responses::default(); C],
            given: Vec::new(),
            sample: Sample::default(),
        }
    }

    /// Takes up pixels with their materials of `maps`.
    pub(crate) fn load(&mut self, maps: &[f64], pixels: &[usize]) {
        let mut materials = Materials::default();
        for (x, &p) in pixels.iter().enumerate() {
            materials.set(x, &self.problem.material(maps, p));
        }
        self.place(maps, pixels);
        self.take(&materials);
    }

    /// Takes up pixels with the normals of `maps`; materials are still to come.
    pub(crate) fn place(&mut self, maps: &[f64], pixels: &[usize]) {
        self.places.clear();
        self.places.extend(pixels);
        self.directions = self.problem.picked_directions(maps, pixels);
        self.given.clear();
        for c in 0..C {
            for picture in 0..self.problem.pictures() {
                self.given
                    .push(self.problem.picked_samples(c, picture, pixels));
            }
        }
        self.isa.run(FillBasis::<f64, COEFFICIENTS> {
            directions: &self.directions,
            basis: &mut self.basis,
        });
    }

    /// Gives the pixels materials, and works out all that no picture changes.
    pub(crate) fn take(&mut self, materials: &Materials<C>) {
        self.materials = materials.clone();
        self.isa.run(FillBands {
            roughness: &self.materials.roughness,
            bands: &mut self.bands,
        });
        for c in 0..C {
            self.isa.run(FillResponses {
                directions: &self.directions,
                albedo: &self.materials.albedo[c],
                roughness: &self.materials.roughness,
                metallic: &self.materials.metallic,
                bands: &self.bands,
                responses: &mut self.responses[c],
            });
        }
    }

    /// Works out the derivatives by the lights.
    pub(crate) fn fill_weights(&mut self) {
        self.isa.run(FillFactors {
            directions: &self.directions,
            materials: &self.materials,
            pixels: self.places.len(),
            bands: &mut self.bands,
            factors: &mut self.factors,
        });
        for (factors, weights) in self.factors.iter().zip(&mut self.weights) {
            self.isa.run(FillWeights {
                basis: &self.basis,
                factors,
                weights,
            });
        }
    }

    /// Adds all samples to the normal equations.
    pub(crate) fn add_samples(&mut self, lights: &[[f64; COEFFICIENTS]], sums: &mut Sums) {
        let isa = self.isa;
        self.each_sample(lights, |c, _, sample| {
            isa.run(AddSample {
                sample,
                unknowns: unknowns_of_channel::<C>(c),
                sums,
            });
        });
    }

    /// Calls `f` with channel, picture and sample, channel by channel. Lights are (channel, picture).
    pub fn each_sample(
        &mut self,
        lights: &[[f64; COEFFICIENTS]],
        mut f: impl FnMut(usize, usize, &Sample),
    ) {
        for (c, of_channel) in lights.chunks(self.problem.pictures()).enumerate() {
            for (picture, light) in of_channel.iter().enumerate() {
                self.take_sample(c, picture, light);
                f(c, picture, &self.sample);
            }
        }
    }

    /// Works out one channel of one picture.
    fn take_sample(&mut self, channel: usize, picture: usize, light: &[f64; COEFFICIENTS]) {
        let [target, weight] = &self.given[channel * self.problem.pictures() + picture];
        self.sample.weight = *weight;
        self.isa.run(TakeSample {
            basis: &self.basis,
            light,
            target,
            responses: &self.responses[channel],
            sample: &mut self.sample,
        });
    }
}

/// Fills in the coefficients of one channel: what [`Factors`] make of each seen number alone.
struct FillResponses<'a> {
    directions: &'a Directions<f64>,
    albedo: &'a Doubles,
    roughness: &'a Doubles,
    metallic: &'a Doubles,
    bands: &'a BlockBands,
    responses: &'a mut Responses,
}

impl Kernel for FillResponses<'_> {
    type Output = ();

    #[inline(always)]
    fn run<I: Isa>(self, _: I) {
        for x in 0..BLOCK {
            let material = Material {
                albedo: [self.albedo.0[x]],
                roughness: self.roughness.0[x],
                metallic: self.metallic.0[x],
            };
            let mut bands = Bands {
                weight: [0.0; 4],
                slope: [0.0; 4],
            };
            for l in 0..4 {
                bands.weight[l] = self.bands[l].0[x];
                bands.slope[l] = self.bands[4 + l].0[x];
            }
            let factors = Factors::new(self.directions.cosine(x), &material, bands);
            // One call, in a loop: of several the compiler would make a function and no vector code.
            for seen in 0..SEEN {
                let mut alone = [0.0; SEEN];
                alone[seen] = 1.0;
                let [by_diffuse, by_band @ ..] = alone;
                let derivatives = factors.pull_back(&material, &[by_diffuse], &[by_band]);
                self.responses.radiance[seen].0[x] = if seen == 0 {
                    factors.diffuse[0]
                } else {
                    factors.specular[0] * bands.weight[seen - 1]
                };
                self.responses.derivatives[0][seen].0[x] = derivatives.albedo[0];
                self.responses.derivatives[1][seen].0[x] = derivatives.roughness;
                self.responses.derivatives[2][seen].0[x] = derivatives.metallic;
            }
        }
    }
}

/// Residual and derivatives of a sample.
struct TakeSample<'a> {
    basis: &'a Basis<f64>,
    light: &'a [f64; COEFFICIENTS],
    target: &'a Doubles,
    responses: &'a Responses,
    sample: &'a mut Sample,
}

impl Kernel for TakeSample<'_> {
    type Output = ();

    #[inline(always)]
    fn run<I: Isa>(self, _: I) {
        let Self {
            basis,
            light,
            target,
            responses,
            sample,
        } = self;
        let seen = seen(basis, light);
        for x in 0..BLOCK {
            sample.residual.0[x] = -target.0[x];
        }
        sample.derivatives = Default::default();
        for s in 0..SEEN {
            for x in 0..BLOCK {
                sample.residual.0[x] += responses.radiance[s].0[x] * seen[s].0[x];
            }
            for j in 0..DERIVATIVES {
                for x in 0..BLOCK {
                    sample.derivatives[j].0[x] += responses.derivatives[j][s].0[x] * seen[s].0[x];
                }
            }
        }
    }
}

/// The normal equations of a block; of the matrix, the lower triangle.
#[derive(Clone, Debug, Default)]
pub(crate) struct Sums {
    pub(crate) matrix: [[Doubles; MAX_UNKNOWNS]; MAX_UNKNOWNS],
    pub(crate) gradient: [Doubles; MAX_UNKNOWNS],
    pub(crate) squares: Doubles,
}

impl Sums {
    /// Puts the matrix of one pixel, both halves of it, at the beginning of `matrix`.
    fn store_matrix(&self, pixel: usize, matrix: &mut [f64], unknowns: usize) {
        for row in 0..unknowns {
            for column in 0..unknowns {
                let lower = &self.matrix[row.max(column)][row.min(column)];
                matrix[row * unknowns + column] = lower.0[pixel];
            }
        }
    }
}

/// Adds a sample to the normal equations.
pub(crate) struct AddSample<'a> {
    pub sample: &'a Sample,
    pub unknowns: [usize; DERIVATIVES],
    pub sums: &'a mut Sums,
}

impl Kernel for AddSample<'_> {
    type Output = ();

    #[inline(always)]
    fn run<I: Isa>(self, _: I) {
        let Self {
            sample,
            unknowns,
            sums,
        } = self;
        let mut weighted = Doubles::default();
        for x in 0..BLOCK {
            weighted.0[x] = sample.weight.0[x] * sample.residual.0[x];
            sums.squares.0[x] += weighted.0[x] * sample.residual.0[x];
        }
        for i in 0..DERIVATIVES {
            let by_row = &sample.derivatives[i];
            let gradient = &mut sums.gradient[unknowns[i]];
            for x in 0..BLOCK {
                gradient.0[x] += weighted.0[x] * by_row.0[x];
            }
            for j in 0..=i {
                let by_column = &sample.derivatives[j];
                let entry = &mut sums.matrix[unknowns[i]][unknowns[j]];
                for x in 0..BLOCK {
                    entry.0[x] += sample.weight.0[x] * by_row.0[x] * by_column.0[x];
                }
            }
        }
    }
}

/// sum += a b
struct AddProduct<'a> {
    a: &'a Doubles,
    b: &'a Doubles,
    sum: &'a mut Doubles,
}

impl Kernel for AddProduct<'_> {
    type Output = ();

    #[inline(always)]
    fn run<I: Isa>(self, _: I) {
        for x in 0..BLOCK {
            self.sum.0[x] += self.a.0[x] * self.b.0[x];
        }
    }
}
