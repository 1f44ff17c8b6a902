//! Blocks of pixels whose normals are free: where they look, and how that changes with their tangent
//! offsets.

use glam::DVec3;

use crate::block::basis::Basis;
use crate::reflectance::ggx::MIN_COSINE;
use crate::reflectance::planes::{
    BLOCK, BlockFunctions, ChannelFactors, ChannelSums, Directions, Doubles, Materials, Plane,
};
use crate::reflectance::reflection::{
    Factors, OPEN_DIFFUSE, Reflection, factors_of, first_entry, rows_of_band, sums_of,
};
use crate::reflectance::sh::{self, BAND_OF, COEFFICIENTS, COSINE_TRANSFER, Real};
use crate::reflectance::tangent_offset;
use crate::runtime::Result;
use crate::runtime::memory::zeros;
use crate::runtime::simd::{Isa, Kernel, Vectors};

/// The tangent offsets (a, b) of a block of pixels.
pub type TangentOffsets = [Doubles; 2];

/// Given normals, which tangent offsets start from, and view directions; a pixel that is not used has
/// +z for both.
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
    /// Puts a pixel into the block.
    pub fn set(&mut self, pixel: usize, [normal, view]: [DVec3; 2]) {
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

    /// Blocks for some pixels. Normals that are free are brought to length 1 to the last digit, as
    /// those of any tangent offset are.
    pub fn blocks(normals: &[DVec3], views: &[DVec3], free: bool) -> Result<Vec<Self>> {
        let count = normals.len().div_ceil(BLOCK);
        let mut blocks: Vec<Self> = zeros("normals", count)?;
        for (p, (&normal, &view)) in normals.iter().zip(views).enumerate() {
            let normal = if free { normal.normalize() } else { normal };
            blocks[p / BLOCK].set(p % BLOCK, [normal, view]);
        }
        Ok(blocks)
    }
}

#[inline(always)]
fn vector(planes: &[Doubles; 3], pixel: usize) -> DVec3 {
    DVec3::new(planes[0].0[pixel], planes[1].0[pixel], planes[2].0[pixel])
}

/// Directions of the pixels of a block at their given normals.
pub struct GivenNormals<'a, T: Real> {
    /// What is given.
    pub given: &'a GivenDirections,
    /// To be written.
    pub directions: &'a mut Directions<T>,
}

impl<T: Real> Kernel for GivenNormals<'_, T> {
    type Output = ();

    #[inline(always)]
    fn run<I: Isa>(self, _: I) {
        let mut cosines = Doubles::default();
        let mut mirrors = <[Doubles; 3]>::default();
        for x in 0..BLOCK {
            let [normal, view] = self.given.get(x);
            let cosine = normal.dot(view);
            let mirror = 2.0 * cosine * normal - view;
            cosines.0[x] = cosine.max(MIN_COSINE);
            for axis in 0..3 {
                mirrors[axis].0[x] = mirror[axis];
            }
        }
        self.directions.fill(&cosines, &self.given.normal, &mirrors);
    }
}

/// Derivatives of [`Directions`] by the tangent offsets a and b.
#[derive(Clone, Debug, Default)]
pub struct NormalJacobian {
    /// Of n.
    pub normal: [[Doubles; 3]; 2],
    /// Of the mirror direction.
    pub mirror: [[Doubles; 3]; 2],
    /// Of the clamped n·v: 0 where n·v ≤ [`MIN_COSINE`].
    pub cosine: [Doubles; 2],
}

/// Directions of the pixels of a block at their tangent offsets, and how they change with these.
///
/// ```text
/// R = 2(n·v)n − v          ∂R/∂a = 2(v·∂n/∂a) n + 2(n·v) ∂n/∂a          ∂(n·v)/∂a = v·∂n/∂a
/// ```
pub struct OffsetNormals<'a, T: Real> {
    /// Where the offsets start.
    pub given: &'a GivenDirections,
    /// By how much.
    pub offsets: &'a TangentOffsets,
    /// To be written.
    pub directions: &'a mut Directions<T>,
    /// To be written.
    pub jacobian: &'a mut NormalJacobian,
}

impl<T: Real> Kernel for OffsetNormals<'_, T> {
    type Output = ();

    #[inline(always)]
    fn run<I: Isa>(self, _: I) {
        let Self {
            given,
            offsets,
            directions,
            jacobian,
        } = self;
        // Planes of their own, which overlap nothing: else the compiler makes no vector code.
        let mut cosines = Doubles::default();
        let [mut normals, mut mirrors] = <[[Doubles; 3]; 2]>::default();
        let mut slopes = NormalJacobian::default();
        for x in 0..BLOCK {
            let [normal, view] = given.get(x);
            let turned = tangent_offset::offset_normal(normal, [offsets[0].0[x], offsets[1].0[x]]);
            let normal = turned.normal;
            let cosine = normal.dot(view);
            let mirror = 2.0 * cosine * normal - view;
            // Not `max`, which treats NaN in a way of its own.
            let free = cosine > MIN_COSINE;
            cosines.0[x] = if free { cosine } else { MIN_COSINE };
            for axis in 0..3 {
                normals[axis].0[x] = normal[axis];
                mirrors[axis].0[x] = mirror[axis];
            }
            for t in 0..2 {
                let by = turned.by_offset[t];
                let by_cosine = view.dot(by);
                let mirror = 2.0 * (by_cosine * normal + cosine * by);
                for axis in 0..3 {
                    slopes.normal[t][axis].0[x] = by[axis];
                    slopes.mirror[t][axis].0[x] = mirror[axis];
                }
                slopes.cosine[t].0[x] = if free { by_cosine } else { 0.0 };
            }
        }
        directions.fill(&cosines, &normals, &mirrors);
        jacobian.clone_from(&slopes);
    }
}

/// Fills in the derivatives of the basis functions by one of the tangent offsets: A_l
/// ∇Y_k(n)·∂n/∂a, and those of R_jk.
pub struct FillBasisSlopes<'a, M: Reflection> {
    /// Where the pixels look.
    pub directions: &'a Directions<f64>,
    /// How that changes.
    pub jacobian: &'a NormalJacobian,
    /// 0 or 1.
    pub offset: usize,
    /// To be written.
    pub slopes: &'a mut Basis<f64>,
    /// Whose basis it is.
    pub model: M,
}

impl<M: Reflection> Kernel for FillBasisSlopes<'_, M> {
    type Output = ();

    #[inline(always)]
    fn run<I: Isa>(self, _: I) {
        let Self {
            directions,
            jacobian,
            offset,
            slopes,
            ..
        } = self;
        let (by_normal, by_mirror) = (&jacobian.normal[offset], &jacobian.mirror[offset]);
        for x in 0..BLOCK {
            let by = vector(by_normal, x).to_array();
            let mut along = [0.0; COEFFICIENTS];
            sh::each_slope(directions.normal(x), |k, axis, slope| {
                along[k] += slope * by[axis];
            });
            for k in 0..OPEN_DIFFUSE {
                slopes.diffuse[k].0[x] = COSINE_TRANSFER[BAND_OF[k]] * along[k];
            }
        }
        let entries = const { first_entry::<M>(COEFFICIENTS) };
        for x in 0..BLOCK {
            let by = [by_normal, by_mirror].map(|by| vector(by, x).to_array());
            let along = M::lobe_along([directions.normal(x), directions.mirror(x)], by);
            for i in 0..entries {
                slopes.lobe[i].0[x] = along[i];
            }
        }
    }
}

/// Sums up derivatives by the basis functions, of all channels: Σ_c kd_c g_ck is that by A_l Y_k(n),
/// and Σ_c s_cj g_ck that by R_jk, for k > 0. Those of Y₀ do not change.
pub struct ByBasis<'a, M: Reflection> {
    /// Whether to begin the sums, or add to them.
    pub begin: bool,
    /// The channel's factors.
    pub factors: &'a ChannelFactors,
    /// Written or added to.
    pub sums: &'a mut Basis,
    /// Whose basis it is.
    pub model: M,
}

impl<M: Reflection> ByBasis<'_, M> {
    /// Takes those by the weights of coefficient k, of V vectors of pixels from number `v` on, summed
    /// over some pictures.
    #[inline(always)]
    pub(super) fn take<I: Vectors<f32>, const V: usize>(
        &mut self,
        isa: I,
        k: usize,
        v: usize,
        by_weights: &[I::Vector; V],
    ) {
        let Self {
            begin,
            factors,
            sums,
            ..
        } = self;
        if k > 0 {
            let (first, rows) = rows_of_band::<M>(BAND_OF[k]);
            for j in first..first + rows {
                let sum = &mut sums.lobe[first_entry::<M>(k) + j - first];
                add_products(isa, *begin, &factors.rows[j], by_weights, v, sum);
            }
            if k < OPEN_DIFFUSE {
                let sum = &mut sums.diffuse[k];
                add_products(isa, *begin, &factors.diffuse, by_weights, v, sum);
            }
        }
    }
}

/// sum = factor · by_weights, or added to it unless this is where to `begin`; for V vectors of pixels
/// from number `v` on.
///
/// A function and no closure: whether the compiler inlines a closure here depends on what else is built,
/// and without that an evaluation takes a third longer.
#[inline(always)]
fn add_products<I: Vectors<f32>, const V: usize>(
    isa: I,
    begin: bool,
    factor: &Plane,
    by_weights: &[I::Vector; V],
    v: usize,
    sum: &mut Plane,
) {
    let factor = &I::of(&factor.0)[v..v + V];
    let sum = &mut I::of_mut(&mut sum.0)[v..v + V];
    for i in 0..V {
        sum[i] = if begin {
            isa.mul(factor[i], by_weights[i])
        } else {
            isa.mul_add(factor[i], by_weights[i], sum[i])
        };
    }
}

/// The last step: from the sums over pictures to the derivatives by the tangent offsets, times
/// `scale`.
///
/// With g_D and g_B what [`ByBasis`] found, and x = n·v,
///
/// ```text
/// g_n = Σ_k g_Dk A_l ∇Y_k(n) + Σ_jk g_Bjk ∂R_jk/∂n          g_R = Σ_jk g_Bjk ∂R_jk/∂mirror
/// g_x = Σ_c dkd_c/dx g_kd_c + Σ_j ds_cj/dx g_s_cj
/// g_a = g_n·∂n/∂a + g_R·∂mirror/∂a + g_x ∂x/∂a
/// ```
pub struct PullBackNormals<'a, M: Reflection, const C: usize, const K: usize> {
    /// Where the pixels look.
    pub directions: &'a Directions,
    /// How that changes with their tangent offsets.
    pub jacobian: &'a NormalJacobian,
    /// What they are made of.
    pub materials: &'a Materials<C>,
    /// The functions of their roughness and n·v, with derivatives by n·v.
    pub functions: &'a BlockFunctions<M::Precision<f32>>,
    /// The adjoint of the factors.
    pub sums: &'a [ChannelSums; C],
    /// The adjoint of the basis functions.
    pub by_basis: &'a Basis,
    /// Factor on all derivatives.
    pub scale: f64,
    /// To be written.
    pub gradient: &'a mut TangentOffsets,
}

impl<M: Reflection, const C: usize, const K: usize> Kernel for PullBackNormals<'_, M, C, K> {
    type Output = ();

    #[inline(always)]
    fn run<I: Isa>(self, _: I) {
        let Self {
            directions,
            jacobian,
            materials,
            functions,
            sums,
            by_basis,
            scale,
            gradient,
        } = self;
        let mut by_normal: [Plane; 3] = Default::default();
        for x in 0..BLOCK {
            let mut by = [0.0; 3];
            sh::each_slope(directions.normal(x), |k, axis, slope| {
                if k < OPEN_DIFFUSE {
                    by[axis] +=
                        COSINE_TRANSFER[BAND_OF[k]] as f32 * slope * by_basis.diffuse[k].0[x];
                }
            });
            for axis in 0..3 {
                by_normal[axis].0[x] = by[axis];
            }
        }
        let [mut by_lobe_normal, mut by_mirror] = <[[Plane; 3]; 2]>::default();
        for x in 0..BLOCK {
            let (normal, mirror) = (directions.normal(x), directions.mirror(x));
            let [of_normal, of_mirror] =
                M::lobe_adjoint::<f32, K>(normal, mirror, |i| by_basis.lobe[i].0[x]);
            for axis in 0..3 {
                by_lobe_normal[axis].0[x] = of_normal[axis];
                by_mirror[axis].0[x] = of_mirror[axis];
            }
        }
        for axis in 0..3 {
            for x in 0..BLOCK {
                by_normal[axis].0[x] += by_lobe_normal[axis].0[x];
            }
        }
        // Planes of their own, which overlap nothing: else the compiler makes no vector code.
        let mut by_cosine = Doubles::default();
        for x in 0..BLOCK {
            let factors = factors_of::<M, f32, C>(directions, materials, functions, x);
            let (by_diffuse, by_row) = sums_of::<M, C>(sums, x);
            let by_channel = factors.by_cosine(
                directions.cosine(x),
                &materials.get(x),
                &by_diffuse,
                &by_row,
            );
            let mut by = 0.0;
            for c in 0..C {
                by += by_channel[c];
            }
            by_cosine.0[x] = by;
        }
        for t in 0..2 {
            let (normal, mirror) = (&jacobian.normal[t], &jacobian.mirror[t]);
            let mut by_offset = Doubles::default();
            for x in 0..BLOCK {
                let mut by = by_cosine.0[x] * jacobian.cosine[t].0[x];
                for axis in 0..3 {
                    by += f64::from(by_normal[axis].0[x]) * normal[axis].0[x]
                        + f64::from(by_mirror[axis].0[x]) * mirror[axis].0[x];
                }
                by_offset.0[x] = scale * by;
            }
            gradient[t] = by_offset;
        }
    }
}
