//! The best material of each pixel when the lights are known.
//!
//! Pixels then have nothing to do with each other. A pixel's sum of squares may have several
//! minima, most of them apart in roughness and metallic; so it descends from several starts, its
//! own material and the best nodes of a grid ([`material_grid`]), and keeps the lowest.
//!
//! Most of the way costs the same for any number of pictures: the sum of squared residuals comes from
//! products over them ([`product_form`](super::product_form)), at the normals that x has. These know
//! it to 10⁻¹⁵ of Σ ω T², that is residuals to half of the digits; the last steps
//! ([`residual_steps`](super::residual_steps)) therefore take the residuals one by one, in passes
//! over the pictures. They also move normals that are free.
//!
//! Every pixel has its own damping, and once it is done it stays where it is: what it ends at does
//! not depend on the pixels beside it.

use crate::block::normal_jacobian::TangentOffsets;
use crate::pixel::descent::{Descent, Point, PriorPlanes};
use crate::pixel::material_grid::{self, AlbedoFromProducts};
use crate::pixel::product_form::{Form, FromProducts, LeastSquaresFromProducts};
use crate::pixel::residual_steps::ResidualSteps;
use crate::pixel::samples::{DERIVATIVES, FREE_DERIVATIVES, UNKNOWNS, by_kind, free_unknowns};
use crate::problem::Problem;
use crate::problem::by_pixel::fill_by_pixel;
use crate::reflectance::planes::{BLOCK, Doubles, Materials};
use crate::reflectance::sh::COEFFICIENTS;
use crate::runtime::simd::Instructions;
use crate::runtime::{Result, check};

/// Blocks of pixels in a piece of work at most: a piece has a cost of its own.
const MAX_CHUNK: usize = 8;
/// Pieces of work that are wanted, so that threads are busy to the end.
const PIECES: usize = 64;
/// Decrease of the cost, as a share of Σ ω T², up to which products cannot tell it from rounding: the
/// pixel stops.
const PRODUCTS_ROUNDING: f64 = 1e-13;
/// Difference of two costs, as a share of Σ ω T², above which products tell for sure which is lower.
/// Up to it both are compared by their residuals.
const PRODUCTS_CERTAIN: f64 = 1e-11;
/// Damping λ of the first step on products, as a share of the diagonal.
const PRODUCTS_DAMPING: f64 = 1e-3;
/// Least perceptual roughness that a descent begins at: at 0 nothing depends on roughness, and it
/// would never leave it. A material of x below it is still kept if nothing better is found.
const START_ROUGHNESS_MIN: f64 = 1e-3;

/// Newton steps to the best albedo of a grid node, which only has to be good enough to begin from.
const NODE_NEWTON_STEPS: usize = 2;

/// How materials are looked for.
#[derive(Clone, Copy, Debug)]
pub struct Search<'a> {
    /// Roughness of the nodes of the grid; empty for no grid.
    pub roughness: &'a [f64],
    /// Metallic of the nodes; not read where metallic is known.
    pub metallic: &'a [f64],
    /// Lowest local minima of the grid that are descended from, beside the material of x.
    pub starts: usize,
    /// Steps of a descent on products at most.
    pub steps: usize,
    /// Steps on residuals at most, of the best.
    pub exact_steps: usize,
    /// Whether normals stay where x has them, though they are free.
    pub held_normals: bool,
    /// What is known of the materials beside the pictures.
    pub prior: Option<GaussianPrior<'a>>,
}

/// Adds Σ_f precision_f (v_f − mean_f)² to the sum of squared residuals of a pixel, for f =
/// roughness, metallic unless it is known and, where normals are free, the two tangent offsets.
#[derive(Clone, Copy, Debug)]
pub struct GaussianPrior<'a> {
    /// (pixel, f)
    pub mean: &'a [f64],
    /// (pixel, f)
    pub precision: &'a [f64],
}

impl Problem {
    /// The best material of each of `pixels` with the lights of x, never worse than that of x: D numbers,
    /// albedo by channel, roughness, metallic unless it is known and, where normals are free, the two
    /// tangent offsets, (pixel, D); and Σ ω (I − T)² without the prior, (pixel).
    ///
    /// What is compared is Σ ω (I − T)² and the prior; it is summed up residual by residual unless
    /// `exact_steps` is 0, when it comes from products. Free normals move in those steps only.
    pub fn fit_materials(
        &self,
        x: &[f64],
        pixels: &[usize],
        search: &Search,
    ) -> Result<[Vec<f64>; 2]> {
        check::unit_interval("roughness", search.roughness)?;
        check::unit_interval("metallic", search.metallic)?;
        if let Some(prior) = &search.prior {
            let count = pixels.len() * (self.unknowns_of_pixel() - self.channels());
            check::length("mean", count, prior.mean.len())?;
            check::length("precision", count, prior.precision.len())?;
            check::moderate("mean", prior.mean, PRIOR_MAX)?;
            check::not_negative("precision", prior.precision, PRIOR_MAX)?;
        }
        let free = self.options.free_normals && !search.held_normals;
        by_kind!(self, free, M, C, D, U => fit::<M, C, D, U>(self, x, pixels, search))
    }
}

/// Models that pixels are fitted with.
trait Fits: AlbedoFromProducts + LeastSquaresFromProducts {}

impl<M: AlbedoFromProducts + LeastSquaresFromProducts> Fits for M {}

/// Largest mean and precision of a prior that are taken: the square of one times the other is finite.
pub(crate) const PRIOR_MAX: f64 = 1e100;

fn fit<M: Fits, const C: usize, const D: usize, const U: usize>(
    problem: &Problem,
    x: &[f64],
    pixels: &[usize],
    search: &Search,
) -> Result<[Vec<f64>; 2]> {
    let (maps, lights) = problem.at(x, pixels)?;
    let known = problem.options.metallic;
    let metallic = match &known {
        Some(metallic) => std::slice::from_ref(metallic),
        None => search.metallic,
    };
    let search = Search {
        metallic,
        ..*search
    };
    let rows = if problem.options.free_normals {
        free_unknowns::<C, FREE_DERIVATIVES>(problem)
    } else {
        free_unknowns::<C, DERIVATIVES>(problem)
    };
    fill_by_pixel(
        ("materials", problem.options.threads),
        pixels,
        pixels.len().div_ceil(PIECES * BLOCK).clamp(1, MAX_CHUNK),
        [rows.len(), 1],
        || Block::<M, C, D, U>::new(problem, &lights, &search, &rows),
        |block, first, pixels, [materials, sum_sq_residuals]| {
            let best = block.fit(maps, pixels, first);
            let planes: Vec<_> = best.materials.planes().chain(best.offsets).collect();
            for (x, material) in materials.chunks_mut(rows.len()).enumerate() {
                // Rounding may leave less than nothing of a sum of squares.
                sum_sq_residuals[x] = best.sum_sq_residuals.0[x].max(0.0);
                for (to, &row) in material.iter_mut().zip(&rows) {
                    *to = planes[row].0[x];
                }
            }
        },
    )
}

/// Up to [`BLOCK`] pixels.
struct Block<'a, M: Fits, const C: usize, const D: usize, const U: usize> {
    problem: &'a Problem,
    lights: &'a [[f64; COEFFICIENTS]],
    search: &'a Search<'a>,
    /// The unknowns of a pixel, as they are handed out.
    rows: &'a [usize],
    isa: Instructions,
    grid: material_grid::Block<'a, M>,
    form: Form<M>,
    /// A plane for each node.
    nodes: Vec<Doubles>,
    offsets: TangentOffsets,
    own: Box<Point<C, UNKNOWNS>>,
    best: Box<Point<C, UNKNOWNS>>,
    candidate: Box<Point<C, UNKNOWNS>>,
    trial: Box<Point<C, UNKNOWNS>>,
    steps: ResidualSteps<'a, M, C, D, U>,
}

/// The best of a block of pixels.
struct Best<'a, const C: usize> {
    materials: &'a Materials<C>,
    offsets: &'a TangentOffsets,
    sum_sq_residuals: &'a Doubles,
}

impl<'a, M: Fits, const C: usize, const D: usize, const U: usize> Block<'a, M, C, D, U> {
    fn new(
        problem: &'a Problem,
        lights: &'a [[f64; COEFFICIENTS]],
        search: &'a Search<'a>,
        rows: &'a [usize],
    ) -> Self {
        let nodes = search.roughness.len() * search.metallic.len();
        Self {
            problem,
            lights,
            search,
            rows,
            isa: problem.options.instructions,
            grid: material_grid::Block::new(problem),
            form: Form::new(problem.options.instructions),
            nodes: vec![Doubles::default(); if search.starts > 0 { nodes } else { 0 }],
            offsets: TangentOffsets::default(),
            own: Box::default(),
            best: Box::default(),
            candidate: Box::default(),
            trial: Box::default(),
            steps: ResidualSteps::new(problem, lights),
        }
    }

    /// The best of some pixels, the first of which is number `first` of all.
    fn fit(&mut self, maps: &[f64], pixels: &[usize], first: usize) -> Best<'_, C> {
        let (isa, search) = (self.isa, self.search);
        let prior = search
            .prior
            .map(|prior| planes(&prior, &self.rows[C..], C, first, pixels.len()));
        let prior = prior.as_ref();
        self.grid.load(maps, self.lights, pixels);
        self.offsets = self.problem.picked_offsets(maps, pixels);
        self.own.materials = Materials::default();
        let mut used = Doubles::default();
        for (x, &p) in pixels.iter().enumerate() {
            self.own.materials.set(x, &self.problem.material(maps, p));
            used.0[x] = 1.0;
        }
        let mut size = Doubles::default();
        for products in &self.grid.products.by_channel {
            for x in 0..BLOCK {
                size.0[x] += products.target_target().0[x];
            }
        }

        let mut products = FromProducts(&mut self.form, &self.grid.products);
        self.own.take(isa, &mut products, prior, false);
        *self.best = *self.own;
        *self.candidate = *self.own;
        self.descend(&used, &size, prior);
        for start in 0..search.starts {
            let Some(active) = self.start(start, prior, pixels.len()) else {
                break;
            };
            self.descend(&active, &size, prior);
        }
        if search.exact_steps > 0 {
            self.descend_on_residuals(maps, pixels, &used, &size, prior);
            let best = &self.steps.best;
            return Best {
                materials: &best.materials,
                offsets: if U > UNKNOWNS {
                    &best.offsets
                } else {
                    &self.offsets
                },
                sum_sq_residuals: &best.sums.sum_sq_residuals,
            };
        }
        Best {
            materials: &self.best.materials,
            offsets: &self.offsets,
            sum_sq_residuals: &self.best.sums.sum_sq_residuals,
        }
    }

    /// Descends from the candidate, on products, and keeps what is better than the best. Pixels that
    /// are not active have no candidate.
    fn descend(&mut self, active: &Doubles, size: &Doubles, prior: Option<&PriorPlanes>) {
        let isa = self.isa;
        for r in &mut self.candidate.materials.roughness.0 {
            *r = r.max(START_ROUGHNESS_MIN);
        }
        let mut products = FromProducts(&mut self.form, &self.grid.products);
        self.candidate.take(isa, &mut products, prior, false);
        let mut floor = Doubles::default();
        for x in 0..BLOCK {
            floor.0[x] = PRODUCTS_ROUNDING * size.0[x];
        }
        Descent {
            isa,
            prior,
            metallic_known: self.problem.options.metallic.is_some(),
            floor: &floor,
            damping: PRODUCTS_DAMPING,
            trial: &mut self.trial,
        }
        .run(
            &mut products,
            &mut self.candidate,
            *active,
            self.search.steps,
        );
        for x in 0..BLOCK {
            if active.0[x] == 0.0 {
                self.candidate.cost.0[x] = f64::INFINITY;
            }
        }
        self.best.keep_lower(isa, &self.candidate);
    }

    /// Makes the local minimum number `start` of the grid the candidate; 1 for the pixels that have
    /// so many, or None if none has.
    fn start(
        &mut self,
        start: usize,
        prior: Option<&PriorPlanes>,
        count: usize,
    ) -> Option<Doubles> {
        let Search {
            roughness,
            metallic,
            ..
        } = *self.search;
        if start == 0 && !self.nodes.is_empty() {
            self.grid
                .fill_grid::<NODE_NEWTON_STEPS>(roughness, metallic, &mut self.nodes);
            if let Some(prior) = prior {
                add_prior(prior, roughness, metallic, &mut self.nodes);
            }
        }
        if self.nodes.is_empty() {
            return None;
        }
        let mut active = Doubles::default();
        for x in 0..count {
            if let Some(node) = local_minimum(&self.nodes, metallic.len(), x, start) {
                active.0[x] = 1.0;
                self.grid.roughness.0[x] = roughness[node / metallic.len()];
                self.grid.metallic.0[x] = metallic[node % metallic.len()];
            }
        }
        if active.0.iter().all(|&a| a == 0.0) {
            return None;
        }
        self.grid.at_own_roughness();
        let materials = &mut self.candidate.materials;
        materials.roughness = self.grid.roughness;
        materials.metallic = self.grid.metallic;
        for (to, from) in materials.albedo.iter_mut().zip(&self.grid.albedo) {
            *to = *from;
        }
        Some(active)
    }

    /// The last steps, on residuals, from the best or the own material, whichever is better.
    fn descend_on_residuals(
        &mut self,
        maps: &[f64],
        pixels: &[usize],
        used: &Doubles,
        size: &Doubles,
        prior: Option<&PriorPlanes>,
    ) {
        // Where products tell for sure, no pass over the pictures is needed to tell.
        let mut unclear = Doubles::default();
        for x in 0..pixels.len() {
            let gained = self.own.cost.0[x] - self.best.cost.0[x];
            if gained <= PRODUCTS_CERTAIN * size.0[x] {
                unclear.0[x] = 1.0;
            }
        }
        self.steps.place(maps, pixels, &self.offsets);
        self.steps.run(
            [&self.own.materials, &self.best.materials],
            [used, &unclear],
            FromProducts(&mut self.form, &self.grid.products),
            prior,
            self.search.exact_steps,
        );
    }
}

/// The prior of `count` pixels from `first` on, at some unknowns of a pixel: those after its
/// `albedos`.
fn planes(
    prior: &GaussianPrior,
    unknowns: &[usize],
    albedos: usize,
    first: usize,
    count: usize,
) -> PriorPlanes {
    let mut planes = PriorPlanes::default();
    for (f, unknown) in unknowns.iter().enumerate() {
        for x in 0..count {
            let i = (first + x) * unknowns.len() + f;
            planes.mean[unknown - albedos].0[x] = prior.mean[i];
            planes.precision[unknown - albedos].0[x] = prior.precision[i];
        }
    }
    planes
}

fn add_prior(prior: &PriorPlanes, roughness: &[f64], metallic: &[f64], nodes: &mut [Doubles]) {
    for (node, plane) in nodes.iter_mut().enumerate() {
        let at = [
            roughness[node / metallic.len()],
            metallic[node % metallic.len()],
        ];
        for (f, value) in at.into_iter().enumerate() {
            for x in 0..BLOCK {
                let deviation = value - prior.mean[f].0[x];
                plane.0[x] += prior.precision[f].0[x] * deviation * deviation;
            }
        }
    }
}

/// Of a pixel's nodes that are lower than their eight neighbours, number `rank` from the lowest. Of
/// equal neighbours the first counts as the lower one.
fn local_minimum(nodes: &[Doubles], columns: usize, x: usize, rank: usize) -> Option<usize> {
    let order = |&a: &usize, &b: &usize| nodes[a].0[x].total_cmp(&nodes[b].0[x]);
    if rank == 0 {
        return (0..nodes.len()).min_by(order);
    }
    let rows = nodes.len() / columns.max(1);
    let is_minimum = |&node: &usize| {
        let (i, j) = (node / columns, node % columns);
        let value = nodes[node].0[x];
        let mut around = (i.saturating_sub(1)..rows.min(i + 2))
            .flat_map(|i| (j.saturating_sub(1)..columns.min(j + 2)).map(move |j| i * columns + j));
        around.all(|other| {
            let there = nodes[other].0[x];
            value < there || (value == there && node <= other)
        })
    };
    let mut minima: Vec<usize> = (0..nodes.len()).filter(is_minimum).collect();
    minima.sort_by(order);
    minima.get(rank).copied()
}
