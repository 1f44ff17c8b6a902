//! The samples of a block of pixels: residuals, and derivatives by the unknowns.
//!
//! A pixel depends on a few projections of a light: Σ_k A_l Y_k(n) L_k and, for each row of its
//! lobe, Σ_k R_jk L_k. Radiance and its derivatives by the material are linear in them, with
//! coefficients that no picture changes ([`Responses`]). Those by the two tangent offsets of a
//! free normal are Σ_k L_k ∂w_ck/∂a, with ∂w_ck/∂a from
//! [`weight_jacobian`](super::weight_jacobian).
//!
//! Code is compiled for pixels whose normals are given, with D = 3 derivatives of a sample and U = 5
//! unknowns of a pixel at most, and for free ones, with 5 and 7.

use std::marker::PhantomData;

use crate::block::basis::{Basis, BasisAt, MAX_PROJECTIONS, Projections, TOGETHER};
use crate::block::factors::FillFunctions;
use crate::block::normal_jacobian::TangentOffsets;
use crate::block::weights::FillWeights;
use crate::pixel::weight_jacobian::WeightJacobian;
use crate::problem::Problem;
use crate::reflectance::planes::{
    BLOCK, ChannelFactors, Directions, Doubles, MAX_ROWS, Materials, no_functions,
};
use crate::reflectance::reflection::{ExactFunctions, Factors, Reflection};
use crate::reflectance::sh::COEFFICIENTS;
use crate::reflectance::tangent_offset::OFFSETS;
use crate::runtime::simd::{Instructions, Isa, Kernel, Vectors, vectorized};

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
        #[allow(unused_imports)]
        use $crate::reflectance::model::{with_model, with_model_of};
        with_model_of!($problem, $m => {
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
    let known = problem.options.metallic.is_some();
    (0..C + D - 1)
        .filter(|&unknown| !(known && unknown == C + 1))
        .collect()
}

/// Up to [`BLOCK`] pixels, picked from anywhere, and their samples.
pub(crate) struct Block<'a, M: Reflection, const C: usize, const D: usize> {
    problem: &'a Problem,
    isa: Instructions,
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
    /// Targets and weights ω, 0 where no pixel is: (channel, picture).
    pub given: Vec<[Doubles; 2]>,
    /// What surroundings bring to each projection: (channel, picture); or empty.
    bounced: Vec<[Doubles; MAX_PROJECTIONS]>,
    /// I − T of samples that were kept: (channel, picture).
    pub residuals: Vec<Doubles>,
    /// ∂I/∂(albedo, roughness, metallic) of them, and by the tangent offsets.
    pub derivatives: Vec<[Doubles; D]>,
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

impl<'a, M: Reflection, const C: usize, const D: usize> Block<'a, M, C, D> {
    pub(crate) fn new(problem: &'a Problem) -> Self {
        Self {
            problem,
            isa: problem.options.instructions,
            directions: Directions::default(),
            materials: Materials::default(),
            basis: Basis::default(),
            functions: no_functions(),
            factors: std::array::from_fn(|_| ChannelFactors::default()),
            weights: Box::new([[Doubles::default(); COEFFICIENTS]; C]),
            responses: vec![Responses::default(); C],
            weight_jacobian: (D > DERIVATIVES).then(|| WeightJacobian::new(C)),
            given: Vec::new(),
            bounced: Vec::new(),
            residuals: Vec::new(),
            derivatives: Vec::new(),
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
        self.problem.pick_samples(pixels, &mut self.given);
        if let Some(weight_jacobian) = &mut self.weight_jacobian {
            weight_jacobian.given = self.problem.picked_given(pixels);
            return;
        }
        self.directions = self.problem.picked_directions(maps, pixels);
        self.fill_basis(pixels);
        self.problem.pick_bounced::<M>(pixels, &mut self.bounced);
    }

    fn fill_basis(&mut self, pixels: &[usize]) {
        self.problem.fill_basis::<M, f64, COEFFICIENTS>(
            &self.directions,
            pixels.iter().copied(),
            &mut self.basis,
        );
    }

    /// Gives the pixels materials and, where they are free, tangent offsets, and works out all that
    /// no picture changes.
    pub(crate) fn take(&mut self, materials: &Materials<C>, offsets: &TangentOffsets) {
        self.materials = *materials;
        if let Some(weight_jacobian) = &mut self.weight_jacobian {
            weight_jacobian.turn(self.isa, offsets, &mut self.directions);
            self.fill_basis(&[]); // of directions alone
        }
        self.isa.run(FillFunctions::<M> {
            cosine: self.directions.cosines(),
            roughness: &self.materials.roughness,
            by_cosine: self.weight_jacobian.is_some(),
            functions: &mut self.functions,
        });
        for c in 0..C {
            let (directions, materials) = (&self.directions, &self.materials);
            let responses = &mut self.responses[c];
            vectorized!(
                self.isa,
                responses.fill::<M, C>(c, directions, materials, &self.functions)
            );
        }
        // The derivatives by the lights.
        for (factors, responses) in self.factors.iter_mut().zip(&self.responses) {
            factors.diffuse = responses.radiance[0];
            factors.rows[..M::ROWS].copy_from_slice(&responses.radiance[1..=M::ROWS]);
        }
        self.isa.run(FillWeights {
            basis: &self.basis,
            factors: &self.factors,
            weights: &mut self.weights,
            model: M::default(),
        });
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

    /// Adds all samples to the normal equations, and keeps them, or none. Lights are (channel,
    /// picture).
    pub(crate) fn add_samples<const U: usize>(
        &mut self,
        lights: &[[f64; COEFFICIENTS]],
        keep: bool,
        sums: &mut Sums<U>,
    ) {
        let kept = if keep { lights.len() } else { 0 };
        self.residuals.resize(kept, Doubles::default());
        self.derivatives.resize(kept, [Doubles::default(); D]);
        let n = self.problem.pictures();
        for (c, lights) in lights.chunks(n).enumerate() {
            self.isa.run(AddSamples {
                basis: &self.basis,
                weights: &self.weights[c],
                lights,
                given: &self.given[c * n..][..n],
                bounced: self.bounced.get(c * n..).unwrap_or_default(),
                responses: &self.responses[c],
                by_offsets: self.weight_jacobian.as_ref().map(|t| &t.weights[c]),
                unknowns: unknowns_of_channel::<C, D>(c),
                sums,
                residuals: self.residuals.get_mut(c * n..).unwrap_or_default(),
                derivatives: self.derivatives.get_mut(c * n..).unwrap_or_default(),
                model: PhantomData::<M>,
            });
        }
    }

    /// Adds Σ ω w_ck w_cl of channel c over the pixels, for each picture or for all: (1 or picture, K, K).
    pub(crate) fn add_grams(&self, c: usize, grams: &mut [f64]) {
        let k = self.problem.coefficients();
        for (i, gram) in grams.chunks_mut(k * k).enumerate() {
            for (row, sums) in gram.chunks_mut(k).enumerate() {
                self.add_weighted(c, i, &self.weights[c][row], sums);
            }
        }
    }

    /// Adds Σ ω w_ck v over the pixels, of channel c and a picture: (K).
    pub(crate) fn add_weighted(&self, c: usize, picture: usize, v: &Doubles, sums: &mut [f64]) {
        let [_, omega] = &self.given[c * self.problem.pictures() + picture];
        vectorized!(self.isa, add_weighted(omega, v, &self.weights[c], sums));
    }

    /// Sum of squares and, unless nobody asks for it, gradient with given normals, in the place of
    /// those that there are.
    pub(crate) fn put_residuals<const U: usize>(
        &mut self,
        lights: &[[f64; COEFFICIENTS]],
        with_gradient: bool,
        sums: &mut Sums<U>,
    ) {
        sums.sum_sq_residuals = Doubles::default();
        if with_gradient {
            sums.gradient = [Doubles::default(); U];
        }
        let n = self.problem.pictures();
        for (c, lights) in lights.chunks(n).enumerate() {
            self.isa.run(AddResiduals {
                basis: &self.basis,
                weights: &self.weights[c],
                lights,
                given: &self.given[c * n..][..n],
                bounced: self.bounced.get(c * n..).unwrap_or_default(),
                responses: &self.responses[c],
                unknowns: unknowns_of_channel::<C, DERIVATIVES>(c),
                with_gradient,
                sums,
                model: PhantomData::<M>,
            });
        }
    }
}

/// Adds Σ ω w_k v over the pixels.
#[inline(always)]
fn add_weighted(
    omega: &Doubles,
    values: &Doubles,
    weights: &[Doubles; COEFFICIENTS],
    sums: &mut [f64],
) {
    /// Numbers that are summed side by side.
    const LANES: usize = 8;
    let mut weighted = Doubles::default();
    for x in 0..BLOCK {
        weighted.0[x] = omega.0[x] * values.0[x];
    }
    let weighted = weighted.0.as_chunks::<LANES>().0;
    for (sum, weights) in sums.iter_mut().zip(weights) {
        let mut lanes = [0.0; LANES];
        for (weights, weighted) in weights.0.as_chunks::<LANES>().0.iter().zip(weighted) {
            for x in 0..LANES {
                lanes[x] += weighted[x] * weights[x];
            }
        }
        *sum += lanes.iter().sum::<f64>();
    }
}

/// The normal equations of a block; of the matrix, the lower triangle.
#[derive(Clone, Copy, Debug)]
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

/// Adds the samples of one channel to the normal equations.
struct AddSamples<'a, M: Reflection, const D: usize, const U: usize> {
    basis: &'a Basis<f64>,
    weights: &'a [Doubles; COEFFICIENTS],
    /// By picture.
    lights: &'a [[f64; COEFFICIENTS]],
    given: &'a [[Doubles; 2]],
    /// By picture, or empty.
    bounced: &'a [[Doubles; MAX_PROJECTIONS]],
    responses: &'a Responses,
    /// ∂w_k by each tangent offset.
    by_offsets: Option<&'a [[Doubles; COEFFICIENTS]; OFFSETS]>,
    unknowns: [usize; D],
    sums: &'a mut Sums<U>,
    /// To be written, or none.
    residuals: &'a mut [Doubles],
    derivatives: &'a mut [[Doubles; D]],
    model: PhantomData<M>,
}

/// Of the derivatives of radiance, by projection.
type ResponsesAt<V> = [[V; DERIVATIVES]; MAX_PROJECTIONS];

/// One vector of pixels of a channel: what no picture changes, its sums, and room for some pictures.
struct ChannelAt<I: Vectors<f64>, const D: usize> {
    basis: BasisAt<I>,
    weights: [I::Vector; COEFFICIENTS],
    responses: ResponsesAt<I::Vector>,
    by_offsets: [[I::Vector; COEFFICIENTS]; OFFSETS],
    squares: I::Vector,
    gradient: [I::Vector; D],
    matrix: [[I::Vector; D]; D],
    projections: Projections<I::Vector>,
}

impl Responses {
    /// Fills in those of channel c: what [`Factors`] make of each projection alone.
    #[inline(always)]
    pub(crate) fn fill<M: Reflection, const C: usize>(
        &mut self,
        c: usize,
        directions: &Directions<f64>,
        materials: &Materials<C>,
        functions: &ExactFunctions<M>,
    ) {
        for x in 0..BLOCK {
            let material = materials.of_channel(c, x);
            let functions = M::functions_of(functions, x);
            let factors = M::factors(directions.cosine(x), &material, functions);
            // One call, in a loop: of several the compiler would make a function and no vector code.
            for projection in 0..=M::ROWS {
                let mut alone = [0.0; MAX_PROJECTIONS];
                alone[projection] = 1.0;
                let mut by_row = [0.0; MAX_ROWS];
                by_row.copy_from_slice(&alone[1..]);
                let derivatives = factors.pull_back(&material, &[alone[0]], &[by_row]);
                self.radiance[projection].0[x] = if projection == 0 {
                    factors.diffuse(0)
                } else {
                    factors.row(0, projection - 1)
                };
                self.derivatives[0][projection].0[x] = derivatives.albedo[0];
                self.derivatives[1][projection].0[x] = derivatives.roughness;
                self.derivatives[2][projection].0[x] = derivatives.metallic;
            }
        }
    }

    #[inline(always)]
    fn take<M: Reflection, I: Vectors<f64>>(&self, v: usize, at: &mut ResponsesAt<I::Vector>) {
        for s in 0..=M::ROWS {
            for d in 0..DERIVATIVES {
                at[s][d] = I::of(&self.derivatives[d][s].0)[v];
            }
        }
    }
}

impl<M: Reflection, const D: usize, const U: usize> Kernel for AddSamples<'_, M, D, U> {
    type Output = ();

    #[inline(always)]
    fn run<I: Isa>(self, isa: I) {
        self.all(isa);
    }
}

impl<M: Reflection, const D: usize, const U: usize> AddSamples<'_, M, D, U> {
    #[inline(always)]
    fn all<I: Vectors<f64>>(mut self, isa: I) {
        let (n, zero) = (self.lights.len(), isa.splat(0.0));
        let mut at = ChannelAt::<I, D> {
            basis: BasisAt::new(isa),
            weights: [zero; COEFFICIENTS],
            responses: [[zero; DERIVATIVES]; MAX_PROJECTIONS],
            by_offsets: [[zero; COEFFICIENTS]; OFFSETS],
            squares: zero,
            gradient: [zero; D],
            matrix: [[zero; D]; D],
            projections: [[zero; MAX_PROJECTIONS]; TOGETHER],
        };
        for v in 0..BLOCK / I::LANES {
            at.basis.take::<M>(self.basis, v);
            for k in 0..COEFFICIENTS {
                at.weights[k] = I::of(&self.weights[k].0)[v];
            }
            self.responses.take::<M, I>(v, &mut at.responses);
            (at.squares, at.gradient, at.matrix) = (zero, [zero; D], [[zero; D]; D]);
            if let Some(by_offsets) = self.by_offsets {
                for t in 0..OFFSETS {
                    for k in 0..COEFFICIENTS {
                        at.by_offsets[t][k] = I::of(&by_offsets[t][k].0)[v];
                    }
                }
            }
            let mut first = 0;
            while first + TOGETHER <= n {
                self.some::<I, TOGETHER>(isa, v, first, &mut at);
                first += TOGETHER;
            }
            for first in first..n {
                self.some::<I, 1>(isa, v, first, &mut at);
            }
            let add = |to: &mut Doubles, sum| {
                let to = &mut I::of_mut(&mut to.0)[v];
                *to = isa.add(*to, sum);
            };
            add(&mut self.sums.sum_sq_residuals, at.squares);
            for i in 0..D {
                let row = self.unknowns[i];
                add(&mut self.sums.gradient[row], at.gradient[i]);
                for j in 0..=i {
                    let column = self.unknowns[j];
                    add(&mut self.sums.matrix[row][column], at.matrix[i][j]);
                }
            }
        }
    }

    /// J pictures, from number `first` on.
    #[inline(always)]
    fn some<I: Vectors<f64>, const J: usize>(
        &mut self,
        isa: I,
        v: usize,
        first: usize,
        at: &mut ChannelAt<I, D>,
    ) {
        let lights = &self.lights[first..first + J];
        at.basis
            .project::<M, J>(isa, |j, k| isa.splat(lights[j][k]), &mut at.projections);
        let mut radiance = radiance::<I, J>(isa, &at.weights, lights);
        if M::SURROUNDED {
            for (j, bounced) in self.bounced.iter().skip(first).take(J).enumerate() {
                for s in 0..=M::ROWS {
                    let brought = I::of(&bounced[s].0)[v];
                    let factor = I::of(&self.responses.radiance[s].0)[v];
                    at.projections[j][s] = isa.add(at.projections[j][s], brought);
                    radiance[j] = isa.mul_add(factor, brought, radiance[j]);
                }
            }
        }
        for j in 0..J {
            let [target, weight] = &self.given[first + j];
            let (target, weight) = (I::of(&target.0)[v], I::of(&weight.0)[v]);
            let residual = isa.sub(radiance[j], target);
            let mut derivatives = [isa.splat(0.0); D];
            for s in 0..=M::ROWS {
                for d in 0..DERIVATIVES {
                    let response = at.responses[s][d];
                    derivatives[d] = isa.mul_add(response, at.projections[j][s], derivatives[d]);
                }
            }
            for t in 0..D - DERIVATIVES {
                for k in 0..COEFFICIENTS {
                    let light = isa.splat(lights[j][k]);
                    let sum = &mut derivatives[DERIVATIVES + t];
                    *sum = isa.mul_add(light, at.by_offsets[t][k], *sum);
                }
            }
            let weighted = isa.mul(weight, residual);
            at.squares = isa.mul_add(weighted, residual, at.squares);
            for i in 0..D {
                at.gradient[i] = isa.mul_add(weighted, derivatives[i], at.gradient[i]);
                let by_row = isa.mul(weight, derivatives[i]);
                for l in 0..=i {
                    at.matrix[i][l] = isa.mul_add(by_row, derivatives[l], at.matrix[i][l]);
                }
            }
            if let Some(kept) = self.derivatives.get_mut(first + j) {
                I::of_mut(&mut self.residuals[first + j].0)[v] = residual;
                for i in 0..D {
                    I::of_mut(&mut kept[i].0)[v] = derivatives[i];
                }
            }
        }
    }
}

/// Adds squares and gradient of one channel with given normals: what residuals add to a light goes
/// through the projections once a pixel, whatever the number of pictures.
struct AddResiduals<'a, M: Reflection, const U: usize> {
    basis: &'a Basis<f64>,
    weights: &'a [Doubles; COEFFICIENTS],
    /// By picture.
    lights: &'a [[f64; COEFFICIENTS]],
    given: &'a [[Doubles; 2]],
    /// By picture, or empty.
    bounced: &'a [[Doubles; MAX_PROJECTIONS]],
    responses: &'a Responses,
    unknowns: [usize; DERIVATIVES],
    with_gradient: bool,
    sums: &'a mut Sums<U>,
    model: PhantomData<M>,
}

impl<M: Reflection, const U: usize> Kernel for AddResiduals<'_, M, U> {
    type Output = ();

    #[inline(always)]
    fn run<I: Isa>(self, isa: I) {
        self.all(isa);
    }
}

impl<M: Reflection, const U: usize> AddResiduals<'_, M, U> {
    #[inline(always)]
    fn all<I: Vectors<f64>>(self, isa: I) {
        let (n, zero) = (self.lights.len(), isa.splat(0.0));
        let mut basis = BasisAt::new(isa);
        let mut responses = [[zero; DERIVATIVES]; MAX_PROJECTIONS];
        let mut projections = [[zero; MAX_PROJECTIONS]; TOGETHER];
        let mut weights = [zero; COEFFICIENTS];
        for v in 0..BLOCK / I::LANES {
            for k in 0..COEFFICIENTS {
                weights[k] = I::of(&self.weights[k].0)[v];
            }
            // Σ ω e², Σ ω e L, and Σ ω e of what surroundings bring.
            let mut sums = (zero, [zero; COEFFICIENTS], [zero; MAX_PROJECTIONS]);
            let mut first = 0;
            while first + TOGETHER <= n {
                self.some::<I, TOGETHER>(isa, &weights, v, first, &mut sums);
                first += TOGETHER;
            }
            for first in first..n {
                self.some::<I, 1>(isa, &weights, v, first, &mut sums);
            }
            let (squares, by_light, by_bounced) = sums;
            let add = |to: &mut Doubles, sum| {
                let to = &mut I::of_mut(&mut to.0)[v];
                *to = isa.add(*to, sum);
            };
            add(&mut self.sums.sum_sq_residuals, squares);
            if self.with_gradient {
                basis.take::<M>(self.basis, v);
                basis.project::<M, 1>(isa, |_, k| by_light[k], &mut projections);
                if M::SURROUNDED {
                    for s in 0..=M::ROWS {
                        projections[0][s] = isa.add(projections[0][s], by_bounced[s]);
                    }
                }
                self.responses.take::<M, I>(v, &mut responses);
                for d in 0..DERIVATIVES {
                    let mut sum = zero;
                    for s in 0..=M::ROWS {
                        sum = isa.mul_add(responses[s][d], projections[0][s], sum);
                    }
                    add(&mut self.sums.gradient[self.unknowns[d]], sum);
                }
            }
        }
    }

    /// J pictures, from number `first` on.
    #[inline(always)]
    fn some<I: Vectors<f64>, const J: usize>(
        &self,
        isa: I,
        weights: &[I::Vector; COEFFICIENTS],
        v: usize,
        first: usize,
        (squares, by_light, by_bounced): &mut (
            I::Vector,
            [I::Vector; COEFFICIENTS],
            [I::Vector; MAX_PROJECTIONS],
        ),
    ) {
        let lights = &self.lights[first..first + J];
        let mut residuals = radiance::<I, J>(isa, weights, lights);
        if M::SURROUNDED {
            for (j, bounced) in self.bounced.iter().skip(first).take(J).enumerate() {
                for s in 0..=M::ROWS {
                    let factor = I::of(&self.responses.radiance[s].0)[v];
                    residuals[j] = isa.mul_add(factor, I::of(&bounced[s].0)[v], residuals[j]);
                }
            }
        }
        for j in 0..J {
            let [target, weight] = &self.given[first + j];
            let residual = isa.sub(residuals[j], I::of(&target.0)[v]);
            residuals[j] = isa.mul(I::of(&weight.0)[v], residual);
            *squares = isa.mul_add(residuals[j], residual, *squares);
        }
        if self.with_gradient {
            if M::SURROUNDED {
                for (j, bounced) in self.bounced.iter().skip(first).take(J).enumerate() {
                    for s in 0..=M::ROWS {
                        let brought = I::of(&bounced[s].0)[v];
                        by_bounced[s] = isa.mul_add(residuals[j], brought, by_bounced[s]);
                    }
                }
            }
            for k in 0..COEFFICIENTS {
                for j in 0..J {
                    by_light[k] = isa.mul_add(residuals[j], isa.splat(lights[j][k]), by_light[k]);
                }
            }
        }
    }
}

/// W Lᵀ of J pictures; to the last bit the same wherever residuals come from it.
#[inline(always)]
fn radiance<I: Vectors<f64>, const J: usize>(
    isa: I,
    weights: &[I::Vector; COEFFICIENTS],
    lights: &[[f64; COEFFICIENTS]],
) -> [I::Vector; J] {
    let mut radiance = [isa.splat(0.0); J];
    for k in 0..COEFFICIENTS {
        for j in 0..J {
            radiance[j] = isa.mul_add(isa.splat(lights[j][k]), weights[k], radiance[j]);
        }
    }
    radiance
}
