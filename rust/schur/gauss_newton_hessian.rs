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
use crate::problem::by_pixel::fill_by_pixel;
use crate::reflectance::planes::{BLOCK, Doubles};
use crate::reflectance::reflection::Reflection;
use crate::reflectance::sh::COEFFICIENTS;
use crate::runtime::simd::vectorized;
use crate::runtime::{Error, Result, check, pool};

/// Blocks of pixels in a piece of work.
const CHUNK: usize = 2;

/// What there may be too little memory for, as messages name it.
const NAME: &str = "normal equations";

impl Problem {
    /// The normal equations of the materials of some pixels with D unknowns each, with the lights held:
    /// A = Jᵀ Ω J (pixel, D, D); g = Jᵀ Ω (I − T) (pixel, D), half of the slope of the sum of squares;
    /// and Σ ω (I − T)² (pixel).
    pub fn normal_equations(&self, x: &[f64], pixels: &[usize]) -> Result<[Vec<f64>; 3]> {
        by_kind!(self, self.options.free_normals, M, C, D, U => {
            normal_equations::<M, C, D, U>(self, x, pixels)
        })
    }

    /// I − T of some pixels, without their weights, in float64 and rounded once: (picture, pixel of
    /// `pixels`, channel).
    pub fn residuals(&self, x: &[f64], pixels: &[usize]) -> Result<Vec<f32>> {
        by_kind!(self, false, M, C, D, U => residuals::<M, C, D, U>(self, x, pixels))
    }

    /// Derivatives of the radiance of some pixels: by albedo (of the same channel), roughness, metallic,
    /// known or not, and, where normals are free, the two tangent offsets, (pixel, picture, channel,
    /// 3 or 5); and by the coefficients of the light, w_ck, the same for all pictures (pixel, channel,
    /// K). And ω: (pixel, picture, channel).
    pub fn derivatives(&self, x: &[f64], pixels: &[usize]) -> Result<[Vec<f64>; 3]> {
        by_kind!(self, self.options.free_normals, M, C, D, U => {
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
        by_kind!(self, self.options.free_normals, M, C, D, U => {
            moves_with_lights::<M, C, D, U>(self, x, pixels, covariances, modes)
        })
    }
}

fn normal_equations<M: Reflection, const C: usize, const D: usize, const U: usize>(
    problem: &Problem,
    x: &[f64],
    pixels: &[usize],
) -> Result<[Vec<f64>; 3]> {
    let (maps, lights) = problem.at(x, pixels)?;
    let rows = free_unknowns::<C, D>(problem);
    let unknowns = rows.len();
    fill_by_pixel(
        (NAME, problem.options.threads),
        pixels,
        CHUNK,
        [unknowns * unknowns, unknowns, 1],
        || Block::<M, C, D>::new(problem),
        |block, _, pixels, [matrices, gradient, sum_sq_residuals]| {
            block.load(maps, pixels);
            let mut sums = Sums::<U>::default();
            block.add_samples(&lights, false, &mut sums);
            for (x, matrix) in matrices.chunks_mut(unknowns * unknowns).enumerate() {
                sums.store_matrix(x, &rows, matrix);
                sum_sq_residuals[x] = sums.sum_sq_residuals.0[x];
            }
            put(&sums.gradient, &rows, gradient);
        },
    )
}

fn residuals<M: Reflection, const C: usize, const D: usize, const U: usize>(
    problem: &Problem,
    x: &[f64],
    pixels: &[usize],
) -> Result<Vec<f32>> {
    let (maps, lights) = problem.at(x, pixels)?;
    let pictures = problem.pictures();
    let pieces = pixels.chunks(CHUNK * BLOCK).collect();
    let pieces = pool::map(problem.options.threads, pieces, |pixels: &[usize]| {
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
) -> Result<[Vec<f64>; 3]> {
    let (maps, lights) = problem.at(x, pixels)?;
    let (pictures, k) = (problem.pictures(), problem.coefficients());
    let samples = pictures * C;
    fill_by_pixel(
        (NAME, problem.options.threads),
        pixels,
        CHUNK,
        [samples * D, C * k, samples],
        || Block::<M, C, D>::new(problem),
        |block, _, pixels, [by_material, by_light, weights]| {
            block.load(maps, pixels);
            for (row, of_row) in by_light.chunks_mut(k).enumerate() {
                for (to, from) in of_row.iter_mut().zip(&block.weights[row % C]) {
                    *to = from.0[row / C];
                }
            }
            block.add_samples(&lights, true, &mut Sums::<U>::default());
            let of_samples = block.derivatives.iter().zip(&block.given).enumerate();
            for (sample, (derivatives, [_, weight])) in of_samples {
                let (c, picture) = (sample / pictures, sample % pictures);
                for x in 0..pixels.len() {
                    let s = x * samples + picture * C + c;
                    weights[s] = weight.0[x];
                    for j in 0..D {
                        by_material[s * D + j] = derivatives[j].0[x];
                    }
                }
            }
        },
    )
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
    fill_by_pixel(
        (NAME, problem.options.threads),
        pixels,
        CHUNK,
        [unknowns, unknowns],
        || {
            let radiance = vec![Doubles::default(); lights.len()];
            (
                Block::<M, C, D>::new(problem),
                Eliminated::default(),
                radiance,
            )
        },
        |(block, samples, radiance), first, pixels, [moves, effects]| {
            let isa = problem.options.instructions;
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
                isa.run(Project {
                    pixels: samples,
                    lights,
                    radiance,
                    sums: &mut sums,
                });
                sums
            };
            put(&product_of(&lights), &rows, effects);
            let mut of_block = vec![[Doubles::default(); U]; U];
            for x in 0..pixels.len() {
                let own = &covariances[(first + x) * unknowns * unknowns..];
                for (i, &row) in rows.iter().enumerate() {
                    for (j, &column) in rows.iter().enumerate() {
                        of_block[row][column].0[x] = own[i * unknowns + j];
                    }
                }
            }
            let mut sums = [Doubles::default(); U];
            for mode in &modes {
                let product = product_of(mode);
                vectorized!(isa, add_squares(&of_block, &product, &mut sums));
            }
            put(&sums, &rows, moves);
        },
    )
}

/// Writes some rows of the planes of a block's pixels: (pixel, row).
fn put(planes: &[Doubles], rows: &[usize], out: &mut [f64]) {
    for (x, out) in out.chunks_mut(rows.len()).enumerate() {
        for (to, &row) in out.iter_mut().zip(rows) {
            *to = planes[row].0[x];
        }
    }
}

/// Adds the squares of C y.
#[inline(always)]
fn add_squares<const U: usize>(
    covariances: &[[Doubles; U]],
    product: &[Doubles; U],
    sums: &mut [Doubles; U],
) {
    for (sum, covariances) in sums.iter_mut().zip(covariances) {
        let mut moved = Doubles::default();
        for (covariance, product) in covariances.iter().zip(product) {
            for x in 0..BLOCK {
                moved.0[x] += covariance.0[x] * product.0[x];
            }
        }
        for x in 0..BLOCK {
            sum.0[x] += moved.0[x] * moved.0[x];
        }
    }
}
