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
use crate::problem::by_pixel::fill_by_pixel;
use crate::reflectance::model::with_model_of;
use crate::reflectance::planes::{BLOCK, Doubles, Plane, no_functions};
use crate::reflectance::reflection::{ExactFunctions, Reflection};
use crate::reflectance::sh::COEFFICIENTS;
use crate::runtime::simd::{Instructions, Isa, Kernel, vectorized};
use crate::runtime::{Result, check};

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

    /// Takes up one channel; always inlined, as [`minimize`](Self::minimize) is.
    fn set_channel(at: Given<'_, Self>, at_roughness: &mut Self::AtRoughness);

    /// The albedo of each channel with the least χ², which is added to the sum of squares. It is
    /// looked for in float32, by `STEPS` of Newton's method, because an error of it counts by its
    /// square; then by `EXACT` more in float64. χ² is float64.
    fn minimize<I: Isa, const STEPS: usize, const EXACT: usize>(
        by_albedo: ByAlbedo<'_, Self::AtRoughness>,
    );
}

/// [`AlbedoFromProducts::minimize`]
struct Minimize<'a, M: AlbedoFromProducts, const STEPS: usize, const EXACT: usize>(
    ByAlbedo<'a, M::AtRoughness>,
);

impl<M: AlbedoFromProducts, const STEPS: usize, const EXACT: usize> Kernel
    for Minimize<'_, M, STEPS, EXACT>
{
    type Output = ();

    #[inline(always)]
    fn run<I: Isa>(self, _: I) {
        M::minimize::<I, STEPS, EXACT>(self.0);
    }
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
    /// lights of x, (pixel, channel); and Σ ω (I − T)² with it, (pixel).
    pub fn best_albedo(&self, x: &[f64], pixels: &[usize]) -> Result<[Vec<f64>; 2]> {
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
    if nodes == 0 {
        return Ok(Vec::new());
    }
    let [grid] = fill_by_pixel(
        ("material grid", problem.options.threads),
        pixels,
        CHUNK,
        [nodes],
        || (Block::<M>::new(problem), vec![Doubles::default(); nodes]),
        |(block, planes), _, pixels, [grid]: [&mut [f32]; 1]| {
            block.load(maps, &lights, pixels);
            block.fill_grid::<NEWTON_STEPS>(roughness, metallic, planes);
            for (i, planes) in planes.chunks(NODES_AT_ONCE).enumerate() {
                for (x, of_pixel) in grid.chunks_mut(nodes).enumerate() {
                    let there = &mut of_pixel[i * NODES_AT_ONCE..][..planes.len()];
                    for (to, plane) in there.iter_mut().zip(planes) {
                        *to = plane.0[x] as f32;
                    }
                }
            }
        },
    )?;
    Ok(grid)
}

fn best_albedo<M: AlbedoFromProducts>(
    problem: &Problem,
    x: &[f64],
    pixels: &[usize],
) -> Result<[Vec<f64>; 2]> {
    let (maps, lights) = problem.at(x, pixels)?;
    fill_by_pixel(
        ("albedo", problem.options.threads),
        pixels,
        CHUNK,
        [problem.channels(), 1],
        || Block::<M>::new(problem),
        |block, _, pixels, [albedo, sum_sq_residuals]| {
            block.load(maps, &lights, pixels);
            for (x, &p) in pixels.iter().enumerate() {
                (block.roughness.0[x], block.metallic.0[x]) =
                    problem.roughness_and_metallic(maps, p);
            }
            block.at_own_roughness();
            sum_sq_residuals.copy_from_slice(&block.sum_sq_residuals.0[..pixels.len()]);
            for (x, albedo) in albedo.chunks_mut(block.albedo.len()).enumerate() {
                for (to, plane) in albedo.iter_mut().zip(&block.albedo) {
                    *to = plane.0[x];
                }
            }
        },
    )
}

/// Up to [`BLOCK`] pixels and what is known of them.
pub(crate) struct Block<'a, M: AlbedoFromProducts> {
    problem: &'a Problem,
    isa: Instructions,
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
            isa: problem.options.instructions,
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
            let cosine = self.products.directions.cosines();
            M::fill_shared(self.isa, cosine, r, &mut self.functions);
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
            cosine: self.products.directions.cosines(),
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
                cosine: self.products.directions.cosines(),
                roughness: &self.roughness,
                functions: &self.functions,
            };
            vectorized!(self.isa, M::set_channel(given, to));
        }
    }

    fn minimize<const STEPS: usize, const EXACT: usize>(&mut self) {
        self.sum_sq_residuals = Doubles::default();
        self.isa.run(Minimize::<M, STEPS, EXACT>(ByAlbedo {
            products: &self.products.by_channel,
            at_roughness: &mut self.at_roughness,
            metallic: &self.metallic,
            albedo: &mut self.albedo,
            sum_sq_residuals: &mut self.sum_sq_residuals,
        }));
    }
}
