//! The least-squares problem for the lights when the materials are known.

use std::ops::Range;

use crate::pixel::samples::{Block, Sums, by_kind};
use crate::problem::{Problem, add};
use crate::reflectance::planes::BLOCK;
use crate::reflectance::reflection::Reflection;
use crate::reflectance::sh::COEFFICIENTS;
use crate::reflectance::tangent_offset;
use crate::runtime::{Result, check, pool};

/// Pieces of work whose normal equations are held at once.
const PIECES_AT_ONCE: usize = 16;

/// The least-squares problem for the lights when materials are known, one channel.
#[derive(Clone, Debug, PartialEq)]
pub struct LightEquations {
    /// Wᵀ Ω W, one for all pictures, or one for each where samples have weights of their own:
    /// (1 or picture, K, K).
    pub gram: Vec<f64>,
    /// Wᵀ Ω T, less what surroundings bring: (picture, K).
    pub right: Vec<f64>,
}

impl Problem {
    /// The normal equations of the lights, channel by channel, for the materials in `maps`, the
    /// first part of x. Sums run in float64, because the lights' condition number squares here.
    pub fn light_equations(&self, maps: &[f64]) -> Result<Vec<LightEquations>> {
        check::length("maps", self.maps(), maps.len())?;
        let (materials, offsets) = self.split_maps(maps);
        check::unit_interval("maps (albedo, roughness, metallic)", materials)?;
        check::moderate("maps (tangent offset)", offsets, tangent_offset::OFFSET_MAX)?;
        let pieces: Vec<_> = self.chunks().collect();
        let mut total: Option<Vec<LightEquations>> = None;
        // A few pieces at a time: with weights each holds a matrix for every picture.
        for pieces in pieces.chunks(PIECES_AT_ONCE) {
            let partials = pool::map(self.options.threads, pieces.to_vec(), |blocks| {
                by_kind!(self, false, M, C, D, U => {
                    equations_of::<M, C, D, U>(self, maps, blocks)
                })
            });
            for partial in partials {
                let Some(total) = &mut total else {
                    total = Some(partial);
                    continue;
                };
                for (total, partial) in total.iter_mut().zip(partial) {
                    add(&mut total.gram, &partial.gram);
                    add(&mut total.right, &partial.right);
                }
            }
        }
        Ok(total.expect("at least one piece of work"))
    }
}

/// Of some blocks of pixels, channel by channel.
fn equations_of<M: Reflection, const C: usize, const D: usize, const U: usize>(
    problem: &Problem,
    maps: &[f64],
    blocks: Range<usize>,
) -> Vec<LightEquations> {
    let (n, k) = (problem.pictures(), problem.coefficients());
    let zero = LightEquations {
        gram: vec![0.0; problem.grams() * k * k],
        right: vec![0.0; n * k],
    };
    let mut sums = vec![zero; C];
    let dark = vec![[0.0; COEFFICIENTS]; C * n];
    let mut block = Block::<M, C, D>::new(problem);
    for first in blocks.map(|block| block * BLOCK) {
        let pixels: Vec<_> = (first..(first + BLOCK).min(problem.pixels())).collect();
        block.load(maps, &pixels);
        // Without light, residuals are what surroundings bring, less T.
        block.add_samples(&dark, true, &mut Sums::<U>::default());
        for (c, sum) in sums.iter_mut().enumerate() {
            block.add_grams(c, &mut sum.gram);
            for (i, right) in sum.right.chunks_mut(k).enumerate() {
                block.add_weighted(c, i, &block.residuals[c * n + i], right);
            }
        }
    }
    for right in sums.iter_mut().flat_map(|sum| &mut sum.right) {
        *right = -*right;
    }
    sums
}
