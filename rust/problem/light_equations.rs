//! The least-squares problem for the lights when the materials are known.

use std::ops::Range;

use super::{Problem, add};
use crate::reflectance::model::with_model_of;
use crate::reflectance::planes::BLOCK;
use crate::reflectance::reflection::Reflection;
use crate::reflectance::shade::{factors_at, shade};
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
    /// Wᵀ Ω T: (picture, K).
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
            let partials = pool::map(self.threads, pieces.to_vec(), |blocks| {
                with_model_of!(self, M => if self.channels == 1 {
                    self.equations_of_chunk::<M, 1>(maps, blocks)
                } else {
                    self.equations_of_chunk::<M, 3>(maps, blocks)
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
        let mut total = total.expect("at least one piece of work");
        let k = self.coefficients;
        for gram in total.iter_mut().flat_map(|e| e.gram.chunks_mut(k * k)) {
            for row in 0..k {
                for column in 0..row {
                    gram[column * k + row] = gram[row * k + column];
                }
            }
        }
        Ok(total)
    }

    /// Lower triangles of the Gram matrices, and the right sides.
    fn equations_of_chunk<M: Reflection, const C: usize>(
        &self,
        maps: &[f64],
        blocks: Range<usize>,
    ) -> Vec<LightEquations> {
        let (n, k) = (self.pictures, self.coefficients);
        let grams = if self.weights.is_empty() { 1 } else { n };
        let zero = LightEquations {
            gram: vec![0.0; grams * k * k],
            right: vec![0.0; n * k],
        };
        let mut sums = vec![zero; C];
        for p in blocks.start * BLOCK..(blocks.end * BLOCK).min(self.pixels) {
            let (block, x) = (p / BLOCK, p % BLOCK);
            let material = self.material::<C>(maps, p);
            let frame = self.frame::<M>(maps, p);
            let weights = shade(&frame, &material);
            let factors = M::SURROUNDED.then(|| factors_at(&frame, &material));
            for (c, sum) in sums.iter_mut().enumerate() {
                let w = &weights[c][..k];
                let mut add_gram = |gram: usize, omega: f64| {
                    for (row, gram) in sum.gram[gram * k * k..][..k * k].chunks_mut(k).enumerate() {
                        for column in 0..=row {
                            gram[column] += omega * w[row] * w[column];
                        }
                    }
                };
                let omegas = self.weights(block, c);
                if omegas.is_empty() {
                    add_gram(0, 1.0);
                }
                for i in 0..n {
                    let omega = omegas.get(i).map_or(1.0, |plane| f64::from(plane.0[x]));
                    if !omegas.is_empty() {
                        add_gram(i, omega);
                    }
                    let target = self.targets.get(block, c, i, x)
                        - self.bounced_radiance::<M, C>(factors.as_ref(), p, c, i);
                    let target = omega * target;
                    for (right, w) in sum.right[i * k..][..k].iter_mut().zip(w) {
                        *right += target * w;
                    }
                }
            }
        }
        sums
    }
}
