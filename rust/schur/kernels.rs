//! The vector kernels of an elimination, over one block of pixels each.

use crate::pixel::samples::{Sums, unknowns_of_channel};
use crate::reflectance::planes::{BLOCK, Doubles, Plane};
use crate::reflectance::sh::{COEFFICIENTS, Real};
use crate::runtime::simd::{Isa, Kernel, Vectors};

/// Ridge on the unit diagonal of scaled matrices, and their least pivot: far below what data can
/// tell.
const RIDGE: f64 = 1e-12;

/// Pictures, and coefficients, that are worked on together.
const TOGETHER: usize = 4;

/// Numbers that are summed side by side.
const LANES: usize = 8;

/// Sums by the coefficients of a light, in parts that add up.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Lanes(pub(super) [[f64; LANES]; COEFFICIENTS]);

/// Inverts the scaled and damped matrices' Cholesky factors: U = L⁻¹ D with L Lᵀ = D A D + damping; and
/// works out U g. D is the root of the inverse diagonal, 0 for what is held.
#[inline(always)]
pub(super) fn whiten<const U: usize>(
    sums: &Sums<U>,
    scale: &[Doubles; U],
    damping: f64,
    whiten: &mut [[Doubles; U]; U],
    whitened: &mut [Doubles; U],
) {
    // L, with the inverse of its diagonal on the diagonal.
    let mut lower = [[Doubles::default(); U]; U];
    for i in 0..U {
        for j in 0..=i {
            let mut entry = Doubles::default();
            for x in 0..BLOCK {
                entry.0[x] = if i == j {
                    1.0 + RIDGE + damping
                } else {
                    sums.matrix[i][j].0[x] * scale[i].0[x] * scale[j].0[x]
                };
            }
            for k in 0..j {
                for x in 0..BLOCK {
                    entry.0[x] -= lower[i][k].0[x] * lower[j][k].0[x];
                }
            }
            for x in 0..BLOCK {
                lower[i][j].0[x] = if i == j {
                    // Rounding may leave less than nothing of a pivot.
                    1.0 / entry.0[x].max(RIDGE).sqrt()
                } else {
                    entry.0[x] * lower[j][j].0[x]
                };
            }
        }
    }
    // Forward substitution of the unit vectors, column by column.
    for column in 0..U {
        for row in 0..U {
            let mut entry = Doubles::default();
            if row == column {
                entry = scale[column];
            }
            for k in column..row {
                for x in 0..BLOCK {
                    entry.0[x] -= lower[row][k].0[x] * whiten[k][column].0[x];
                }
            }
            for x in 0..BLOCK {
                whiten[row][column].0[x] = if row < column {
                    0.0
                } else {
                    entry.0[x] * lower[row][row].0[x]
                };
            }
        }
    }
    for row in 0..U {
        whitened[row] = Doubles::default();
        for column in 0..=row {
            for x in 0..BLOCK {
                whitened[row].0[x] += whiten[row][column].0[x] * sums.gradient[column].0[x];
            }
        }
    }
}

/// R = U (Ω J)ᵀ of one sample, in the place of J, whose derivatives are by the unknowns `own`.
pub(super) struct FillRows<'a, const D: usize, const U: usize> {
    pub(super) own: [usize; D],
    pub(super) omega: &'a Doubles,
    pub(super) whiten: &'a [[Doubles; U]; U],
    pub(super) rows: &'a mut [Doubles; D],
}

impl<const D: usize, const U: usize> Kernel for FillRows<'_, D, U> {
    type Output = ();

    #[inline(always)]
    fn run<I: Isa>(self, isa: I) {
        self.all(isa);
    }
}

impl<const D: usize, const U: usize> FillRows<'_, D, U> {
    #[inline(always)]
    fn all<I: Vectors<f64>>(self, isa: I) {
        for v in 0..BLOCK / I::LANES {
            let omega = I::of(&self.omega.0)[v];
            let mut weighted = [omega; D];
            for j in 0..D {
                weighted[j] = isa.mul(omega, I::of(&self.rows[j].0)[v]);
            }
            for i in 0..D {
                let whiten = |j: usize| I::of(&self.whiten[self.own[i]][self.own[j]].0)[v];
                let mut sum = isa.mul(whiten(0), weighted[0]);
                for j in 1..=i {
                    sum = isa.mul_add(whiten(j), weighted[j], sum);
                }
                I::of_mut(&mut self.rows[i].0)[v] = sum;
            }
        }
    }
}

/// R W of one sample: its columns of the rows of a block, (coefficient, pixel) of the albedo. What is
/// shared, (coefficient, unknown, pixel), is added to: lights that all channels have collect from all.
#[inline(always)]
pub(super) fn fill_dense_rows<const D: usize>(
    weights: &[Doubles],
    rows: &[Doubles; D],
    albedo: &mut [[f64; BLOCK]],
    shared: &mut [[f64; BLOCK]],
) {
    for (k, weights) in weights.iter().enumerate() {
        for x in 0..BLOCK {
            albedo[k][x] = rows[0].0[x] * weights.0[x];
        }
        for (unknown, rows) in rows[1..].iter().enumerate() {
            for x in 0..BLOCK {
                shared[(D - 1) * k + unknown][x] += rows.0[x] * weights.0[x];
            }
        }
    }
}

/// Pixels of a block that are eliminated, samples being (channel, picture).
#[derive(Clone, Debug, Default)]
pub(super) struct Eliminated<T: Copy + Default, const D: usize> {
    /// w_ck, by channel; 0 where no pixel is.
    pub(super) weights: Vec<[Plane<T>; COEFFICIENTS]>,
    /// R of every sample: by the channel's own albedo, roughness, metallic and what follows.
    pub(super) rows: Vec<[Plane<T>; D]>,
    /// ω of every sample; empty where all are 1.
    pub(super) omega: Vec<Plane<T>>,
}

impl<const D: usize> Eliminated<f64, D> {
    pub(super) fn rounded(&self) -> Eliminated<f32, D> {
        let round = |plane: &Doubles| Plane(plane.0.map(|value| value as f32));
        Eliminated {
            weights: self
                .weights
                .iter()
                .map(|w| w.each_ref().map(round))
                .collect(),
            rows: self
                .rows
                .iter()
                .map(|rows| rows.each_ref().map(round))
                .collect(),
            omega: self.omega.iter().map(round).collect(),
        }
    }
}

/// W v of every sample; and what R makes of it is added to `sums`.
pub(super) struct Project<'a, T: Copy + Default, const D: usize, const U: usize> {
    pub(super) pixels: &'a Eliminated<T, D>,
    /// v, by sample.
    pub(super) lights: &'a [[T; COEFFICIENTS]],
    /// W v; to be written.
    pub(super) radiance: &'a mut [Plane<T>],
    pub(super) sums: &'a mut [Plane<T>; U],
}

/// Adds Wᵀ (Ω x − Rᵀ y), with x by sample, which changes, and y by unknown.
pub(super) struct Collect<'a, T: Copy + Default, const D: usize, const U: usize> {
    pub(super) pixels: &'a Eliminated<T, D>,
    pub(super) values: &'a mut [Plane<T>],
    pub(super) whitened: &'a [Plane<T>; U],
    /// By sample.
    pub(super) sums: &'a mut [Lanes],
}

macro_rules! kernels {
    ($($kernel:ident of $t:ty),*) => {$(
        impl<const D: usize, const U: usize> Kernel for $kernel<'_, $t, D, U> {
            type Output = ();

            #[inline(always)]
            fn run<I: Isa>(self, isa: I) {
                self.all::<I>(isa);
            }
        }
    )*};
}

kernels!(Project of f32, Project of f64, Collect of f32, Collect of f64);

impl<T: Real, const D: usize, const U: usize> Project<'_, T, D, U> {
    #[inline(always)]
    fn all<I: Vectors<T>>(mut self, isa: I) {
        let (channels, zero) = (self.pixels.weights.len(), isa.splat(T::default()));
        let pictures = self.lights.len() / channels;
        for (c, of_channel) in self.pixels.weights.iter().enumerate() {
            let (first, end) = (c * pictures, (c + 1) * pictures);
            for v in 0..BLOCK / I::LANES {
                let mut weights = [zero; COEFFICIENTS];
                for k in 0..COEFFICIENTS {
                    weights[k] = I::of(&of_channel[k].0)[v];
                }
                let mut sums = [zero; D];
                let mut i = first;
                while i + TOGETHER <= end {
                    self.some::<I, TOGETHER>(isa, &weights, v, i, &mut sums);
                    i += TOGETHER;
                }
                for i in i..end {
                    self.some::<I, 1>(isa, &weights, v, i, &mut sums);
                }
                let own: [usize; D] = unknowns_of(channels, c);
                for d in 0..D {
                    let sum = &mut I::of_mut(&mut self.sums[own[d]].0)[v];
                    *sum = isa.add(*sum, sums[d]);
                }
            }
        }
    }

    /// J samples, from number `first` on.
    #[inline(always)]
    fn some<I: Vectors<T>, const J: usize>(
        &mut self,
        isa: I,
        weights: &[I::Vector; COEFFICIENTS],
        v: usize,
        first: usize,
        sums: &mut [I::Vector; D],
    ) {
        let lights = &self.lights[first..first + J];
        let mut radiance = [isa.splat(T::default()); J];
        for k in 0..COEFFICIENTS {
            for j in 0..J {
                radiance[j] = isa.mul_add(isa.splat(lights[j][k]), weights[k], radiance[j]);
            }
        }
        for j in 0..J {
            let rows = &self.pixels.rows[first + j];
            for d in 0..D {
                sums[d] = isa.mul_add(I::of(&rows[d].0)[v], radiance[j], sums[d]);
            }
            I::of_mut(&mut self.radiance[first + j].0)[v] = radiance[j];
        }
    }
}

impl<T: Real, const D: usize, const U: usize> Collect<'_, T, D, U> {
    #[inline(always)]
    fn all<I: Vectors<T>>(mut self, isa: I) {
        let channels = self.pixels.weights.len();
        let pictures = self.values.len() / channels;
        for (c, weights) in self.pixels.weights.iter().enumerate() {
            let (first, end) = (c * pictures, (c + 1) * pictures);
            let own: [usize; D] = unknowns_of(channels, c);
            for i in first..end {
                self.subtract(isa, i, own);
            }
            let mut i = first;
            while i + 2 <= end {
                self.some::<I, 2>(isa, weights, i);
                i += 2;
            }
            if i < end {
                self.some::<I, 1>(isa, weights, i);
            }
        }
    }

    /// Makes ω x − Rᵀ y of one sample.
    #[inline(always)]
    fn subtract<I: Vectors<T>>(&mut self, isa: I, i: usize, own: [usize; D]) {
        let (rows, values) = (&self.pixels.rows[i], I::of_mut(&mut self.values[i].0));
        if let Some(omega) = self.pixels.omega.get(i) {
            for (value, omega) in values.iter_mut().zip(I::of(&omega.0)) {
                *value = isa.mul(*value, *omega);
            }
        }
        for v in 0..BLOCK / I::LANES {
            let mut sum = isa.splat(T::default());
            for d in 0..D {
                let whitened = I::of(&self.whitened[own[d]].0)[v];
                sum = isa.mul_add(I::of(&rows[d].0)[v], whitened, sum);
            }
            values[v] = isa.sub(values[v], sum);
        }
    }

    /// J samples, from number `first` on.
    #[inline(always)]
    fn some<I: Vectors<T>, const J: usize>(
        &mut self,
        isa: I,
        weights: &[Plane<T>; COEFFICIENTS],
        first: usize,
    ) {
        for k in (0..COEFFICIENTS).step_by(TOGETHER) {
            let mut sums = [[isa.splat(T::default()); TOGETHER]; J];
            for v in 0..BLOCK / I::LANES {
                for i in 0..TOGETHER {
                    let weight = I::of(&weights[k + i].0)[v];
                    for j in 0..J {
                        let value = I::of(&self.values[first + j].0)[v];
                        sums[j][i] = isa.mul_add(weight, value, sums[j][i]);
                    }
                }
            }
            for j in 0..J {
                for i in 0..TOGETHER {
                    let mut lanes = [T::default(); 2 * LANES];
                    I::of_mut(&mut lanes)[0] = sums[j][i];
                    for lane in 0..I::LANES {
                        self.sums[first + j].0[k + i][lane % LANES] += lanes[lane].to_f64();
                    }
                }
            }
        }
    }
}

/// [`unknowns_of_channel`], with a number of channels that is known when it runs.
#[inline(always)]
fn unknowns_of<const D: usize>(channels: usize, channel: usize) -> [usize; D] {
    if channels == 1 {
        unknowns_of_channel::<1, D>(channel)
    } else {
        unknowns_of_channel::<3, D>(channel)
    }
}
