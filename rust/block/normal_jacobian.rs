//! Blocks of pixels whose normals are free: where they look, and how that changes with their tangent
//! offsets.

use glam::DVec3;

use crate::block::basis::Basis;
use crate::reflectance::ggx::MIN_COSINE;
use crate::reflectance::planes::{
    BLOCK, BlockFunctions, ChannelFactors, ChannelSums, Directions, Doubles, Materials, Plane,
    vector,
};
use crate::reflectance::reflection::{
    Factors, OPEN_DIFFUSE, Reflection, factors_of, first_entry, rows_of_band, sums_of,
};
use crate::reflectance::sh::{self, BAND_OF, COEFFICIENTS, COSINE_TRANSFER, Real};
use crate::reflectance::tangent_offset;
use crate::runtime::Result;
use crate::runtime::memory::zeros;
use crate::runtime::simd::Vectors;

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
        let (normal, view) = (vector(&self.normal, pixel), vector(&self.view, pixel));
        [DVec3::from_array(normal), DVec3::from_array(view)]
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

    /// Where the pixels look at their given normals.
    #[inline(always)]
    pub fn place<T: Real>(&self, directions: &mut Directions<T>) {
        let mut cosines = Doubles::default();
        let mut mirrors = <[Doubles; 3]>::default();
        for x in 0..BLOCK {
            let [normal, view] = self.get(x);
            let cosine = normal.dot(view);
            let mirror = 2.0 * cosine * normal - view;
            cosines.0[x] = cosine.max(MIN_COSINE);
            for axis in 0..3 {
                mirrors[axis].0[x] = mirror[axis];
            }
        }
        directions.fill(&cosines, &self.normal, &mirrors);
    }

    /// Where the pixels look at their tangent offsets, and how that changes with these.
    ///
    /// ```text
    /// R = 2(n·v)n − v          ∂R/∂a = 2(v·∂n/∂a) n + 2(n·v) ∂n/∂a          ∂(n·v)/∂a = v·∂n/∂a
    /// ```
    #[inline(always)]
    pub fn turn<T: Real>(
        &self,
        offsets: &TangentOffsets,
        directions: &mut Directions<T>,
        jacobian: &mut NormalJacobian,
    ) {
        // Planes of their own, which overlap nothing: else the compiler makes no vector code.
        let mut cosines = Doubles::default();
        let [mut normals, mut mirrors] = <[[Doubles; 3]; 2]>::default();
        let mut slopes = NormalJacobian::default();
        for x in 0..BLOCK {
            let [normal, view] = self.get(x);
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

impl NormalJacobian {
    /// Fills in the derivatives of the basis functions by one of the tangent offsets, 0 or 1: A_l
    /// ∇Y_k(n)·∂n/∂a, and those of R_jk.
    #[inline(always)]
    pub fn fill_basis_slopes<M: Reflection>(
        &self,
        offset: usize,
        directions: &Directions<f64>,
        slopes: &mut Basis<f64>,
    ) {
        let (by_normal, by_mirror) = (&self.normal[offset], &self.mirror[offset]);
        for x in 0..BLOCK {
            let by = vector(by_normal, x);
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
            let by = [by_normal, by_mirror].map(|by| vector(by, x));
            let along = M::lobe_along([directions.normal(x), directions.mirror(x)], by);
            for i in 0..entries {
                slopes.lobe[i].0[x] = along[i];
            }
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
    #[inline(always)]
    pub fn pull_back<M: Reflection, const C: usize, const K: usize>(
        &self,
        directions: &Directions,
        materials: &Materials<C>,
        functions: &BlockFunctions<M::Precision<f32>>,
        sums: &[ChannelSums; C],
        by_basis: &Basis,
        scale: f64,
    ) -> TangentOffsets {
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
        let mut gradient = TangentOffsets::default();
        for t in 0..2 {
            let (normal, mirror) = (&self.normal[t], &self.mirror[t]);
            let mut by_offset = Doubles::default();
            for x in 0..BLOCK {
                let mut by = by_cosine.0[x] * self.cosine[t].0[x];
                for axis in 0..3 {
                    by += f64::from(by_normal[axis].0[x]) * normal[axis].0[x]
                        + f64::from(by_mirror[axis].0[x]) * mirror[axis].0[x];
                }
                by_offset.0[x] = scale * by;
            }
            gradient[t] = by_offset;
        }
        gradient
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
