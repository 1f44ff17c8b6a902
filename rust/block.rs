//! A block of pixels: what is done to it in an evaluation, each step over all its pixels.
//!
//! For one colour channel, with W (pixel, K), lights L (picture, K) and targets T:
//!
//! ```text
//! I = W Lᵀ,   e = ω (I − T),   ∂/∂W = e L,   ∂/∂L = eᵀ W        (of ½ Σ ω (I − T)²)
//! ```
//!
//! W does not depend on the picture, so its derivative is reduced to the material once per pixel.
//! Factors that depend on the material are float64 and rounded once; the products are float32.
//!
//! Values lie in planes, pixel beside pixel. The three products keep a small rectangle of results
//! in registers (pictures or coefficients by vectors of pixels), so that every number loaded is
//! used several times. The remaining steps are plain loops that the compiler turns into vectors.

use std::ops::Range;

use glam::DVec3;

use crate::sh::{self, BAND_OF, BANDS, COEFFICIENTS, COSINE_TRANSFER, Real};
use crate::shade::{
    self, BlockFunctions, MAX_ENTRIES, MAX_FUNCTIONS, MAX_ROWS, Material, Reflection, each_entry,
    first_entry,
};
use crate::simd::{Ahead, Isa, Kernel, Vectors};

/// Pixels in a block.
pub const BLOCK: usize = 128;
/// Pictures at most that go through the products together: their residuals stay in the cache.
pub const GROUP: usize = 16;
/// Basis functions with a diffuse response: bands 0 to 2.
pub const DIFFUSE: usize = 9;
/// Lanes of the widest vector.
const MAX_LANES: usize = 16;
/// Parts in which sums over pixels are kept.
const PARTS: usize = 8;

/// One number for each pixel of a block.
#[derive(Clone, Copy, Debug)]
#[repr(C, align(64))]
pub struct Plane<T = f32>(pub [T; BLOCK]);

impl<T: Copy + Default> Default for Plane<T> {
    fn default() -> Self {
        Self([T::default(); BLOCK])
    }
}

/// Where the pixels of a block look; a pixel that is not used has zeros.
#[derive(Clone, Debug)]
pub struct Directions<T = f32> {
    cosine: Plane<f64>,
    normal: [Plane<T>; 3],
    mirror: [Plane<T>; 3],
}

/// The basis functions at those directions, A_l Y_k(n) and R_jk; of the latter, as many as the model
/// has.
#[derive(Clone, Debug)]
pub struct Basis<T: Copy + Default = f32> {
    /// A_l Y_k(n)
    pub diffuse: [Plane<T>; DIFFUSE],
    /// R_jk, coefficient by coefficient.
    pub lobe: [Plane<T>; MAX_ENTRIES],
}

impl<T: Copy + Default> Default for Basis<T> {
    fn default() -> Self {
        Self {
            diffuse: [Plane::default(); DIFFUSE],
            lobe: [Plane::default(); MAX_ENTRIES],
        }
    }
}

/// The materials of a block, or derivatives by them.
#[derive(Clone, Debug)]
pub struct Materials<const C: usize> {
    /// Base colour, by channel.
    pub albedo: [Plane<f64>; C],
    /// Perceptual roughness.
    pub roughness: Plane<f64>,
    /// Metallic.
    pub metallic: Plane<f64>,
}

/// No functions of a block yet.
pub fn no_functions<T: Real>() -> Box<BlockFunctions<T>> {
    Box::new([Plane::default(); MAX_FUNCTIONS])
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

/// A sum over pixels, in parts that are added up in float64 in the end.
#[derive(Clone, Copy, Debug, Default)]
#[repr(C, align(32))]
pub struct Parts([f32; PARTS]);

/// Derivatives by the K coefficients of one light.
pub type LightSums<const K: usize> = [Parts; K];

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
    /// Puts a pixel into the block.
    pub fn set(&mut self, pixel: usize, normal: DVec3, view: DVec3) {
        let (cosine, mirror) = shade::directions(normal, view);
        self.put(pixel, cosine, normal, mirror);
    }

    /// Puts a pixel into the block from its clamped n·v, normal and mirror direction.
    pub fn put(&mut self, pixel: usize, cosine: f64, normal: DVec3, mirror: DVec3) {
        self.cosine.0[pixel] = cosine;
        for axis in 0..3 {
            self.normal[axis].0[pixel] = T::from_f64(normal[axis]);
            self.mirror[axis].0[pixel] = T::from_f64(mirror[axis]);
        }
    }

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

    /// Normal and mirror direction of a pixel, as they were rounded.
    pub fn rounded(&self, pixel: usize) -> [DVec3; 2] {
        [self.normal(pixel), self.mirror(pixel)].map(|d| DVec3::from(d.map(Real::to_f64)))
    }
}

#[inline(always)]
fn vector<T: Real>(planes: &[Plane<T>; 3], pixel: usize) -> [T; 3] {
    [planes[0].0[pixel], planes[1].0[pixel], planes[2].0[pixel]]
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
}

/// Takes `count` pixels from planes of `pixels` values each, starting at `first`. Returns whether all
/// of them lie in \[0, 1\].
///
/// The copy lets the compiler know that no two planes overlap, without which the loops over them
/// are no vector code.
pub struct Load<'a, const C: usize> {
    /// Albedo, roughness and, unless it is known, metallic.
    pub maps: &'a [f64],
    /// Pixels in a plane.
    pub pixels: usize,
    /// First pixel of the block.
    pub first: usize,
    /// Pixels of the block that are used; the others get values that do no harm.
    pub count: usize,
    /// Metallic, where maps have none.
    pub known_metallic: Option<f64>,
    /// To be written.
    pub materials: &'a mut Materials<C>,
}

impl<const C: usize> Kernel for Load<'_, C> {
    type Output = bool;

    #[inline(always)]
    fn run<I: Isa>(self, _: I) -> bool {
        let Materials {
            albedo,
            roughness,
            metallic,
        } = self.materials;
        let mut planes = self.maps.chunks(self.pixels);
        let mut in_range = true;
        for to in albedo.iter_mut().chain([roughness, &mut *metallic]) {
            let Some(plane) = planes.next() else {
                break;
            };
            to.0[self.count..].fill(0.5);
            for (to, &from) in to.0.iter_mut().zip(&plane[self.first..][..self.count]) {
                in_range &= from == from.clamp(0.0, 1.0); // NaN is not
                *to = from;
            }
        }
        if let Some(known) = self.known_metallic {
            metallic.0.fill(known);
        }
        in_range
    }
}

/// Fills in the basis functions, those of the lobe for K coefficients.
pub struct FillBasis<'a, M: Reflection, T: Real, const K: usize> {
    /// Where the pixels look.
    pub directions: &'a Directions<T>,
    /// To be written.
    pub basis: &'a mut Basis<T>,
    /// Whose lobe it is.
    pub model: M,
}

impl<M: Reflection, T: Real, const K: usize> Kernel for FillBasis<'_, M, T, K> {
    type Output = ();

    #[inline(always)]
    fn run<I: Isa>(self, _: I) {
        let Self {
            directions, basis, ..
        } = self;
        for x in 0..BLOCK {
            let y = sh::basis(directions.normal(x));
            for k in 0..DIFFUSE {
                basis.diffuse[k].0[x] = T::from_f64(COSINE_TRANSFER[BAND_OF[k]]) * y[k];
            }
        }
        fill_lobe::<M, T, K>(&directions.normal, &directions.mirror, &mut basis.lobe);
    }
}

/// A function of its own, from whose arguments the compiler knows that they do not overlap, and a count
/// that it knows beforehand: else it makes no vector code of so many planes.
#[inline(always)]
fn fill_lobe<M: Reflection, T: Real, const K: usize>(
    normal: &[Plane<T>; 3],
    mirror: &[Plane<T>; 3],
    lobe: &mut [Plane<T>; MAX_ENTRIES],
) {
    let entries = const { first_entry::<M>(K) };
    for x in 0..BLOCK {
        let of_pixel = M::lobe(vector(normal, x), vector(mirror, x));
        for entry in 0..entries {
            lobe[entry].0[x] = of_pixel[entry];
        }
    }
}

/// Numbers of a light that a pixel sees at most: the diffuse one, then one for each row.
pub const MAX_SEEN: usize = 1 + MAX_ROWS;

/// What the pixels see of a light: Σ_k A_l Y_k(n) L_k, and for each row Σ_k R_jk L_k.
#[inline(always)]
pub fn seen<M: Reflection>(
    basis: &Basis<f64>,
    light: &[f64; COEFFICIENTS],
) -> [Plane<f64>; MAX_SEEN] {
    let mut seen = [Plane::default(); MAX_SEEN];
    for k in 0..DIFFUSE {
        for x in 0..BLOCK {
            seen[0].0[x] += light[k] * basis.diffuse[k].0[x];
        }
    }
    each_entry::<M, COEFFICIENTS>(|k, row, entry| {
        let (sum, lobe) = (&mut seen[1 + row], &basis.lobe[entry]);
        for x in 0..BLOCK {
            sum.0[x] += light[k] * lobe.0[x];
        }
    });
    seen
}

/// The same for one vector of pixels, number `v` of the block.
#[inline(always)]
pub fn seen_by<M: Reflection, I: Vectors<f64>>(
    isa: I,
    basis: &Basis<f64>,
    light: &[f64; COEFFICIENTS],
    v: usize,
) -> [I::Vector; MAX_SEEN] {
    let mut seen = [isa.splat(0.0); MAX_SEEN];
    for k in 0..DIFFUSE {
        seen[0] = isa.mul_add(isa.splat(light[k]), I::of(&basis.diffuse[k].0)[v], seen[0]);
    }
    each_entry::<M, COEFFICIENTS>(|k, row, entry| {
        let sum = &mut seen[1 + row];
        *sum = isa.mul_add(isa.splat(light[k]), I::of(&basis.lobe[entry].0)[v], *sum);
    });
    seen
}

/// Fills in the functions of roughness and n·v of a block, in double precision.
pub struct FillFunctions<'a, M: Reflection> {
    /// The clamped n·v.
    pub cosine: &'a Plane<f64>,
    /// In \[0, 1\].
    pub roughness: &'a Plane<f64>,
    /// Whether derivatives by n·v are filled in too.
    pub by_cosine: bool,
    /// To be written.
    pub functions: &'a mut BlockFunctions<M::Precision<f64>>,
    /// Whose functions they are.
    pub model: M,
}

impl<M: Reflection> Kernel for FillFunctions<'_, M> {
    type Output = ();

    #[inline(always)]
    fn run<I: Isa>(self, isa: I) {
        M::fill_functions::<I, f64>(
            isa,
            self.cosine,
            self.roughness,
            self.by_cosine,
            self.functions,
        );
    }
}

/// Fills in functions and factors of the first `pixels` pixels; the others' factors become zero, and
/// with them their weights, residuals and derivatives.
pub struct FillFactors<'a, M: Reflection, T: Real, const C: usize> {
    /// Where the pixels look.
    pub directions: &'a Directions<T>,
    /// What they are made of.
    pub materials: &'a Materials<C>,
    /// Pixels used.
    pub pixels: usize,
    /// Whether derivatives by n·v will be asked for.
    pub by_cosine: bool,
    /// To be written.
    pub functions: &'a mut BlockFunctions<M::Precision<T>>,
    /// To be written.
    pub factors: &'a mut [ChannelFactors<T>; C],
    /// Whose factors they are.
    pub model: M,
}

impl<M: Reflection, T: Real, const C: usize> Kernel for FillFactors<'_, M, T, C> {
    type Output = ();

    #[inline(always)]
    fn run<I: Isa>(self, isa: I) {
        let Self {
            directions,
            materials,
            pixels,
            by_cosine,
            functions,
            factors,
            ..
        } = self;
        M::fill_functions::<I, T>(
            isa,
            &directions.cosine,
            &materials.roughness,
            by_cosine,
            functions,
        );
        M::fill_factors(directions, materials, functions, factors);
        for of_channel in factors {
            of_channel.diffuse.0[pixels..].fill(T::default());
            for plane in &mut of_channel.rows[..M::ROWS] {
                plane.0[pixels..].fill(T::default());
            }
        }
    }
}

#[inline(always)]
pub(crate) fn factors_of<M: Reflection, T: Real, const C: usize>(
    directions: &Directions<T>,
    materials: &Materials<C>,
    functions: &BlockFunctions<M::Precision<T>>,
    x: usize,
) -> M::Factors<C> {
    M::factors(
        directions.cosine.0[x],
        &materials.get(x),
        M::functions_of(functions, x),
    )
}

/// Fills in one channel's weights, W transposed: coefficient first.
pub struct FillWeights<'a, M: Reflection, T: Real, const K: usize> {
    /// The basis functions.
    pub basis: &'a Basis<T>,
    /// The channel's factors.
    pub factors: &'a ChannelFactors<T>,
    /// To be written.
    pub weights: &'a mut [Plane<T>; K],
    /// Whose weights they are.
    pub model: M,
}

impl<M: Reflection, const K: usize> Kernel for FillWeights<'_, M, f64, K> {
    type Output = ();

    #[inline(always)]
    fn run<I: Isa>(self, isa: I) {
        fill_weights::<M, f64, I, K>(isa, self.basis, self.factors, self.weights);
    }
}

impl<M: Reflection, const K: usize> Kernel for FillWeights<'_, M, f32, K> {
    type Output = ();

    #[inline(always)]
    fn run<I: Isa>(self, isa: I) {
        fill_weights::<M, f32, I, K>(isa, self.basis, self.factors, self.weights);
    }
}

#[inline(always)]
fn fill_weights<M: Reflection, T: Real, I: Vectors<T>, const K: usize>(
    isa: I,
    basis: &Basis<T>,
    factors: &ChannelFactors<T>,
    weights: &mut [Plane<T>; K],
) {
    // Pixels outside, so that the factors stay in registers.
    for v in 0..BLOCK / I::LANES {
        weights_of_band::<M, T, I, 0>(isa, basis, factors, v, weights);
        weights_of_band::<M, T, I, 1>(isa, basis, factors, v, weights);
        weights_of_band::<M, T, I, 2>(isa, basis, factors, v, weights);
        if K == COEFFICIENTS {
            weights_of_band::<M, T, I, 3>(isa, basis, factors, v, weights);
        }
    }
}

/// Those of band L, for one vector of pixels. Of one band, because then the compiler knows all counts.
#[inline(always)]
fn weights_of_band<M: Reflection, T: Real, I: Vectors<T>, const L: usize>(
    isa: I,
    basis: &Basis<T>,
    factors: &ChannelFactors<T>,
    v: usize,
    weights: &mut [Plane<T>],
) {
    let diffuse = I::of(&factors.diffuse.0)[v];
    let (first_row, rows) = (M::FIRST_ROW[L], M::FIRST_ROW[L + 1] - M::FIRST_ROW[L]);
    let mut factor = [diffuse; BANDS];
    for j in 0..rows {
        factor[j] = I::of(&factors.rows[first_row + j].0)[v];
    }
    let first_entry = const { first_entry::<M>(L * L) };
    for i in 0..2 * L + 1 {
        let (k, entry) = (L * L + i, first_entry + i * rows);
        let mut w = isa.mul(factor[0], I::of(&basis.lobe[entry].0)[v]);
        for j in 1..rows {
            w = isa.mul_add(factor[j], I::of(&basis.lobe[entry + j].0)[v], w);
        }
        if k < DIFFUSE {
            w = isa.mul_add(diffuse, I::of(&basis.diffuse[k].0)[v], w);
        }
        I::of_mut(&mut weights[k].0)[v] = w;
    }
}

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

/// First product: e = ω (W Lᵀ − T) for up to [`GROUP`] pictures. Returns Σ ω (I − T)².
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
    /// What the next steps will need.
    pub ahead: &'a mut Ahead,
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

impl<'a, const K: usize, const WEIGHTED: bool> Residuals<'a, K, WEIGHTED> {
    /// The same without ω: e = W Lᵀ − T.
    pub fn unweighted(self) -> Residuals<'a, K, false> {
        let Self {
            weights,
            lights,
            targets,
            residuals,
            ahead,
            ..
        } = self;
        Residuals {
            weights,
            lights,
            targets,
            sample_weights: &[],
            residuals,
            ahead,
        }
    }

    #[inline(always)]
    fn all<I: Vectors<f32>, const V: usize>(&mut self, isa: I) -> f64 {
        let n = self.lights.len();
        let mut squares = [isa.splat(0.0); V];
        let mut j = 0;
        while j + 4 <= n {
            self.some::<I, V, 4>(isa, j, &mut squares);
            j += 4;
        }
        match n - j {
            3 => self.some::<I, V, 3>(isa, j, &mut squares),
            2 => self.some::<I, V, 2>(isa, j, &mut squares),
            1 => self.some::<I, V, 1>(isa, j, &mut squares),
            _ => {}
        }
        let mut sum = 0.0;
        for i in 0..V {
            sum += lanes(isa, squares[i])
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
        squares: &mut [I::Vector; V],
    ) {
        let lights = &self.lights[first..first + J];
        let targets = &self.targets[first..first + J];
        let residuals = &mut self.residuals[first..first + J];
        for v in (0..BLOCK / I::LANES).step_by(V) {
            self.ahead.step(I::LANES / 2);
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
                        squares[i] = isa.mul_add(out[i], e, squares[i]);
                    } else {
                        out[i] = e;
                        squares[i] = isa.mul_add(e, e, squares[i]);
                    }
                }
            }
        }
    }
}

/// Second product, reduced at once to the derivatives by kd and by the rows' factors.
pub struct Reduce<'a, M: Reflection, const K: usize, B: ByWeights = ()> {
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
    /// What else the derivatives by the weights are for.
    pub by_weights: B,
    /// What the next steps will need.
    pub ahead: &'a mut Ahead,
    /// Whose weights they are.
    pub model: M,
}

/// Takes the derivatives by the weights as [`Reduce`] comes upon them; `()` does nothing with them.
pub trait ByWeights {
    /// Those by coefficient k, of V vectors of pixels from number `v` on,
    /// summed over some pictures.
    fn take<I: Vectors<f32>, const V: usize>(
        &mut self,
        isa: I,
        k: usize,
        v: usize,
        by_weights: &[I::Vector; V],
    );
}

impl ByWeights for () {
    #[inline(always)]
    fn take<I: Vectors<f32>, const V: usize>(
        &mut self,
        _: I,
        _: usize,
        _: usize,
        _: &[I::Vector; V],
    ) {
    }
}

impl<M: Reflection, const K: usize, B: ByWeights> Kernel for Reduce<'_, M, K, B> {
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

impl<'a, M: Reflection, const K: usize> Reduce<'a, M, K> {
    /// The same, with another use for the derivatives by the weights.
    pub fn giving<B: ByWeights>(self, by_weights: B) -> Reduce<'a, M, K, B> {
        let Self {
            begin,
            basis,
            lights,
            residuals,
            sums,
            ahead,
            model,
            ..
        } = self;
        Reduce {
            begin,
            basis,
            lights,
            residuals,
            sums,
            by_weights,
            ahead,
            model,
        }
    }
}

impl<M: Reflection, const K: usize, B: ByWeights> Reduce<'_, M, K, B> {
    /// `COUNT` coefficients from `FIRST`, V vectors at a time.
    #[inline(always)]
    fn some<I: Vectors<f32>, const FIRST: usize, const COUNT: usize, const V: usize>(
        &mut self,
        isa: I,
    ) {
        for v in (0..BLOCK / I::LANES).step_by(V) {
            self.ahead.step(I::LANES / 2);
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
                self.by_weights.take(isa, FIRST + k, v, &by_weights[k]);
                if FIRST + k < DIFFUSE {
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
            if FIRST < DIFFUSE {
                let sum = &mut I::of_mut(&mut self.sums.diffuse.0)[v..v + V];
                add(isa, self.begin && FIRST == 0, sum, &diffuse);
            }
        }
    }
}

impl<M: Reflection, const K: usize, B: ByWeights> Reduce<'_, M, K, B> {
    /// The sums of the rows of band L.
    #[inline(always)]
    fn rows<I: Vectors<f32>, const V: usize, const L: usize>(
        &mut self,
        isa: I,
        v: usize,
        by_weights: &[[I::Vector; V]],
    ) {
        let (first_row, rows) = (M::FIRST_ROW[L], M::FIRST_ROW[L + 1] - M::FIRST_ROW[L]);
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
            add(isa, self.begin, sum, &row);
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
    /// What the next steps will need.
    pub ahead: &'a mut Ahead,
}

impl<const K: usize> Kernel for ByLights<'_, K> {
    type Output = ();

    #[inline(always)]
    fn run<I: Isa>(mut self, isa: I) {
        if K == DIFFUSE {
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
            self.ahead.step(I::LANES / 2);
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

/// The lanes of a vector, with zeros to the widest.
#[inline(always)]
fn lanes<I: Vectors<f32>>(_: I, vector: I::Vector) -> [f32; MAX_LANES] {
    let mut lanes = [0.0; MAX_LANES];
    I::of_mut(&mut lanes)[0] = vector;
    lanes
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

/// Moves sums in float32 to sums in float64.
pub struct Flush<'a> {
    /// Become zero.
    pub from: &'a mut [Parts],
    /// As many; added to.
    pub to: &'a mut [WideParts],
}

impl Kernel for Flush<'_> {
    type Output = ();

    #[inline(always)]
    fn run<I: Isa>(self, _: I) {
        for (from, to) in self.from.iter_mut().zip(self.to) {
            for x in 0..PARTS {
                to.0[x] += f64::from(from.0[x]);
            }
            from.0 = [0.0; PARTS];
        }
    }
}

impl WideParts {
    /// All parts together.
    pub fn sum(&self) -> f64 {
        self.0.iter().sum()
    }
}

/// The pictures in groups of at most [`GROUP`], as even as fours allow.
pub fn groups(pictures: usize) -> impl Iterator<Item = Range<usize>> {
    let size = pictures
        .div_ceil(pictures.div_ceil(GROUP))
        .next_multiple_of(4);
    (0..pictures)
        .step_by(size)
        .map(move |first| first..(first + size).min(pictures))
}

/// The last step: from the channels' sums to the derivatives by the material, times `scale`.
pub struct PullBack<'a, M: Reflection, const C: usize> {
    /// Where the pixels look.
    pub directions: &'a Directions,
    /// What they are made of.
    pub materials: &'a Materials<C>,
    /// The functions of their roughness and n·v.
    pub functions: &'a BlockFunctions<M::Precision<f32>>,
    /// The adjoint of the factors.
    pub sums: &'a [ChannelSums; C],
    /// Factor on all derivatives.
    pub scale: f64,
    /// To be written.
    pub gradient: &'a mut Materials<C>,
    /// Whose factors they are.
    pub model: M,
}

impl<M: Reflection, const C: usize> Kernel for PullBack<'_, M, C> {
    type Output = ();

    #[inline(always)]
    fn run<I: Isa>(self, _: I) {
        let Self {
            directions,
            materials,
            functions,
            sums,
            scale,
            gradient,
            ..
        } = self;
        M::pull_back_block(directions, materials, functions, sums, scale, gradient);
    }
}

/// The adjoint of one pixel's factors: derivatives by kd_c and by s_cj.
#[inline(always)]
pub(crate) fn sums_of<M: Reflection, const C: usize>(
    sums: &[ChannelSums; C],
    x: usize,
) -> ([f64; C], [shade::ByRow; C]) {
    let (mut by_diffuse, mut by_row) = ([0.0; C], [[0.0; MAX_ROWS]; C]);
    for c in 0..C {
        by_diffuse[c] = f64::from(sums[c].diffuse.0[x]);
        for j in 0..M::ROWS {
            by_row[c][j] = f64::from(sums[c].rows[j].0[x]);
        }
    }
    (by_diffuse, by_row)
}
