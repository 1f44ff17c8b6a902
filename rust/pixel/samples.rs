//! The samples of a block of pixels, one at a time: residual, and derivatives by the unknowns.
//!
//! A pixel depends on a few projections of a light: Σ_k A_l Y_k(n) L_k and, for each row of its
//! lobe, Σ_k R_jk L_k. Radiance and its derivatives by the material are linear in them, with
//! coefficients that no picture changes ([`FillResponses`]). Those by the two tangent offsets of a
//! free normal are Σ_k L_k ∂w_ck/∂a, with ∂w_ck/∂a from
//! [`weight_jacobian`](super::weight_jacobian).
//!
//! Code is compiled for pixels whose normals are given, with D = 3 derivatives of a sample and U = 5
//! unknowns of a pixel at most, and for free ones, with 5 and 7.

use std::marker::PhantomData;

use crate::block::basis::{Basis, FillBasis, MAX_PROJECTIONS, light_projections};
use crate::block::factors::{FillFactors, FillFunctions};
use crate::block::normal_jacobian::TangentOffsets;
use crate::block::radiance::Radiance;
use crate::block::weights::FillWeights;
use crate::pixel::weight_jacobian::WeightJacobian;
use crate::problem::Problem;
use crate::reflectance::planes::{
    BLOCK, ChannelFactors, Directions, Doubles, Materials, no_functions,
};
use crate::reflectance::planes::{MAX_ROWS, Material};
use crate::reflectance::reflection::{ExactFunctions, Factors, Reflection};
use crate::reflectance::sh::COEFFICIENTS;
use crate::reflectance::tangent_offset::OFFSETS;
use crate::runtime::simd::{Instructions, Isa, Kernel};

/// Derivatives of a sample where normals are given: by its channel's albedo, roughness, metallic.
pub(crate) const DERIVATIVES: usize = 3;
/// Unknowns of a pixel at most, where normals are given.
pub(crate) const UNKNOWNS: usize = 5;
/// Derivatives of a sample, where normals are free: the tangent offsets come after the others.
pub(crate) const FREE_DERIVATIVES: usize = DERIVATIVES + OFFSETS;
/// Unknowns of a pixel at most, where normals are free.
pub(crate) const FREE_UNKNOWNS: usize = UNKNOWNS + OFFSETS;

/// `by_kind!(problem, free, M, C, D, U => f::<M, C, D, U>(…))`: code that is compiled for each kind
/// of problem, with its model, its channels, and derivatives and unknowns as they are where normals
/// are `free` or not.
macro_rules! by_kind {
    ($problem:expr, $free:expr, $m:ident, $c:ident, $d:ident, $u:ident => $code:expr) => {{
        use $crate::pixel::samples::{DERIVATIVES, FREE_DERIVATIVES, FREE_UNKNOWNS, UNKNOWNS};
        macro_rules! kind {
            ($channels:expr, $derivatives:expr, $unknowns:expr) => {{
                const $c: usize = $channels;
                const $d: usize = $derivatives;
                const $u: usize = $unknowns;
                $code
            }};
        }
        $crate::reflectance::model::with_model!($problem.model(), $m => {
            match ($problem.channels(), $free) {
                (1, false) => kind!(1, DERIVATIVES, UNKNOWNS),
                (_, false) => kind!(3, DERIVATIVES, UNKNOWNS),
                (1, true) => kind!(1, FREE_DERIVATIVES, FREE_UNKNOWNS),
                (_, true) => kind!(3, FREE_DERIVATIVES, FREE_UNKNOWNS),
            }
        })
    }};
}
pub(crate) use by_kind;

/// Where the derivatives of a channel belong among the unknowns of a pixel: albedo by channel,
/// roughness, metallic, tangent offsets.
pub(crate) fn unknowns_of_channel<const C: usize, const D: usize>(channel: usize) -> [usize; D] {
    std::array::from_fn(|j| if j == 0 { channel } else { C + j - 1 })
}

/// The unknowns that are free, in order: all but a known metallic.
pub(crate) fn free_unknowns<const C: usize, const D: usize>(problem: &Problem) -> Vec<usize> {
    let known = problem.known_metallic().is_some();
    (0..C + D - 1)
        .filter(|&unknown| !(known && unknown == C + 1))
        .collect()
}

/// Up to [`BLOCK`] pixels, picked from anywhere, and one of their samples at a time.
pub(crate) struct Block<'a, M: Reflection, const C: usize, const D: usize> {
    model: M,
    problem: &'a Problem,
    isa: Instructions,
    /// Where the pixels come from.
    places: Vec<usize>,
    directions: Directions<f64>,
    pub materials: Materials<C>,
    basis: Basis<f64>,
    functions: Box<ExactFunctions<M>>,
    factors: [ChannelFactors<f64>; C],
    /// w_ck
    pub weights: Box<[[Doubles; COEFFICIENTS]; C]>,
    responses: Vec<Responses>,
    /// Where D says that normals are free.
    pub weight_jacobian: Option<WeightJacobian>,
    /// Targets and weights ω: (channel, picture).
    given: Vec<[Doubles; 2]>,
    sample: Sample<D>,
}

/// By which the projections of a light become radiance and its derivatives.
#[derive(Clone, Debug)]
pub(crate) struct Responses {
    pub(crate) radiance: [Doubles; MAX_PROJECTIONS],
    pub(crate) derivatives: [[Doubles; MAX_PROJECTIONS]; DERIVATIVES],
}

impl Default for Responses {
    fn default() -> Self {
        Self {
            radiance: [Doubles::default(); MAX_PROJECTIONS],
            derivatives: [[Doubles::default(); MAX_PROJECTIONS]; DERIVATIVES],
        }
    }
}

/// One channel of one picture.
#[derive(Clone, Debug)]
pub(crate) struct Sample<const D: usize> {
    /// I − T
    pub residual: Doubles,
    /// ω; 0 where no pixel is.
    pub weight: Doubles,
    /// ∂I/∂(albedo, roughness, metallic), and by the tangent offsets.
    pub derivatives: [Doubles; D],
}

impl<const D: usize> Default for Sample<D> {
    fn default() -> Self {
        Self {
            residual: Doubles::default(),
            weight: Doubles::default(),
            derivatives: [Doubles::default(); D],
        }
    }
}

impl<'a, M: Reflection, const C: usize, const D: usize> Block<'a, M, C, D> {
    pub(crate) fn new(problem: &'a Problem) -> Self {
        Self {
            model: M::default(),
            problem,
            isa: problem.instructions(),
            places: Vec::new(),
            directions: Directions::default(),
            materials: Materials::default(),
            basis: Basis::default(),
            functions: no_functions(),
            factors: std::array::from_fn(|_| ChannelFactors::default()),
            weights: Box::new([[Doubles::default(); COEFFICIENTS]; C]),
            responses: vec![Responses::default(); C],
            weight_jacobian: (D > DERIVATIVES).then(|| WeightJacobian::new(C)),
            given: Vec::new(),
            sample: Sample::default(),
        }
    }

    /// Takes up pixels with their materials, and tangent offsets, of `maps`.
    pub(crate) fn load(&mut self, maps: &[f64], pixels: &[usize]) {
        let mut materials = Materials::default();
        for (x, &p) in pixels.iter().enumerate() {
            materials.set(x, &self.problem.material(maps, p));
        }
        self.place(maps, pixels);
        let offsets = self.problem.picked_offsets(maps, pixels);
        self.take(&materials, &offsets);
    }

    /// Takes up pixels, whose materials, and tangent offsets where they are free, are still to come.
    pub(crate) fn place(&mut self, maps: &[f64], pixels: &[usize]) {
        self.places.clear();
        self.places.extend(pixels);
        self.given.clear();
        for c in 0..C {
            for picture in 0..self.problem.pictures() {
                self.given
                    .push(self.problem.picked_samples(c, picture, pixels));
            }
        }
        if let Some(weight_jacobian) = &mut self.weight_jacobian {
            weight_jacobian.place(self.problem, pixels);
            return;
        }
        self.directions = self.problem.picked_directions(maps, pixels);
        self.fill_basis();
    }

    fn fill_basis(&mut self) {
        self.isa.run(FillBasis::<M, f64, COEFFICIENTS> {
            directions: &self.directions,
            basis: &mut self.basis,
            model: self.model,
        });
    }

    /// Gives the pixels materials and, where they are free, tangent offsets, and works out all that
    /// no picture changes.
    pub(crate) fn take(&mut self, materials: &Materials<C>, offsets: &TangentOffsets) {
        self.materials = materials.clone();
        if let Some(weight_jacobian) = &mut self.weight_jacobian {
            weight_jacobian.turn(self.isa, offsets, &mut self.directions);
            self.fill_basis();
        }
        self.isa.run(FillFunctions {
            cosine: self.directions.cosines(),
            roughness: &self.materials.roughness,
            by_cosine: self.weight_jacobian.is_some(),
            functions: &mut self.functions,
            model: self.model,
        });
        for c in 0..C {
            self.isa.run(FillResponses {
                directions: &self.directions,
                albedo: &self.materials.albedo[c],
                roughness: &self.materials.roughness,
                metallic: &self.materials.metallic,
                functions: &self.functions,
                responses: &mut self.responses[c],
                model: PhantomData::<M>,
            });
        }
        if let Some(weight_jacobian) = &mut self.weight_jacobian {
            weight_jacobian.fill::<M, C>(
                self.isa,
                &self.directions,
                &self.basis,
                &self.materials,
                &self.functions,
            );
        }
    }

    /// Works out the derivatives by the lights.
    pub(crate) fn fill_weights(&mut self) {
        self.isa.run(FillFactors {
            directions: &self.directions,
            materials: &self.materials,
            pixels: self.places.len(),
            by_cosine: false,
            functions: &mut self.functions,
            factors: &mut self.factors,
            model: self.model,
        });
        self.isa.run(FillWeights {
            basis: &self.basis,
            factors: &self.factors,
            weights: &mut self.weights,
            model: self.model,
        });
    }

    /// Adds all samples to the normal equations.
    pub(crate) fn add_samples<const U: usize>(
        &mut self,
        lights: &[[f64; COEFFICIENTS]],
        sums: &mut Sums<U>,
    ) {
        let isa = self.isa;
        self.each_sample(lights, |c, _, sample| {
            isa.run(AddSample {
                sample,
                unknowns: unknowns_of_channel::<C, D>(c),
                sums,
            });
        });
    }

    /// Calls `f` with channel, picture and sample, channel by channel. Lights are (channel, picture).
    pub fn each_sample(
        &mut self,
        lights: &[[f64; COEFFICIENTS]],
        mut f: impl FnMut(usize, usize, &Sample<D>),
    ) {
        for (c, of_channel) in lights.chunks(self.problem.pictures()).enumerate() {
            for (picture, light) in of_channel.iter().enumerate() {
                self.take_sample(c, picture, light);
                f(c, picture, &self.sample);
            }
        }
    }

    /// Works out one channel of one picture.
    fn take_sample(&mut self, channel: usize, picture: usize, light: &[f64; COEFFICIENTS]) {
        let [target, weight] = &self.given[channel * self.problem.pictures() + picture];
        self.sample.weight = *weight;
        self.isa.run(TakeSample {
            basis: &self.basis,
            light,
            target,
            responses: &self.responses[channel],
            by_offsets: self.weight_jacobian.as_ref().map(|t| &t.weights[channel]),
            sample: &mut self.sample,
            model: PhantomData::<M>,
        });
    }
}

/// Fills in the coefficients of one channel: what [`Factors`] make of each projection alone.
pub(crate) struct FillResponses<'a, M: Reflection> {
    pub(crate) directions: &'a Directions<f64>,
    pub(crate) albedo: &'a Doubles,
    pub(crate) roughness: &'a Doubles,
    pub(crate) metallic: &'a Doubles,
    pub(crate) functions: &'a ExactFunctions<M>,
    pub(crate) responses: &'a mut Responses,
    pub(crate) model: PhantomData<M>,
}

impl<M: Reflection> Kernel for FillResponses<'_, M> {
    type Output = ();

    #[inline(always)]
    fn run<I: Isa>(self, _: I) {
        for x in 0..BLOCK {
            let material = Material {
                albedo: [self.albedo.0[x]],
                roughness: self.roughness.0[x],
                metallic: self.metallic.0[x],
            };
            let functions = M::functions_of(self.functions, x);
            let factors = M::factors(self.directions.cosine(x), &material, functions);
            // One call, in a loop: of several the compiler would make a function and no vector code.
            for projection in 0..=M::ROWS {
                let mut alone = [0.0; MAX_PROJECTIONS];
                alone[projection] = 1.0;
                let mut by_row = [0.0; MAX_ROWS];
                by_row.copy_from_slice(&alone[1..]);
                let derivatives = factors.pull_back(&material, &[alone[0]], &[by_row]);
                self.responses.radiance[projection].0[x] = if projection == 0 {
                    factors.diffuse(0)
                } else {
                    factors.row(0, projection - 1)
                };
                self.responses.derivatives[0][projection].0[x] = derivatives.albedo[0];
                self.responses.derivatives[1][projection].0[x] = derivatives.roughness;
                self.responses.derivatives[2][projection].0[x] = derivatives.metallic;
            }
        }
    }
}

/// Residual and derivatives of a sample.
struct TakeSample<'a, M: Reflection, const D: usize> {
    basis: &'a Basis<f64>,
    light: &'a [f64; COEFFICIENTS],
    target: &'a Doubles,
    responses: &'a Responses,
    /// ∂w_k by each tangent offset.
    by_offsets: Option<&'a [[Doubles; COEFFICIENTS]; OFFSETS]>,
    sample: &'a mut Sample<D>,
    model: PhantomData<M>,
}

impl<M: Reflection, const D: usize> Kernel for TakeSample<'_, M, D> {
    type Output = ();

    #[inline(always)]
    fn run<I: Isa>(self, isa: I) {
        let Self {
            basis,
            light,
            target,
            responses,
            by_offsets,
            sample,
            ..
        } = self;
        let light_projections = light_projections::<M>(basis, light);
        for x in 0..BLOCK {
            sample.residual.0[x] = -target.0[x];
        }
        sample.derivatives[..DERIVATIVES].fill(Doubles::default());
        for s in 0..=M::ROWS {
            for x in 0..BLOCK {
                sample.residual.0[x] += responses.radiance[s].0[x] * light_projections[s].0[x];
            }
            for j in 0..DERIVATIVES {
                for x in 0..BLOCK {
                    sample.derivatives[j].0[x] +=
                        responses.derivatives[j][s].0[x] * light_projections[s].0[x];
                }
            }
        }
        if let Some(by_offsets) = by_offsets {
            let (_, of_offsets) = sample.derivatives.split_at_mut(DERIVATIVES);
            for (weights, radiance) in by_offsets.iter().zip(of_offsets) {
                let radiance = Radiance {
                    weights,
                    light,
                    radiance,
                };
                radiance.run(isa);
            }
        }
    }
}

/// The normal equations of a block; of the matrix, the lower triangle.
#[derive(Clone, Debug)]
pub(crate) struct Sums<const U: usize> {
    pub(crate) matrix: [[Doubles; U]; U],
    pub(crate) gradient: [Doubles; U],
    pub(crate) sum_sq_residuals: Doubles,
}

impl<const U: usize> Default for Sums<U> {
    fn default() -> Self {
        Self {
            matrix: [[Doubles::default(); U]; U],
            gradient: [Doubles::default(); U],
            sum_sq_residuals: Doubles::default(),
        }
    }
}

impl<const U: usize> Sums<U> {
    /// Puts some rows and columns of the matrix of one pixel at the beginning of `matrix`.
    pub(crate) fn store_matrix(&self, pixel: usize, rows: &[usize], matrix: &mut [f64]) {
        for (i, &row) in rows.iter().enumerate() {
            for (j, &column) in rows.iter().enumerate() {
                let lower = &self.matrix[row.max(column)][row.min(column)];
                matrix[i * rows.len() + j] = lower.0[pixel];
            }
        }
    }
}

/// Adds a sample to the normal equations.
pub(crate) struct AddSample<'a, const D: usize, const U: usize> {
    pub sample: &'a Sample<D>,
    pub unknowns: [usize; D],
    pub sums: &'a mut Sums<U>,
}

impl<const D: usize, const U: usize> Kernel for AddSample<'_, D, U> {
    type Output = ();

    #[inline(always)]
    fn run<I: Isa>(self, _: I) {
        let Self {
            sample,
            unknowns,
            sums,
        } = self;
        let mut weighted = Doubles::default();
        for x in 0..BLOCK {
            weighted.0[x] = sample.weight.0[x] * sample.residual.0[x];
            sums.sum_sq_residuals.0[x] += weighted.0[x] * sample.residual.0[x];
        }
        for i in 0..D {
            let by_row = &sample.derivatives[i];
            let gradient = &mut sums.gradient[unknowns[i]];
            for x in 0..BLOCK {
                gradient.0[x] += weighted.0[x] * by_row.0[x];
            }
            for j in 0..=i {
                let by_column = &sample.derivatives[j];
                let entry = &mut sums.matrix[unknowns[i]][unknowns[j]];
                for x in 0..BLOCK {
                    entry.0[x] += sample.weight.0[x] * by_row.0[x] * by_column.0[x];
                }
            }
        }
    }
}
