//! The system of the lights, over all pixels of a call, without a matrix.

use super::eliminated_block::Solved;
use super::kernels::Lanes;
use super::{Elimination, ReducedProduct};
use crate::problem::{Problem, add};
use crate::reflectance::planes::BLOCK;
use crate::reflectance::reflection::Reflection;
use crate::reflectance::sh::COEFFICIENTS;
use crate::runtime::memory::zeros;
use crate::runtime::{Error, Result, check, pool};
use std::marker::PhantomData;

/// Blocks in a piece of work of a product.
pub(super) const CHUNK: usize = 8;

/// A call: the problem, where it stands, and which pixels take part.
pub(super) struct Lights<'a, M: Reflection, const C: usize, const D: usize, const U: usize> {
    pub(super) problem: &'a Problem,
    pub(super) maps: &'a [f64],
    /// (channel, picture)
    pub(super) lights: Vec<[f64; COEFFICIENTS]>,
    pub(super) pixels: &'a [usize],
    pub(super) how: &'a Elimination<'a>,
    pub(super) pictures: usize,
    pub(super) coefficients: usize,
    /// Of the unknown lights: C, or 1 where all have the same.
    pub(super) channels: usize,
    pub(super) model: PhantomData<M>,
}

impl<'a, M: Reflection, const C: usize, const D: usize, const U: usize> Lights<'a, M, C, D, U> {
    pub(super) fn new(
        problem: &'a Problem,
        x: &'a [f64],
        pixels: &'a [usize],
        how: &'a Elimination<'a>,
    ) -> Result<Self> {
        let (maps, lights) = problem.at(x, pixels)?;
        if !(0.0..f64::INFINITY).contains(&how.damping) {
            return Err(Error::argument(
                "damping",
                "a share, 0 or more",
                how.damping,
            ));
        }
        if let Some(pull) = how.pull {
            let expected = pixels.len() * (problem.unknowns_of_pixel() - C);
            check::length("precision", expected, pull.precision.len())?;
            check::length("off", expected, pull.off.len())?;
            check::moderate("precision", pull.precision, check::LARGEST_F64)?;
            check::not_negative("precision", pull.precision)?;
            check::moderate("off", pull.off, check::LARGEST_F64)?;
        }
        Ok(Self {
            problem,
            maps,
            lights,
            pixels,
            how,
            pictures: problem.pictures(),
            coefficients: problem.coefficients(),
            channels: if how.mono { 1 } else { C },
            model: PhantomData,
        })
    }

    /// M
    pub(super) fn size(&self) -> usize {
        self.channels * self.of_channel()
    }

    /// Unknowns of a light channel.
    pub(super) fn of_channel(&self) -> usize {
        self.pictures * self.coefficients
    }

    /// v as (channel, picture), zeros where a band is left out; of all C channels.
    pub(super) fn padded(&self, v: &[f64]) -> Result<Vec<[f64; COEFFICIENTS]>> {
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
    pub(super) fn eliminate(&self, block: usize, solved: &mut Solved<'a, M, C, D, U>) {
        let first = block * BLOCK;
        let pixels = &self.pixels[first..self.pixels.len().min(first + BLOCK)];
        let finish = self.problem.unknowns_of_pixel() - C;
        let pull = self.how.pull.map(|pull| {
            [pull.precision, pull.off]
                .map(|of_all| &of_all[first * finish..][..pixels.len() * finish])
        });
        solved.take(self.maps, &self.lights, pixels, pull, self.how.damping);
    }

    pub(super) fn blocks(&self) -> usize {
        self.pixels.len().div_ceil(BLOCK)
    }

    pub(super) fn product(&self, v: &[f64]) -> Result<ReducedProduct> {
        let moves = self.padded(v)?;
        let pieces = (0..self.blocks()).step_by(CHUNK).collect();
        let parts = pool::map(self.problem.threads(), pieces, |first: usize| {
            let mut solved = Solved::new(self.problem);
            let mut product = vec![Lanes::default(); C * self.pictures];
            let mut gradient = product.clone();
            for block in first..self.blocks().min(first + CHUNK) {
                self.eliminate(block, &mut solved);
                solved.add_gradient(&mut gradient);
                solved.add_product(&moves, &mut product);
            }
            [self.collected(&product), self.collected(&gradient)]
        });
        let mut found = ReducedProduct {
            product: zeros("normal equations", self.size())?,
            gradient: zeros("normal equations", self.size())?,
        };
        for [product, gradient] in parts {
            add(&mut found.product, &product);
            add(&mut found.gradient, &gradient);
        }
        Ok(found)
    }

    /// Sums by light (channel, picture) as the unknown lights are.
    pub(super) fn collected(&self, sums: &[Lanes]) -> Vec<f64> {
        let mut collected = vec![0.0; self.size()];
        for (i, lanes) in sums.iter().enumerate() {
            let first = i % (self.channels * self.pictures) * self.coefficients;
            for (to, lanes) in collected[first..][..self.coefficients]
                .iter_mut()
                .zip(&lanes.0)
            {
                *to += lanes.iter().sum::<f64>();
            }
        }
        collected
    }

    pub(super) fn follow(&self, v: &[f64]) -> Result<Vec<f64>> {
        let moves = self.padded(v)?;
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
                let mut solved = Solved::new(self.problem);
                for (i, out) in out.chunks_mut(BLOCK * unknowns).enumerate() {
                    self.eliminate(piece * CHUNK + i, &mut solved);
                    solved.follow(&moves, out);
                }
            },
        );
        Ok(materials)
    }
}
