//! The radiance of a block, I = W Lᵀ, and its residuals.

use crate::reflectance::planes::{BLOCK, Plane};
use crate::reflectance::sh::COEFFICIENTS;
use crate::runtime::simd::{Isa, Kernel, Vectors};

/// Lanes of the widest vector.
pub(super) const MAX_LANES: usize = 16;

/// I = W Lᵀ of one picture, in double precision.
pub struct Radiance<'a> {
    /// The channel's weights.
    pub weights: &'a [Plane<f64>; COEFFICIENTS],
    /// The picture's light.
    pub light: &'a [f64; COEFFICIENTS],
    /// To be written.
    pub radiance: &'a mut Plane<f64>,
}

impl Kernel for Radiance<'_> {
    type Output = ();

    #[inline(always)]
    fn run<I: Isa>(self, isa: I) {
        radiance(isa, self.weights, self.light, self.radiance);
    }
}

#[inline(always)]
fn radiance<I: Vectors<f64>>(
    isa: I,
    weights: &[Plane<f64>; COEFFICIENTS],
    light: &[f64; COEFFICIENTS],
    out: &mut Plane<f64>,
) {
    const V: usize = 8;
    for v in (0..BLOCK / I::LANES).step_by(V) {
        let mut radiance = [isa.splat(0.0); V];
        for k in 0..COEFFICIENTS {
            let light = isa.splat(light[k]);
            let w = &I::of(&weights[k].0)[v..v + V];
            for i in 0..V {
                radiance[i] = isa.mul_add(light, w[i], radiance[i]);
            }
        }
        I::of_mut(&mut out.0)[v..v + V].copy_from_slice(&radiance);
    }
}

/// First product: e = ω (W Lᵀ − T) for some pictures. Returns Σ ω (I − T)².
pub struct Residuals<'a, const K: usize, const WEIGHTED: bool> {
    /// The channel's weights.
    pub weights: &'a [Plane; K],
    /// A row for each picture.
    pub lights: &'a [[f32; K]],
    /// A plane for each picture.
    pub targets: &'a [Plane],
    /// ω, a plane for each picture; not read unless `WEIGHTED`.
    pub sample_weights: &'a [Plane],
    /// To be written, a plane for each picture.
    pub residuals: &'a mut [Plane],
}

impl<const K: usize, const WEIGHTED: bool> Kernel for Residuals<'_, K, WEIGHTED> {
    type Output = f64;

    #[inline(always)]
    fn run<I: Isa>(mut self, isa: I) -> f64 {
        if I::REGISTERS >= 32 {
            self.all::<I, 4>(isa)
        } else {
            self.all::<I, 2>(isa)
        }
    }
}

impl<const K: usize, const WEIGHTED: bool> Residuals<'_, K, WEIGHTED> {
    #[inline(always)]
    fn all<I: Vectors<f32>, const V: usize>(&mut self, isa: I) -> f64 {
        let n = self.lights.len();
        let mut sum_sq = [isa.splat(0.0); V];
        let mut j = 0;
        while j + 4 <= n {
            self.some::<I, V, 4>(isa, j, &mut sum_sq);
            j += 4;
        }
        match n - j {
            3 => self.some::<I, V, 3>(isa, j, &mut sum_sq),
            2 => self.some::<I, V, 2>(isa, j, &mut sum_sq),
            1 => self.some::<I, V, 1>(isa, j, &mut sum_sq),
            _ => {}
        }
        let mut sum = 0.0;
        for i in 0..V {
            sum += lanes(isa, sum_sq[i])
                .iter()
                .map(|&s| f64::from(s))
                .sum::<f64>();
        }
        sum
    }

    /// J pictures, V vectors at a time.
    #[inline(always)]
    fn some<I: Vectors<f32>, const V: usize, const J: usize>(
        &mut self,
        isa: I,
        first: usize,
        sum_sq: &mut [I::Vector; V],
    ) {
        let lights = &self.lights[first..first + J];
        let targets = &self.targets[first..first + J];
        let residuals = &mut self.residuals[first..first + J];
        for v in (0..BLOCK / I::LANES).step_by(V) {
            let mut radiance = [[isa.splat(0.0); V]; J];
            for k in 0..K {
                let w = &I::of(&self.weights[k].0)[v..v + V];
                for j in 0..J {
                    let light = isa.splat(lights[j][k]);
                    for i in 0..V {
                        radiance[j][i] = isa.mul_add(light, w[i], radiance[j][i]);
                    }
                }
            }
            for j in 0..J {
                let target = &I::of(&targets[j].0)[v..v + V];
                let out = &mut I::of_mut(&mut residuals[j].0)[v..v + V];
                for i in 0..V {
                    let e = isa.sub(radiance[j][i], target[i]);
                    if WEIGHTED {
                        let omega = I::of(&self.sample_weights[first + j].0)[v + i];
                        out[i] = isa.mul(omega, e);
                        sum_sq[i] = isa.mul_add(out[i], e, sum_sq[i]);
                    } else {
                        out[i] = e;
                        sum_sq[i] = isa.mul_add(e, e, sum_sq[i]);
                    }
                }
            }
        }
    }
}

/// The lanes of a vector, with zeros to the widest.
#[inline(always)]
pub(super) fn lanes<I: Vectors<f32>>(_: I, vector: I::Vector) -> [f32; MAX_LANES] {
    let mut lanes = [0.0; MAX_LANES];
    I::of_mut(&mut lanes)[0] = vector;
    lanes
}
