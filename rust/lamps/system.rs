//! Normal equations of pixels and of the lights that they share.
//!
//! The lights' unknowns y are the place and the colour of each lamp k, and the ambient light of each
//! picture i; those z of a pixel are two tangent offsets of its normal, albedos and roughness. With the
//! residuals e of [`samples`](super::samples), their weights W and Jacobians, of each pixel
//!
//! ```text
//! A = J_zᵀ W J_z      B = J_zᵀ W J_y      g = J_zᵀ W e      h = J_yᵀ W e,      and of all Σ J_yᵀ W J_y.
//! ```
//!
//! A lamp's radiance s c I(ω) in a channel, of strength s and colour c, changes with its place q as
//!
//! ```text
//! ∂(s c I)/∂q = s c (τ ∂I/∂ω + I ∂ln s/∂q),
//! ```
//!
//! where a small change of q turns the direction ω by τ times its part across ω. A sample sees no light
//! but that of its own picture, so the lights' matrix has a block for each picture.

use std::marker::PhantomData;

use glam::DVec3;

use super::ambient::weights_with_slopes;
use super::number::Wide;
use super::pixel_fit::LampPictures;
use super::samples::{LANES, Lanes, NONE, Samples};
use super::surface::{Reflected, Surface};
use crate::reflectance::model::with_model;
use crate::reflectance::planes::Material;
use crate::reflectance::reflection::Reflection;
use crate::reflectance::tangent_offset::tangents;
use crate::runtime::check::LARGEST_F32;
use crate::runtime::memory::zeros;
use crate::runtime::simd::{Isa, Kernel, Vectors};
use crate::runtime::{Result, check, pool};

/// Pixels in a piece of work.
const PIECE: usize = 64;
/// Unknowns of a pixel: offsets, albedos, roughness.
pub const OF_PIXEL: usize = 6;
/// Numbers of a sample: weight, residual, derivatives by offsets, its albedo, roughness.
const SHOWN: usize = 6;
/// The same, and what is left of the samples.
pub const ROWS: usize = OF_PIXEL + 1;

/// How radiance changes with places and colours of lamps.
#[derive(Clone, Copy, Debug)]
pub struct Movable<'a> {
    /// s: as [`LampPictures::directions`].
    pub strengths: &'a [f64],
    /// τ and ∂ln s/∂q: likewise.
    pub by_place: &'a [[f64; 4]],
    /// Whether Σ J_yᵀ W J_y is wanted.
    pub of_lights: bool,
}

/// See the [module](self). Columns are places of all lamps, their colours, then ambient light.
#[derive(Clone, Debug, Default)]
pub struct LampSystem {
    /// A, and g in the last row: (pixel).
    pub own: Vec<[[f64; OF_PIXEL]; ROWS]>,
    /// B, and h in the last row: (pixel, row, column).
    pub mixed: Vec<f64>,
    /// Σ J_yᵀ W J_y: (column, column); 0 where it is not wanted.
    pub shared: Vec<f64>,
}

/// The equations at normals and materials.
///
/// The result does not depend on the number of threads.
pub fn lamp_system(
    given: &LampPictures,
    weights: &[[f64; 3]],
    movable: Movable,
    normals: &[DVec3],
    materials: &[Material],
) -> Result<LampSystem> {
    let lights = given.check("normals", weights, normals, materials)?;
    let (pixels, lamps) = (materials.len(), given.picture_of.len());
    check::length("strengths", given.directions.len(), movable.strengths.len())?;
    check::length("by_place", given.directions.len(), movable.by_place.len())?;
    check::moderate("strengths", movable.strengths, LARGEST_F32)?;
    check::moderate("by_place", movable.by_place.as_flattened(), LARGEST_F32)?;
    let first = |i: usize| given.picture_of.partition_point(|&of| of < i);
    let columns_of = |i| {
        [0, 1, 2].map(|c| {
            let lamp = |k| [3 * k, 3 * k + 1, 3 * k + 2, 3 * (lamps + k) + c];
            let of_lamps = (first(i)..first(i + 1)).flat_map(lamp);
            of_lamps.chain([6 * lamps + 3 * i + c]).collect()
        })
    };
    let pictures: Vec<[Vec<usize>; 3]> = (0..given.ambient.len()).map(columns_of).collect();
    let columns = 6 * lamps + 3 * pictures.len();
    let mut system = LampSystem {
        own: zeros("albedo", pixels)?,
        mixed: zeros("directions", pixels * ROWS * columns)?,
        shared: zeros("directions", columns * columns)?,
    };
    let mixed = system.mixed.chunks_mut(PIECE * ROWS * columns.max(1));
    let pieces = (system.own.chunks_mut(PIECE).zip(mixed).enumerate()).collect();
    let sums = pool::map(given.threads, pieces, |(piece, (own, mixed))| {
        let samples = pictures.as_flattened().iter();
        let mut sums: Vec<Vec<f64>> = samples.map(|at| vec![0.0; at.len() * at.len()]).collect();
        let mut seen = Seen::default();
        let rows = own.iter_mut().zip(mixed.chunks_mut(ROWS * columns.max(1)));
        for (p, (own, mixed)) in (piece * PIECE..).zip(rows) {
            let of_lamps = given.lamps_of(p);
            with_model!(given.model, M => lights.instructions.run(OfPixel {
                samples: &Samples::new(given, weights, &lights, p),
                normal: normals[p],
                material: &materials[p],
                strengths: &movable.strengths[of_lamps.clone()],
                by_place: &movable.by_place[of_lamps.clone()],
                intensities: &given.intensities[of_lamps],
                pictures: &pictures,
                of_lights: movable.of_lights,
                seen: &mut seen,
                own,
                mixed,
                sums: &mut sums,
                model: PhantomData::<M>,
            }));
        }
        sums
    });
    let each = |of| pictures.as_flattened().iter().zip(of);
    for (at, sums) in sums.iter().flat_map(each) {
        for (&x, row) in at.iter().zip(sums.chunks(at.len())) {
            for (&y, value) in at.iter().zip(row) {
                system.shared[x * columns + y] += value;
            }
        }
    }
    Ok(system)
}

/// What one pixel adds.
struct OfPixel<'a, M> {
    samples: &'a Samples<'a>,
    normal: DVec3,
    material: &'a Material,
    /// By lamp, as [`Movable`] and [`LampPictures`] have them.
    strengths: &'a [f64],
    by_place: &'a [[f64; 4]],
    intensities: &'a [[f64; 3]],
    /// Columns that each channel of each picture sees: place and colour of every lamp, then ambient
    /// light.
    pictures: &'a [[Vec<usize>; 3]],
    of_lights: bool,
    seen: &'a mut Seen,
    own: &'a mut [[f64; OF_PIXEL]; ROWS],
    mixed: &'a mut [f64],
    /// Of each picture and channel Σ J_yᵀ W J_y.
    sums: &'a mut [Vec<f64>],
    model: PhantomData<M>,
}

/// Slopes of a pixel's samples.
#[derive(Default)]
struct Seen {
    /// By picture and channel: weight, and derivatives by the pixel's unknowns, then the residual.
    samples: Vec<[(f64, [f64; ROWS]); 3]>,
    /// By picture and channel, by the light's unknowns.
    by_light: Vec<[Vec<f64>; 3]>,
}

impl<M: Reflection> Kernel for OfPixel<'_, M> {
    type Output = ();

    #[inline(always)]
    fn run<I: Isa>(self, isa: I) {
        let turned = tangents(self.normal);
        let vectors = [self.normal, self.samples.view];
        let ambient = weights_with_slopes::<M>(vectors, self.material, &turned);
        let surface = Surface::<true>::new(
            self.samples.model,
            self.normal,
            self.samples.view,
            self.material,
        );
        let Seen { samples, by_light } = self.seen;
        samples.resize(self.pictures.len(), Default::default());
        by_light.resize(self.pictures.len(), Default::default());
        for i in 0..self.pictures.len() {
            for c in 0..3 {
                let ends = self.pictures[i][c].len();
                by_light[i][c].resize(ends, 0.0);
                by_light[i][c][ends - 1] = ambient.0[c];
            }
        }
        for (b, lights) in self.samples.lights.blocks.iter().enumerate() {
            let here = LANES * b..self.pictures.len().min(LANES * (b + 1));
            let none = [[[0.0; LANES]; 4]; 3];
            let mut units = vec![none; lights.lamps.len()];
            let mut shown = [[[0.0; LANES]; SHOWN]; 3];
            for at in 0..LANES / <I as Vectors<f64>>::LANES {
                let put = |lanes: &mut Lanes, value: Wide<I>| I::of_mut(lanes)[at] = value.1;
                let each = |k: usize, lit: Wide<I>, unit: &Reflected<Wide<I>>| {
                    let by_direction = unit.by_direction();
                    for c in 0..3 {
                        let [x, y, z] = by_direction[c];
                        let all = [unit.radiance[c], x, y, z];
                        for a in 0..4 {
                            put(&mut units[k][c][a], lit * all[a]);
                        }
                    }
                };
                let seen = self
                    .samples
                    .seen(isa, [b, at], &surface, &turned, &Some(ambient), each);
                for c in 0..3 {
                    let [albedo, roughness, _, first, second] = seen.slopes[c];
                    let all = [
                        seen.weights[c],
                        seen.residuals[c],
                        first,
                        second,
                        albedo,
                        roughness,
                    ];
                    for x in 0..SHOWN {
                        put(&mut shown[c][x], all[x]);
                    }
                }
            }
            for i in here {
                let lane = i - LANES * b;
                for c in 0..3 {
                    let [weight, residual, first, second, albedo, roughness] =
                        shown[c].map(|lanes| lanes[lane]);
                    let mut rows = [first, second, 0.0, 0.0, 0.0, roughness, residual];
                    rows[2 + c] = albedo;
                    samples[i][c] = (weight, rows);
                    for j in 0..units.len() {
                        let k = lights.lamps[j][lane];
                        if k == NONE {
                            continue;
                        }
                        let (of_unit, by_place) = (&units[j][c], &self.by_place[k]);
                        let unit = of_unit[0][lane];
                        let of_lamp = &mut by_light[i][c][4 * j..4 * j + 4];
                        for a in 0..3 {
                            let moved = by_place[0] * of_unit[1 + a][lane] + unit * by_place[1 + a];
                            of_lamp[a] = self.intensities[k][c] * moved;
                        }
                        of_lamp[3] = self.strengths[k] * unit;
                    }
                }
            }
        }
        let columns = self.mixed.len() / ROWS;
        for i in 0..3 * self.pictures.len() {
            let (weight, rows) = &samples.as_flattened()[i];
            let at = &self.pictures.as_flattened()[i][..];
            let by = &by_light.as_flattened()[i][..at.len()];
            let sums = &mut self.sums[i][..];
            for x in 0..ROWS {
                let weighted = weight * rows[x];
                // Two of the albedos are of other channels.
                if weighted == 0.0 {
                    continue;
                }
                for y in 0..OF_PIXEL {
                    self.own[x][y] = I::fma(weighted, rows[y], self.own[x][y]);
                }
                let mixed = &mut self.mixed[x * columns..(x + 1) * columns];
                for j in 0..at.len() {
                    mixed[at[j]] = I::fma(weighted, by[j], mixed[at[j]]);
                }
            }
            for j in 0..if self.of_lights { at.len() } else { 0 } {
                let weighted = weight * by[j];
                let sums = &mut sums[j * at.len()..(j + 1) * at.len()];
                for k in 0..at.len() {
                    sums[k] = I::fma(weighted, by[k], sums[k]);
                }
            }
        }
    }
}
