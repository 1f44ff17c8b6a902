//! What one pixel costs under known lamps, and its normal equations.
//!
//! With intensities e_kc at the pixel, unit radiance I_kc ([`Surface`]), and light a_i
//! beside the lamps of picture i that comes alike from all sides,
//!
//! ```text
//! model_ic = Σ_k e_kc I_kc + w_c a_ic              residual_ic = model_ic − y_ic
//! cost     = Σ_ic w_ic residual_ic² + Σ_x p_x (x − mean_x)²
//! ```
//!
//! where a residual counts only if what the sample says is missed: y_ic itself, at least y_ic (of a
//! sample at the upper limit of its file), or at most y_ic. Unknowns are in the order of the
//! [`Arrowhead`](crate::pixel::arrowhead::Arrowhead): albedos, roughness, metallic, tangent offsets.

use std::marker::PhantomData;

use glam::DVec3;

use super::ambient::{AmbientSlopes, SLOPES_OF_SAMPLE, weights_with_slopes};
use super::number::{Number, Wide};
use super::pixel_fit::{LampPictures, NUMBERS, PLACES};
use super::surface::{Reflected, Surface};
use crate::reflectance::model::Model;
use crate::reflectance::planes::Material;
use crate::reflectance::reflection::Reflection;
use crate::reflectance::tangent_offset::OFFSETS;
pub use crate::runtime::check::{AT_LEAST, AT_MOST};
use crate::runtime::simd::{Instructions, Isa, Kernel, Vectors};

/// Unknowns of a pixel: albedos, roughness, metallic, tangent offsets.
pub(super) const UNKNOWNS: usize = 7;
pub(super) const ROUGHNESS: usize = 3;
pub(super) const METALLIC: usize = 4;
pub(super) const OFFSET: usize = 5;

/// Where a pixel is.
#[derive(Clone, Copy, Debug)]
pub(super) struct Point {
    pub(super) offset: [f64; OFFSETS],
    pub(super) normal: DVec3,
    pub(super) material: Material,
}

impl Point {
    pub(super) fn values(&self) -> [f64; UNKNOWNS] {
        let Material {
            albedo: [red, green, blue],
            roughness,
            metallic,
        } = self.material;
        let [a, b] = self.offset;
        [red, green, blue, roughness, metallic, a, b]
    }
}

/// Σ w J Jᵀ and Σ w J residual, with the prior.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Equations {
    /// On the diagonal and below it.
    pub(super) matrix: [[f64; UNKNOWNS]; UNKNOWNS],
    pub(super) gradient: [f64; UNKNOWNS],
}

/// Pictures that are looked at together: as many numbers as the widest vectors have.
pub(super) const LANES: usize = 8;

/// A number of each.
pub(super) type Lanes = [f64; LANES];

/// Where no lamp is.
pub(super) const NONE: usize = usize::MAX;

/// Of all pixels, by [`LANES`] pictures: lamps, and light that comes alike from all sides.
pub(super) struct Lights {
    pub(super) blocks: Vec<LightBlock>,
    /// Whether a picture has the latter.
    any_ambient: bool,
    pub(super) instructions: Instructions,
}

pub(super) struct LightBlock {
    /// Numbers of lamps: the first of each picture, the second of each, and so on.
    pub(super) lamps: Vec<[usize; LANES]>,
    ambient: [Lanes; 3],
}

impl Lights {
    /// From the picture of each lamp, in rising order, and the ambient light of each picture.
    pub(super) fn new(picture_of: &[usize], ambient: &[[f64; 3]]) -> Self {
        let block_of = |(b, pictures): (usize, &[[f64; 3]])| {
            let mut block = LightBlock {
                lamps: Vec::new(),
                ambient: [[0.0; LANES]; 3],
            };
            for (i, light) in pictures.iter().enumerate() {
                let first = picture_of.partition_point(|&of| of < LANES * b + i);
                let end = picture_of.partition_point(|&of| of <= LANES * b + i);
                for k in first..end {
                    if block.lamps.len() <= k - first {
                        block.lamps.push([NONE; LANES]);
                    }
                    block.lamps[k - first][i] = k;
                }
                for c in 0..3 {
                    block.ambient[c][i] = light[c];
                }
            }
            block
        };
        Self {
            blocks: ambient.chunks(LANES).enumerate().map(block_of).collect(),
            any_ambient: ambient.as_flattened().iter().any(|&light| light != 0.0),
            instructions: Instructions::best(),
        }
    }
}

/// What is known of one pixel.
pub(super) struct Samples<'a> {
    pub(super) model: Model,
    pub(super) view: DVec3,
    pub(super) lights: &'a Lights,
    pub(super) blocks: Vec<SampleBlock>,
    prior_mean: [f64; UNKNOWNS],
    prior_precision: [f64; UNKNOWNS],
}

/// A residual is raised to `lowest` and lowered to `highest`: −∞ and ∞, but 0 at a limit that is kept.
pub(super) struct SampleBlock {
    pub(super) targets: [Lanes; 3],
    pub(super) weights: [Lanes; 3],
    lowest: [Lanes; 3],
    highest: [Lanes; 3],
    /// Directions to those that [`LightBlock::lamps`] has, and what they bring.
    lamps: Vec<[[Lanes; 3]; 2]>,
}

impl<'a> Samples<'a> {
    /// Side by side what is given one after the other, of pixel p.
    pub(super) fn new(
        given: &LampPictures,
        weights: &[[f64; 3]],
        lights: &'a Lights,
        p: usize,
    ) -> Self {
        let (pictures, of_lamps) = (given.ambient.len(), given.lamps_of(p));
        let directions = &given.directions[of_lamps.clone()];
        let brought = &given.intensities[of_lamps];
        let none = [[0.0; LANES]; 3];
        let block_of = |(b, of): (usize, &LightBlock)| {
            let mut block = SampleBlock {
                targets: none,
                weights: none,
                lowest: [[f64::NEG_INFINITY; LANES]; 3],
                highest: [[f64::INFINITY; LANES]; 3],
                lamps: vec![[none; 2]; of.lamps.len()],
            };
            for i in 0..LANES.min(pictures - LANES * b) {
                let at = p * pictures + LANES * b + i;
                for c in 0..3 {
                    block.targets[c][i] = given.pictures[at][c];
                    block.weights[c][i] = weights[at][c];
                    match given.limits.as_ref().map(|limits| limits[at][c]) {
                        Some(AT_LEAST) => block.highest[c][i] = 0.0,
                        Some(AT_MOST) => block.lowest[c][i] = 0.0,
                        _ => (),
                    }
                }
            }
            for (to, numbers) in block.lamps.iter_mut().zip(&of.lamps) {
                for (i, &k) in numbers.iter().enumerate().filter(|(_, k)| **k != NONE) {
                    let direction = directions[k].to_array();
                    for c in 0..3 {
                        to[0][c][i] = direction[c];
                        to[1][c][i] = brought[k][c];
                    }
                }
            }
            block
        };
        Self {
            model: given.model,
            view: given.views[p],
            lights,
            blocks: lights.blocks.iter().enumerate().map(block_of).collect(),
            prior_mean: [0.0; UNKNOWNS],
            prior_precision: [0.0; UNKNOWNS],
        }
    }

    /// With a prior, by the numbers of a pixel.
    pub(super) fn with_prior(self, mean: &[f64; NUMBERS], precision: &[f64; NUMBERS]) -> Self {
        Self {
            prior_mean: PLACES.map(|x| mean[x]),
            prior_precision: PLACES.map(|x| precision[x]),
            ..self
        }
    }

    /// Whether any sample counts.
    pub(super) fn any(&self) -> bool {
        (self.blocks.iter()).any(|block| block.weights.as_flattened().iter().any(|&w| w > 0.0))
    }

    /// The cost of a point, and the normal equations there; `turned` is ∂n by the tangent offsets, 0
    /// where these are held.
    pub(super) fn equations<M: Reflection>(
        &self,
        point: &Point,
        turned: &[DVec3; OFFSETS],
    ) -> (f64, Equations) {
        let mut sums = self.lights.instructions.run(Pass {
            samples: self,
            point,
            turned,
            model: PhantomData::<M>,
        });
        for (x, value) in point.values().into_iter().enumerate() {
            let deviation = value - self.prior_mean[x];
            sums.0 += self.prior_precision[x] * deviation * deviation;
            sums.1.matrix[x][x] += self.prior_precision[x];
            sums.1.gradient[x] += self.prior_precision[x] * deviation;
        }
        sums
    }
}

/// Samples side by side, by channel.
pub(super) struct Seen<I: Isa> {
    pub(super) radiance: [Wide<I>; 3],
    pub(super) residuals: [Wide<I>; 3],
    /// 0 where a limit is kept.
    pub(super) weights: [Wide<I>; 3],
    /// By the pixel's unknowns.
    pub(super) slopes: [[Wide<I>; SLOPES_OF_SAMPLE]; 3],
}

impl Samples<'_> {
    /// What ambient light adds, if there is any.
    #[inline(always)]
    pub(super) fn ambient<M: Reflection>(
        &self,
        normal: DVec3,
        material: &Material,
        turned: &[DVec3; OFFSETS],
    ) -> Option<AmbientSlopes> {
        let weights = || weights_with_slopes::<M>([normal, self.view], material, turned);
        self.lights.any_ambient.then(weights)
    }

    /// The samples of a vector of a block; `each` takes the number of a lamp of its picture, whether it
    /// is seen (1, else 0), and what is reflected of its unit light.
    #[inline(always)]
    pub(super) fn seen<I: Isa, const SLOPES: bool>(
        &self,
        isa: I,
        [b, at]: [usize; 2],
        surface: &Surface<SLOPES>,
        turned: &[DVec3; OFFSETS],
        of_ambient: &Option<AmbientSlopes>,
        mut each: impl FnMut(usize, Wide<I>, &Reflected<Wide<I>>),
    ) -> Seen<I> {
        let (block, lights) = (&self.blocks[b], &self.lights.blocks[b]);
        let of = |lanes: &Lanes| Wide(isa, I::of(lanes)[at]);
        let none = Wide(isa, isa.splat(0.0));
        let (mut radiance, mut slopes) = ([none; 3], [[none; SLOPES_OF_SAMPLE]; 3]);
        for (k, [[x, y, z], intensities]) in block.lamps.iter().enumerate() {
            let (lit, unit) = surface.reflected_of([of(x), of(y), of(z)]);
            let along = match SLOPES {
                true => [unit.along(turned[0]), unit.along(turned[1])],
                false => [[none; 3]; OFFSETS],
            };
            for c in 0..3 {
                let intensity = lit * of(&intensities[c]);
                radiance[c] = radiance[c] + intensity * unit.radiance[c];
                if SLOPES {
                    let slopes = &mut slopes[c];
                    slopes[0] = slopes[0] + intensity * unit.by_albedo[c];
                    slopes[1] = slopes[1] + intensity * unit.by_roughness[c];
                    slopes[2] = slopes[2] + intensity * unit.by_metallic[c];
                    slopes[3] = slopes[3] + intensity * along[0][c];
                    slopes[4] = slopes[4] + intensity * along[1][c];
                }
            }
            each(k, lit, &unit);
        }
        if let Some((weights, by)) = of_ambient {
            for c in 0..3 {
                let light = of(&lights.ambient[c]);
                radiance[c] = radiance[c] + light * weights[c];
                for x in 0..SLOPES_OF_SAMPLE {
                    slopes[c][x] = slopes[c][x] + light * by[c][x];
                }
            }
        }
        let (mut residuals, mut weights) = (radiance, radiance);
        for c in 0..3 {
            let (lowest, highest) = (of(&block.lowest[c]), of(&block.highest[c]));
            let residual = (radiance[c] - of(&block.targets[c]))
                .max(lowest)
                .min(highest);
            // A limit that is kept tells nothing.
            let weight = of(&block.weights[c]);
            let kept = none - residual * residual;
            let is_free = highest.min(none - lowest);
            residuals[c] = residual;
            weights[c] = is_free.at_least(f64::INFINITY, weight, kept.at_least(0.0, none, weight));
        }
        Seen {
            radiance,
            residuals,
            weights,
            slopes,
        }
    }
}

/// One pass over the samples of a pixel.
struct Pass<'a, M> {
    samples: &'a Samples<'a>,
    point: &'a Point,
    turned: &'a [DVec3; OFFSETS],
    model: PhantomData<M>,
}

impl<M: Reflection> Kernel for Pass<'_, M> {
    type Output = (f64, Equations);

    #[inline(always)]
    fn run<I: Isa>(self, isa: I) -> (f64, Equations) {
        let Self {
            samples,
            point: Point {
                normal, material, ..
            },
            turned,
            ..
        } = self;
        let surface = Surface::<true>::new(samples.model, *normal, samples.view, material);
        let of_ambient = samples.ambient::<M>(*normal, material, turned);
        let none = Wide(isa, isa.splat(0.0));
        let mut sums = Sums::of(none);
        for b in 0..samples.blocks.len() {
            for at in 0..LANES / <I as Vectors<f64>>::LANES {
                let seen = samples.seen(isa, [b, at], &surface, turned, &of_ambient, |_, _, _| ());
                for c in 0..3 {
                    sums.add(c, &seen.slopes[c], seen.weights[c], seen.residuals[c]);
                }
            }
        }
        sums.total()
    }
}

/// Number of the derivatives that no channel has for itself.
const SHARED: usize = SLOPES_OF_SAMPLE - 1;

/// Σ w J Jᵀ and Σ w J residual by lane: of the albedos, of these with what is shared, and of that.
struct Sums<I: Isa> {
    cost: Wide<I>,
    albedo: [Wide<I>; 3],
    albedo_gradient: [Wide<I>; 3],
    arms: [[Wide<I>; 3]; SHARED],
    dense: [[Wide<I>; SHARED]; SHARED],
    gradient: [Wide<I>; SHARED],
}

impl<I: Isa> Sums<I> {
    #[inline(always)]
    fn of(none: Wide<I>) -> Self {
        Self {
            cost: none,
            albedo: [none; 3],
            albedo_gradient: [none; 3],
            arms: [[none; 3]; SHARED],
            dense: [[none; SHARED]; SHARED],
            gradient: [none; SHARED],
        }
    }

    /// Adds the samples of a channel.
    #[inline(always)]
    fn add(
        &mut self,
        c: usize,
        slopes: &[Wide<I>; SLOPES_OF_SAMPLE],
        weight: Wide<I>,
        residual: Wide<I>,
    ) {
        self.cost = self.cost + weight * residual * residual;
        let albedo = weight * slopes[0];
        self.albedo[c] = self.albedo[c] + albedo * slopes[0];
        self.albedo_gradient[c] = self.albedo_gradient[c] + albedo * residual;
        for f in 0..SHARED {
            let weighted = weight * slopes[f + 1];
            self.arms[f][c] = self.arms[f][c] + albedo * slopes[f + 1];
            self.gradient[f] = self.gradient[f] + weighted * residual;
            for g in 0..=f {
                self.dense[f][g] = self.dense[f][g] + weighted * slopes[g + 1];
            }
        }
    }

    /// Sums over the lanes.
    #[inline(always)]
    fn total(&self) -> (f64, Equations) {
        let sum = |x: Wide<I>| x.0.sum(x.1);
        let mut equations = Equations::default();
        for c in 0..3 {
            equations.matrix[c][c] = sum(self.albedo[c]);
            equations.gradient[c] = sum(self.albedo_gradient[c]);
        }
        for f in 0..SHARED {
            let row = &mut equations.matrix[ROUGHNESS + f];
            for c in 0..3 {
                row[c] = sum(self.arms[f][c]);
            }
            for g in 0..=f {
                row[ROUGHNESS + g] = sum(self.dense[f][g]);
            }
            equations.gradient[ROUGHNESS + f] = sum(self.gradient[f]);
        }
        (sum(self.cost), equations)
    }
}
