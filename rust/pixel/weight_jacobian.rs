//! How the weights of a block of pixels change with the tangent offsets of their normals.
//!
//! With the clamped x = n·v the derivative of w_ck (see [`shade`](crate::reflectance::shade)) by
//! the tangent offset a is
//!
//! ```text
//! ∂w_ck/∂a = kd_c A_l ∇Y_k(n)·∂n/∂a + (dkd_c/dx) (∂x/∂a) A_l Y_k(n)
//!          + Σ_j s_cj ∂R_jk/∂a + (ds_cj/dx) (∂x/∂a) R_jk
//! ```
//!
//! and the same for b. No picture changes it, so a sample costs a sum over k, as radiance does.

use crate::block::basis::Basis;
use crate::block::normal_jacobian::{GivenDirections, NormalJacobian, TangentOffsets};
use crate::reflectance::planes::{BLOCK, Directions, Doubles, MAX_ROWS, Materials};
use crate::reflectance::reflection::{
    ExactFunctions, Factors, OPEN_DIFFUSE, Reflection, each_entry,
};
use crate::reflectance::sh::COEFFICIENTS;
use crate::reflectance::tangent_offset::OFFSETS;
use crate::runtime::simd::{Instructions, vectorized};

/// The normals of up to [`BLOCK`] pixels, and the derivatives of their weights.
pub(crate) struct WeightJacobian {
    pub(crate) given: GivenDirections,
    pub(crate) offsets: TangentOffsets,
    jacobian: NormalJacobian,
    /// Derivatives of the basis functions, by tangent offset.
    slopes: [Basis<f64>; OFFSETS],
    /// ∂w_ck by each tangent offset, by channel.
    pub(crate) weights: Vec<[[Doubles; COEFFICIENTS]; OFFSETS]>,
}

impl WeightJacobian {
    pub(crate) fn new(channels: usize) -> Self {
        Self {
            given: GivenDirections::default(),
            offsets: TangentOffsets::default(),
            jacobian: NormalJacobian::default(),
            slopes: Default::default(),
            weights: vec![[[Doubles::default(); COEFFICIENTS]; OFFSETS]; channels],
        }
    }

    /// Gives the pixels tangent offsets, and works out where they look.
    pub(crate) fn turn(
        &mut self,
        isa: Instructions,
        offsets: &TangentOffsets,
        directions: &mut Directions<f64>,
    ) {
        self.offsets = *offsets;
        let jacobian = &mut self.jacobian;
        vectorized!(isa, self.given.turn(offsets, directions, jacobian));
    }

    /// Works out the derivatives of the weights.
    pub(crate) fn fill<M: Reflection, const C: usize>(
        &mut self,
        isa: Instructions,
        directions: &Directions<f64>,
        basis: &Basis<f64>,
        materials: &Materials<C>,
        functions: &ExactFunctions<M>,
    ) {
        let jacobian = &self.jacobian;
        for (offset, slopes) in self.slopes.iter_mut().enumerate() {
            vectorized!(
                isa,
                jacobian.fill_basis_slopes::<M>(offset, directions, slopes)
            );
        }
        for c in 0..C {
            vectorized!(
                isa,
                self.fill_weights::<M, C>(c, directions, basis, materials, functions)
            );
        }
    }

    /// Those of one channel.
    #[inline(always)]
    fn fill_weights<M: Reflection, const C: usize>(
        &mut self,
        c: usize,
        directions: &Directions<f64>,
        basis: &Basis<f64>,
        materials: &Materials<C>,
        functions: &ExactFunctions<M>,
    ) {
        // kd and s_j, and their derivatives by the cosine.
        let (mut diffuse, mut by_diffuse) = <(Doubles, Doubles)>::default();
        let (mut rows, mut by_row) = <([Doubles; MAX_ROWS], [Doubles; MAX_ROWS])>::default();
        for x in 0..BLOCK {
            let material = materials.of_channel(c, x);
            let cosine = directions.cosine(x);
            let factors = M::factors(cosine, &material, M::functions_of(functions, x));
            let ([diffuse_slope], [row_slopes]) = factors.slopes_by_cosine(cosine, &material);
            diffuse.0[x] = factors.diffuse(0);
            by_diffuse.0[x] = diffuse_slope;
            for j in 0..M::ROWS {
                rows[j].0[x] = factors.row(0, j);
                by_row[j].0[x] = row_slopes[j];
            }
        }
        for t in 0..OFFSETS {
            let (cosine, slopes) = (&self.jacobian.cosine[t], &self.slopes[t]);
            let of_offset = &mut self.weights[c][t];
            of_offset.fill(Doubles::default());
            each_entry::<M, COEFFICIENTS>(|k, j, entry| {
                let (row, by_row) = (&rows[j], &by_row[j]);
                let (slope, lobe) = (&slopes.lobe[entry], &basis.lobe[entry]);
                let weights = &mut of_offset[k];
                for x in 0..BLOCK {
                    weights.0[x] += row.0[x] * slope.0[x] + cosine.0[x] * by_row.0[x] * lobe.0[x];
                }
            });
            for k in 0..OPEN_DIFFUSE {
                let weights = &mut of_offset[k];
                for x in 0..BLOCK {
                    weights.0[x] += diffuse.0[x] * slopes.diffuse[k].0[x]
                        + cosine.0[x] * by_diffuse.0[x] * basis.diffuse[k].0[x];
                }
            }
        }
    }
}
