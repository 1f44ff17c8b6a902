//! The forward model over many pixels in double precision: ground truth, relighting, residuals.

use glam::DVec3;

use super::chunks_of_planes;
use crate::block::basis::{Basis, fill_basis};
use crate::block::factors::FillFactors;
use crate::block::normal_jacobian::GivenDirections;
use crate::block::radiance::Radiance;
use crate::block::weights::FillWeights;
use crate::reflectance::model::{Model, with_model};
use crate::reflectance::planes::{
    BLOCK, ChannelFactors, Directions, Material, Materials, Plane, no_functions,
};
use crate::reflectance::reflection::Reflection;
use crate::reflectance::sh::COEFFICIENTS;
use crate::runtime::memory::zeros;
use crate::runtime::simd::{Instructions, vectorized};
use crate::runtime::{Error, Result, check, pool};
use crate::transport::table::Transfer;

/// Blocks in a piece of work.
const CHUNK: usize = 8;

/// Radiance of every pixel under every light: (light, pixel, channel).
///
/// `lighting` is (light, coefficient, channel). A transfer takes the place of the model's rows; what
/// it says is brought is by light and channel. `threads` = 0 means one for each processor.
pub fn render(
    normals: &[DVec3],
    views: &[DVec3],
    materials: &[Material],
    lighting: &[f64],
    (model, transfer): (Model, Option<&Transfer>),
    threads: usize,
) -> Result<Vec<f64>> {
    let pixels = check::pixels(normals, views, materials.len())?;
    check::moderate("lighting", lighting, check::LARGEST_F64)?;
    let (coefficients, rest) = lighting.as_chunks::<{ COEFFICIENTS * 3 }>();
    if !rest.is_empty() {
        let found = lighting.len();
        return Err(Error::argument("lighting", "48 numbers a picture", found));
    }
    let lights: Vec<[[f64; COEFFICIENTS]; 3]> = coefficients
        .iter()
        .map(|light| [0, 1, 2].map(|c| std::array::from_fn(|k| light[k * 3 + c])))
        .collect();

    let piece = CHUNK * BLOCK;
    pictures(lights.len(), pixels, piece, threads, |first, parts| {
        let given = (normals, views);
        if transfer.is_some() {
            with_model!(model, true, M => {
                render_chunk::<M>(given, materials, &lights, transfer, first, parts);
            });
        } else {
            with_model!(model, M => {
                render_chunk::<M>(given, materials, &lights, None, first, parts);
            });
        }
    })
}

/// Pictures of so many pixels, (light, pixel, channel), filled in pieces.
///
/// `fill` gets the index of a first pixel and, of every picture, the part of `piece` pixels (fewer
/// at the end) that begins there, as zeros.
pub(crate) fn pictures(
    lights: usize,
    pixels: usize,
    piece: usize,
    threads: usize,
    fill: impl Fn(usize, &mut [&mut [f64]]) + Send + Sync,
) -> Result<Vec<f64>> {
    let mut images = zeros("images", lights * pixels * 3)?;
    if images.is_empty() {
        return Ok(images);
    }
    // Each piece of work writes its own part of every picture.
    let pieces = chunks_of_planes(&mut images, pixels * 3, piece * 3);
    let pieces = pieces.enumerate().collect();
    pool::map(threads, pieces, |(i, mut parts): (usize, Vec<_>)| {
        fill(i * piece, &mut parts);
    });
    Ok(images)
}

/// Renders the pixels from `first` on that the parts have room for.
fn render_chunk<M: Reflection>(
    (normals, views): (&[DVec3], &[DVec3]),
    materials: &[Material],
    lights: &[[[f64; COEFFICIENTS]; 3]],
    transfer: Option<&Transfer>,
    first: usize,
    parts: &mut [&mut [f64]],
) {
    let isa = Instructions::best();
    let mut given = GivenDirections::default();
    let mut directions = Directions::<f64>::default();
    let mut of_block = Materials::<3>::default();
    let mut basis = Basis::<f64>::default();
    let mut functions = no_functions();
    let model = M::default();
    let mut factors: [ChannelFactors<f64>; 3] = Default::default();
    let mut weights = [[Plane::default(); COEFFICIENTS]; 3];
    let mut radiance = Plane::default();
    let end = first + parts[0].len() / 3;
    for block in (first..end).step_by(BLOCK) {
        let count = BLOCK.min(end - block);
        for x in 0..count {
            given.set(x, [normals[block + x], views[block + x]]);
            of_block.set(x, &materials[block + x]);
        }
        vectorized!(isa, given.place(&mut directions));
        match transfer {
            Some(transfer) => transfer.fill_basis::<M, f64>(block..block + count, &mut basis),
            None => {
                let (directions, basis) = (&directions, &mut basis);
                vectorized!(isa, fill_basis::<M, f64, COEFFICIENTS>(directions, basis));
            }
        }
        isa.run(FillFactors::<M, _, _> {
            directions: &directions,
            materials: &of_block,
            pixels: count,
            by_cosine: false,
            functions: &mut functions,
            factors: &mut factors,
        });
        isa.run(FillWeights {
            basis: &basis,
            factors: &factors,
            weights: &mut weights,
            model,
        });
        for c in 0..3 {
            for (i, (light, part)) in lights.iter().zip(parts.iter_mut()).enumerate() {
                isa.run(Radiance {
                    weights: &weights[c],
                    light: &light[c],
                    radiance: &mut radiance,
                });
                if let Some(transfer) = transfer.filter(|transfer| !transfer.bounced.is_empty()) {
                    for (x, radiance) in radiance.0[..count].iter_mut().enumerate() {
                        for s in 0..=M::ROWS {
                            let factor = match s {
                                0 => factors[c].diffuse.0[x],
                                s => factors[c].rows[s - 1].0[x],
                            };
                            let brought = transfer.bounced_of::<M>(block + x, s, lights.len() * 3);
                            *radiance += factor * f64::from(brought[i * 3 + c]);
                        }
                    }
                }
                let pixels = part[(block - first) * 3..].as_chunks_mut::<3>().0;
                for (pixel, radiance) in pixels.iter_mut().zip(&radiance.0[..count]) {
                    pixel[c] = *radiance;
                }
            }
        }
    }
}
