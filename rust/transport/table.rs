//! The rows of a pixel among its surroundings, and what these bring of each picture.

use glam::{DVec3, Vec3A};

use super::dual::Dual;
use super::sampling::Rays;
use super::surroundings::Surroundings;
use crate::block::basis::Basis;
use crate::reflectance::model::{Model, with_model};
use crate::reflectance::planes::{BLOCK, MAX_ROWS, directions};
use crate::reflectance::reflection::{Reflection, each_entry};
use crate::reflectance::sh::{self, COEFFICIENTS, Real};
use crate::reflectance::shade::Frame;
use crate::runtime::memory::zeros;
use crate::runtime::{Error, Result, check, pool};

/// Pixels in a piece of work.
const PIECE: usize = 64;

/// Pixels that rays start from.
#[derive(Clone, Copy, Debug)]
pub struct Origins<'a> {
    /// Where rays start, off the surface by as much as keeps them from meeting it.
    pub points: &'a [DVec3],
    /// Unit normals.
    pub normals: &'a [DVec3],
    /// Unit vectors to the camera.
    pub views: &'a [DVec3],
    /// A number of its own for each pixel, which its rays follow from.
    pub seeds: &'a [u64],
}

/// Pictures of the surroundings, which tell what a blocked ray brings.
#[derive(Clone, Copy, Debug)]
pub struct Radiance<'a> {
    /// (row, column, picture and channel)
    pub samples: &'a [f32],
    /// Rows and columns.
    pub size: [usize; 2],
    /// Tangent of half of the horizontal field of view; 0 is orthographic.
    pub half_width: f32,
}

impl<'a> Radiance<'a> {
    fn values(&self) -> usize {
        self.samples.len() / (self.size[0] * self.size[1]).max(1)
    }

    /// What pictures have where a point is seen, or at the edge that is nearest to it.
    fn at(&self, point: Vec3A) -> &'a [f32] {
        let [height, width] = self.size.map(|size| size as f32);
        let scale = if self.half_width > 0.0 {
            // Behind the camera the nearest edge is that in the point's direction.
            self.half_width * (-point.z).max(1e-6 * point.length())
        } else {
            1.0
        };
        let place = |x: f32, size: f32| (0.5 * (x + size)).clamp(0.0, size - 1.0) as usize;
        let column = place(point.x / scale * width, width);
        let row = place(-point.y / scale * width, height);
        let values = self.values();
        &self.samples[(row * self.size[1] + column) * values..][..values]
    }
}

/// Rows in the place of the model's, pixel by pixel: the matt part's, then those of the lobe.
#[derive(Clone, Debug, Default)]
pub struct Transfer {
    /// (pixel, row, coefficient)
    pub rows: Vec<f32>,
    /// What blocked rays bring to each row: (pixel, row, picture and channel), or empty.
    pub bounced: Vec<f32>,
}

impl Transfer {
    /// Rows of a pixel, by coefficient.
    pub(crate) fn rows_of<M: Reflection>(&self, pixel: usize) -> &[[f32; COEFFICIENTS]] {
        &self.rows.as_chunks().0[pixel * (1 + M::ROWS)..][..1 + M::ROWS]
    }

    /// What is brought to a row of a pixel, so many values of pictures and channels.
    pub(crate) fn bounced_of<M: Reflection>(
        &self,
        pixel: usize,
        row: usize,
        values: usize,
    ) -> &[f32] {
        &self.bounced[(pixel * (1 + M::ROWS) + row) * values..][..values]
    }

    /// The rows of some pixels, at most [`BLOCK`], as basis functions.
    pub(crate) fn fill_basis<M: Reflection, T: Real>(
        &self,
        pixels: impl ExactSizeIterator<Item = usize>,
        basis: &mut Basis<T>,
    ) {
        if pixels.len() < BLOCK {
            *basis = Basis::default();
        }
        for (x, p) in pixels.enumerate() {
            let rows = self.rows_of::<M>(p);
            for k in 0..COEFFICIENTS {
                basis.diffuse[k].0[x] = T::from_f64(rows[0][k].into());
            }
            each_entry::<M, COEFFICIENTS>(|k, row, entry| {
                basis.lobe[entry].0[x] = T::from_f64(rows[1 + row][k].into());
            });
        }
    }
}

/// The transfer of pixels, from about `rays` rays each; the same at any number of threads.
pub fn transfer(
    surroundings: &Surroundings,
    origins: Origins,
    model: Model,
    rays: usize,
    radiance: Option<Radiance>,
    threads: usize,
) -> Result<Transfer> {
    let pixels = origins.points.len();
    check::length("normals", pixels, origins.normals.len())?;
    check::length("views", pixels, origins.views.len())?;
    check::length("seeds", pixels, origins.seeds.len())?;
    check::unit_vectors("normals", origins.normals)?;
    check::unit_vectors("views", origins.views)?;
    if origins.points.iter().any(|point| !point.is_finite()) {
        return Err(Error::argument(
            "points",
            "finite numbers",
            "NaN or infinity",
        ));
    }
    if rays == 0 {
        return Err(Error::argument("rays", "at least one", rays));
    }
    let values = radiance.as_ref().map_or(0, Radiance::values);
    with_model!(model, M => {
        let rows = 1 + M::ROWS;
        let mut found = Transfer {
            rows: zeros("transfer", pixels * rows * COEFFICIENTS)?,
            bounced: zeros("transfer", pixels * rows * values)?,
        };
        let mut bounced: Vec<_> = if values == 0 {
            (0..pixels).step_by(PIECE).map(|_| Default::default()).collect()
        } else {
            found.bounced.chunks_mut(PIECE * rows * values).collect()
        };
        let pieces = found
            .rows
            .chunks_mut(PIECE * rows * COEFFICIENTS)
            .zip(bounced.iter_mut())
            .enumerate()
            .collect();
        pool::map(threads, pieces, |(piece, (to, bounced)): (usize, (&mut [f32], &mut &mut [f32]))| {
            for (i, to) in to.chunks_mut(rows * COEFFICIENTS).enumerate() {
                let pixel = Pixel {
                    surroundings,
                    point: origins.points[piece * PIECE + i],
                    normal: origins.normals[piece * PIECE + i],
                    view: origins.views[piece * PIECE + i],
                    seed: origins.seeds[piece * PIECE + i],
                    model,
                    rays,
                };
                let bounced = bounced.get_mut(i * rows * values..(i + 1) * rows * values);
                pixel.fill::<M>(to.as_chunks_mut().0, radiance, bounced.unwrap_or_default());
            }
        });
        Ok(found)
    })
}

struct Pixel<'a> {
    surroundings: &'a Surroundings,
    point: DVec3,
    normal: DVec3,
    view: DVec3,
    seed: u64,
    model: Model,
    rays: usize,
}

impl Pixel<'_> {
    /// Writes its rows: those of the open sky less what is blocked; and what that brings.
    fn fill<M: Reflection>(
        &self,
        rows: &mut [[f32; COEFFICIENTS]],
        radiance: Option<Radiance>,
        bounced: &mut [f32],
    ) {
        let (cosine, _) = directions(self.normal, self.view);
        let open = Frame::<M>::new(self.normal, self.view);
        rows[0] = open.diffuse.map(|y| y as f32);
        each_entry::<M, COEFFICIENTS>(|k, row, entry| rows[1 + row][k] = open.lobe[entry] as f32);
        let [normal, view, point] = [self.normal, self.view, self.point].map(|v| v.as_vec3a());
        let dual = Dual::new(self.model, cosine, normal, view);
        let mut blocked = [[0.0; COEFFICIENTS]; 1 + MAX_ROWS];
        let mut by_row = [0.0; 1 + MAX_ROWS];
        Rays::new(normal, view, self.rays, self.seed).each(|direction, weight| {
            let hit = match radiance {
                None if !self.surroundings.blocks(point, direction) => return,
                None => None,
                Some(radiance) => {
                    let Some(distance) = self.surroundings.distance(point, direction) else {
                        return;
                    };
                    Some(radiance.at(point + distance * direction))
                }
            };
            let harmonics = sh::basis(direction.to_array());
            by_row[0] = weight * normal.dot(direction);
            by_row[1..].copy_from_slice(&dual.of(direction, weight));
            for (sums, factor) in blocked.iter_mut().zip(by_row) {
                for k in 0..COEFFICIENTS {
                    sums[k] += factor * harmonics[k];
                }
            }
            if let Some(hit) = hit {
                for (sums, factor) in bounced.chunks_mut(hit.len()).zip(by_row) {
                    for (sum, value) in sums.iter_mut().zip(hit) {
                        *sum += factor * value;
                    }
                }
            }
        });
        debug_assert_eq!(rows.len(), 1 + dual.rows());
        for (row, blocked) in rows.iter_mut().zip(&blocked) {
            for k in 0..COEFFICIENTS {
                row[k] -= blocked[k];
            }
        }
    }
}
