//! How well materials explain a pixel when the lights are known, with its albedo put out of the way.
//!
//! With the lights known, roughness and metallic given, the channels of a pixel have nothing to do
//! with each other, and each has one unknown, its albedo ρ, of which χ² = Σ_i ω_i (I_i − T_i)² is a
//! smooth function whose coefficients come from [`products`](super::products) over pictures. Given
//! these, roughness costs a quadratic form, metallic and albedo a handful of operations. What these
//! are is the model's own ([`AlbedoFromProducts`]).

use crate::block::factors::FillFunctions;
use crate::pixel::products::{PixelProducts, Products};
use crate::problem::Problem;
use crate::reflectance::model::with_model_of;
use crate::reflectance::planes::{BLOCK, Doubles, Plane, no_functions};
use crate::reflectance::reflection::{ExactFunctions, Reflection};
use crate::reflectance::sh::COEFFICIENTS;
use crate::runtime::memory::zeros;
use crate::runtime::simd::Instructions;
use crate::runtime::{Result, check, pool};

mod paper;
mod principled;

/// Newton steps to the best albedo in float32, from the best of [`STARTS`].
const NEWTON_STEPS: usize = 4;
/// Newton steps in float64 after them, where the albedo itself is asked for.
const EXACT_STEPS: usize = 2;
/// Albedos that Newton's method may start from; the lowest does, as χ² may have two minima.
pub(crate) const STARTS: [f32; 5] = [0.0, 0.25, 0.5, 0.75, 1.0];
/// Nodes that are put beside each other at once, a line of the cache.
const NODES_AT_ONCE: usize = 16;
/// Blocks of pixels in a piece of work.
const CHUNK: usize = 2;

/// Models whose best albedo comes from products.
pub(crate) trait AlbedoFromProducts: Reflection {
    /// What is left of products and functions of a channel when roughness is given.
    type AtRoughness: Clone + Default + Send;

    /// Fills in the functions of a roughness that all pixels of a block share.
    fn fill_shared(
        isa: Instructions,
        cosine: &Doubles,
        roughness: f64,
        functions: &mut ExactFunctions<Self>,
    ) {
        isa.run(FillFunctions::<Self> {
            cosine,
            roughness: &Plane([roughness; BLOCK]),
            by_cosine: false,
            functions,
        });
    }

    /// Takes up one channel.
    fn set_channel(isa: Instructions, at: Given<'_, Self>, at_roughness: &mut Self::AtRoughness);

    /// The albedo of each channel with the least χ², which is added to the sum of squares. It is
    /// looked for in float32, by `STEPS` of Newton's method, because an error of it counts by its
    /// square; then by `EXACT` more in float64. χ² is float64.
    fn minimize<const STEPS: usize, const EXACT: usize>(
        isa: Instructions,
        by_albedo: ByAlbedo<'_, Self::AtRoughness>,
    );
}

/// What a channel is taken up from.
pub(crate) struct Given<'a, M: Reflection> {
    pub(crate) products: &'a Products,
    pub(crate) cosine: &'a Doubles,
    pub(crate) roughness: &'a Doubles,
    pub(crate) functions: &'a ExactFunctions<M>,
}

/// What the best albedo is looked for with, by channel.
pub(crate) struct ByAlbedo<'a, G> {
    pub(crate) products: &'a [Products],
    /// Room for what is made of them, too.
    pub(crate) at_roughness: &'a mut [G],
    pub(crate) metallic: &'a Doubles,
    /// To be written.
    pub(crate) albedo: &'a mut [Doubles],
    /// Added to.
    pub(crate) sum_sq_residuals: &'a mut Doubles,
}

/// Best albedo of each pixel, and Σ ω (I − T)² with it.
#[derive(Clone, Debug)]
pub struct BestAlbedo {
    /// (pixel, channel)
    pub albedo: Vec<f64>,
    /// (pixel)
    pub sum_sq_residuals: Vec<f64>,
}

impl Problem {
    /// Least Σ ω (I − T)² over albedo for every combination of roughness and metallic, with the
    /// lights of x, in float32: (pixel of `pixels`, roughness, metallic).
    pub fn material_grid(
        &self,
        x: &[f64],
        pixels: &[usize],
        roughness: &[f64],
        metallic: &[f64],
    ) -> Result<Vec<f32>> {
        check::unit_interval("roughness", roughness)?;
        check::unit_interval("metallic", metallic)?;
        let nodes = [roughness, metallic];
        with_model_of!(self, M => material_grid::<M>(self, x, pixels, nodes))
    }

    /// The albedo that explains each of `pixels` best with the roughness and metallic of x, and the
    /// lights of x.
    pub fn best_albedo(&self, x: &[f64], pixels: &[usize]) -> Result<BestAlbedo> {
        with_model_of!(self, M => best_albedo::<M>(self, x, pixels))
    }
}

fn material_grid<M: AlbedoFromProducts>(
    problem: &Problem,
    x: &[f64],
    pixels: &[usize],
    [roughness, metallic]: [&[f64]; 2],
) -> Result<Vec<f32>> {
    let (maps, lights) = problem.at(x, pixels)?;
    let nodes = roughness.len() * metallic.len();
    let mut grid: Vec<f32> = zeros("material grid", pixels.len() * nodes)?;
    if grid.is_empty() {
        return Ok(grid);
    }
    let pieces = pixels
        .chunks(CHUNK * BLOCK)
        .zip(grid.chunks_mut(CHUNK * BLOCK * nodes))
        .collect();
    pool::map(problem.threads(), pieces, |(pixels, grid)| {
        let mut block = Block::<M>::new(problem);
        let mut planes = vec![Doubles::default(); nodes];
        for (pixels, grid) in pixels.chunks(BLOCK).zip(grid.chunks_mut(BLOCK * nodes)) {
            block.load(maps, &lights, pixels);
            block.fill_grid::<NEWTON_STEPS>(roughness, metallic, &mut planes);
            for (i, planes) in planes.chunks(NODES_AT_ONCE).enumerate() {
                for (x, of_pixel) in grid.chunks_mut(nodes).enumerate() {
                    let there = &mut of_pixel[i * NODES_AT_ONCE..][..planes.len()];
                    for (to, plane) in there.iter_mut().zip(planes) {
                        *to = plane.0[x] as f32;
                    }
                }
            }
        }
    });
    Ok(grid)
}

fn best_albedo<M: AlbedoFromProducts>(
    problem: &Problem,
    x: &[f64],
    pixels: &[usize],
) -> Result<BestAlbedo> {
    let (maps, lights) = problem.at(x, pixels)?;
    let parts = pool::map(
        problem.threads(),
        pixels.chunks(CHUNK * BLOCK).collect(),
        |pixels: &[usize]| {
            let mut block = Block::<M>::new(problem);
            let (mut albedo, mut sum_sq_residuals) = (Vec::new(), Vec::new());
            for pixels in pixels.chunks(BLOCK) {
                block.load(maps, &lights, pixels);
                for (x, &p) in pixels.iter().enumerate() {
                    (block.roughness.0[x], block.metallic.0[x]) =
                        problem.roughness_and_metallic(maps, p);
                }
                block.at_own_roughness();
                for x in 0..pixels.len() {
                    albedo.extend(block.albedo.iter().map(|plane| plane.0[x]));
                    sum_sq_residuals.push(block.sum_sq_residuals.0[x]);
                }
            }
            (albedo, sum_sq_residuals)
        },
    );
    let (albedo, sum_sq_residuals): (Vec<_>, Vec<_>) = parts.into_iter().unzip();
    Ok(BestAlbedo {
        albedo: albedo.concat(),
        sum_sq_residuals: sum_sq_residuals.concat(),
    })
}

/// Up to [`BLOCK`] pixels and what is known of them.
pub(crate) struct Block<'a, M: AlbedoFromProducts> {
    problem: &'a Problem,
    isa: Instructions,
    /// n·v
    cosine: Doubles,
    pub(crate) products: PixelProducts,
    functions: Box<ExactFunctions<M>>,
    /// By channel.
    at_roughness: Vec<M::AtRoughness>,
    pub(crate) roughness: Doubles,
    pub(crate) metallic: Doubles,
    /// By channel.
    pub(crate) albedo: Vec<Doubles>,
    sum_sq_residuals: Doubles,
}

impl<'a, M: AlbedoFromProducts> Block<'a, M> {
    pub(crate) fn new(problem: &'a Problem) -> Self {
        Self {
            problem,
            isa: problem.instructions(),
            cosine: Plane([1.0; BLOCK]),
            products: PixelProducts::new(problem.channels()),
            functions: no_functions(),
            at_roughness: vec![M::AtRoughness::default(); problem.channels()],
            roughness: Doubles::default(),
            metallic: Doubles::default(),
            albedo: vec![Doubles::default(); problem.channels()],
            sum_sq_residuals: Doubles::default(),
        }
    }

    /// Takes up pixels, with the normals of `maps`, and sums their products over pictures.
    pub(crate) fn load(&mut self, maps: &[f64], lights: &[[f64; COEFFICIENTS]], pixels: &[usize]) {
        self.products.load::<M>(self.problem, maps, lights, pixels);
        self.cosine = *self.products.directions.cosines();
    }

    /// χ² at every node of the grid: a plane for each, (roughness, metallic). `STEPS` of Newton's
    /// method find the albedos.
    pub(crate) fn fill_grid<const STEPS: usize>(
        &mut self,
        roughness: &[f64],
        metallic: &[f64],
        nodes: &mut [Doubles],
    ) {
        for (&r, of_roughness) in roughness.iter().zip(nodes.chunks_mut(metallic.len())) {
            M::fill_shared(self.isa, &self.cosine, r, &mut self.functions);
            self.roughness.0.fill(r);
            self.set_channels();
            for (sum, &m) in of_roughness.iter_mut().zip(metallic) {
                self.metallic.0.fill(m);
                self.minimize::<STEPS, 0>();
                *sum = self.sum_sq_residuals;
            }
        }
    }

    /// Best albedo and χ² at the roughness and metallic that each pixel has.
    pub(crate) fn at_own_roughness(&mut self) {
        self.isa.run(FillFunctions::<M> {
            cosine: &self.cosine,
            roughness: &self.roughness,
            by_cosine: false,
            functions: &mut self.functions,
        });
        self.set_channels();
        self.minimize::<NEWTON_STEPS, EXACT_STEPS>();
    }

    fn set_channels(&mut self) {
        for (products, to) in self.products.by_channel.iter().zip(&mut self.at_roughness) {
            let given = Given {
                products,
                cosine: &self.cosine,
                roughness: &self.roughness,
                functions: &self.functions,
            };
            M::set_channel(self.isa, given, to);
        }
    }

    fn minimize<const STEPS: usize, const EXACT: usize>(&mut self) {
        self.sum_sq_residuals = Doubles::default();
        M::minimize::<STEPS, EXACT>(
            self.isa,
            ByAlbedo {
                products: &self.products.by_channel,
                at_roughness: &mut self.at_roughness,
                metallic: &self.metallic,
                albedo: &mut self.albedo,
                sum_sq_residuals: &mut self.sum_sq_residuals,
            },
        );
    }
}
