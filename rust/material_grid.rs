//! How well materials explain a pixel when the lights are known, with its albedo put out of the way.
//!
//! With the lights known, roughness and metallic given, the channels of a pixel have nothing to do
//! with each other, and each has one unknown, its albedo ρ. Over pictures i,
//!
//! ```text
//! I_i = a D_i + b S_i        a = kd(ρ) = (1−F)(1−m)ρ/π       b = ks(ρ)/h = F G₁/4
//! D_i = Σ_k A_l Y_k(n) L_ik          S_i = Σ_l h_l(r) B_li          B_li = Σ_{k in l} Y_k(mirror) L_ik
//! F   = f₀ + f₁ρ             f₀ = s + (1−s) 0.04(1−m)        f₁ = (1−s) m       s = (1−n·v)⁵
//! ```
//!
//! so that χ² = Σ_i ω_i (I_i − T_i)² is a polynomial of degree 4 in ρ, whose coefficients come from
//! the [`products`](crate::products) of the six vectors D, B₀ to B₃ and T over pictures. Given
//! these, roughness costs a small quadratic form, metallic and albedo a handful of operations.

use std::f64::consts::FRAC_1_PI;

use crate::block::{BLOCK, BlockBands, FillBands, Plane};
use crate::ggx::{self, DIELECTRIC_F0};
use crate::problem::Problem;
use crate::products::{PixelProducts, Products, Specular, TakeRoughness};
use crate::sh::COEFFICIENTS;
use crate::simd::{Instructions, Isa, Kernel};
use crate::{Error, Result, check, pool};

/// Steps of Newton's method for the best albedo. From the best of [`STARTS`] three reach 1e-9.
const NEWTON_STEPS: usize = 4;
/// Albedos to start from: the polynomial may have two minima.
const STARTS: [f64; 5] = [0.0, 0.25, 0.5, 0.75, 1.0];
/// Blocks of pixels in a piece of work.
const CHUNK: usize = 2;

type Doubles = Plane<f64>;

/// Best albedo of each pixel, and Σ ω (I − T)² with it.
#[derive(Clone, Debug)]
pub struct BestAlbedo {
    /// (pixel, channel)
    pub albedo: Vec<f64>,
    /// (pixel)
    pub squares: Vec<f64>,
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
        let (maps, lights) = self.at(x, pixels)?;
        let nodes = roughness.len() * metallic.len();
        let mut grid: Vec<f32> = Vec::new();
        grid.try_reserve_exact(pixels.len() * nodes)
            .map_err(|_| Error::Memory("material grid"))?;
        grid.resize(pixels.len() * nodes, 0.0);
        if grid.is_empty() {
            return Ok(grid);
        }
        let pieces = pixels
            .chunks(CHUNK * BLOCK)
            .zip(grid.chunks_mut(CHUNK * BLOCK * nodes))
            .collect();
        pool::map(self.threads(), pieces, |(pixels, grid)| {
            let mut block = Block::new(self);
            let mut planes = vec![Doubles::default(); nodes];
            for (pixels, grid) in pixels.chunks(BLOCK).zip(grid.chunks_mut(BLOCK * nodes)) {
                block.load(maps, &lights, pixels);
                block.fill_grid::<NEWTON_STEPS>(roughness, metallic, &mut planes);
                for (x, of_pixel) in grid.chunks_mut(nodes).enumerate() {
                    for (to, plane) in of_pixel.iter_mut().zip(&planes) {
                        *to = plane.0[x] as f32;
                    }
                }
            }
        });
        Ok(grid)
    }

    /// The albedo that explains each of `pixels` best with the roughness and metallic of x, and the
    /// lights of x.
    pub fn best_albedo(&self, x: &[f64], pixels: &[usize]) -> Result<BestAlbedo> {
        let (maps, lights) = self.at(x, pixels)?;
        let parts = pool::map(
            self.threads(),
            pixels.chunks(CHUNK * BLOCK).collect(),
            |pixels: &[usize]| {
                let mut block = Block::new(self);
                let (mut albedo, mut squares) = (Vec::new(), Vec::new());
                for pixels in pixels.chunks(BLOCK) {
                    block.load(maps, &lights, pixels);
                    for (x, &p) in pixels.iter().enumerate() {
                        (block.roughness.0[x], block.metallic.0[x]) =
                            self.roughness_and_metallic(maps, p);
                    }
                    block.at_own_roughness();
                    for x in 0..pixels.len() {
                        albedo.extend(block.albedo.iter().map(|plane| plane.0[x]));
                        squares.push(block.squares.0[x]);
                    }
                }
                (albedo, squares)
            },
        );
        let (albedo, squares): (Vec<_>, Vec<_>) = parts.into_iter().unzip();
        Ok(BestAlbedo {
            albedo: albedo.concat(),
            squares: squares.concat(),
        })
    }
}

/// Up to [`BLOCK`] pixels and what is known of them.
pub(crate) struct Block<'a> {
    problem: &'a Problem,
    isa: Instructions,
    /// n·v
    cosine: Doubles,
    /// (1−n·v)⁵
    schlick: Doubles,
    pub(crate) products: PixelProducts,
    specular: Specular,
    bands: [Doubles; 4],
    g1: Doubles,
    pub(crate) roughness: Doubles,
    pub(crate) metallic: Doubles,
    /// By channel.
    pub(crate) albedo: Vec<Doubles>,
    squares: Doubles,
}

impl<'a> Block<'a> {
    pub(crate) fn new(problem: &'a Problem) -> Self {
        Self {
            problem,
            isa: problem.instructions(),
            cosine: Plane([1.0; BLOCK]),
            schlick: Doubles::default(),
            products: PixelProducts::new(problem.channels()),
            specular: Specular::default(),
            bands: Default::default(),
            g1: Doubles::default(),
            roughness: Doubles::default(),
            metallic: Doubles::default(),
            albedo: vec![Doubles::default(); problem.channels()],
            squares: Doubles::default(),
        }
    }

    /// Takes up pixels, with the normals of `maps`, and sums their products over pictures.
    pub(crate) fn load(&mut self, maps: &[f64], lights: &[[f64; COEFFICIENTS]], pixels: &[usize]) {
        self.products.load(self.problem, maps, lights, pixels);
        for x in 0..BLOCK {
            self.cosine.0[x] = self.products.directions.cosine(x);
            self.schlick.0[x] = ggx::schlick(self.cosine.0[x]);
        }
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
            for (plane, h) in self.bands.iter_mut().zip(ggx::bands(r).weight) {
                plane.0.fill(h);
            }
            for x in 0..BLOCK {
                self.g1.0[x] = ggx::smith_g1(self.cosine.0[x], r).0;
            }
            of_roughness.fill(Doubles::default());
            for c in 0..self.albedo.len() {
                self.take_roughness(c);
                // Squares wait in their plane until all channels have added theirs.
                for (sum, &m) in of_roughness.iter_mut().zip(metallic) {
                    self.metallic.0.fill(m);
                    std::mem::swap(&mut self.squares, sum);
                    self.minimize::<STEPS>(c);
                    std::mem::swap(&mut self.squares, sum);
                }
            }
        }
    }

    /// Best albedo and χ² at the roughness and metallic that each pixel has.
    pub(crate) fn at_own_roughness(&mut self) {
        let mut bands = BlockBands::default();
        self.isa.run(FillBands {
            roughness: &self.roughness,
            bands: &mut bands,
        });
        self.bands.copy_from_slice(&bands[..4]);
        for x in 0..BLOCK {
            self.g1.0[x] = ggx::smith_g1(self.cosine.0[x], self.roughness.0[x]).0;
        }
        self.squares = Doubles::default();
        for c in 0..self.albedo.len() {
            self.take_roughness(c);
            self.minimize::<NEWTON_STEPS>(c);
        }
    }

    fn take_roughness(&mut self, channel: usize) {
        self.isa.run(TakeRoughness {
            products: &self.products.by_channel[channel],
            bands: &self.bands,
            specular: &mut self.specular,
        });
    }

    fn minimize<const STEPS: usize>(&mut self, channel: usize) {
        self.isa.run(MinimizeByAlbedo::<STEPS> {
            products: &self.products.by_channel[channel],
            specular: &self.specular,
            schlick: &self.schlick,
            g1: &self.g1,
            metallic: &self.metallic,
            albedo: &mut self.albedo[channel],
            squares: &mut self.squares,
        });
    }
}

/// One channel: the albedo with the least χ², which is added to `squares`; by `STEPS` of Newton's
/// method.
struct MinimizeByAlbedo<'a, const STEPS: usize> {
    products: &'a Products,
    specular: &'a Specular,
    schlick: &'a Doubles,
    g1: &'a Doubles,
    metallic: &'a Doubles,
    albedo: &'a mut Doubles,
    squares: &'a mut Doubles,
}

impl<const STEPS: usize> Kernel for MinimizeByAlbedo<'_, STEPS> {
    type Output = ();

    #[inline(always)]
    fn run<I: Isa>(self, _: I) {
        let Self {
            products,
            specular,
            schlick,
            g1,
            metallic,
            albedo,
            squares,
        } = self;
        for x in 0..BLOCK {
            let (m, s) = (metallic.0[x], schlick.0[x]);
            let f0 = s + (1.0 - s) * DIELECTRIC_F0 * (1.0 - m);
            let f1 = (1.0 - s) * m;
            // a = a₁ρ − a₂ρ²,  b = b₀ + b₁ρ
            let a1 = (1.0 - f0) * (1.0 - m) * FRAC_1_PI;
            let a2 = f1 * (1.0 - m) * FRAC_1_PI;
            let (b0, b1) = (0.25 * g1.0[x] * f0, 0.25 * g1.0[x] * f1);
            let dd = products.diffuse_diffuse.0[x];
            let dt = products.diffuse_target.0[x];
            let ds = specular.diffuse_specular.0[x];
            let ss = specular.specular_specular.0[x];
            let st = specular.specular_target.0[x];
            // χ² = c₀ + c₁ρ + c₂ρ² + c₃ρ³ + c₄ρ⁴
            let c0 = products.target_target.0[x] + b0 * (b0 * ss - 2.0 * st);
            let c1 = 2.0 * (a1 * (b0 * ds - dt) + b1 * (b0 * ss - st));
            let c2 = a1 * a1 * dd + b1 * b1 * ss + 2.0 * ((a1 * b1 - a2 * b0) * ds + a2 * dt);
            let c3 = -2.0 * a2 * (a1 * dd + b1 * ds);
            let c4 = a2 * a2 * dd;
            let polynomial = |rho: f64| (((c4 * rho + c3) * rho + c2) * rho + c1) * rho + c0;

            let (mut best, mut least) = (0.0, c0);
            for start in STARTS {
                let value = polynomial(start);
                best = if value < least { start } else { best };
                least = if value < least { value } else { least };
            }
            let mut rho = best;
            for _ in 0..STEPS {
                let slope = ((4.0 * c4 * rho + 3.0 * c3) * rho + 2.0 * c2) * rho + c1;
                let bend = (12.0 * c4 * rho + 6.0 * c3) * rho + 2.0 * c2;
                let next = rho - slope / (bend.abs() + f64::MIN_POSITIVE);
                // A comparison with NaN is false: then the albedo stays where it is.
                rho = if next > 0.0 { next } else { 0.0 };
                rho = if rho < 1.0 { rho } else { 1.0 };
            }
            let value = polynomial(rho);
            albedo.0[x] = if value < least { rho } else { best };
            least = if value < least { value } else { least };
            // Rounding may leave less than nothing of a sum of squares.
            squares.0[x] += if least > 0.0 { least } else { 0.0 };
        }
    }
}
