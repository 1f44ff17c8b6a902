//! Loss and gradient of one piece of work, in a version for every kind of problem.
//!
//! What a problem does not have (a second and third channel, the third band, sample weights,
//! unknown lights, unknown normals) is not in its version at all, so it costs nothing and no loop
//! asks for it.

use std::ops::Range;

use super::{Problem, add, chunks_of_planes};
use crate::block::adjoint::{ByFactors, ByLights, Parts, WideParts, flush};
use crate::block::basis::Basis;
use crate::block::bounced::{add_bounced, subtract_bounced};
use crate::block::factors::{FillFactors, load};
use crate::block::normal_jacobian::{ByBasis, NormalJacobian, TangentOffsets};
use crate::block::radiance::Residuals;
use crate::block::weights::FillWeights;
use crate::reflectance::model::with_model_of;
use crate::reflectance::planes::{
    BLOCK, ChannelFactors, ChannelSums, Directions, Materials, Plane, no_functions,
};
use crate::reflectance::reflection::Reflection;
use crate::reflectance::tangent_offset::OFFSET_MAX;
use crate::runtime::simd::vectorized;
use crate::runtime::{Result, check, pool};

/// Pictures at most that go through the products together: their residuals stay in the cache.
const GROUP: usize = 16;

/// Blocks whose light derivatives are summed in float32 before float64 takes over.
const FLUSH: usize = 16;

impl Problem {
    /// The loss at x; its gradient is written to `gradient`.
    pub fn value_and_grad(&self, x: &[f64], gradient: &mut [f64]) -> Result<f64> {
        let (maps, lighting) = self.split(x)?;
        check::length("gradient", self.size(), gradient.len())?;
        let evaluate = choose(self);
        let lights = self.by_channel(lighting);
        let factor = 2.0 / self.total_weight;

        let (by_maps, by_lighting) = gradient.split_at_mut(maps.len());
        let chunk = self.chunk();
        let pieces = self
            .chunks()
            .zip(chunks_of_planes(by_maps, self.pixels(), chunk * BLOCK));
        let (threads, pieces) = (self.options.threads, pieces.collect());
        let partials = pool::map(threads, pieces, |(blocks, mut out)| {
            let piece = Piece {
                problem: self,
                maps,
                lights: &lights,
                factor,
                blocks,
            };
            evaluate(&piece, &mut out)
        });

        let mut loss = 0.0;
        let mut by_lights = vec![0.0; lights.len()];
        for partial in &partials {
            if !partial.in_range {
                // Which entry it was is worth a second look only now.
                self.check_maps(maps)?;
            }
            loss += partial.loss;
            add(&mut by_lights, &partial.by_lights);
        }
        let (k, c) = (self.coefficients(), self.channels());
        for (i, of_entry) in by_lighting.iter_mut().enumerate() {
            let (picture, coefficient, channel) = (i / (k * c), i / c % k, i % c);
            *of_entry = factor * by_lights[(channel * self.pictures() + picture) * k + coefficient];
        }
        Ok(loss / self.total_weight)
    }

    /// Lights in float32: (channel, picture, coefficient).
    fn by_channel(&self, lighting: &[f64]) -> Vec<f32> {
        let mut lights = Vec::with_capacity(lighting.len());
        for c in 0..self.channels() {
            let of_channel = lighting.iter().skip(c).step_by(self.channels());
            lights.extend(of_channel.map(|&l| l as f32));
        }
        lights
    }
}

/// A piece of work.
struct Piece<'a> {
    /// The pictures.
    problem: &'a Problem,
    /// The first part of x.
    maps: &'a [f64],
    /// In float32: (channel, picture, coefficient).
    lights: &'a [f32],
    /// Factor on the gradient.
    factor: f64,
    /// What to evaluate.
    blocks: Range<usize>,
}

/// Evaluates a piece of work and writes the planes of its gradient.
type Evaluate = fn(&Piece, &mut [&mut [f64]]) -> Partial;

/// What one piece of work adds to the sums over pixels.
struct Partial {
    /// Σ ω φ(I − T)
    loss: f64,
    /// Derivatives of ½ Σ ω φ(I − T) by the lights: (channel, picture, coefficient).
    by_lights: Vec<f64>,
    /// Whether all materials lay in \[0, 1\], and all tangent offsets were moderate.
    in_range: bool,
}

/// The version for a problem.
fn choose(problem: &Problem) -> Evaluate {
    with_model_of!(problem, M => match (problem.channels(), problem.coefficients()) {
        (1, 9) => with::<M, 1, 9>(problem),
        (1, _) => with::<M, 1, 16>(problem),
        (_, 9) => with::<M, 3, 9>(problem),
        _ => with::<M, 3, 16>(problem),
    })
}

fn with<M: Reflection, const C: usize, const K: usize>(problem: &Problem) -> Evaluate {
    let (weighted, free_normals) = (problem.weights.is_some(), problem.options.free_normals);
    match (weighted, problem.options.lighting.is_none(), free_normals) {
        (false, true, false) => evaluate::<M, C, K, false, true, false>,
        (false, false, false) => evaluate::<M, C, K, false, false, false>,
        (true, true, false) => evaluate::<M, C, K, true, true, false>,
        (true, false, false) => evaluate::<M, C, K, true, false, false>,
        (false, true, true) => evaluate::<M, C, K, false, true, true>,
        (false, false, true) => evaluate::<M, C, K, false, false, true>,
        (true, true, true) => evaluate::<M, C, K, true, true, true>,
        (true, false, true) => evaluate::<M, C, K, true, false, true>,
    }
}

/// Tangent offsets of a block, how directions change with them, and derivatives by them.
#[derive(Default)]
struct FreeNormals {
    offsets: TangentOffsets,
    jacobian: NormalJacobian,
    by_basis: Basis,
}

/// A block at a time: basis functions and factors of its pixels; then, channel by channel and
/// group of pictures by group, the matrix products; then the derivatives by material and normal.
fn evaluate<
    M: Reflection,
    const C: usize,
    const K: usize,
    const WEIGHTED: bool,
    const FREE_LIGHTS: bool,
    const FREE_NORMALS: bool,
>(
    piece: &Piece,
    gradient: &mut [&mut [f64]],
) -> Partial {
    let &Piece {
        problem,
        maps,
        lights,
        factor,
        ref blocks,
    } = piece;
    let (pixels, pictures) = (problem.pixels(), problem.pictures());
    let isa = problem.options.instructions;
    let lights: &[[f32; K]] = lights.as_chunks().0;
    let (of_materials, of_offsets) = problem.split_maps(maps);
    let materials_of_gradient = problem.unknowns_of_material();
    let mut partial = Partial {
        loss: 0.0,
        by_lights: Vec::new(),
        in_range: true,
    };
    let light_sum_count = if FREE_LIGHTS { C * pictures } else { 0 };
    let mut light_sums = vec![[Parts::default(); K]; light_sum_count];
    let mut light_totals = vec![[WideParts::default(); K]; light_sum_count];

    let mut basis = Basis::default();
    let mut materials = Materials::<C>::default();
    let mut by_materials = Materials::<C>::default();
    let mut functions = no_functions();
    let model = M::default();
    let mut factors: [_; C] = std::array::from_fn(|_| ChannelFactors::default());
    let mut sums: [_; C] = std::array::from_fn(|_| ChannelSums::default());
    let mut weights = [[Plane::default(); K]; C];
    let mut residuals = [Plane::default(); GROUP];
    let (mut bounced, mut less) = (Vec::new(), [Plane::default(); GROUP]);

    let mut directions = Directions::default();
    let mut free_normals = FREE_NORMALS.then(Box::<FreeNormals>::default);
    if let Some(known) = problem.options.metallic {
        materials.metallic.0.fill(known);
    }

    let first_pixel = blocks.start * BLOCK;
    for block in blocks.clone() {
        let first = block * BLOCK;
        let count = BLOCK.min(pixels - first);
        let Materials {
            albedo,
            roughness,
            metallic,
        } = &mut materials;
        let taken = first..first + count;
        let planes = albedo.iter_mut().chain([roughness, metallic]);
        partial.in_range &= vectorized!(
            isa,
            load(of_materials, pixels, taken.clone(), [0.0, 1.0], 0.5, planes)
        );
        let (given, to) = (&problem.given[block], &mut directions);
        match &mut free_normals {
            None => vectorized!(isa, given.place(to)),
            Some(free) => {
                let (planes, range) = (free.offsets.iter_mut(), [-OFFSET_MAX, OFFSET_MAX]);
                partial.in_range &= vectorized!(
                    isa,
                    load(of_offsets, pixels, taken.clone(), range, 0.0, planes)
                );
                let (offsets, jacobian) = (&free.offsets, &mut free.jacobian);
                vectorized!(isa, given.turn(offsets, to, jacobian));
            }
        }
        let directions = &directions;
        problem.fill_basis::<M, f32, K>(directions, taken.clone(), &mut basis);
        isa.run(FillFactors::<M, _, _> {
            directions,
            materials: &materials,
            pixels: count,
            by_cosine: FREE_NORMALS,
            functions: &mut functions,
            factors: &mut factors,
        });
        isa.run(FillWeights {
            basis: &basis,
            factors: &factors,
            weights: &mut weights,
            model,
        });
        for c in 0..C {
            let targets = problem.targets(block, c);
            let sample_weights = problem.weights(block, c);
            if M::SURROUNDED {
                problem.fill_bounced::<M>(taken.clone(), c, &mut bounced);
            }
            for group in groups(pictures) {
                let lights = &lights[c * pictures..][group.clone()];
                let residuals = &mut residuals[..group.len()];
                let mut targets = &targets[group.clone()];
                let brought = group.start * (1 + M::ROWS)..group.end * (1 + M::ROWS);
                let bounced = bounced.get(brought).unwrap_or_default();
                if M::SURROUNDED && !bounced.is_empty() {
                    let (factors, less) = (&factors[c], &mut less[..group.len()]);
                    vectorized!(isa, subtract_bounced::<M>(factors, bounced, targets, less));
                    targets = less;
                }
                let sample_weights = if WEIGHTED {
                    &sample_weights[group.clone()]
                } else {
                    &[]
                };
                partial.loss += isa.run(Residuals::<K, WEIGHTED> {
                    weights: &weights[c],
                    lights,
                    targets,
                    sample_weights,
                    residuals,
                });
                isa.run(ByFactors::<M, K, FREE_NORMALS> {
                    begin: group.start == 0,
                    basis: &basis,
                    lights,
                    residuals,
                    sums: &mut sums[c],
                    by_basis: free_normals.as_mut().map(|free| ByBasis {
                        model,
                        begin: c == 0 && group.start == 0,
                        factors: &factors[c],
                        sums: &mut free.by_basis,
                    }),
                    model,
                });
                if M::SURROUNDED && !bounced.is_empty() {
                    let sums = &mut sums[c];
                    vectorized!(isa, add_bounced::<M>(residuals, bounced, sums));
                }
                if FREE_LIGHTS {
                    isa.run(ByLights {
                        weights: &weights[c],
                        residuals,
                        sums: &mut light_sums[c * pictures..][group],
                    });
                }
            }
        }
        let (materials, functions) = (&materials, &functions);
        let to = &mut by_materials;
        vectorized!(
            isa,
            M::pull_back_block(directions, materials, functions, &sums, factor, to)
        );
        let to = first - first_pixel;
        by_materials.store(&mut gradient[..materials_of_gradient], to, count);
        if let Some(free) = &mut free_normals {
            let (jacobian, by_basis) = (&free.jacobian, &free.by_basis);
            let by_offsets = vectorized!(
                isa,
                jacobian.pull_back::<M, C, K>(
                    directions, materials, functions, &sums, by_basis, factor
                )
            );
            let planes = gradient[materials_of_gradient..].iter_mut();
            for (plane, own) in planes.zip(&by_offsets) {
                plane[to..][..count].copy_from_slice(&own.0[..count]);
            }
        }

        if FREE_LIGHTS && ((block + 1) % FLUSH == 0 || block + 1 == blocks.end) {
            let (from, to) = (&mut light_sums, &mut light_totals);
            vectorized!(isa, flush(from.as_flattened_mut(), to.as_flattened_mut()));
        }
    }
    partial.by_lights = light_totals
        .as_flattened()
        .iter()
        .map(WideParts::sum)
        .collect();
    partial
}

/// The pictures in groups of at most [`GROUP`], as even as fours allow.
fn groups(pictures: usize) -> impl Iterator<Item = Range<usize>> {
    let size = pictures
        .div_ceil(pictures.div_ceil(GROUP))
        .next_multiple_of(4);
    (0..pictures)
        .step_by(size)
        .map(move |first| first..(first + size).min(pictures))
}
