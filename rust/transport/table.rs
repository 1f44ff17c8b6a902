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
use crate::runtime::simd::{Instructions, Isa, Kernel};
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
        let mut blocked = Blocked::new(&dual, normal, bounced);
        Rays::new(normal, view, self.rays, self.seed).each(|direction, weight| match radiance {
            None => {
                if self.surroundings.blocks(point, direction) {
                    blocked.push(direction, weight, &[]);
                }
            }
            Some(radiance) => {
                if let Some(hit) = self.surroundings.hit(point, direction) {
                    let shown = radiance.at(point + hit.distance * direction, hit.surface);
                    blocked.push(direction, weight, shown);
                }
            }
        });
        let blocked = blocked.finish();
        debug_assert_eq!(rows.len(), 1 + dual.rows());
        for (row, blocked) in rows.iter_mut().zip(&blocked) {
            for k in 0..COEFFICIENTS {
                row[k] -= blocked[k];
            }
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
            self.add();
        }
    }

    fn finish(mut self) -> [[f32; COEFFICIENTS]; 1 + MAX_ROWS] {
        if self.count > 0 {
            self.batch.weight[self.count..].fill(0.0);
            self.add();
        }
        self.rows
    }

    fn add(&mut self) {
        Instructions::best().run(AddRays {
            dual: self.dual,
            normal: self.normal,
            batch: &self.batch,
            shown: &self.shown[..self.count],
            rows: &mut self.rows,
            bounced: self.bounced,
        });
        self.count = 0;
    }
}

/// Adds a batch of rays: Σ w q Y, and Σ w q times what they bring.
struct AddRays<'a, 'b> {
    dual: &'a Dual,
    normal: Vec3A,
    batch: &'b Batch,
    shown: &'b [&'a [f32]],
    rows: &'b mut [[f32; COEFFICIENTS]; 1 + MAX_ROWS],
    bounced: &'b mut [f32],
}

impl Kernel for AddRays<'_, '_> {
    type Output = ();

    #[inline(always)]
    fn run<I: Isa>(self, _: I) {
        /// Partial sums, so that additions need not wait for each other.
        const LANES: usize = 16;
        let Self {
            dual,
            normal,
            batch,
            shown,
            rows,
            bounced,
        } = self;
        let mut q = [[0.0; RAYS]; 1 + MAX_ROWS];
        let (matt, lobe) = q.split_first_mut().expect("the matt part's row");
        for x in 0..RAYS {
            matt[x] = batch.weight[x] * batch.dot(normal, x);
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
        for (x, shown) in shown.iter().enumerate() {
            for (sums, q) in bounced.chunks_exact_mut(shown.len()).zip(&q) {
                for (sum, value) in sums.iter_mut().zip(*shown) {
                    *sum += q[x] * value;
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::reflectance::lobe_table;
    use crate::reflectance::planes::Material;
    use crate::reflectance::reflection::Factors;
    use crate::reflectance::shade::{factors_at, shade};
    use crate::transport::tests::Numbers;

    const MODELS: [Model; 2] = [Model::Paper, Model::Principled];

    type Corners = [[[f32; 3]; 3]; 2];

    /// A square of `half` its side about a middle.
    fn square(middle: [f32; 3], u: [f32; 3], v: [f32; 3]) -> Corners {
        let [middle, u, v] = [middle, u, v].map(Vec3A::from);
        let [a, b, c, d] = [-u - v, u - v, u + v, v - u].map(|side| (middle + side).to_array());
        [[a, b, c], [a, c, d]]
    }

    /// A cube of 2 about the origin, each face a surface from number 1 on.
    fn cube() -> Surroundings {
        let mut triangles = Vec::new();
        for axis in 0..3 {
            for side in [-1.0, 1.0] {
                let turned = |by: usize, size: f32| {
                    let mut vector = [0.0; 3];
                    vector[(axis + by) % 3] = size;
                    vector
                };
                triangles.extend(square(turned(0, side), turned(1, 1.0), turned(2, 1.0)));
            }
        }
        let surfaces: Vec<u8> = (0..12).map(|i| 1 + i / 2).collect();
        Surroundings::new(&triangles, &surfaces).unwrap()
    }

    fn picture<'a>(size: [usize; 2], samples: &'a [f32], nearest: &'a [u32]) -> Radiance<'a> {
        Radiance {
            samples,
            size,
            half_width: 0.5,
            nearest,
        }
    }

    fn nothing() -> Surroundings {
        Surroundings::new(&[], &[]).unwrap()
    }

    struct Pixels {
        points: Vec<DVec3>,
        normals: Vec<DVec3>,
        views: Vec<DVec3>,
        seeds: Vec<u64>,
    }

    impl Pixels {
        /// Within the cube, seen at up to so many degrees.
        fn new(count: usize, degrees: f32) -> Self {
            let mut numbers = Numbers(9);
            let mut found = Self {
                points: Vec::new(),
                normals: Vec::new(),
                views: Vec::new(),
                seeds: (0..count as u64).map(|i| 1000 + 7 * i).collect(),
            };
            for _ in 0..count {
                let point = std::array::from_fn(|_| f64::from(0.6 * numbers.signed()));
                let normal = numbers.direction();
                let (x, y) = normal.any_orthonormal_pair();
                let (sin, cos) = (degrees * numbers.next()).to_radians().sin_cos();
                let (across, along) = (std::f32::consts::TAU * numbers.next()).sin_cos();
                let view = cos * normal + sin * (along * x + across * y);
                found.points.push(DVec3::from(point));
                found.normals.push(normal.as_dvec3().normalize());
                found.views.push(view.as_dvec3().normalize());
            }
            found
        }

        fn origins(&self) -> Origins<'_> {
            Origins {
                points: &self.points,
                normals: &self.normals,
                views: &self.views,
                seeds: &self.seeds,
            }
        }

        fn transfer(&self, surroundings: &Surroundings, model: Model, rays: usize) -> Transfer {
            transfer(surroundings, self.origins(), model, rays, None, 1).unwrap()
        }

        /// Radiance of a pixel under uniform light of radiance 1, with rows of a transfer: of a
        /// white surface and one that is a metal. And as in the open.
        fn radiance<M: Reflection>(
            &self,
            found: &Transfer,
            p: usize,
            roughness: f64,
        ) -> [[f64; 2]; 2] {
            let frame = Frame::<M>::new(self.normals[p], self.views[p]);
            [0.0, 1.0].map(|metallic| {
                let material = Material {
                    albedo: [0.8],
                    roughness,
                    metallic,
                };
                let factors = factors_at(&frame, &material);
                let y = 4.0 * std::f64::consts::PI; // of Y_0 for a light of 1
                let rows = found.rows_of::<M>(p);
                let blocked: f64 = (0..=M::ROWS)
                    .map(|s| {
                        let factor = match s {
                            0 => factors.diffuse(0),
                            s => factors.row(0, s - 1),
                        };
                        factor * f64::from(rows[s][0])
                    })
                    .sum();
                [blocked, shade(&frame, &material)[0][0]].map(|w| w * y.sqrt())
            })
        }
    }

    #[test]
    fn with_nothing_about_rows_are_those_of_the_model() {
        let pixels = Pixels::new(150, 100.0);
        for model in MODELS {
            let found = pixels.transfer(&nothing(), model, 2048);
            let none = Pixels::new(0, 0.0).transfer(&cube(), model, 64);
            assert!(none.rows.is_empty());
            with_model!(model, M => for p in 0..150 {
                let open = Frame::<M>::new(pixels.normals[p], pixels.views[p]);
                let mut expected = vec![[0.0; COEFFICIENTS]; 1 + M::ROWS];
                expected[0] = open.diffuse.map(|y| y as f32);
                each_entry::<M, COEFFICIENTS>(|k, row, entry| {
                    expected[1 + row][k] = open.lobe[entry] as f32;
                });
                assert_eq!(found.rows_of::<M>(p), expected);
            });
        }
    }

    /// Of the principled model at any view. The paper's lobe takes light from below the horizon too
    /// where it is seen aslant, which nothing blocks: so seen from above.
    #[test]
    fn in_a_closed_box_no_light_arrives() {
        for (model, degrees) in [(Model::Paper, 0.0), (Model::Principled, 75.0)] {
            let pixels = Pixels::new(60, degrees);
            let found = pixels.transfer(&cube(), model, 2048);
            for roughness in [0.2, 0.35, 0.6, 1.0] {
                let mut squares = [0.0; 2];
                for p in 0..60 {
                    let of_pixel =
                        with_model!(model, M => pixels.radiance::<M>(&found, p, roughness));
                    for [left, open] in of_pixel {
                        let holds = left.abs() < 0.06 * open;
                        assert!(holds, "{model:?}, roughness {roughness}: {left} of {open}");
                        squares[0] += left * left;
                        squares[1] += open * open;
                    }
                }
                let share = (squares[0] / squares[1]).sqrt();
                assert!(share < 0.015, "{model:?}, roughness {roughness}: {share}");
            }
        }
    }

    /// And the least squares are then exact, for every lobe is: what is left is the rays' noise,
    /// which falls as their number grows.
    #[test]
    fn what_is_left_in_a_closed_box_is_the_rays_noise() {
        let pixels = Pixels::new(25, 60.0);
        let left = |rays: usize| {
            let found = pixels.transfer(&cube(), Model::Principled, rays);
            let squares: f64 = (0..25)
                .flat_map(
                    |p| with_model!(Model::Principled, M => pixels.radiance::<M>(&found, p, 0.5)),
                )
                .map(|[left, _]| left * left)
                .sum();
            squares.sqrt()
        };
        let (few, many) = (left(300), left(15_000));
        assert!(many < 0.15 * few, "{few}, then {many}");
    }

    /// A wall that hides all with x > 0 from a floor leaves the matt row of half of the sky, by
    /// quadrature.
    #[test]
    fn a_long_wall_hides_half_of_the_sky() {
        let wall = square([1e-2, 0.0, 0.0], [0.0, 50.0, 0.0], [0.0, 0.0, 50.0]);
        let surroundings = Surroundings::new(&wall, &[0, 0]).unwrap();
        let pixels = Pixels {
            points: vec![DVec3::new(0.0, 0.0, 1e-4)],
            normals: vec![DVec3::Z],
            views: vec![DVec3::new(-0.6, 0.0, 0.8)],
            seeds: vec![4],
        };
        let mut expected = [0.0; COEFFICIENTS];
        const POLAR: usize = 200;
        const AROUND: usize = 400;
        for i in 0..POLAR {
            // dω n·ω = ½ d(z²) dφ
            let z2 = (i as f64 + 0.5) / POLAR as f64;
            for j in 0..AROUND {
                let turn = std::f64::consts::TAU * (j as f64 + 0.5) / AROUND as f64;
                let (sin, cos) = turn.sin_cos();
                if cos > 0.0 {
                    continue;
                }
                let radius = (1.0 - z2).sqrt();
                let y = sh::basis([radius * cos, radius * sin, z2.sqrt()]);
                let area = std::f64::consts::PI / (POLAR * AROUND) as f64;
                for k in 0..COEFFICIENTS {
                    expected[k] += area * y[k];
                }
            }
        }
        for model in MODELS {
            let found = pixels.transfer(&surroundings, model, 10_000);
            for k in 0..COEFFICIENTS {
                let row = f64::from(found.rows[k]);
                assert!(
                    (row - expected[k]).abs() < 2e-3,
                    "{model:?}: {row} at {k}, expected {}",
                    expected[k]
                );
            }
        }
    }

    /// A wall in the mirror direction hides a narrow lobe and no matt light to speak of; one at its
    /// side does not touch the lobe.
    #[test]
    fn a_small_screen_hides_what_is_mirrored_there() {
        let view = DVec3::new(-0.6, 0.0, 0.8);
        let pixels = Pixels {
            points: vec![DVec3::ZERO],
            normals: vec![DVec3::Z],
            views: vec![view],
            seeds: vec![0],
        };
        let screen = |x: f32| {
            let wall = square([x, 0.0, 8.0], [3.0, 0.0, 0.0], [0.0, 3.0, 0.0]);
            Surroundings::new(&wall, &[0, 0]).unwrap()
        };
        for model in MODELS {
            let share = |surroundings: &Surroundings| {
                let found = pixels.transfer(surroundings, model, 8192);
                let [_, [left, open]] =
                    with_model!(model, M => pixels.radiance::<M>(&found, 0, 0.15));
                left / open
            };
            let (hidden, beside) = (share(&screen(6.0)), share(&screen(-6.0)));
            assert!(hidden.abs() < 0.1, "{model:?}: {hidden}");
            assert!((beside - 1.0).abs() < 0.03, "{model:?}: {beside}");
        }
    }

    /// A white room of radiance 1 gives back all that it hides: light that is uniform stays so.
    #[test]
    fn a_room_as_bright_as_the_sky_is_not_seen() {
        let pixels = Pixels::new(40, 70.0);
        let samples = [1.0; 4 * 4];
        let nearest: Vec<u32> = (0..6 * 16).map(|i| i % 16).collect();
        let given = picture([4, 4], &samples, &nearest);
        // A screen on one side, so that part of the light comes from the sky itself.
        let wall = square([0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]);
        let screen = Surroundings::new(&wall, &[0, 0]).unwrap();
        for (surroundings, nearest) in [(cube(), &nearest[..]), (screen, &[])] {
            for model in MODELS {
                let given = Radiance { nearest, ..given };
                let found =
                    transfer(&surroundings, pixels.origins(), model, 2048, Some(given), 1).unwrap();
                with_model!(model, M => for p in 0..40 {
                    let open = Frame::<M>::new(pixels.normals[p], pixels.views[p]);
                    let rows = found.rows_of::<M>(p);
                    // Row by row to rounding: what is taken is what is given.
                    let y0 = (4.0 * std::f64::consts::PI).sqrt();
                    let mut expected = [0.0; 1 + M::ROWS];
                    expected[0] = open.diffuse[0];
                    each_entry::<M, 1>(|_, row, entry| expected[1 + row] = open.lobe[entry]);
                    for (s, expected) in expected.iter().enumerate() {
                        let brought = f64::from(found.bounced_of::<M>(p, s, 1)[0]);
                        let total = f64::from(rows[s][0]) * y0 + brought;
                        assert!(
                            (total - expected * y0).abs() < 1e-4 * (1.0 + brought.abs()),
                            "{model:?}, row {s}: {total}, expected {}",
                            expected * y0
                        );
                    }
                });
            }
        }
    }

    #[test]
    fn a_pixels_rows_depend_on_nothing_but_itself() {
        let pixels = Pixels::new(200, 80.0);
        let samples: Vec<f32> = (0..5 * 7 * 6)
            .map(|i| (i as f32 * 0.37).sin().abs())
            .collect();
        let nearest: Vec<u32> = (0..6 * 35).map(|i| (i * 11) % 35).collect();
        let given = picture([5, 7], &samples, &nearest);
        for model in MODELS {
            let of = |pixels: &Pixels, threads: usize| {
                transfer(&cube(), pixels.origins(), model, 100, Some(given), threads).unwrap()
            };
            let all = of(&pixels, 1);
            for threads in [2, 3] {
                let again = of(&pixels, threads);
                assert!(again.rows == all.rows && again.bounced == all.bounced);
            }
            // Alone, in another order and beside others.
            let order: Vec<usize> = (0..67).map(|i| (i * 131 + 5) % 200).collect();
            let few = Pixels {
                points: order.iter().map(|&p| pixels.points[p]).collect(),
                normals: order.iter().map(|&p| pixels.normals[p]).collect(),
                views: order.iter().map(|&p| pixels.views[p]).collect(),
                seeds: order.iter().map(|&p| pixels.seeds[p]).collect(),
            };
            let found = of(&few, 2);
            with_model!(model, M => for (i, &p) in order.iter().enumerate() {
                assert_eq!(found.rows_of::<M>(i), all.rows_of::<M>(p));
                for s in 0..=M::ROWS {
                    assert_eq!(found.bounced_of::<M>(i, s, 6), all.bounced_of::<M>(p, s, 6));
                }
            });
            // Whether pictures are given changes no row.
            assert_eq!(pixels.transfer(&cube(), model, 100).rows, all.rows);
        }
    }

    /// Twice as bright pictures bring twice as much, and the sum of two the sum.
    #[test]
    fn what_is_brought_is_linear_in_the_pictures() {
        let pixels = Pixels::new(10, 60.0);
        let mut numbers = Numbers(2);
        let samples: Vec<f32> = (0..16)
            .flat_map(|_| {
                let (a, b) = (numbers.next(), numbers.next());
                [a, b, a + b, 2.0 * a]
            })
            .collect();
        let nearest: Vec<u32> = (0..6 * 16).map(|i| i % 16).collect();
        let given = picture([4, 4], &samples, &nearest);
        for model in MODELS {
            let found = transfer(&cube(), pixels.origins(), model, 500, Some(given), 1).unwrap();
            for of_row in found.bounced.chunks(4) {
                let [a, b, sum, twice] = of_row.try_into().unwrap();
                assert!((a + b - sum).abs() < 1e-4 * (1.0 + a.abs() + b.abs()));
                assert!((2.0 * a - twice).abs() < 1e-4 * (1.0 + a.abs()));
            }
        }
    }

    #[test]
    fn points_are_looked_up_where_they_are_seen() {
        // Two rows, four columns; each pixel shows its own number.
        let samples: Vec<f32> = (0..8).map(|i| i as f32).collect();
        // Surface 1 is shown by pixel 5 alone; surface 2 by 0 and 3.
        let nearest = [[5; 8], [0, 0, 3, 3, 0, 0, 3, 3]].concat();
        let shows = |half_width: f32, point: [f32; 3], surface: u8| {
            let given = picture([2, 4], &samples, &nearest);
            let given = Radiance {
                half_width,
                ..given
            };
            given.at(Vec3A::from(point), surface)[0]
        };
        shows(0.5, [0.0; 3], 0); // at the camera itself: some pixel
        for (half_width, point, surface, expected) in [
            // At depth 2 a picture of half width 0.5 spans x from -1 to 1, and y from -0.5 to 0.5.
            (0.5, [-0.9, 0.4, -2.0], 0, 0.0),
            (0.5, [-0.3, 0.4, -2.0], 0, 1.0),
            (0.5, [0.3, 0.1, -2.0], 0, 2.0),
            (0.5, [0.9, 0.4, -2.0], 0, 3.0),
            (0.5, [-0.9, -0.4, -2.0], 0, 4.0),
            (0.5, [0.9, -0.1, -2.0], 0, 7.0),
            (0.5, [9.0, 0.1, -2.0], 0, 3.0), // beyond the edge
            (0.5, [0.3, -9.0, -2.0], 0, 6.0),
            // Behind the camera: the edge in the point's direction.
            (0.5, [-5.0, 0.1, 2.0], 0, 0.0),
            (0.5, [5.0, 0.1, 2.0], 0, 3.0),
            (0.5, [5.0, -0.1, 0.0], 0, 7.0),
            (0.5, [0.2, 5.0, 2.0], 0, 2.0),
            (0.5, [0.2, -5.0, 2.0], 0, 6.0),
            // Orthographic: x from -1 to 1 whatever the depth.
            (0.0, [-0.9, 0.4, -7.0], 0, 0.0),
            (0.0, [0.9, -0.4, 7.0], 0, 7.0),
            // Surfaces that another pixel shows.
            (0.5, [0.9, 0.4, -2.0], 1, 5.0),
            (0.5, [-0.9, 0.4, -2.0], 2, 0.0),
            (0.5, [0.9, -0.4, -2.0], 2, 3.0),
        ] {
            let found = shows(half_width, point, surface);
            assert_eq!(found, expected, "{point:?} on {surface}");
        }
    }

    #[test]
    fn unusable_arguments_are_named_in_one_line() {
        type Change = fn(&mut Pixels, &mut usize, &mut Radiance);
        let message = |change: Change| {
            let (mut pixels, mut rays) = (Pixels::new(3, 30.0), 64);
            let mut given = picture([2, 2], &[1.0; 4], &[0; 6 * 4]);
            change(&mut pixels, &mut rays, &mut given);
            let found = transfer(
                &cube(),
                pixels.origins(),
                Model::Paper,
                rays,
                Some(given),
                1,
            );
            found.unwrap_err().to_string()
        };
        let cases: [(Change, &str); 17] = [
            (|p, _, _| p.points[1].y = f64::NAN, "points: "),
            (|p, _, _| p.points[1].y = 1e300, "points: "),
            (|p, _, _| p.normals[2] *= 2.0, "normals: unit vectors"),
            (|p, _, _| p.views[0] *= 0.0, "views: unit vectors"),
            (|p, _, _| p.normals.truncate(2), "normals: 3 numbers"),
            (|p, _, _| p.views.truncate(2), "views: 3 numbers"),
            (|p, _, _| p.seeds.truncate(2), "seeds: 3 numbers"),
            (|_, rays, _| *rays = 0, "rays: "),
            (|_, rays, _| *rays = usize::MAX, "rays: "),
            (|_, _, g| g.nearest = &[0; 23], "nearest: 24 numbers"),
            (|_, _, g| g.nearest = &[4; 24], "nearest: pixels below 4"),
            (|_, _, g| g.size = [0, 2], "radiance: at least one pixel"),
            (|_, _, g| g.samples = &[1.0; 5], "radiance: "),
            (|_, _, g| g.samples = &[f32::NAN; 4], "radiance: "),
            (|_, _, g| g.half_width = f32::NAN, "half_width: "),
            (|_, _, g| g.half_width = f32::INFINITY, "half_width: "),
            (|_, _, g| g.half_width = -1.0, "half_width: "),
        ];
        for (change, expected) in cases {
            let found = message(change).replacen("expected ", "", 1);
            let complete = found.starts_with(expected) && found.contains(", found ");
            assert!(complete && !found.contains('\n'), "{found}");
        }
    }

    /// The functions that the least squares take are those of the model's factors: a₀ and b₀ of the
    /// table are what its first row integrates to.
    #[test]
    fn the_lobes_of_rays_are_those_of_the_table() {
        let view = DVec3::new(-0.6, 0.0, 0.8);
        let [normal, toward] = [DVec3::Z, view].map(|v| v.as_vec3a());
        let rays = Rays::new(normal, toward, 60_000, 0);
        for roughness in [0.3, 0.6, 1.0] {
            let [values, _, _] = lobe_table::values(roughness, 0.8);
            let mut sums = [0.0; 2];
            rays.each(|direction, weight| {
                let half = (toward + direction).normalize();
                let schlick = (1.0 - toward.dot(half)).powi(5);
                let lobe = weight
                    * super::super::dual::principled(
                        roughness as f32,
                        normal.dot(half),
                        normal.dot(direction),
                        0.8,
                    );
                sums[0] += f64::from(lobe * (1.0 - schlick));
                sums[1] += f64::from(lobe * schlick);
            });
            let uniform = (4.0 * std::f64::consts::PI).sqrt();
            for (sum, value) in sums.iter().zip([values[0], values[10]]) {
                let expected = uniform * value;
                let holds = (sum - expected).abs() < 0.01 * expected;
                assert!(holds, "roughness {roughness}: {sum}, expected {expected}");
            }
        }
    }
}
