//! How likely samples are under lamps, and what they weigh.
//!
//! A sample y that is no darker than the model's radiance I is normally distributed around it, with the
//! variance s² = σ² + γ y, or σ² + γ y²; its channels share what is left of them, so they count as one.
//! A darker one may be in a cast shadow, anywhere from 0 to the mean Ī over the channels. With the share
//! P₀ of a picture's samples that are in none,
//!
//! ```text
//! ln q = −½ mean_c (e_c²/s_c² + ln 2π s_c²)        odds    = P₀ q Ī / (1−P₀), ∞ where no darker
//! p(y) = P₀ q, and (1−P₀)/Ī more where darker
//! ```
//!
//! In a sum of squares Σ w e² a sample weighs P/s² + (1−P) min(1/(I |e|), 1/s²), P = odds/(1 + odds):
//! the weights that have the gradient of the likelihood, but none more in a shadow than in none.

use std::f64::consts::TAU;
use std::iter::repeat_n;
use std::marker::PhantomData;

use glam::DVec3;

use super::number::{Number, Wide};
use super::pixel_fit::LampPictures;
use super::samples::{LANES, Lanes, Samples};
use super::surface::Surface;
use crate::reflectance::model::with_model;
use crate::reflectance::planes::Material;
use crate::reflectance::reflection::Reflection;
use crate::reflectance::tangent_offset::OFFSETS;
use crate::runtime::memory::{collect, zeros};
use crate::runtime::simd::{Isa, Kernel, Vectors};
use crate::runtime::{Result, check, pool};

/// Pixels in a piece of work.
const PIECE: usize = 128;

/// Of samples under lamps.
#[derive(Clone, Copy, Debug)]
pub struct LampNoise<'a> {
    /// σ
    pub floor: f64,
    /// γ
    pub growth: f64,
    /// Whether variances grow with y².
    pub proportional: bool,
    /// Radiance and residuals count as no less.
    pub least: f64,
    /// 1 − P₀: (picture).
    pub shadows: &'a [f64],
}

/// What was found of samples.
#[derive(Clone, Debug)]
pub struct Judged {
    /// ln of the odds that a sample is in no shadow: (pixel, picture).
    pub odds: Vec<f64>,
    /// ln p of all samples: (pixel).
    pub likelihoods: Vec<f64>,
    /// What samples weigh in a shadow and in none, beside their own weights: (pixel, picture).
    pub weights: Vec<[[f64; 3]; 2]>,
}

/// Samples as normals and materials show them.
///
/// The result does not depend on the number of threads.
pub fn judge(
    given: &LampPictures,
    weights: &[[f64; 3]],
    noise: LampNoise,
    normals: &[DVec3],
    materials: &[Material],
) -> Result<Judged> {
    let lights = given.check("normals", weights, normals, materials)?;
    let pictures = given.ambient.len();
    check::length("shadows", pictures, noise.shadows.len())?;
    check::unit_interval("shadows", noise.shadows)?;
    let samples = materials.len() * pictures;
    let mut judged = Judged {
        odds: collect("pictures", samples, repeat_n(f64::INFINITY, samples))?,
        likelihoods: zeros("albedo", materials.len())?,
        weights: zeros("pictures", samples)?,
    };
    let logarithms = |share: &f64| [(1.0 - share).ln(), share.ln()];
    let shares: Vec<_> = noise.shadows.iter().map(logarithms).collect();
    let piece = PIECE * pictures.max(1);
    let pieces = (judged.odds.chunks_mut(piece))
        .zip(judged.weights.chunks_mut(piece))
        .zip(judged.likelihoods.chunks_mut(PIECE))
        .enumerate()
        .collect();
    pool::map(
        given.threads,
        pieces,
        |(piece, ((of_odds, judged), likelihoods))| {
            let each = (of_odds.chunks_mut(pictures.max(1)))
                .zip(judged.chunks_mut(pictures.max(1)))
                .zip(likelihoods);
            for (p, ((of_odds, judged), likelihood)) in (piece * PIECE..).zip(each) {
                with_model!(given.model, M => lights.instructions.run(OfPixel {
                    samples: &Samples::new(given, weights, &lights, p),
                    normal: normals[p],
                    material: &materials[p],
                    noise: &noise,
                    shares: &shares,
                    judged: (of_odds, likelihood, judged),
                    model: PhantomData::<M>,
                }));
            }
        },
    );
    Ok(judged)
}

struct OfPixel<'a, M> {
    samples: &'a Samples<'a>,
    normal: DVec3,
    material: &'a Material,
    noise: &'a LampNoise<'a>,
    /// ln P₀ and ln (1 − P₀): (picture).
    shares: &'a [[f64; 2]],
    judged: (&'a mut [f64], &'a mut f64, &'a mut [[[f64; 3]; 2]]),
    model: PhantomData<M>,
}

impl<M: Reflection> Kernel for OfPixel<'_, M> {
    type Output = ();

    #[inline(always)]
    fn run<I: Isa>(self, isa: I) {
        let (model, view) = (self.samples.model, self.samples.view);
        let surface = Surface::<false>::new(model, self.normal, view, self.material);
        let still = [DVec3::ZERO; OFFSETS];
        let ambient = self
            .samples
            .ambient::<M>(self.normal, self.material, &still);
        let (odds, likelihood, weights) = self.judged;
        let of = |value| Wide(isa, isa.splat(value));
        let [none, one, least] = [0.0, 1.0, self.noise.least].map(of);
        for b in 0..self.samples.blocks.len() {
            let block = &self.samples.blocks[b];
            // Of each sample e²/s² and Π 2π s² of its channels, their number, what is left, and 3 Ī.
            let mut sums = [[0.0; LANES]; 5];
            let mut weighed = [[[0.0; LANES]; 2]; 3];
            for at in 0..LANES / <I as Vectors<f64>>::LANES {
                let seen =
                    (self.samples).seen(isa, [b, at], &surface, &still, &ambient, |_, _, _| ());
                let [mut squares, mut count, mut left, mut shown] = [none; 4];
                let mut product = one;
                for c in 0..3 {
                    let data = |lanes: &[Lanes; 3]| Wide(isa, I::of(&lanes[c])[at]);
                    let (weight, residual) = (data(&block.weights), seen.residuals[c]);
                    let is_told = weight.at_least(f64::MIN_POSITIVE, one, none);
                    let level = data(&block.targets).max(least);
                    let grown = level * if self.noise.proportional { level } else { one };
                    let variance = grown * self.noise.growth + self.noise.floor * self.noise.floor;
                    let ordinary = one / variance;
                    squares = squares + is_told * residual * residual * ordinary;
                    product = product * is_told.at_least(1.0, variance * TAU, one);
                    count = count + is_told;
                    left = left + is_told * residual;
                    let radiance = seen.radiance[c].max(least);
                    shown = shown + radiance;
                    let size = residual.max(none - residual).max(least);
                    let in_shadow = (one / (radiance * size)).min(ordinary);
                    I::of_mut(&mut weighed[c][0])[at] = (weight * in_shadow).1;
                    I::of_mut(&mut weighed[c][1])[at] = (weight * ordinary).1;
                }
                let all = [squares, product, count, left, shown];
                for x in 0..all.len() {
                    I::of_mut(&mut sums[x])[at] = all[x].1;
                }
            }
            for i in LANES * b..self.shares.len().min(LANES * (b + 1)) {
                let lane = i - LANES * b;
                let [squares, product, count, left, shown]: [f64; 5] =
                    sums.map(|lanes| lanes[lane]);
                let [lit, shadowed] = self.shares[i];
                let ordinary = lit - 0.5 * (squares + product.ln()) / count.max(1.0);
                let mut likely = ordinary;
                if left > 0.0 {
                    let in_shadow = shadowed - (shown / 3.0).ln();
                    odds[i] = ordinary - in_shadow;
                    likely = ordinary.max(in_shadow) + (-odds[i].abs()).exp().ln_1p();
                }
                *likelihood += if count > 0.0 { likely } else { 0.0 };
                for c in 0..3 {
                    for x in 0..2 {
                        weights[i][x][c] = weighed[c][x][lane];
                    }
                }
            }
        }
    }
}
