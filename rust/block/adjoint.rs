//! From the residuals of a block to the derivatives by its factors and by the lights.

use super::basis::Basis;
use super::normal_jacobian::ByBasis;
use super::radiance::{MAX_LANES, lanes};
use crate::reflectance::planes::{BLOCK, ChannelSums, Plane};
use crate::reflectance::reflection::{OPEN_DIFFUSE, Reflection, first_entry, rows_of_band};
use crate::reflectance::sh::COEFFICIENTS;
use crate::runtime::simd::{Isa, Kernel, Vectors};

/// Parts in which sums over pixels are kept.
const PARTS: usize = 8;

/// A sum over pixels, in parts that are added up in float64 in the end.
#[derive(Clone, Copy, Debug, Default)]
#[repr(C, align(32))]
pub struct Parts([f32; PARTS]);

/// Derivatives by the K coefficients of one light.
pub type LightSums<const K: usize> = [Parts; K];

/// Second product, e L, projected at once on the basis: the derivatives by kd and by the rows'
/// factors.
pub struct ByFactors<'a, M: Reflection, const K: usize, const FREE_NORMALS: bool> {
    /// Whether to begin the sums, or add to them.
    pub begin: bool,
    /// The basis functions.
    pub basis: &'a Basis,
    /// A row for each picture.
    pub lights: &'a [[f32; K]],
    /// e, a plane for each picture.
    pub residuals: &'a [Plane],
    /// Written or added to.
    pub sums: &'a mut ChannelSums,
    /// Takes the derivatives by the weights too, where there are `FREE_NORMALS`.
    pub by_basis: Option<ByBasis<'a, M>>,
    /// Whose weights they are.
    pub model: M,
}

impl<M: Reflection, const K: usize, const FREE_NORMALS: bool> Kernel
    for ByFactors<'_, M, K, FREE_NORMALS>
{
    type Output = ();

    #[inline(always)]
    fn run<I: Isa>(mut self, isa: I) {
        // Coefficients band by band, bands 0 and 1 together, by as many vectors as registers hold.
        if I::REGISTERS >= 32 {
            self.some::<I, 0, 4, 4>(isa);
            self.some::<I, 4, 5, 4>(isa);
        } else {
            self.some::<I, 0, 4, 2>(isa);
            self.some::<I, 4, 5, 2>(isa);
        }
        if K == COEFFICIENTS {
            if I::REGISTERS >= 32 {
                self.some::<I, 9, 7, 2>(isa);
            } else {
                self.some::<I, 9, 7, 1>(isa);
            }
        }
    }
}

impl<M: Reflection, const K: usize, const FREE_NORMALS: bool> ByFactors<'_, M, K, FREE_NORMALS> {
    /// `COUNT` coefficients from `FIRST`, V vectors at a time.
    #[inline(always)]
    fn some<I: Vectors<f32>, const FIRST: usize, const COUNT: usize, const V: usize>(
        &mut self,
        isa: I,
    ) {
        for v in (0..BLOCK / I::LANES).step_by(V) {
            let mut by_weights = [[isa.splat(0.0); V]; COUNT];
            for (light, e) in self.lights.iter().zip(self.residuals) {
                let e = &I::of(&e.0)[v..v + V];
                for k in 0..COUNT {
                    let light = isa.splat(light[FIRST + k]);
                    for i in 0..V {
                        by_weights[k][i] = isa.mul_add(light, e[i], by_weights[k][i]);
                    }
                }
            }
            // In registers to the end: a store for each coefficient would cost as much as a tenth
            // of the products.
            let mut diffuse = [isa.splat(0.0); V];
            for k in 0..COUNT {
                if FREE_NORMALS && let Some(by_basis) = &mut self.by_basis {
                    by_basis.take(isa, FIRST + k, v, &by_weights[k]);
                }
                if FIRST + k < M::DIFFUSE {
                    let normal = &I::of(&self.basis.diffuse[FIRST + k].0)[v..v + V];
                    for i in 0..V {
                        diffuse[i] = isa.mul_add(by_weights[k][i], normal[i], diffuse[i]);
                    }
                }
            }
            match FIRST {
                0 => {
                    self.rows::<I, V, 0>(isa, v, &by_weights[..1]);
                    self.rows::<I, V, 1>(isa, v, &by_weights[1..]);
                }
                4 => self.rows::<I, V, 2>(isa, v, &by_weights),
                _ => self.rows::<I, V, 3>(isa, v, &by_weights),
            }
            if FIRST < M::DIFFUSE {
                let sum = &mut I::of_mut(&mut self.sums.diffuse.0)[v..v + V];
                add(isa, self.begin && FIRST == 0, sum, &diffuse);
            }
        }
    }

    /// The sums of the rows of band L.
    #[inline(always)]
    fn rows<I: Vectors<f32>, const V: usize, const L: usize>(
        &mut self,
        isa: I,
        v: usize,
        by_weights: &[[I::Vector; V]],
    ) {
        let (first_row, rows) = const { rows_of_band::<M>(L) };
        let first_entry = const { first_entry::<M>(L * L) };
        for j in 0..rows {
            let mut row = [isa.splat(0.0); V];
            for k in 0..2 * L + 1 {
                let lobe = &I::of(&self.basis.lobe[first_entry + k * rows + j].0)[v..v + V];
                for i in 0..V {
                    row[i] = isa.mul_add(by_weights[k][i], lobe[i], row[i]);
                }
            }
            let sum = &mut I::of_mut(&mut self.sums.rows[first_row + j].0)[v..v + V];
            add(isa, self.begin && (L == 0 || !M::SURROUNDED), sum, &row);
        }
    }
}

#[inline(always)]
fn add<I: Vectors<f32>>(isa: I, begin: bool, total: &mut [I::Vector], more: &[I::Vector]) {
    for (total, &more) in total.iter_mut().zip(more) {
        *total = if begin { more } else { isa.add(*total, more) };
    }
}

/// Third product: adds eᵀ W to the sums of each picture.
pub struct ByLights<'a, const K: usize> {
    /// The channel's weights.
    pub weights: &'a [Plane; K],
    /// e, a plane for each picture.
    pub residuals: &'a [Plane],
    /// Added to, an entry for each picture.
    pub sums: &'a mut [LightSums<K>],
}

impl<const K: usize> Kernel for ByLights<'_, K> {
    type Output = ();

    #[inline(always)]
    fn run<I: Isa>(mut self, isa: I) {
        if K == OPEN_DIFFUSE {
            self.all::<I, 3>(isa);
        } else if I::REGISTERS >= 32 {
            self.all::<I, 4>(isa);
        } else {
            self.all::<I, 2>(isa);
        }
    }
}

impl<const K: usize> ByLights<'_, K> {
    #[inline(always)]
    fn all<I: Vectors<f32>, const COUNT: usize>(&mut self, isa: I) {
        let n = self.residuals.len();
        let mut j = 0;
        while j + 4 <= n {
            self.some::<I, COUNT, 4>(isa, j);
            j += 4;
        }
        match n - j {
            3 => self.some::<I, COUNT, 3>(isa, j),
            2 => self.some::<I, COUNT, 2>(isa, j),
            1 => self.some::<I, COUNT, 1>(isa, j),
            _ => {}
        }
    }

    /// J pictures, `COUNT` coefficients at a time.
    #[inline(always)]
    fn some<I: Vectors<f32>, const COUNT: usize, const J: usize>(&mut self, isa: I, first: usize) {
        let residuals = &self.residuals[first..first + J];
        let sums = &mut self.sums[first..first + J];
        for k in (0..K).step_by(COUNT) {
            let mut total = [[isa.splat(0.0); COUNT]; J];
            for v in 0..BLOCK / I::LANES {
                let mut w = [isa.splat(0.0); COUNT];
                for i in 0..COUNT {
                    w[i] = I::of(&self.weights[k + i].0)[v];
                }
                for j in 0..J {
                    let e = I::of(&residuals[j].0)[v];
                    for i in 0..COUNT {
                        total[j][i] = isa.mul_add(e, w[i], total[j][i]);
                    }
                }
            }
            for j in 0..J {
                for i in 0..COUNT {
                    sums[j][k + i].add(&lanes(isa, total[j][i]), I::LANES);
                }
            }
        }
    }
}

impl Parts {
    #[inline(always)]
    fn add(&mut self, lanes: &[f32; MAX_LANES], used: usize) {
        for x in 0..PARTS.min(used) {
            self.0[x] += if used > PARTS {
                lanes[x] + lanes[x + PARTS]
            } else {
                lanes[x]
            };
        }
    }
}

/// The same in float64, for the long run.
#[derive(Clone, Copy, Debug, Default)]
#[repr(C, align(64))]
pub struct WideParts([f64; PARTS]);

/// Moves sums in float32 to as many in float64.
#[inline(always)]
pub fn flush(from: &mut [Parts], to: &mut [WideParts]) {
    for (from, to) in from.iter_mut().zip(to) {
        for x in 0..PARTS {
            to.0[x] += f64::from(from.0[x]);
        }
        from.0 = [0.0; PARTS];
    }
}

impl WideParts {
    /// All parts together.
    pub fn sum(&self) -> f64 {
        self.0.iter().sum()
    }
}
