//! The system of the lights, over all pixels of a call, without a matrix.

use std::marker::PhantomData;

use super::Elimination;
use super::eliminated_block::EliminatedBlock;
use super::kept::KeptSystem;
use super::kernels::Lanes;
use super::tied::SharedSums;
use crate::problem::by_pixel::fill_by_pixel;
use crate::problem::{Problem, add};
use crate::reflectance::planes::BLOCK;
use crate::reflectance::reflection::Reflection;
use crate::reflectance::sh::COEFFICIENTS;
use crate::runtime::memory::zeros;
use crate::runtime::{Error, Result, check, pool};

/// Blocks in a piece of work of a product.
pub(super) const CHUNK: usize = 8;

/// How the lights lie that are unknown.
#[derive(Clone, Copy, Debug)]
pub(super) struct UnknownLights {
    pub(super) pictures: usize,
    pub(super) coefficients: usize,
    /// Of the lights: C, or 1 where all have the same.
    pub(super) channels: usize,
    /// Of the pictures: C.
    of_pictures: usize,
    /// Unknowns after the lights: offsets of the prior.
    pub(super) offsets: usize,
}

impl UnknownLights {
    /// M
    pub(super) fn size(&self) -> usize {
        self.of_lights() + self.offsets
    }

    /// How many of the shared unknowns are lights.
    pub(super) fn of_lights(&self) -> usize {
        self.channels * self.of_channel()
    }

    /// To be added to.
    pub(super) fn sums(&self) -> SharedSums {
        SharedSums {
            lights: vec![Lanes::default(); self.of_pictures * self.pictures],
            offsets: vec![0.0; self.offsets],
        }
    }

    /// Unknowns of a light channel.
    pub(super) fn of_channel(&self) -> usize {
        self.pictures * self.coefficients
    }

    /// v as (channel, picture), zeros where a band is left out; of all C channels. And the offsets.
    pub(super) fn padded<'v>(&self, v: &'v [f64]) -> Result<(Vec<[f64; COEFFICIENTS]>, &'v [f64])> {
        check::length("v", self.size(), v.len())?;
        check::moderate("v", v, check::LARGEST_F64)?;
        let lights = (0..self.of_pictures * self.pictures)
            .map(|i| {
                let first = i % (self.channels * self.pictures) * self.coefficients;
                let mut light = [0.0; COEFFICIENTS];
                light[..self.coefficients].copy_from_slice(&v[first..][..self.coefficients]);
                light
            })
            .collect();
        Ok((lights, &v[self.of_lights()..]))
    }

    /// Sums as the shared unknowns are.
    pub(super) fn collected(&self, sums: &SharedSums) -> Vec<f64> {
        let mut collected = vec![0.0; self.of_lights()];
        for (i, lanes) in sums.lights.iter().enumerate() {
            let first = i % (self.channels * self.pictures) * self.coefficients;
            for (to, lanes) in collected[first..][..self.coefficients]
                .iter_mut()
                .zip(&lanes.0)
            {
                *to += lanes.iter().sum::<f64>();
            }
        }
        collected.extend(&sums.offsets);
        collected
    }

    /// All pieces' sums, in order.
    pub(super) fn total<'a>(&self, parts: impl Iterator<Item = &'a Vec<f64>>) -> Result<Vec<f64>> {
        let mut total = zeros("normal equations", self.size())?;
        for part in parts {
            add(&mut total, part);
        }
        Ok(total)
    }
}

/// A call: the problem, where it stands, and which pixels take part.
pub(super) struct LightSystem<'a, M: Reflection, const C: usize, const D: usize, const U: usize> {
    pub(super) problem: &'a Problem,
    maps: &'a [f64],
    /// (channel, picture)
    lights: Vec<[f64; COEFFICIENTS]>,
    pixels: &'a [usize],
    elimination: &'a Elimination,
    pub(super) unknown: UnknownLights,
    model: PhantomData<M>,
}

impl<'a, M: Reflection, const C: usize, const D: usize, const U: usize>
    LightSystem<'a, M, C, D, U>
{
    pub(super) fn new(
        problem: &'a Problem,
        x: &'a [f64],
        pixels: &'a [usize],
        elimination: &'a Elimination,
    ) -> Result<Self> {
        let (maps, lights) = problem.at(x, pixels)?;
        let damping = elimination.damping;
        if !(0.0..f64::INFINITY).contains(&damping) {
            return Err(Error::argument("damping", "a share, 0 or more", damping));
        }
        let of_prior = problem.unknowns_of_pixel() - C;
        if let Some(prior) = &elimination.prior {
            let expected = pixels.len() * of_prior;
            check::length("precision", expected, prior.precision.len())?;
            check::length("deviation", expected, prior.deviation.len())?;
            check::not_negative("precision", &prior.precision, check::LARGEST_F64)?;
            check::moderate("deviation", &prior.deviation, check::LARGEST_F64)?;
            if let Some(clusters) = &prior.clusters {
                check::length("cluster", pixels.len(), clusters.of_pixels.len())?;
                check::indices("cluster", clusters.count, &clusters.of_pixels)?;
            }
        }
        let prior = elimination.prior.as_ref();
        let clusters = prior.and_then(|prior| prior.clusters.as_ref());
        Ok(Self {
            problem,
            maps,
            lights,
            pixels,
            elimination,
            unknown: UnknownLights {
                pictures: problem.pictures(),
                coefficients: problem.coefficients(),
                channels: if elimination.mono { 1 } else { C },
                of_pictures: C,
                offsets: clusters.map_or(0, |clusters| clusters.count * of_prior),
            },
            model: PhantomData,
        })
    }

    /// Takes up a block of pixels, the `block`th of the call, and solves for them.
    pub(super) fn eliminate(&self, block: usize, eliminated: &mut EliminatedBlock<'a, M, C, D, U>) {
        let first = block * BLOCK;
        let pixels = &self.pixels[first..self.pixels.len().min(first + BLOCK)];
        eliminated.take(self.maps, &self.lights, first, pixels, self.elimination);
    }

    pub(super) fn blocks(&self) -> usize {
        self.pixels.len().div_ceil(BLOCK)
    }

    /// The gradient, and what products need.
    pub(super) fn keep(&self) -> Result<KeptSystem> {
        let first = (0..self.blocks()).step_by(CHUNK).collect();
        let parts = pool::map(self.problem.options.threads, first, |first: usize| {
            let mut eliminated = EliminatedBlock::new(self.problem);
            let mut gradient = self.unknown.sums();
            let mut kept = Vec::new();
            for block in first..self.blocks().min(first + CHUNK) {
                self.eliminate(block, &mut eliminated);
                kept.push((eliminated.pixels.rounded(), eliminated.tied.clone()));
                eliminated.add_gradient(&mut gradient);
            }
            (kept, self.unknown.collected(&gradient))
        });
        let gradient = self
            .unknown
            .total(parts.iter().map(|(_, gradient)| gradient))?;
        let pieces = parts.into_iter();
        Ok(KeptSystem {
            unknown: self.unknown,
            threads: self.problem.options.threads,
            isa: self.problem.options.instructions,
            gradient,
            pieces: pieces.map(|(kept, _)| Box::new(kept) as _).collect(),
        })
    }

    pub(super) fn back_substitute(&self, v: &[f64]) -> Result<Vec<f64>> {
        let (light_step, offset_step) = self.unknown.padded(v)?;
        let [materials] = fill_by_pixel(
            ("normal equations", self.problem.options.threads),
            self.pixels,
            CHUNK,
            [self.problem.unknowns_of_pixel()],
            || EliminatedBlock::new(self.problem),
            |eliminated, first, _, [out]| {
                self.eliminate(first / BLOCK, eliminated);
                eliminated.back_substitute(&light_step, offset_step, out);
            },
        )?;
        Ok(materials)
    }
}
