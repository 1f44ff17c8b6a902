//! A block of pixels whose unknowns are eliminated.

use super::kernels::{Collect, Eliminated, FillRows, Project, whiten};
use super::tied::{SharedSums, Tied};
use super::{Elimination, PriorTerm};
use crate::pixel::offset_step::limit_offset_step;
use crate::pixel::samples::{Block, DERIVATIVES, Sums, free_unknowns, unknowns_of_channel};
use crate::problem::Problem;
use crate::reflectance::planes::{BLOCK, Doubles};
use crate::reflectance::reflection::Reflection;
use crate::reflectance::sh::COEFFICIENTS;
use crate::reflectance::tangent_offset::OFFSETS;
use crate::runtime::simd::{Instructions, vectorized};

/// A block of pixels that are solved for. Samples are (channel, picture).
pub(super) struct EliminatedBlock<'a, M: Reflection, const C: usize, const D: usize, const U: usize>
{
    problem: &'a Problem,
    isa: Instructions,
    block: Block<'a, M, C, D>,
    pub(super) pixels: Eliminated<f64, D>,
    /// The unknowns that there are.
    unknowns: Vec<usize>,
    /// I − T, by sample.
    residuals: Vec<Doubles>,
    sums: Sums<U>,
    /// U, lower triangular; 0 for what is held.
    whiten: [[Doubles; U]; U],
    /// U g
    whitened: [Doubles; U],
    /// Where clusters of pixels share offsets of their prior.
    pub(super) tied: Option<Tied<U>>,
}

impl<'a, M: Reflection, const C: usize, const D: usize, const U: usize>
    EliminatedBlock<'a, M, C, D, U>
{
    pub(super) fn new(problem: &'a Problem) -> Self {
        Self {
            problem,
            isa: problem.options.instructions,
            block: Block::new(problem),
            pixels: Eliminated::default(),
            unknowns: free_unknowns::<C, D>(problem),
            residuals: Vec::new(),
            sums: Sums::default(),
            whiten: [[Doubles::default(); U]; U],
            whitened: [Doubles::default(); U],
            tied: None,
        }
    }

    /// Takes up some pixels, the first of which is number `first` of the call, and works out U.
    pub(super) fn take(
        &mut self,
        maps: &[f64],
        lights: &[[f64; COEFFICIENTS]],
        first: usize,
        pixels: &[usize],
        elimination: &Elimination,
    ) {
        let (isa, n) = (self.isa, self.problem.pictures());
        self.block.load(maps, pixels);
        self.sums = Sums::default();
        self.block.add_samples(lights, true, &mut self.sums);
        let shared = self.unknowns.len() - C;
        let prior = elimination.prior.as_ref();
        if let Some(prior) = prior {
            for (x, f, a, deviation) in prior.of_block(first, pixels.len(), shared) {
                let unknown = self.unknowns[C + f];
                self.sums.matrix[unknown][unknown].0[x] += a;
                self.sums.gradient[unknown].0[x] += a * deviation;
            }
        }
        self.whiten(elimination.damping);
        self.tied = prior.and_then(|prior| self.ties(prior, first, pixels.len()));
        let Eliminated {
            weights,
            rows,
            omega,
        } = &mut self.pixels;
        weights.clear();
        weights.extend(self.block.weights.iter());
        for plane in weights.as_flattened_mut() {
            plane.0[pixels.len()..].fill(0.0);
        }
        omega.clear();
        if !self.problem.weights(0, 0).is_empty() {
            omega.extend(self.block.given.iter().map(|[_, omega]| omega));
        }
        std::mem::swap(&mut self.residuals, &mut self.block.residuals);
        std::mem::swap(rows, &mut self.block.derivatives);
        for (i, (rows, [_, omega])) in rows.iter_mut().zip(&self.block.given).enumerate() {
            isa.run(FillRows {
                own: unknowns_of_channel::<C, D>(i / n),
                omega,
                whiten: &self.whiten,
                rows,
            });
        }
    }

    fn ties(&self, prior: &PriorTerm, first: usize, pixels: usize) -> Option<Tied<U>> {
        let clusters = &prior.clusters.as_ref()?.of_pixels[first..][..pixels];
        let unknowns = self.unknowns[C..].to_vec();
        let count = unknowns.len();
        let mut tied = Tied {
            precision: vec![Doubles::default(); count],
            pull: vec![Doubles::default(); count],
            columns: vec![[Doubles::default(); U]; count],
            clusters: clusters.to_vec(),
            unknowns,
        };
        for (x, f, a, deviation) in prior.of_block(first, pixels, count) {
            tied.precision[f].0[x] = a;
            tied.pull[f].0[x] = a * deviation;
            for row in tied.unknowns[f]..U {
                tied.columns[f][row].0[x] = a * self.whiten[row][tied.unknowns[f]].0[x];
            }
        }
        Some(tied)
    }

    /// θ of one kind.
    fn values(&self, unknown: usize) -> &Doubles {
        let materials = &self.block.materials;
        match (unknown, &self.block.weight_jacobian) {
            (c, _) if c < C => &materials.albedo[c],
            (c, _) if c == C => &materials.roughness,
            (c, Some(weight_jacobian)) if c > C + 1 => &weight_jacobian.offsets[c - C - 2],
            _ => &materials.metallic,
        }
    }

    /// Works out U, which is 0 for unknowns that are held, and U g.
    fn whiten(&mut self, damping: f64) {
        let mut scale = [Doubles::default(); U];
        for &unknown in &self.unknowns {
            let values = self.values(unknown);
            let gradient = &self.sums.gradient[unknown];
            let diagonal = &self.sums.matrix[unknown][unknown];
            let bounded = unknown < C + 2;
            for x in 0..BLOCK {
                let (value, slope, d) = (values.0[x], gradient.0[x], diagonal.0[x]);
                let held = (value <= 0.0 && slope > 0.0) || (value >= 1.0 && slope < 0.0);
                let used = !(held && bounded) && d > f64::MIN_POSITIVE;
                scale[unknown].0[x] = if used { 1.0 / d.sqrt() } else { 0.0 };
            }
        }
        let (sums, to) = (&self.sums, &mut self.whiten);
        vectorized!(
            self.isa,
            whiten(sums, &scale, damping, to, &mut self.whitened)
        );
    }

    /// Adds Wᵀ (Ω (I − T) − Rᵀ U g), and what belongs to offsets. The residuals are used up.
    pub(super) fn add_gradient(&mut self, sums: &mut SharedSums) {
        if let Some(tied) = &self.tied {
            tied.add_gradient(&self.whitened, &mut sums.offsets);
        }
        self.isa.run(Collect {
            pixels: &self.pixels,
            values: &mut self.residuals,
            whitened: &self.whitened,
            sums: &mut sums.lights,
        });
    }

    /// θ − Uᵀ (U g + R W v), within bounds and reach: (pixel, D).
    pub(super) fn back_substitute(
        &mut self,
        light_step: &[[f64; COEFFICIENTS]],
        offset_step: &[f64],
        out: &mut [f64],
    ) {
        let mut whitened = self.whitened;
        self.isa.run(Project {
            pixels: &self.pixels,
            lights: light_step,
            radiance: &mut self.residuals,
            sums: &mut whitened,
        });
        if let Some(tied) = &self.tied {
            tied.subtract(offset_step, &mut whitened);
        }
        let count = self.unknowns.len();
        if D > DERIVATIVES {
            let offsets = &self.unknowns[count - OFFSETS..];
            let before = [0, 1].map(|t| self.values(offsets[t]));
            let after = [0, 1].map(|t| self.stepped(offsets[t], &whitened));
            for (x, out) in out.chunks_mut(count).enumerate() {
                let before = before.map(|plane| plane.0[x]);
                let step = [0, 1].map(|t| after[t].0[x] - before[t]);
                let (share, offset) = limit_offset_step(before, step);
                for &row in offsets {
                    whitened[row].0[x] *= share;
                }
                out[count - OFFSETS..].copy_from_slice(&offset);
            }
        }
        let of_material = self.unknowns.iter().filter(|&&unknown| unknown < C + 2);
        for (i, &unknown) in of_material.enumerate() {
            let after = self.stepped(unknown, &whitened);
            for (out, value) in out.chunks_mut(count).zip(after.0) {
                out[i] = value.clamp(0.0, 1.0);
            }
        }
    }

    /// θ − Uᵀ `whitened` of one kind.
    fn stepped(&self, unknown: usize, whitened: &[Doubles; U]) -> Doubles {
        let mut values = *self.values(unknown);
        for &row in self.unknowns.iter().filter(|&&row| row >= unknown) {
            let whiten = &self.whiten[row][unknown];
            for x in 0..BLOCK {
                values.0[x] -= whiten.0[x] * whitened[row].0[x];
            }
        }
        values
    }

    /// Σ ω w_ck w_cl over the pixels: (channel, 1 or picture, K, K).
    pub(super) fn grams(&self) -> Vec<f64> {
        let of_channel = self.problem.grams() * self.problem.coefficients().pow(2);
        let mut grams = vec![0.0; C * of_channel];
        for (c, grams) in grams.chunks_mut(of_channel).enumerate() {
            self.block.add_grams(c, grams);
        }
        grams
    }
}
