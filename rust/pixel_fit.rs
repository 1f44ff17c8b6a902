//! The best material of each pixel when the lights are known.
//!
//! Pixels then have nothing to do with each other. A pixel's squares may have several minima, most
//! of them apart in roughness and metallic; so it descends from several starts, its own material
//! and the best nodes of a grid ([`material_grid`](crate::material_grid)), and keeps the lowest.
//!
//! Most of the way costs the same for any number of pictures. With D, S = Σ_l h_l B_l, S' = Σ_l h'_l
//! B_l and T as vectors over pictures,
//!
//! ```text
//! I     = a D + b S               a = kd, b = ks
//! ∂I/∂ρ = a_ρ D + b_ρ S           ∂I/∂m = a_m D + b_m S           ∂I/∂r = b_r S + b S'
//! ```
//!
//! so squares, gradient and Gauss–Newton matrix follow from ten products a channel, which are small
//! quadratic forms in h and h' of the [`products`](crate::products) ([`AddChannel`]). These forms
//! know squares to 10⁻¹⁵ of Σ ω T², that is residuals to half of the digits; the last steps
//! therefore take the residuals one by one, in passes over the pictures.
//!
//! Every pixel has its own damping, and once it is done it stays where it is: what it ends at does
//! not depend on the pixels beside it.

use crate::block::{BLOCK, BlockBands, Directions, FillBands, Materials, Plane};
use crate::descent::{Descent, Point, Pull, Squares};
use crate::ggx::Bands;
use crate::material_grid;
use crate::normal_matrix::{self, Sums};
use crate::problem::Problem;
use crate::products::{PixelProducts, Products};
use crate::sh::COEFFICIENTS;
use crate::shade::{Factors, Material};
use crate::simd::{Instructions, Isa, Kernel};
use crate::{Error, Result, check, pool};

/// Blocks of pixels in a piece of work at most: a piece has a cost of its own.
const MAX_CHUNK: usize = 8;
/// Pieces of work that are wanted, so that threads are busy to the end.
const PIECES: usize = 64;
/// Of Σ ω T²: a decrease that the products cannot tell from rounding.
const FORM_FLOOR: f64 = 1e-13;
/// Of Σ ω T²: a difference that the products can tell for sure.
const FORM_CLEAR: f64 = 1e-11;
/// Of the squares: a decrease that sums of squares cannot tell from rounding.
const EXACT_FLOOR: f64 = 1e-14;
/// Damping of the first step on products, and on residuals.
const FORM_DAMPING: f64 = 1e-3;
const EXACT_DAMPING: f64 = 1e-9;
/// Descents begin at least at this roughness: at 0 nothing depends on roughness, and they would
/// never leave it. A material of x below it is still kept if nothing better is found.
const LEAST_ROUGHNESS: f64 = 1e-3;

/// Of the best albedo of a node, which only has to be good enough to begin from.
const NEWTON_STEPS: usize = 2;

type Doubles = Plane<f64>;

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
    /// What materials are drawn to, beside the pictures.
    pub pull: Option<Towards<'a>>,
}

/// Adds Σ_f precision_f (v_f − centre_f)² to the squares of a pixel, for f = roughness and, unless
/// it is known, metallic.
#[derive(Clone, Copy, Debug)]
pub struct Towards<'a> {
    /// (pixel, f)
    pub centre: &'a [f64],
    /// (pixel, f)
    pub precision: &'a [f64],
}

/// Materials of D numbers: albedo by channel, roughness and, unless it is known, metallic.
#[derive(Clone, Debug)]
pub struct Fitted {
    /// (pixel, D)
    pub materials: Vec<f64>,
    /// Σ ω (I − T)², without the pull: (pixel).
    pub squares: Vec<f64>,
}

impl Problem {
    /// The best material of each of `pixels` with the lights of x, never worse than that of x.
    ///
    /// What is compared is Σ ω (I − T)² and the pull; it is summed up residual by residual unless
    /// `exact_steps` is 0, when it comes from products.
    pub fn fit_materials(&self, x: &[f64], pixels: &[usize], search: &Search) -> Result<Fitted> {
        check::unit_interval("roughness", search.roughness)?;
        check::unit_interval("metallic", search.metallic)?;
        if let Some(pull) = &search.pull {
            let count = pixels.len() * (self.unknowns_of_material() - self.channels());
            check::length("centre", count, pull.centre.len())?;
            check::length("precision", count, pull.precision.len())?;
            check::moderate("centre", pull.centre, LARGEST_PULL)?;
            check::moderate("precision", pull.precision, LARGEST_PULL)?;
            check::not_negative("precision", pull.precision)?;
        }
        match self.channels() {
            1 => fit::<1>(self, x, pixels, search),
            _ => fit::<3>(self, x, pixels, search),
        }
    }
}

/// Centres and precisions at most.
const LARGEST_PULL: f64 = 1e100;

fn fit<const C: usize>(
    problem: &Problem,
    x: &[f64],
    pixels: &[usize],
    search: &Search,
) -> Result<Fitted> {
    let (maps, lights) = problem.at(x, pixels)?;
    let known = problem.known_metallic();
    let metallic = match &known {
        Some(metallic) => std::slice::from_ref(metallic),
        None => search.metallic,
    };
    let search = Search {
        metallic,
        ..*search
    };
    let unknowns = problem.unknowns_of_pixel();
    let mut fitted = Fitted {
        materials: zeros(pixels.len() * unknowns)?,
        squares: zeros(pixels.len())?,
    };
    let size = (pixels.len().div_ceil(PIECES * BLOCK)).clamp(1, MAX_CHUNK) * BLOCK;
    let pieces = pixels
        .chunks(size)
        .zip(fitted.materials.chunks_mut(size * unknowns))
        .zip(fitted.squares.chunks_mut(size))
        .enumerate()
        .collect();
    pool::map(
        problem.threads(),
        pieces,
        |(piece, ((pixels, materials), squares))| {
            let mut block = Block::<C>::new(problem, &lights, &search);
            for (i, pixels) in pixels.chunks(BLOCK).enumerate() {
                let best = block.fit(maps, pixels, piece * size + i * BLOCK);
                for x in 0..pixels.len() {
                    let p = i * BLOCK + x;
                    // Rounding may leave less than nothing of a sum of squares.
                    squares[p] = best.sums.squares.0[x].max(0.0);
                    let to = &mut materials[p * unknowns..][..unknowns];
                    for (to, from) in to.iter_mut().zip(best.materials.planes()) {
                        *to = from.0[x];
                    }
                }
            }
        },
    );
    Ok(fitted)
}

fn zeros(count: usize) -> Result<Vec<f64>> {
    let mut numbers = Vec::new();
    numbers
        .try_reserve_exact(count)
        .map_err(|_| Error::Memory("materials"))?;
    numbers.resize(count, 0.0);
    Ok(numbers)
}

/// Up to [`BLOCK`] pixels.
struct Block<'a, const C: usize> {
    problem: &'a Problem,
    lights: &'a [[f64; COEFFICIENTS]],
    search: &'a Search<'a>,
    isa: Instructions,
    grid: material_grid::Block<'a>,
    /// A plane for each node.
    nodes: Vec<Doubles>,
    samples: normal_matrix::Block<'a, C>,
    own: Box<Point<C>>,
    best: Box<Point<C>>,
    candidate: Box<Point<C>>,
    trial: Box<Point<C>>,
}

impl<'a, const C: usize> Block<'a, C> {
    fn new(
        problem: &'a Problem,
        lights: &'a [[f64; COEFFICIENTS]],
        search: &'a Search<'a>,
    ) -> Self {
        let nodes = search.roughness.len() * search.metallic.len();
        Self {
            problem,
            lights,
            search,
            isa: problem.instructions(),
            grid: material_grid::Block::new(problem),
            nodes: vec![Doubles::default(); if search.starts > 0 { nodes } else { 0 }],
            samples: normal_matrix::Block::new(problem),
            own: Box::default(),
            best: Box::default(),
            candidate: Box::default(),
            trial: Box::default(),
        }
    }

    /// The best materials of some pixels, the first of which is number `first` of all.
    fn fit(&mut self, maps: &[f64], pixels: &[usize], first: usize) -> &Point<C> {
        let (isa, search) = (self.isa, self.search);
        let factors = self.problem.unknowns_of_material() - C;
        let pull = search
            .pull
            .map(|pull| planes(&pull, factors, first, pixels.len()));
        let pull = pull.as_ref();
        self.grid.load(maps, self.lights, pixels);
        self.own.materials = Materials::default();
        let mut used = Doubles::default();
        for (x, &p) in pixels.iter().enumerate() {
            self.own.materials.set(x, &self.problem.material(maps, p));
            used.0[x] = 1.0;
        }
        let mut size = Doubles::default();
        for products in &self.grid.products.by_channel {
            for x in 0..BLOCK {
                size.0[x] += products.target_target.0[x];
            }
        }

        self.own
            .take(isa, &mut Form::new(isa, &self.grid.products), pull);
        self.best.clone_from(&self.own);
        self.candidate.clone_from(&self.own);
        self.descend(&used, &size, pull);
        for start in 0..search.starts {
            let Some(active) = self.start(start, pull, pixels.len()) else {
                break;
            };
            self.descend(&active, &size, pull);
        }
        if search.exact_steps > 0 {
            self.finish(maps, pixels, &used, &size, pull);
        }
        &self.best
    }

    /// Descends from the candidate, on products, and keeps what is better than the best. Pixels that
    /// are not active have no candidate.
    fn descend(&mut self, active: &Doubles, size: &Doubles, pull: Option<&Pull>) {
        let isa = self.isa;
        for r in &mut self.candidate.materials.roughness.0 {
            *r = r.max(LEAST_ROUGHNESS);
        }
        let mut form = Form::new(isa, &self.grid.products);
        self.candidate.take(isa, &mut form, pull);
        let mut floor = Doubles::default();
        for x in 0..BLOCK {
            floor.0[x] = FORM_FLOOR * size.0[x];
        }
        Descent {
            isa,
            pull,
            metallic_known: self.problem.known_metallic().is_some(),
            floor: &floor,
            damping: FORM_DAMPING,
            trial: &mut self.trial,
        }
        .run(&mut form, &mut self.candidate, *active, self.search.steps);
        for x in 0..BLOCK {
            if active.0[x] == 0.0 {
                self.candidate.cost.0[x] = f64::INFINITY;
            }
        }
        self.best.keep_lower(isa, &self.candidate);
    }

    /// Makes the local minimum number `start` of the grid the candidate; 1 for the pixels that have
    /// so many, or None if none has.
    fn start(&mut self, start: usize, pull: Option<&Pull>, count: usize) -> Option<Doubles> {
        let Search {
            roughness,
            metallic,
            starts,
            ..
        } = *self.search;
        if start == 0 && !self.nodes.is_empty() {
            self.grid
                .fill_grid::<NEWTON_STEPS>(roughness, metallic, &mut self.nodes);
            if let Some(pull) = pull {
                add_pull(pull, roughness, metallic, &mut self.nodes);
            }
        }
        if self.nodes.is_empty() {
            return None;
        }
        let lowest = self.isa.run(Lowest { nodes: &self.nodes });
        let mut active = Doubles::default();
        for x in 0..count {
            let node = if starts == 1 {
                Some(lowest.0[x] as usize)
            } else {
                local_minimum(&self.nodes, metallic.len(), x, start)
            };
            if let Some(node) = node {
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
    fn finish(
        &mut self,
        maps: &[f64],
        pixels: &[usize],
        used: &Doubles,
        size: &Doubles,
        pull: Option<&Pull>,
    ) {
        let isa = self.isa;
        // Where products tell for sure, no pass over the pictures is needed to tell.
        let mut unclear = false;
        for x in 0..pixels.len() {
            let gained = self.own.cost.0[x] - self.best.cost.0[x];
            if gained <= FORM_CLEAR * size.0[x] {
                unclear = true;
            } else {
                self.own.cost.0[x] = f64::INFINITY;
            }
        }
        self.samples.place(maps, pixels);
        let mut exact = Exact {
            lights: self.lights,
            block: &mut self.samples,
        };
        self.best.take(isa, &mut exact, pull);
        if unclear {
            let clear = self.own.cost;
            self.own.take(isa, &mut exact, pull);
            for x in 0..BLOCK {
                if clear.0[x] == f64::INFINITY {
                    self.own.cost.0[x] = f64::INFINITY;
                }
            }
            self.best.keep_lower(isa, &self.own);
        }
        let mut floor = Doubles::default();
        for x in 0..BLOCK {
            floor.0[x] = EXACT_FLOOR * self.best.cost.0[x];
        }
        Descent {
            isa,
            pull,
            metallic_known: self.problem.known_metallic().is_some(),
            floor: &floor,
            damping: EXACT_DAMPING,
            trial: &mut self.trial,
        }
        .run(&mut exact, &mut self.best, *used, self.search.exact_steps);
    }
}

/// The pull of `count` pixels from `first` on, with `factors` of them a pixel.
fn planes(pull: &Towards, factors: usize, first: usize, count: usize) -> Pull {
    let mut planes = Pull::default();
    for f in 0..factors {
        for x in 0..count {
            let i = (first + x) * factors + f;
            planes.centre[f].0[x] = pull.centre[i];
            planes.precision[f].0[x] = pull.precision[i];
        }
    }
    planes
}

fn add_pull(pull: &Pull, roughness: &[f64], metallic: &[f64], nodes: &mut [Doubles]) {
    for (node, plane) in nodes.iter_mut().enumerate() {
        let at = [
            roughness[node / metallic.len()],
            metallic[node % metallic.len()],
        ];
        for (f, value) in at.into_iter().enumerate() {
            for x in 0..BLOCK {
                let offset = value - pull.centre[f].0[x];
                plane.0[x] += pull.precision[f].0[x] * offset * offset;
            }
        }
    }
}

/// The lowest node of each pixel, the first of equals.
struct Lowest<'a> {
    nodes: &'a [Doubles],
}

impl Kernel for Lowest<'_> {
    type Output = Doubles;

    #[inline(always)]
    fn run<I: Isa>(self, _: I) -> Doubles {
        let (mut least, mut lowest) = (self.nodes[0], Doubles::default());
        for (i, node) in self.nodes.iter().enumerate() {
            for x in 0..BLOCK {
                let lower = node.0[x] < least.0[x];
                lowest.0[x] = if lower { i as f64 } else { lowest.0[x] };
                least.0[x] = if lower { node.0[x] } else { least.0[x] };
            }
        }
        lowest
    }
}

/// Of a pixel's nodes that are lower than their eight neighbours, number `rank` from the lowest. Of
/// equal neighbours the first counts as the lower one.
fn local_minimum(nodes: &[Doubles], columns: usize, x: usize, rank: usize) -> Option<usize> {
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
    minima.sort_by(|&a, &b| nodes[a].0[x].total_cmp(&nodes[b].0[x]));
    minima.get(rank).copied()
}

/// Squares from products.
struct Form<'a> {
    isa: Instructions,
    products: &'a PixelProducts,
    bands: BlockBands,
}

impl<'a> Form<'a> {
    fn new(isa: Instructions, products: &'a PixelProducts) -> Self {
        Self {
            isa,
            products,
            bands: BlockBands::default(),
        }
    }
}

impl<const C: usize> Squares<C> for Form<'_> {
    fn take(&mut self, materials: &Materials<C>, sums: &mut Sums) {
        self.isa.run(FillBands {
            roughness: &materials.roughness,
            bands: &mut self.bands,
        });
        *sums = Sums::default();
        for c in 0..C {
            self.isa.run(AddChannel {
                directions: &self.products.directions,
                products: &self.products.by_channel[c],
                bands: &self.bands,
                materials,
                channel: c,
                sums,
            });
        }
    }
}

/// Squares from residuals.
struct Exact<'a, 'b, const C: usize> {
    lights: &'a [[f64; COEFFICIENTS]],
    block: &'a mut normal_matrix::Block<'b, C>,
}

impl<const C: usize> Squares<C> for Exact<'_, '_, C> {
    fn take(&mut self, materials: &Materials<C>, sums: &mut Sums) {
        *sums = Sums::default();
        self.block.take(materials);
        self.block.add_samples(self.lights, sums);
    }
}

/// Adds one channel's squares, gradient and matrix, from its products.
struct AddChannel<'a, const C: usize> {
    directions: &'a Directions<f64>,
    products: &'a Products,
    bands: &'a BlockBands,
    materials: &'a Materials<C>,
    channel: usize,
    sums: &'a mut Sums,
}

/// Products of S and S' at the roughness of each pixel.
#[derive(Default)]
struct AtRoughness {
    ss: Doubles,
    sp: Doubles,
    pp: Doubles,
    ds: Doubles,
    dp: Doubles,
    st: Doubles,
    pt: Doubles,
}

impl<const C: usize> Kernel for AddChannel<'_, C> {
    type Output = ();

    #[inline(always)]
    fn run<I: Isa>(self, _: I) {
        let Self {
            directions,
            products,
            bands,
            materials,
            channel,
            sums,
        } = self;
        let mut at = AtRoughness::default();
        for x in 0..BLOCK {
            let (mut h, mut slope) = ([0.0; 4], [0.0; 4]);
            for l in 0..4 {
                h[l] = bands[l].0[x];
                slope[l] = bands[4 + l].0[x];
            }
            for l in 0..4 {
                // Row l of the products of bands, times h and h'.
                let (mut by_h, mut by_slope) = (0.0, 0.0);
                for j in 0..4 {
                    let (low, high) = if j < l { (j, l) } else { (l, j) };
                    let product = products.band_band[high * (high + 1) / 2 + low].0[x];
                    by_h += product * h[j];
                    by_slope += product * slope[j];
                }
                at.ss.0[x] += h[l] * by_h;
                at.sp.0[x] += slope[l] * by_h;
                at.pp.0[x] += slope[l] * by_slope;
                at.ds.0[x] += h[l] * products.diffuse_band[l].0[x];
                at.dp.0[x] += slope[l] * products.diffuse_band[l].0[x];
                at.st.0[x] += h[l] * products.band_target[l].0[x];
                at.pt.0[x] += slope[l] * products.band_target[l].0[x];
            }
        }
        let (r, m) = (C, C + 1);
        for x in 0..BLOCK {
            let material = Material {
                albedo: [materials.albedo[channel].0[x]],
                roughness: materials.roughness.0[x],
                metallic: materials.metallic.0[x],
            };
            // S in the place of band 0, its weight 1 whatever the roughness: then the derivatives
            // by roughness are those of b, and S' comes by hand.
            let whole = Bands {
                weight: [1.0, 0.0, 0.0, 0.0],
                slope: [0.0; 4],
            };
            let factors = Factors::new(directions.cosine(x), &material, whole);
            let (a, b) = (factors.diffuse[0], factors.specular[0]);
            let of_a = factors.pull_back(&material, &[1.0], &[[0.0; 4]]);
            let of_b = factors.pull_back(&material, &[0.0], &[[1.0, 0.0, 0.0, 0.0]]);
            let (a_rho, a_m) = (of_a.albedo[0], of_a.metallic);
            let (b_rho, b_m, b_r) = (of_b.albedo[0], of_b.metallic, of_b.roughness);
            let dd = products.diffuse_diffuse.0[x];
            let dt = products.diffuse_target.0[x];
            let (ds, ss, st) = (at.ds.0[x], at.ss.0[x], at.st.0[x]);
            let (dp, sp, pp, pt) = (at.dp.0[x], at.sp.0[x], at.pp.0[x], at.pt.0[x]);
            // The residual e = a D + b S − T with D, S and S'.
            let ed = a * dd + b * ds - dt;
            let es = a * ds + b * ss - st;
            let ep = a * dp + b * sp - pt;
            sums.squares.0[x] += a * (ed - dt) + b * (es - st) + products.target_target.0[x];
            sums.gradient[channel].0[x] += a_rho * ed + b_rho * es;
            sums.gradient[r].0[x] += b_r * es + b * ep;
            sums.gradient[m].0[x] += a_m * ed + b_m * es;
            // ∂I/∂ρ, ∂I/∂m and ∂I/∂r with D, S and S', as far as they are needed.
            let (rho_d, rho_s) = (a_rho * dd + b_rho * ds, a_rho * ds + b_rho * ss);
            let (m_d, m_s) = (a_m * dd + b_m * ds, a_m * ds + b_m * ss);
            let (rho_p, m_p) = (a_rho * dp + b_rho * sp, a_m * dp + b_m * sp);
            sums.matrix[channel][channel].0[x] += a_rho * rho_d + b_rho * rho_s;
            sums.matrix[m][channel].0[x] += a_m * rho_d + b_m * rho_s;
            sums.matrix[m][m].0[x] += a_m * m_d + b_m * m_s;
            sums.matrix[r][channel].0[x] += b_r * rho_s + b * rho_p;
            sums.matrix[m][r].0[x] += b_r * m_s + b * m_p;
            sums.matrix[r][r].0[x] += b_r * (b_r * ss + 2.0 * b * sp) + b * b * pp;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn local_minima_come_from_the_lowest_and_equals_count_once() {
        let values = [
            [3.0, 2.0, 2.0, 9.0],
            [3.0, 5.0, 5.0, 9.0],
            [9.0, 9.0, 9.0, 9.0],
            [1.0, 9.0, 9.0, 4.0],
        ];
        let nodes: Vec<Doubles> = values
            .as_flattened()
            .iter()
            .map(|&v| Plane([v; BLOCK]))
            .collect();
        let found: Vec<_> = (0..5)
            .map(|rank| local_minimum(&nodes, 4, 3, rank))
            .collect();
        assert_eq!(found, [Some(12), Some(1), Some(15), None, None]);
        let lowest = Instructions::best().run(Lowest { nodes: &nodes });
        assert_eq!(lowest.0, [12.0; BLOCK]);
        let lowest = Instructions::best().run(Lowest {
            nodes: &nodes[..12],
        });
        assert_eq!(lowest.0, [1.0; BLOCK]);
    }
}
