//! The Gauss–Newton Hessian of each pixel's material, and how it is tied to the lights.
//!
//! With radiance I, targets T, weights ω of the samples (picture i, channel c) and θ the unknowns of
//! a pixel, that is albedo by channel, roughness, metallic unless it is known and, where normals are
//! free, the two tangent offsets:
//!
//! ```text
//! J = ∂I/∂θ          A = Jᵀ Ω J          g = Jᵀ Ω (I − T)
//! ```
//!
//! Radiance is linear in the light, I_ic = Σ_k w_ck L_ick, so the normal matrix of materials and
//! lights together is an arrowhead. Pixels touch the lights only, and a light of one channel touches
//! none but itself:
//!
//! ```text
//! ⎛ A_p  B_p ⎞       B_p[θ, ick]    = ω_ic J_icθ w_ck
//! ⎝ B_pᵀ  G  ⎠       G[ick, ick']   = Σ_p ω_ic w_ck w_ck'
//! ```
//!
//! All of this is float64 (see [`samples`](crate::pixel::samples)): the matrices are differenced and
//! inverted afterwards.

use super::kernels::{Eliminated, Project};
use crate::pixel::samples::{Block, Sums, by_kind, free_unknowns};
use crate::problem::Problem;
use crate::reflectance::planes::{BLOCK, Doubles};
use crate::reflectance::reflection::Reflection;
use crate::reflectance::sh::COEFFICIENTS;
use crate::runtime::memory::zeros;
use crate::runtime::simd::{Isa, Kernel};
use crate::runtime::{Error, Result, check, pool};

/// Blocks of pixels in a piece of work.
const CHUNK: usize = 2;

/// The normal equations of some pixels with D unknowns each.
#[derive(Clone, Debug)]
pub struct NormalEquations {
    /// A = Jᵀ Ω J: (pixel, D, D).
    pub matrices: Vec<f64>,
    /// g = Jᵀ Ω (I − T), half of the slope of the sum of squares: (pixel, D).
    pub gradient: Vec<f64>,
    /// Σ ω (I − T)²: (pixel).
    pub sum_sq_residuals: Vec<f64>,
}

/// Derivatives of the radiance of some pixels.
#[derive(Clone, Debug)]
pub struct Derivatives {
    /// By albedo (of the same channel), roughness, metallic, known or not, and, where normals are
    /// free, the two tangent offsets: (pixel, picture, channel, 3 or 5).
    pub by_material: Vec<f64>,
    /// By the coefficients of the light, w_ck, the same for all pictures: (pixel, channel, K).
    pub by_light: Vec<f64>,
    /// ω: (pixel, picture, channel).
    pub weights: Vec<f64>,
}

impl Problem {
    /// The normal equations of the materials of some pixels, with the lights held.
    pub fn normal_equations(&self, x: &[f64], pixels: &[usize]) -> Result<NormalEquations> {
        by_kind!(self, self.free_normals(), M, C, D, U => {
            normal_equations::<M, C, D, U>(self, x, pixels)
        })
    }

    /// I − T of some pixels, without their weights, in float64 and rounded once: (picture, pixel of
    /// `pixels`, channel).
    pub fn residuals(&self, x: &[f64], pixels: &[usize]) -> Result<Vec<f32>> {
        by_kind!(self, false, M, C, D, U => residuals::<M, C, D, U>(self, x, pixels))
    }

    /// Derivatives of the radiance of some pixels by their materials and by the lights.
    pub fn derivatives(&self, x: &[f64], pixels: &[usize]) -> Result<Derivatives> {
        by_kind!(self, self.free_normals(), M, C, D, U => {
            derivatives::<M, C, D, U>(self, x, pixels)
        })
    }

    /// How far the materials of some pixels move with the lights, and B L of the lights of x:
    /// (pixel, D) each.
    ///
    /// When the lights move by a mode v, the best material of a pixel moves by −C B v, with its
    /// covariance C = A⁻¹, `covariances` (pixel, D, D). The first result is the sum of squares of
    /// these moves over `modes` (mode, picture, coefficient, channel).
    pub fn moves_with_lights(
        &self,
        x: &[f64],
        pixels: &[usize],
        covariances: &[f64],
        modes: &[f64],
    ) -> Result<[Vec<f64>; 2]> {
        by_kind!(self, self.free_normals(), M, C, D, U => {
            moves_with_lights::<M, C, D, U>(self, x, pixels, covariances, modes)
        })
    }
}

fn normal_equations<M: Reflection, const C: usize, const D: usize, const U: usize>(
    problem: &Problem,
    x: &[f64],
    pixels: &[usize],
) -> Result<NormalEquations> {
    let (maps, lights) = problem.at(x, pixels)?;
    let rows = free_unknowns::<C, D>(problem);
    let unknowns = rows.len();
    let mut matrices = zeros("normal equations", pixels.len() * unknowns * unknowns)?;
    let mut gradient = zeros("normal equations", pixels.len() * unknowns)?;
    let mut sum_sq_residuals = zeros("normal equations", pixels.len())?;
    let size = CHUNK * BLOCK;
    let pieces = pixels
        .chunks(size)
        .zip(matrices.chunks_mut(size * unknowns * unknowns))
        .zip(gradient.chunks_mut(size * unknowns))
        .zip(sum_sq_residuals.chunks_mut(size))
        .collect();
    pool::map(
        problem.threads(),
        pieces,
        |(((pixels, matrices), gradient), sum_sq_residuals)| {
            let mut block = Block::<M, C, D>::new(problem);
            for (i, pixels) in pixels.chunks(BLOCK).enumerate() {
                block.load(maps, pixels);
                let mut sums = Sums::<U>::default();
                block.add_samples(&lights, false, &mut sums);
                for x in 0..pixels.len() {
                    let p = i * BLOCK + x;
                    sums.store_matrix(x, &rows, &mut matrices[p * unknowns * unknowns..]);
                    sum_sq_residuals[p] = sums.sum_sq_residuals.0[x];
                }
                let first = i * BLOCK * unknowns;
                put(&sums.gradient, &rows, pixels.len(), &mut gradient[first..]);
            }
        },
    );
    Ok(NormalEquations {
        matrices,
        gradient,
        sum_sq_residuals,
    })
}

fn residuals<M: Reflection, const C: usize, const D: usize, const U: usize>(
    problem: &Problem,
    x: &[f64],
    pixels: &[usize],
) -> Result<Vec<f32>> {
    let (maps, lights) = problem.at(x, pixels)?;
    let pictures = problem.pictures();
    let pieces = pixels.chunks(CHUNK * BLOCK).collect();
    let pieces = pool::map(problem.threads(), pieces, |pixels: &[usize]| {
        let mut block = Block::<M, C, D>::new(problem);
        // (picture, pixel, channel)
        let mut found = vec![0.0; pictures * pixels.len() * C];
        for (b, of_block) in pixels.chunks(BLOCK).enumerate() {
            block.load(maps, of_block);
            block.add_samples(&lights, true, &mut Sums::<U>::default());
            for (sample, residuals) in block.residuals.iter().enumerate() {
                let (c, picture) = (sample / pictures, sample % pictures);
                let first = (picture * pixels.len() + b * BLOCK) * C + c;
                for x in 0..of_block.len() {
                    found[first + x * C] = residuals.0[x] as f32;
                }
            }
        }
        found
    });
    let mut residuals = Vec::with_capacity(pictures * pixels.len() * C);
    for picture in 0..pictures {
        for found in &pieces {
            let row = found.len() / pictures;
            residuals.extend_from_slice(&found[picture * row..][..row]);
        }
    }
    Ok(residuals)
}

fn derivatives<M: Reflection, const C: usize, const D: usize, const U: usize>(
    problem: &Problem,
    x: &[f64],
    pixels: &[usize],
) -> Result<Derivatives> {
    let (maps, lights) = problem.at(x, pixels)?;
    let samples = problem.pictures() * C;
    let k = problem.coefficients();
    let mut by_material = zeros("normal equations", pixels.len() * samples * D)?;
    let mut by_light = zeros("normal equations", pixels.len() * C * k)?;
    let mut weights = zeros("normal equations", pixels.len() * samples)?;
    let size = CHUNK * BLOCK;
    let pieces = pixels
        .chunks(size)
        .zip(by_material.chunks_mut(size * samples * D))
        .zip(by_light.chunks_mut(size * C * k))
        .zip(weights.chunks_mut(size * samples))
        .collect();
    pool::map(
        problem.threads(),
        pieces,
        |(((pixels, by_material), by_light), weights)| {
            let mut block = Block::<M, C, D>::new(problem);
            for (i, pixels) in pixels.chunks(BLOCK).enumerate() {
                block.load(maps, pixels);
                let of_block = by_light[i * BLOCK * C * k..].chunks_mut(k).enumerate();
                for (row, of_row) in of_block.take(pixels.len() * C) {
                    for (to, from) in of_row.iter_mut().zip(&block.weights[row % C]) {
                        *to = from.0[row / C];
                    }
                }
                block.add_samples(&lights, true, &mut Sums::<U>::default());
                let of_samples = block.derivatives.iter().zip(&block.given).enumerate();
                for (sample, (derivatives, [_, weight])) in of_samples {
                    let (c, picture) = (sample / problem.pictures(), sample % problem.pictures());
                    for x in 0..pixels.len() {
                        let s = (i * BLOCK + x) * samples + picture * C + c;
                        weights[s] = weight.0[x];
                        for j in 0..D {
                            by_material[s * D + j] = derivatives[j].0[x];
                        }
                    }
                }
            }
        },
    );
    Ok(Derivatives {
        by_material,
        by_light,
        weights,
    })
}

fn moves_with_lights<M: Reflection, const C: usize, const D: usize, const U: usize>(
    problem: &Problem,
    x: &[f64],
    pixels: &[usize],
    covariances: &[f64],
    modes: &[f64],
) -> Result<[Vec<f64>; 2]> {
    let (maps, lights) = problem.at(x, pixels)?;
    let rows = free_unknowns::<C, D>(problem);
    let unknowns = rows.len();
    let of_mode = problem.pictures() * problem.coefficients() * C;
    let expected = pixels.len() * unknowns * unknowns;
    check::length("covariances", expected, covariances.len())?;
    check::moderate("modes", modes, check::LARGEST_F64)?;
    if !modes.len().is_multiple_of(of_mode) {
        let expected = format!("{of_mode} numbers a mode");
        return Err(Error::argument("modes", expected, modes.len()));
    }
    let modes: Vec<_> = modes
        .chunks(of_mode)
        .map(|mode| problem.padded_lights(mode))
        .collect();
    let mut moves = zeros("normal equations", pixels.len() * unknowns)?;
    let mut effects = zeros("normal equations", pixels.len() * unknowns)?;
    let size = CHUNK * BLOCK;
    let pieces = pixels
        .chunks(size)
        .zip(covariances.chunks(size * unknowns * unknowns))
        .zip(moves.chunks_mut(size * unknowns))
        .zip(effects.chunks_mut(size * unknowns))
        .collect();
    pool::map(
        problem.threads(),
        pieces,
        |(((pixels, covariances), moves), effects)| {
            let mut block = Block::<M, C, D>::new(problem);
            let mut samples = Eliminated::default();
            let mut radiance = vec![Doubles::default(); lights.len()];
            for (i, pixels) in pixels.chunks(BLOCK).enumerate() {
                block.load(maps, pixels);
                // ω J of every sample.
                block.add_samples(&lights, true, &mut Sums::<U>::default());
                samples.weights.clear();
                samples.weights.extend(block.weights.iter());
                std::mem::swap(&mut samples.rows, &mut block.derivatives);
                for (derivatives, [_, weight]) in samples.rows.iter_mut().zip(&block.given) {
                    for plane in derivatives {
                        for x in 0..BLOCK {
                            plane.0[x] *= weight.0[x];
                        }
                    }
                }
                // B v
                let mut product_of = |lights: &[[f64; COEFFICIENTS]]| {
                    let mut sums = [Doubles::default(); U];
                    problem.instructions().run(Project {
                        pixels: &samples,
                        lights,
                        radiance: &mut radiance,
                        sums: &mut sums,
                    });
                    sums
                };
                let first = i * BLOCK * unknowns;
                put(
                    &product_of(&lights),
                    &rows,
                    pixels.len(),
                    &mut effects[first..],
                );
                let mut of_block = vec![[Doubles::default(); U]; U];
                for x in 0..pixels.len() {
                    let own = &covariances[(first + x * unknowns) * unknowns..];
                    for (i, &row) in rows.iter().enumerate() {
                        for (j, &column) in rows.iter().enumerate() {
                            of_block[row][column].0[x] = own[i * unknowns + j];
                        }
                    }
                }
                let mut sums = [Doubles::default(); U];
                for mode in &modes {
                    problem.instructions().run(AddSquares {
                        covariances: &of_block,
                        product: &product_of(mode),
                        sums: &mut sums,
                    });
                }
                put(&sums, &rows, pixels.len(), &mut moves[first..]);
            }
        },
    );
    Ok([moves, effects])
}

/// Writes some rows of the planes of a block's pixels: (pixel, row).
fn put(planes: &[Doubles], rows: &[usize], pixels: usize, out: &mut [f64]) {
    for (x, out) in out.chunks_mut(rows.len()).take(pixels).enumerate() {
        for (to, &row) in out.iter_mut().zip(rows) {
            *to = planes[row].0[x];
        }
    }
}

/// Adds the squares of C y.
struct AddSquares<'a, const U: usize> {
    covariances: &'a [[Doubles; U]],
    product: &'a [Doubles; U],
    sums: &'a mut [Doubles; U],
}

impl<const U: usize> Kernel for AddSquares<'_, U> {
    type Output = ();

    #[inline(always)]
    fn run<I: Isa>(self, _: I) {
        for (sum, covariances) in self.sums.iter_mut().zip(self.covariances) {
            let mut moved = Doubles::default();
            for (covariance, product) in covariances.iter().zip(self.product) {
                for x in 0..BLOCK {
                    moved.0[x] += covariance.0[x] * product.0[x];
                }
            }
            for x in 0..BLOCK {
                sum.0[x] += moved.0[x] * moved.0[x];
            }
        }
    }
}
