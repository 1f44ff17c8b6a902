//! A block of pixels whose unknowns are eliminated.

use super::kernels::{AddRows, Collect, FillRows, LANES, Lanes, SubtractRows, Whiten};
use crate::block::radiance::Radiance;
use crate::pixel::offset_step::limit_offset_step;
use crate::pixel::samples::{
    AddSample, Block, DERIVATIVES, Sums, free_unknowns, unknowns_of_channel,
};
use crate::problem::Problem;
use crate::reflectance::planes::{BLOCK, Doubles};
use crate::reflectance::reflection::Reflection;
use crate::reflectance::sh::COEFFICIENTS;
use crate::reflectance::tangent_offset::OFFSETS;
use crate::runtime::simd::Instructions;

use super::PriorTerm;

/// A block of pixels that are solved for. Samples are (channel, picture).
pub(super) struct EliminatedBlock<'a, M: Reflection, const C: usize, const D: usize, const U: usize>
{
    problem: &'a Problem,
    pub(super) block: Block<'a, M, C, D>,
    /// Pixels in the block.
    count: usize,
    /// The unknowns that there are.
    unknowns: Vec<usize>,
    /// Ω J, by the channel's own albedo, roughness, metallic and what follows.
    weighted: Vec<[Doubles; D]>,
    /// ω (I − T)
    slopes: Vec<Doubles>,
    /// ω
    omega: Vec<Doubles>,
    sums: Sums<U>,
    /// U, lower triangular; 0 for what is held.
    whiten: [[Doubles; U]; U],
    /// U g
    whitened: [Doubles; U],
    /// The prior whose offsets clusters share: a and a (v − c − o) by unknown, and the cluster of
    /// each pixel.
    tied: Option<Tied<U>>,
    /// R, in the same order as J.
    pub(super) rows: Vec<[Doubles; D]>,
}

struct Tied<const U: usize> {
    precision: [Doubles; U],
    pull: [Doubles; U],
    clusters: Vec<usize>,
}

impl<'a, M: Reflection, const C: usize, const D: usize, const U: usize>
    EliminatedBlock<'a, M, C, D, U>
{
    pub(super) fn new(problem: &'a Problem) -> Self {
        let samples = C * problem.pictures();
        Self {
            problem,
            block: Block::new(problem),
            count: 0,
            unknowns: free_unknowns::<C, D>(problem),
            weighted: vec![[Doubles::default(); D]; samples],
            slopes: vec![Doubles::default(); samples],
            omega: vec![Doubles::default(); samples],
            sums: Sums::default(),
            whiten: [[Doubles::default(); U]; U],
            whitened: [Doubles::default(); U],
            tied: None,
            rows: vec![[Doubles::default(); D]; samples],
        }
    }

    pub(super) fn take(
        &mut self,
        maps: &[f64],
        lights: &[[f64; COEFFICIENTS]],
        pixels: &[usize],
        prior: Option<PriorTerm>,
        damping: f64,
    ) {
        let isa = self.problem.instructions();
        let n = self.problem.pictures();
        self.count = pixels.len();
        self.block.load(maps, pixels);
        self.block.fill_weights();
        self.sums = Sums::default();
        let (weighted, slopes, omega) = (&mut self.weighted, &mut self.slopes, &mut self.omega);
        let sums = &mut self.sums;
        self.block.each_sample(lights, |c, picture, sample| {
            let i = c * n + picture;
            isa.run(AddSample {
                sample,
                unknowns: unknowns_of_channel::<C, D>(c),
                sums,
            });
            omega[i] = sample.weight;
            for x in 0..BLOCK {
                slopes[i].0[x] = sample.weight.0[x] * sample.residual.0[x];
            }
            for (to, from) in weighted[i].iter_mut().zip(&sample.derivatives) {
                for x in 0..BLOCK {
                    to.0[x] = sample.weight.0[x] * from.0[x];
                }
            }
        });
        self.tied = None;
        if let Some(prior) = prior {
            let shared = prior.precision.len() / pixels.len();
            let mut precision = [Doubles::default(); U];
            let mut pull = [Doubles::default(); U];
            for (i, (a, deviation)) in prior.precision.iter().zip(prior.deviation).enumerate() {
                let (x, unknown) = (i / shared, self.unknowns[C + i % shared]);
                self.sums.matrix[unknown][unknown].0[x] += a;
                self.sums.gradient[unknown].0[x] += a * deviation;
                precision[unknown].0[x] = *a;
                pull[unknown].0[x] = a * deviation;
            }
            self.tied = prior.clusters.map(|clusters| Tied {
                precision,
                pull,
                clusters: clusters.of_pixels.to_vec(),
            });
        }
        self.whiten(damping);
        for (sample, weighted) in self.weighted.iter().enumerate() {
            isa.run(FillRows {
                own: unknowns_of_channel::<C, D>(sample / n),
                weighted,
                whiten: &self.whiten,
                rows: &mut self.rows[sample],
            });
        }
    }

    pub(super) fn isa(&self) -> Instructions {
        self.problem.instructions()
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
        self.isa().run(Whiten {
            sums: &self.sums,
            scale: &scale,
            damping,
            whiten: &mut self.whiten,
            whitened: &mut self.whitened,
        });
    }

    /// Adds Wᵀ (Ω (I − T) − Rᵀ U g), and by the offsets of clusters a (Uᵀ U g − (v − c − o)).
    pub(super) fn add_gradient(&mut self, sums: &mut [Lanes], by_offsets: &mut [f64]) {
        self.each_offset(|unknown, offset, x, tied| {
            let moved = self.unwhitened(unknown, x, &self.whitened);
            by_offsets[offset] += tied.precision[unknown].0[x] * moved - tied.pull[unknown].0[x];
        });
        let n = self.problem.pictures();
        for (sample, sums) in sums.iter_mut().enumerate() {
            let c = sample / n;
            let mut left = self.slopes[sample];
            self.subtract_rows(sample, c, &self.whitened, &mut left);
            self.isa().run(Collect {
                weights: &self.block.weights[c],
                values: &left,
                sums,
            });
        }
    }

    /// Adds Wᵀ (Ω − Rᵀ R) W v, and what offsets have to do with it.
    pub(super) fn add_product(
        &mut self,
        light_step: &[[f64; COEFFICIENTS]],
        offset_step: &[f64],
        sums: &mut [Lanes],
        by_offsets: &mut [f64],
    ) {
        let n = self.problem.pictures();
        let radiance = self.moved_radiance(light_step);
        let mut projected = [Doubles::default(); U];
        self.add_rows(&radiance, &mut projected);
        self.add_offset_rows(offset_step, &mut projected);
        self.each_offset(|unknown, offset, x, tied| {
            let moved = offset_step[offset] + self.unwhitened(unknown, x, &projected);
            by_offsets[offset] += tied.precision[unknown].0[x] * moved;
        });
        for (sample, sums) in sums.iter_mut().enumerate() {
            let c = sample / n;
            let mut left = Doubles::default();
            for x in 0..BLOCK {
                left.0[x] = self.omega[sample].0[x] * radiance[sample].0[x];
            }
            self.subtract_rows(sample, c, &projected, &mut left);
            self.isa().run(Collect {
                weights: &self.block.weights[c],
                values: &left,
                sums,
            });
        }
    }

    /// θ − Uᵀ (U g + R W v), within bounds and reach: (pixel, D).
    pub(super) fn back_substitute(
        &mut self,
        light_step: &[[f64; COEFFICIENTS]],
        offset_step: &[f64],
        out: &mut [f64],
    ) {
        let radiance = self.moved_radiance(light_step);
        let mut whitened = self.whitened;
        self.add_rows(&radiance, &mut whitened);
        self.add_offset_rows(offset_step, &mut whitened);
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

    /// Calls with each unknown of the prior, the place of its cluster's offset, and the pixel.
    fn each_offset(&self, mut visit: impl FnMut(usize, usize, usize, &Tied<U>)) {
        let Some(tied) = &self.tied else { return };
        let of_prior = &self.unknowns[C..];
        for (f, &unknown) in of_prior.iter().enumerate() {
            for (x, cluster) in tied.clusters.iter().enumerate() {
                visit(unknown, cluster * of_prior.len() + f, x, tied);
            }
        }
    }

    /// Subtracts U a o, for offsets o that move by `step`.
    fn add_offset_rows(&self, step: &[f64], sums: &mut [Doubles; U]) {
        self.each_offset(|unknown, offset, x, tied| {
            let moved = tied.precision[unknown].0[x] * step[offset];
            for row in unknown..U {
                sums[row].0[x] -= self.whiten[row][unknown].0[x] * moved;
            }
        });
    }

    /// Uᵀ `whitened` of one kind and pixel.
    fn unwhitened(&self, unknown: usize, x: usize, whitened: &[Doubles; U]) -> f64 {
        (unknown..U)
            .map(|row| self.whiten[row][unknown].0[x] * whitened[row].0[x])
            .sum()
    }

    /// Puts −U a of the offsets, in the columns of their clusters, into `columns` (offset, unknown
    /// that all channels share, pixel), and adds a to `diagonal`.
    pub(super) fn fill_offset_columns(&self, columns: &mut [f64], diagonal: &mut [f64]) {
        self.each_offset(|unknown, offset, x, tied| {
            let a = tied.precision[unknown].0[x];
            diagonal[offset] += a;
            for row in unknown..C + D - 1 {
                let place = (offset * (D - 1) + row - C) * BLOCK + x;
                columns[place] = -self.whiten[row][unknown].0[x] * a;
            }
        });
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

    /// W v of every sample.
    fn moved_radiance(&self, light_step: &[[f64; COEFFICIENTS]]) -> Vec<Doubles> {
        let n = self.problem.pictures();
        let mut radiance = vec![Doubles::default(); light_step.len()];
        for (sample, (light, radiance)) in light_step.iter().zip(&mut radiance).enumerate() {
            self.isa().run(Radiance {
                weights: &self.block.weights[sample / n],
                light,
                radiance,
            });
        }
        radiance
    }

    /// Adds R times `values`, one for each sample.
    fn add_rows(&self, values: &[Doubles], sums: &mut [Doubles; U]) {
        let n = self.problem.pictures();
        for (sample, values) in values.iter().enumerate() {
            self.isa().run(AddRows {
                own: unknowns_of_channel::<C, D>(sample / n),
                rows: &self.rows[sample],
                values,
                sums,
            });
        }
    }

    /// Subtracts the sample's Rᵀ `whitened`.
    fn subtract_rows(
        &self,
        sample: usize,
        channel: usize,
        whitened: &[Doubles; U],
        left: &mut Doubles,
    ) {
        self.isa().run(SubtractRows {
            own: unknowns_of_channel::<C, D>(channel),
            rows: &self.rows[sample],
            whitened,
            left,
        });
    }

    /// Σ ω w_ck w_cl over the pixels: (channel, 1 or picture, K, K).
    pub(super) fn grams(&self) -> Vec<f64> {
        let (n, k) = (self.problem.pictures(), self.problem.coefficients());
        let each = if self.problem.weights(0, 0).is_empty() {
            1
        } else {
            n
        };
        let mut grams = vec![0.0; C * each * k * k];
        for (i, gram) in grams.chunks_mut(k * k).enumerate() {
            let (c, picture) = (i / each, i % each);
            let omega = &self.omega[c * n + picture].0;
            let weights = &self.block.weights[c];
            for row in 0..k {
                for column in 0..k {
                    let mut sum = [0.0; LANES];
                    for x in 0..BLOCK {
                        sum[x % LANES] += omega[x] * weights[row].0[x] * weights[column].0[x];
                    }
                    gram[row * k + column] = sum.iter().sum();
                }
            }
        }
        grams
    }
}
