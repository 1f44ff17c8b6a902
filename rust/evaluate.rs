//! Loss and gradient of one piece of work, in a version for every kind of problem.
//!
//! What a problem does not have (a second and third channel, the third band, sample weights,
//! unknown lights) is not in its version at all, so it costs nothing and no loop asks for it.

use std::ops::Range;

use crate::block::{
    self, BLOCK, Basis, BlockBands, ByLights, ChannelFactors, ChannelSums, FillBasis, FillFactors,
    FillWeights, Flush, GROUP, Lanes, Materials, Plane, PullBack, Reduce, Residuals, WideLanes,
};
use crate::problem::Problem;
use crate::simd::Ahead;

/// Blocks whose light derivatives are summed in float32 before float64 takes over.
const FLUSH: usize = 16;

/// Evaluates a range of blocks: (problem, maps, lights by channel and picture, blocks, scale of the
/// gradient, planes of the gradient for these blocks).
pub type Evaluate = fn(&Problem, &[f64], &[f32], Range<usize>, f64, &mut [&mut [f64]]) -> Partial;

/// What one piece of work adds to the sums over pixels.
pub struct Partial {
    /// Σ ω (I − T)²
    pub squares: f64,
    /// Derivatives of ½ Σ ω (I − T)² by the lights: (channel, picture, coefficient).
    pub by_lights: Vec<f64>,
    /// Whether all materials lay in \[0, 1\].
    pub in_range: bool,
}

/// The version for a problem.
pub fn choose(channels: usize, coefficients: usize, weighted: bool, free_lights: bool) -> Evaluate {
    match channels {
        1 => with_channels::<1>(coefficients, weighted, free_lights),
        _ => with_channels::<3>(coefficients, weighted, free_lights),
    }
}

fn with_channels<const C: usize>(
    coefficients: usize,
    weighted: bool,
    free_lights: bool,
) -> Evaluate {
    match coefficients {
        9 => with_coefficients::<C, 9>(weighted, free_lights),
        _ => with_coefficients::<C, 16>(weighted, free_lights),
    }
}

fn with_coefficients<const C: usize, const K: usize>(
    weighted: bool,
    free_lights: bool,
) -> Evaluate {
    match (weighted, free_lights) {
        (false, true) => evaluate::<C, K, false, true>,
        (false, false) => evaluate::<C, K, false, false>,
        (true, true) => evaluate::<C, K, true, true>,
        (true, false) => evaluate::<C, K, true, false>,
    }
}

/// A block at a time: basis functions and factors of its pixels; then, channel by channel and
/// group of pictures by group, the matrix products; then the material derivatives.
fn evaluate<const C: usize, const K: usize, const WEIGHTED: bool, const FREE_LIGHTS: bool>(
    problem: &Problem,
    maps: &[f64],
    lights: &[f32],
    blocks: Range<usize>,
    scale: f64,
    gradient: &mut [&mut [f64]],
) -> Partial {
    let (isa, pixels, pictures) = (problem.instructions(), problem.pixels(), problem.pictures());
    let lights: &[[f32; K]] = lights.as_chunks().0;
    let mut partial = Partial {
        squares: 0.0,
        by_lights: Vec::new(),
        in_range: true,
    };
    let lit = if FREE_LIGHTS { C * pictures } else { 0 };
    let mut light_sums = vec![[Lanes::default(); K]; lit];
    let mut light_totals = vec![[WideLanes::default(); K]; lit];

    let mut basis = Basis::default();
    let mut materials = Materials::<C>::default();
    let mut by_materials = Materials::<C>::default();
    let mut bands = BlockBands::default();
    let mut factors: [_; C] = std::array::from_fn(|_| ChannelFactors::default());
    let mut sums: [_; C] = std::array::from_fn(|_| ChannelSums::default());
    let mut weights = [Plane::default(); K];
    let mut residuals = [Plane::default(); GROUP];

    let mut ahead = Ahead::default();
    let first_pixel = blocks.start * BLOCK;
    let last = blocks.end - 1;
    for block in blocks {
        let first = block * BLOCK;
        let count = BLOCK.min(pixels - first);
        partial.in_range &= materials.load(maps, pixels, first, count, problem.known_metallic());
        let directions = problem.directions(block);
        isa.run(FillBasis::<f32, K> {
            directions,
            basis: &mut basis,
        });
        isa.run(FillFactors {
            directions,
            materials: &materials,
            pixels: count,
            bands: &mut bands,
            factors: &mut factors,
        });
        for c in 0..C {
            isa.run(FillWeights {
                basis: &basis,
                factors: &factors[c],
                weights: &mut weights,
            });
            sums[c] = ChannelSums::default();
            look_ahead::<C>(
                problem,
                maps,
                gradient,
                first_pixel,
                block,
                last,
                c,
                &mut ahead,
            );
            let targets = problem.targets(block, c);
            let sample_weights = problem.weights(block, c);
            for group in block::groups(pictures) {
                let lights = &lights[c * pictures..][group.clone()];
                let residuals = &mut residuals[..group.len()];
                partial.squares += isa.run(Residuals::<K, WEIGHTED> {
                    weights: &weights,
                    lights,
                    targets: &targets[group.clone()],
                    sample_weights: if WEIGHTED {
                        &sample_weights[group.clone()]
                    } else {
                        &[]
                    },
                    residuals,
                    ahead: &mut ahead,
                });
                isa.run(Reduce {
                    basis: &basis,
                    lights,
                    residuals,
                    sums: &mut sums[c],
                    ahead: &mut ahead,
                });
                if FREE_LIGHTS {
                    isa.run(ByLights {
                        weights: &weights,
                        residuals,
                        sums: &mut light_sums[c * pictures..][group],
                        ahead: &mut ahead,
                    });
                }
            }
        }
        isa.run(PullBack {
            directions,
            materials: &materials,
            bands: &bands,
            sums: &sums,
            scale,
            gradient: &mut by_materials,
        });
        by_materials.store(gradient, first - first_pixel, count);

        if FREE_LIGHTS && ((block + 1) % FLUSH == 0 || block == last) {
            isa.run(Flush {
                from: light_sums.as_flattened_mut(),
                to: light_totals.as_flattened_mut(),
            });
        }
    }
    partial.by_lights = light_totals
        .as_flattened()
        .iter()
        .map(WideLanes::sum)
        .collect();
    partial
}

/// While channel c of a block is worked on: the next channel's targets, and a share of the rest of
/// the next block.
fn look_ahead<const C: usize>(
    problem: &Problem,
    maps: &[f64],
    gradient: &[&mut [f64]],
    first_pixel: usize,
    block: usize,
    last: usize,
    c: usize,
    ahead: &mut Ahead,
) {
    ahead.clear();
    let pixels = problem.pixels();
    let from = (block + 1) * BLOCK;
    if block < last {
        if c == C - 1 {
            for plane in gradient {
                let from = from - first_pixel;
                ahead.push(&plane[from..(from + BLOCK).min(plane.len())]);
            }
        }
        if c == 1 % C {
            ahead.push(std::slice::from_ref(problem.directions(block + 1)));
        }
        if c == 0 {
            for plane in maps.chunks(pixels) {
                ahead.push(&plane[from..(from + BLOCK).min(pixels)]);
            }
        }
    }
    if c + 1 < C {
        ahead.push(problem.targets(block, c + 1));
    } else if block < last {
        ahead.push(problem.targets(block + 1, 0));
    }
}
