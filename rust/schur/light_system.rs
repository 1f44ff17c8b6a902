//! The system of the lights, over all pixels of a call, without a matrix.

use std::marker::PhantomData;

use super::eliminated_block::EliminatedBlock;
use super::kernels::Lanes;
use super::{Clusters, Elimination, PriorTerm, SchurProduct};
use crate::problem::{Problem, add};
use crate::reflectance::planes::BLOCK;
use crate::reflectance::reflection::Reflection;
use crate::reflectance::sh::COEFFICIENTS;
use crate::runtime::memory::zeros;
use crate::runtime::{Error, Result, check, pool};

/// Blocks in a piece of work of a product.
const CHUNK: usize = 8;

/// A call: the problem, where it stands, and which pixels take part.
pub(super) struct LightSystem<'a, M: Reflection, const C: usize, const D: usize, const U: usize> {
    pub(super) problem: &'a Problem,
    maps: &'a [f64],
    /// (channel, picture)
    lights: Vec<[f64; COEFFICIENTS]>,
    pixels: &'a [usize],
    elimination: &'a Elimination<'a>,
    pub(super) pictures: usize,
    pub(super) coefficients: usize,
    /// Of the unknown lights: C, or 1 where all have the same.
    pub(super) channels: usize,
    model: PhantomData<M>,
}

impl<'a, M: Reflection, const C: usize, const D: usize, const U: usize>
    LightSystem<'a, M, C, D, U>
{
    pub(super) fn new(
        problem: &'a Problem,
        x: &'a [f64],
        pixels: &'a [usize],
        elimination: &'a Elimination<'a>,
    ) -> Result<Self> {
        let (maps, lights) = problem.at(x, pixels)?;
        if !(0.0..f64::INFINITY).contains(&elimination.damping) {
            return Err(Error::argument(
                "damping",
                "a share, 0 or more",
                elimination.damping,
            ));
        }
        if let Some(prior) = elimination.prior {
            let expected = pixels.len() * (problem.unknowns_of_pixel() - C);
            check::length("precision", expected, prior.precision.len())?;
            check::length("deviation", expected, prior.deviation.len())?;
            check::moderate("precision", prior.precision, check::LARGEST_F64)?;
            check::not_negative("precision", prior.precision)?;
            check::moderate("deviation", prior.deviation, check::LARGEST_F64)?;
            if let Some(clusters) = prior.clusters {
                check::length("cluster", pixels.len(), clusters.of_pixels.len())?;
                if let Some(&found) = clusters.of_pixels.iter().find(|&&g| g >= clusters.count) {
                    let expected = format!("numbers below {}", clusters.count);
                    return Err(Error::argument("cluster", expected, found));
                }
            }
        }
        Ok(Self {
            problem,
            maps,
            lights,
            pixels,
            elimination,
            pictures: problem.pictures(),
            coefficients: problem.coefficients(),
            channels: if elimination.mono { 1 } else { C },
            model: PhantomData,
        })
    }

    /// M
    pub(super) fn size(&self) -> usize {
        self.of_lights() + self.offsets()
    }

    /// How many of the shared unknowns are lights.
    pub(super) fn of_lights(&self) -> usize {
        self.channels * self.of_channel()
    }

    /// How many of the shared unknowns are offsets of the prior.
    pub(super) fn offsets(&self) -> usize {
        let clusters = self.elimination.prior.and_then(|prior| prior.clusters);
        clusters.map_or(0, |clusters| clusters.count * self.of_prior())
    }

    /// F
    pub(super) fn of_prior(&self) -> usize {
        self.problem.unknowns_of_pixel() - C
    }

    /// Unknowns of a light channel.
    pub(super) fn of_channel(&self) -> usize {
        self.pictures * self.coefficients
    }

    /// v as (channel, picture), zeros where a band is left out; of all C channels.
    fn padded(&self, v: &[f64]) -> Result<Vec<[f64; COEFFICIENTS]>> {
        check::length("v", self.size(), v.len())?;
        check::moderate("v", v, check::LARGEST_F64)?;
        Ok((0..C * self.pictures)
            .map(|i| {
                let first = i % (self.channels * self.pictures) * self.coefficients;
                let mut light = [0.0; COEFFICIENTS];
                light[..self.coefficients].copy_from_slice(&v[first..][..self.coefficients]);
                light
            })
            .collect())
    }

    /// Takes up a block of pixels, the `block`th of the call, and solves for them.
    pub(super) fn eliminate(&self, block: usize, eliminated: &mut EliminatedBlock<'a, M, C, D, U>) {
        let first = block * BLOCK;
        let pixels = &self.pixels[first..self.pixels.len().min(first + BLOCK)];
        let shared = self.of_prior();
        let range = first * shared..(first + pixels.len()) * shared;
        let prior = self.elimination.prior.map(|prior| PriorTerm {
            precision: &prior.precision[range.clone()],
            deviation: &prior.deviation[range.clone()],
            clusters: prior.clusters.map(|clusters| Clusters {
                of_pixels: &clusters.of_pixels[first..][..pixels.len()],
                ..clusters
            }),
        });
        eliminated.take(
            self.maps,
            &self.lights,
            pixels,
            prior,
            self.elimination.damping,
        );
    }

    pub(super) fn blocks(&self) -> usize {
        self.pixels.len().div_ceil(BLOCK)
    }

    pub(super) fn product(&self, v: &[f64]) -> Result<SchurProduct> {
        let light_step = self.padded(v)?;
        let offset_step = &v[self.of_lights()..];
        let pieces = (0..self.blocks()).step_by(CHUNK).collect();
        let parts = pool::map(self.problem.threads(), pieces, |first: usize| {
            let mut eliminated = EliminatedBlock::new(self.problem);
            let mut product = vec![Lanes::default(); C * self.pictures];
            let mut gradient = product.clone();
            let mut of_offsets = [vec![0.0; self.offsets()], vec![0.0; self.offsets()]];
            for block in first..self.blocks().min(first + CHUNK) {
                self.eliminate(block, &mut eliminated);
                let [by_offsets, offset_product] = &mut of_offsets;
                eliminated.add_gradient(&mut gradient, by_offsets);
                eliminated.add_product(&light_step, offset_step, &mut product, offset_product);
            }
            let [by_offsets, offset_product] = of_offsets;
            [
                self.collected(&product, offset_product),
                self.collected(&gradient, by_offsets),
            ]
        });
        let mut found = SchurProduct {
            product: zeros("normal equations", self.size())?,
            gradient: zeros("normal equations", self.size())?,
        };
        for [product, gradient] in parts {
            add(&mut found.product, &product);
            add(&mut found.gradient, &gradient);
        }
        Ok(found)
    }

    /// Sums by light (channel, picture) as the unknown lights are, and then those by offsets.
    pub(super) fn collected(&self, sums: &[Lanes], offsets: Vec<f64>) -> Vec<f64> {
        let mut collected = vec![0.0; self.of_lights()];
        for (i, lanes) in sums.iter().enumerate() {
            let first = i % (self.channels * self.pictures) * self.coefficients;
            for (to, lanes) in collected[first..][..self.coefficients]
                .iter_mut()
                .zip(&lanes.0)
            {
                *to += lanes.iter().sum::<f64>();
            }
        }
        collected.extend(offsets);
        collected
    }

    pub(super) fn back_substitute(&self, v: &[f64]) -> Result<Vec<f64>> {
        let light_step = self.padded(v)?;
        let offset_step = &v[self.of_lights()..];
        let unknowns = self.problem.unknowns_of_pixel();
        let mut materials = zeros("normal equations", self.pixels.len() * unknowns)?;
        let pieces = materials
            .chunks_mut(CHUNK * BLOCK * unknowns)
            .enumerate()
            .collect();
        pool::map(
            self.problem.threads(),
            pieces,
            |(piece, out): (usize, &mut [f64])| {
                let mut eliminated = EliminatedBlock::new(self.problem);
                for (i, out) in out.chunks_mut(BLOCK * unknowns).enumerate() {
                    self.eliminate(piece * CHUNK + i, &mut eliminated);
                    eliminated.back_substitute(&light_step, offset_step, out);
                }
            },
        );
        Ok(materials)
    }
}
