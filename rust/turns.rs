//! Blocks of pixels whose normals are free: where they look, and how that changes with their tilts.

use glam::DVec3;

use crate::block::{BLOCK, Basis, DIFFUSE, Directions, Plane};
use crate::ggx::MIN_COSINE;
use crate::sh::{self, BAND_OF, COEFFICIENTS, COSINE_TRANSFER, Real};
use crate::simd::{Isa, Kernel};
use crate::{Error, Result, tilt};

type Doubles = Plane<f64>;

/// The tilts (a, b) of a block of pixels.
pub type Tilts = [Doubles; 2];

/// Normals that tilts turn, of length 1, and view directions; a pixel that is not used has +z for
/// both.
#[derive(Clone, Debug)]
pub struct GivenDirections {
    normal: [Doubles; 3],
    view: [Doubles; 3],
}

impl Default for GivenDirections {
    fn default() -> Self {
        let z = [0.0, 0.0, 1.0].map(|axis| Plane([axis; BLOCK]));
        Self { normal: z, view: z }
    }
}

impl GivenDirections {
    /// Puts a pixel into the block. The normal is brought to length 1 to the last digit, as
    /// those of any tilt are.
    pub fn set(&mut self, pixel: usize, normal: DVec3, view: DVec3) {
        self.put(pixel, [normal.normalize(), view]);
    }

    fn put(&mut self, pixel: usize, [normal, view]: [DVec3; 2]) {
        for axis in 0..3 {
            self.normal[axis].0[pixel] = normal[axis];
            self.view[axis].0[pixel] = view[axis];
        }
    }

    /// Normal and view direction of a pixel.
    #[inline(always)]
    pub fn get(&self, pixel: usize) -> [DVec3; 2] {
        [vector(&self.normal, pixel), vector(&self.view, pixel)]
    }

    /// Takes over a pixel of another block.
    pub fn copy(&mut self, pixel: usize, from: &Self, there: usize) {
        self.put(pixel, from.get(there));
    }

    /// Blocks for some pixels.
    pub fn blocks(normals: &[DVec3], views: &[DVec3]) -> Result<Vec<Self>> {
        let count = normals.len().div_ceil(BLOCK);
        let mut blocks = Vec::new();
        blocks
            .try_reserve_exact(count)
            .map_err(|_| Error::Memory("normals"))?;
        blocks.resize(count, Self::default());
        for (p, (&normal, &view)) in normals.iter().zip(views).enumerate() {
            blocks[p / BLOCK].set(p % BLOCK, normal, view);
        }
        Ok(blocks)
    }
}

#[inline(always)]
fn vector(planes: &[Doubles; 3], pixel: usize) -> DVec3 {
    DVec3::new(planes[0].0[pixel], planes[1].0[pixel], planes[2].0[pixel])
}

/// Derivatives of [`Directions`] by the tilts a and b.
#[derive(Clone, Debug, Default)]
pub struct Turns {
    /// Of n.
    pub normal: [[Doubles; 3]; 2],
    /// Of the mirror direction.
    pub mirror: [[Doubles; 3]; 2],
    /// Of the clamped n·v: 0 where n·v ≤ [`MIN_COSINE`].
    pub cosine: [Doubles; 2],
}

/// Turns the pixels of a block.
///
/// ```text
/// R = 2(n·v)n − v          ∂R/∂a = 2(v·∂n/∂a) n + 2(n·v) ∂n/∂a          ∂(n·v)/∂a = v·∂n/∂a
/// ```
pub struct Turn<'a, T: Real> {
    /// What is turned.
    pub given: &'a GivenDirections,
    /// By how much.
    pub tilts: &'a Tilts,
    /// To be written.
    pub directions: &'a mut Directions<T>,
    /// To be written.
    pub turns: &'a mut Turns,
}

impl<T: Real> Kernel for Turn<'_, T> {
    type Output = ();

    #[inline(always)]
    fn run<I: Isa>(self, _: I) {
        let Self {
            given,
            tilts,
            directions,
            turns,
        } = self;
        for x in 0..BLOCK {
            let [normal, view] = given.get(x);
            let turned = tilt::turn(normal, [tilts[0].0[x], tilts[1].0[x]]);
            let normal = turned.normal;
            let cosine = normal.dot(view);
            // Not `max`, which the compiler makes no vector code of.
            let clamped = if cosine > MIN_COSINE {
                cosine
            } else {
                MIN_COSINE
            };
            let slope = if cosine > MIN_COSINE { 1.0 } else { 0.0 };
            directions.put(x, clamped, normal, 2.0 * cosine * normal - view);
            for t in 0..2 {
                let by = turned.by_tilt[t];
                let by_cosine = view.dot(by);
                let mirror = 2.0 * (by_cosine * normal + cosine * by);
                for axis in 0..3 {
                    turns.normal[t][axis].0[x] = by[axis];
                    turns.mirror[t][axis].0[x] = mirror[axis];
                }
                turns.cosine[t].0[x] = slope * by_cosine;
            }
        }
    }
}

/// Fills in the derivatives of the basis functions by one of the tilts: A_l ∇Y_k(n)·∂n/∂a and
/// ∇Y_k(mirror)·∂mirror/∂a.
pub struct FillBasisSlopes<'a> {
    /// Where the pixels look.
    pub directions: &'a Directions<f64>,
    /// How that changes.
    pub turns: &'a Turns,
    /// 0 or 1.
    pub tilt: usize,
    /// To be written.
    pub slopes: &'a mut Basis<f64>,
}

impl Kernel for FillBasisSlopes<'_> {
    type Output = ();

    #[inline(always)]
    fn run<I: Isa>(self, _: I) {
        let Self {
            directions,
            turns,
            tilt,
            slopes,
        } = self;
        let (by_normal, by_mirror) = (&turns.normal[tilt], &turns.mirror[tilt]);
        for x in 0..BLOCK {
            let by = vector(by_normal, x).to_array();
            let mut along = [0.0; COEFFICIENTS];
            sh::each_slope(directions.normal(x), |k, axis, slope| {
                along[k] += slope * by[axis];
            });
            for k in 0..DIFFUSE {
                slopes.diffuse[k].0[x] = COSINE_TRANSFER[BAND_OF[k]] * along[k];
            }
        }
        for x in 0..BLOCK {
            let by = vector(by_mirror, x).to_array();
            let mut along = [0.0; COEFFICIENTS];
            sh::each_slope(directions.mirror(x), |k, axis, slope| {
                along[k] += slope * by[axis];
            });
            for k in 0..COEFFICIENTS {
                slopes.mirror[k].0[x] = along[k];
            }
        }
    }
}
