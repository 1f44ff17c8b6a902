//! What a block of pixels holds, value by value: planes, pixel beside pixel, so that a loop over the
//! pixels becomes vector code. And one pixel's material, of which these are made.

use glam::DVec3;

use super::ggx::MIN_COSINE;
use super::sh::{COEFFICIENTS, Real};

/// Pixels in a block.
pub const BLOCK: usize = 128;

/// One number for each pixel of a block.
#[derive(Clone, Copy, Debug)]
#[repr(C, align(64))]
pub struct Plane<T = f32>(pub [T; BLOCK]);

impl<T: Copy + Default> Default for Plane<T> {
    fn default() -> Self {
        Self([T::default(); BLOCK])
    }
}

/// One float64 for each pixel of a block.
pub type Doubles = Plane<f64>;

/// Rows of a lobe at most.
pub const MAX_ROWS: usize = 10;

/// Basis functions R_jk of a lobe at most.
pub const MAX_ENTRIES: usize = 50;

/// The same where each row sees every coefficient.
pub const MAX_LOBE: usize = MAX_ROWS * COEFFICIENTS;

/// Functions of roughness and n·v at most.
pub const MAX_FUNCTIONS: usize = 72;

/// One number for each row of a lobe.
pub type ByRow = [f64; MAX_ROWS];

/// The [functions](super::reflection::Reflection::Functions) of a block of pixels.
pub type BlockFunctions<T = f64> = [Plane<T>; MAX_FUNCTIONS];

/// No functions of a block yet.
pub fn no_functions<T: Real>() -> Box<BlockFunctions<T>> {
    Box::new([Plane::default(); MAX_FUNCTIONS])
}

/// Material of one pixel with C colour channels; all numbers lie in \[0, 1\].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Material<const C: usize = 3> {
    /// Base colour ρ, linear Rec.709; of a metal it is F0.
    pub albedo: [f64; C],
    /// Perceptual roughness r, α = r².
    pub roughness: f64,
    /// Metallic m.
    pub metallic: f64,
}

/// The materials of a block, or derivatives by them.
#[derive(Clone, Copy, Debug)]
pub struct Materials<const C: usize> {
    /// Base colour, by channel.
    pub albedo: [Plane<f64>; C],
    /// Perceptual roughness.
    pub roughness: Plane<f64>,
    /// Metallic.
    pub metallic: Plane<f64>,
}

impl<const C: usize> Default for Materials<C> {
    fn default() -> Self {
        Self {
            albedo: [Plane::default(); C],
            roughness: Plane::default(),
            metallic: Plane::default(),
        }
    }
}

impl<const C: usize> Materials<C> {
    /// Puts one pixel into the block.
    pub fn set(&mut self, pixel: usize, material: &Material<C>) {
        for c in 0..C {
            self.albedo[c].0[pixel] = material.albedo[c];
        }
        self.roughness.0[pixel] = material.roughness;
        self.metallic.0[pixel] = material.metallic;
    }

    /// Albedo by channel, roughness, metallic.
    pub fn planes(&self) -> impl Iterator<Item = &Plane<f64>> {
        self.albedo.iter().chain([&self.roughness, &self.metallic])
    }

    /// Puts `count` pixels into planes, starting at `first`; metallic only where there is a plane.
    pub fn store(&self, planes: &mut [&mut [f64]], first: usize, count: usize) {
        for (plane, own) in planes.iter_mut().zip(self.planes()) {
            plane[first..][..count].copy_from_slice(&own.0[..count]);
        }
    }

    /// One pixel.
    #[inline(always)]
    pub fn get(&self, pixel: usize) -> Material<C> {
        let mut albedo = [0.0; C];
        for c in 0..C {
            albedo[c] = self.albedo[c].0[pixel];
        }
        Material {
            albedo,
            roughness: self.roughness.0[pixel],
            metallic: self.metallic.0[pixel],
        }
    }

    /// One pixel in channel c.
    #[inline(always)]
    pub fn of_channel(&self, c: usize, pixel: usize) -> Material<1> {
        Material {
            albedo: [self.albedo[c].0[pixel]],
            roughness: self.roughness.0[pixel],
            metallic: self.metallic.0[pixel],
        }
    }
}

/// The clamped n·v and the mirror direction; the latter is not clamped.
pub fn directions(normal: DVec3, view: DVec3) -> (f64, DVec3) {
    let cosine = normal.dot(view);
    (cosine.max(MIN_COSINE), 2.0 * cosine * normal - view)
}

/// Where the pixels of a block look; a pixel that is not used has zeros.
#[derive(Clone, Debug)]
pub struct Directions<T = f32> {
    pub(crate) cosine: Plane<f64>,
    pub(crate) normal: [Plane<T>; 3],
    pub(crate) mirror: [Plane<T>; 3],
}

impl<T: Real> Default for Directions<T> {
    fn default() -> Self {
        Self {
            cosine: Plane([1.0; BLOCK]),
            normal: Default::default(),
            mirror: Default::default(),
        }
    }
}

impl<T: Real> Directions<T> {
    /// Puts in all pixels, from planes of the same.
    #[inline(always)]
    pub fn fill(
        &mut self,
        cosine: &Plane<f64>,
        normal: &[Plane<f64>; 3],
        mirror: &[Plane<f64>; 3],
    ) {
        self.cosine = *cosine;
        for axis in 0..3 {
            for x in 0..BLOCK {
                self.normal[axis].0[x] = T::from_f64(normal[axis].0[x]);
            }
            for x in 0..BLOCK {
                self.mirror[axis].0[x] = T::from_f64(mirror[axis].0[x]);
            }
        }
    }

    /// The clamped n·v of all pixels.
    pub fn cosines(&self) -> &Plane<f64> {
        &self.cosine
    }

    /// The clamped n·v of a pixel.
    pub fn cosine(&self, pixel: usize) -> f64 {
        self.cosine.0[pixel]
    }

    /// The normal of a pixel.
    #[inline(always)]
    pub fn normal(&self, pixel: usize) -> [T; 3] {
        vector(&self.normal, pixel)
    }

    /// The mirror direction of a pixel.
    #[inline(always)]
    pub fn mirror(&self, pixel: usize) -> [T; 3] {
        vector(&self.mirror, pixel)
    }
}

#[inline(always)]
pub(crate) fn vector<T: Real>(planes: &[Plane<T>; 3], pixel: usize) -> [T; 3] {
    [planes[0].0[pixel], planes[1].0[pixel], planes[2].0[pixel]]
}

/// One channel's material factors, rounded once: kd and s_j.
#[derive(Clone, Debug, Default)]
pub struct ChannelFactors<T: Copy + Default = f32> {
    pub(crate) diffuse: Plane<T>,
    pub(crate) rows: [Plane<T>; MAX_ROWS],
}

/// The adjoint of [`ChannelFactors`]: derivatives by kd, and for each row Σ_k g_k R_jk.
#[derive(Clone, Debug, Default)]
pub struct ChannelSums {
    pub(crate) diffuse: Plane,
    pub(crate) rows: [Plane; MAX_ROWS],
}
