//! The rows of a pixel among its surroundings, and what these bring of each picture.

use glam::{DVec3, Vec3A};

use super::dual::{Batch, Dual, RAYS};
use super::sampling::Rays;
use super::surroundings::{LARGEST, Surroundings};
use crate::block::basis::Basis;
use crate::reflectance::model::{Model, with_model};
use crate::reflectance::planes::{BLOCK, MAX_ROWS, directions};
use crate::reflectance::reflection::{Reflection, each_entry};
use crate::reflectance::sh::{self, COEFFICIENTS, Real};
use crate::reflectance::shade::Frame;
use crate::runtime::check::LARGEST_F32;
use crate::runtime::memory::zeros;
use crate::runtime::simd::{Instructions, vectorized};
use crate::runtime::{Error, Result, check, pool};

/// Pixels in a piece of work.
const PIECE: usize = 64;

/// Rays of a pixel at most; far from where float32 counts no further.
const MAX_RAYS: usize = 1 << 20;

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
    /// For each surface from number 1 on, which pixel shows it nearest to each pixel: (surface, row,
    /// column), pixels counted row by row. Surface 0 is whatever a pixel shows.
    pub nearest: &'a [u32],
}

impl<'a> Radiance<'a> {
    fn values(&self) -> usize {
        self.samples.len() / (self.size[0] * self.size[1]).max(1)
    }

    /// What pictures have of a surface where a point of it is seen, or nearest to there.
    fn at(&self, point: Vec3A, surface: u8) -> &'a [f32] {
        let [height, width] = self.size.map(|size| size as f32);
        let scale = if self.half_width == 0.0 {
            1.0
        } else if -point.z > 1e-3 * point.length() {
            self.half_width * -point.z
        } else {
            // Behind the camera the nearest edge is that in the point's direction.
            (point.x.abs())
                .max(point.y.abs() * width / height)
                .max(f32::MIN_POSITIVE)
        };
        let place = |x: f32, size: f32| (0.5 * (x + size)).clamp(0.0, size - 1.0) as usize;
        let column = place(point.x / scale * width, width);
        let row = place(-point.y / scale * width, height);
        let mut pixel = row * self.size[1] + column;
        if surface > 0 {
            let of_surface = (usize::from(surface) - 1) * self.size[0] * self.size[1];
            pixel = self.nearest[of_surface + pixel] as usize;
        }
        let values = self.values();
        &self.samples[pixel * values..][..values]
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
    let coordinates: Vec<f64> = origins.points.iter().flat_map(DVec3::to_array).collect();
    check::moderate("points", &coordinates, LARGEST)?;
    if !(1..=MAX_RAYS).contains(&rays) {
        return Err(Error::argument("rays", format!("1 to {MAX_RAYS}"), rays));
    }
    let values = radiance.as_ref().map_or(0, Radiance::values);
    if let Some(radiance) = &radiance {
        let size = radiance.size[0] * radiance.size[1];
        if size == 0 {
            return Err(Error::argument("radiance", "at least one pixel", "none"));
        }
        check::length("radiance", values * size, radiance.samples.len())?;
        check::moderate("radiance", radiance.samples, LARGEST_F32)?;
        if !(radiance.half_width >= 0.0 && radiance.half_width.is_finite()) {
            let found = radiance.half_width;
            return Err(Error::argument("half_width", "a tangent, 0 or more", found));
        }
        let surfaces = usize::from(surroundings.last_surface());
        check::length("nearest", surfaces * size, radiance.nearest.len())?;
        if let Some(&beyond) = radiance.nearest.iter().find(|&&i| i as usize >= size) {
            let expected = format!("pixels below {size}");
            return Err(Error::argument("nearest", expected, beyond));
        }
    }
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
                let bounced = bounced.get_mut(i * rows * values..(i + 1) * rows * values);
                let to = (to.as_chunks_mut().0, bounced.unwrap_or_default());
                let pixel = (origins, piece * PIECE + i);
                fill_pixel::<M>(surroundings, pixel, model, rays, radiance, to);
            }
        });
        Ok(found)
    })
}

/// Writes the rows of pixel p: those of the open sky less what is blocked; and what that brings.
fn fill_pixel<M: Reflection>(
    surroundings: &Surroundings,
    (origins, p): (Origins, usize),
    model: Model,
    rays: usize,
    radiance: Option<Radiance>,
    (rows, bounced): (&mut [[f32; COEFFICIENTS]], &mut [f32]),
) {
    let [normal, view] = [origins.normals[p], origins.views[p]];
    let (cosine, _) = directions(normal, view);
    let open = Frame::<M>::new(normal, view);
    rows[0] = open.diffuse.map(|y| y as f32);
    each_entry::<M, COEFFICIENTS>(|k, row, entry| rows[1 + row][k] = open.lobe[entry] as f32);
    let [normal, view, point] = [normal, view, origins.points[p]].map(|v| v.as_vec3a());
    let dual = Dual::new(model, cosine, normal, view);
    let mut blocked = Blocked::new(&dual, normal, bounced);
    Rays::new(normal, view, rays, origins.seeds[p]).each(|direction, weight| match radiance {
        None => {
            if surroundings.blocks(point, direction) {
                blocked.push(direction, weight, &[]);
            }
        }
        Some(radiance) => {
            if let Some(hit) = surroundings.hit(point, direction) {
                let shown = radiance.at(point + hit.distance * direction, hit.surface);
                blocked.push(direction, weight, shown);
            }
        }
    });
    for (row, blocked) in rows.iter_mut().zip(&blocked.finish()) {
        for k in 0..COEFFICIENTS {
            row[k] -= blocked[k];
        }
    }
}

/// Sums over blocked rays, a batch of them at a time.
struct Blocked<'a, 'b> {
    dual: &'a Dual,
    normal: Vec3A,
    batch: Batch,
    /// What each ray brings.
    shown: [&'a [f32]; RAYS],
    count: usize,
    rows: [[f32; COEFFICIENTS]; 1 + MAX_ROWS],
    bounced: &'b mut [f32],
}

impl<'a, 'b> Blocked<'a, 'b> {
    fn new(dual: &'a Dual, normal: Vec3A, bounced: &'b mut [f32]) -> Self {
        Self {
            dual,
            normal,
            batch: Batch {
                direction: [[0.0; RAYS]; 3],
                weight: [0.0; RAYS],
            },
            shown: [&[]; RAYS],
            count: 0,
            rows: [[0.0; COEFFICIENTS]; 1 + MAX_ROWS],
            bounced,
        }
    }

    fn push(&mut self, direction: Vec3A, weight: f32, shown: &'a [f32]) {
        for axis in 0..3 {
            self.batch.direction[axis][self.count] = direction[axis];
        }
        self.batch.weight[self.count] = weight;
        self.shown[self.count] = shown;
        self.count += 1;
        if self.count == RAYS {
            vectorized!(Instructions::best(), self.add());
            self.count = 0;
        }
    }

    fn finish(mut self) -> [[f32; COEFFICIENTS]; 1 + MAX_ROWS] {
        if self.count > 0 {
            self.batch.weight[self.count..].fill(0.0);
            vectorized!(Instructions::best(), self.add());
        }
        self.rows
    }

    /// Adds the batch: Σ w q Y, and Σ w q times what its rays bring.
    #[inline(always)]
    fn add(&mut self) {
        /// Partial sums, so that additions need not wait for each other.
        const LANES: usize = 16;
        let Self {
            dual,
            normal,
            batch,
            shown,
            count,
            rows,
            bounced,
        } = self;
        let mut q = [[0.0; RAYS]; 1 + MAX_ROWS];
        let (matt, lobe) = q.split_first_mut().expect("the matt part's row");
        for x in 0..RAYS {
            matt[x] = batch.weight[x] * batch.dot(*normal, x);
        }
        dual.fill(batch, lobe.first_chunk_mut().expect("rows of the lobe"));
        for row in &mut lobe[..dual.rows()] {
            for x in 0..RAYS {
                row[x] *= batch.weight[x];
            }
        }
        let mut harmonics = [[0.0; RAYS]; COEFFICIENTS];
        for x in 0..RAYS {
            let of_ray = sh::basis(batch.direction.each_ref().map(|axis| axis[x]));
            for k in 0..COEFFICIENTS {
                harmonics[k][x] = of_ray[k];
            }
        }
        for (sums, q) in rows.iter_mut().zip(&q[..1 + dual.rows()]) {
            for k in 0..COEFFICIENTS {
                let mut lanes = [0.0; LANES];
                for (q, y) in q.chunks_exact(LANES).zip(harmonics[k].chunks_exact(LANES)) {
                    for x in 0..LANES {
                        lanes[x] += q[x] * y[x];
                    }
                }
                sums[k] += lanes.iter().sum::<f32>();
            }
        }
        if bounced.is_empty() {
            return;
        }
        for (x, shown) in shown[..*count].iter().enumerate() {
            for (sums, q) in bounced.chunks_exact_mut(shown.len()).zip(&q) {
                for (sum, value) in sums.iter_mut().zip(*shown) {
                    *sum += q[x] * value;
                }
            }
        }
    }
}

#[cfg(test)]
#[path = "../../tests/rust/transport_table.rs"]
mod tests;
