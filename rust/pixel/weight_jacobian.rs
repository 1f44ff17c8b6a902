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
use crate::block::normal_jacobian::{
    FillBasisSlopes, GivenDirections, NormalJacobian, OffsetNormals, TangentOffsets,
};
use crate::problem::Problem;
use crate::reflectance::planes::{BLOCK, Directions, Doubles, MAX_ROWS, Material, Materials};
use crate::reflectance::reflection::{
    ExactFunctions, Factors, OPEN_DIFFUSE, Reflection, each_entry,
};
use crate::reflectance::sh::COEFFICIENTS;
use crate::reflectance::tangent_offset::OFFSETS;
use crate::runtime::simd::{Instructions, Isa, Kernel};

/// The normals of up to [`BLOCK`] pixels, and the derivatives of their weights.
pub(crate) struct WeightJacobian {
    given: GivenDirections,
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

    /// Takes up pixels, whose tangent offsets are still to come.
    pub(crate) fn place(&mut self, problem: &Problem, pixels: &[usize]) {
        self.given = problem.picked_given(pixels);
    }

    /// Gives the pixels tangent offsets, and works out where they look.
    pub(crate) fn turn(
        &mut self,
        isa: Instructions,
        offsets: &TangentOffsets,
        directions: &mut Directions<f64>,
    ) {
        self.offsets = *offsets;
        isa.run(OffsetNormals {
            given: &self.given,
            offsets,
            directions,
            jacobian: &mut self.jacobian,
        });
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
        let model = M::default();
        for (offset, slopes) in self.slopes.iter_mut().enumerate() {
            isa.run(FillBasisSlopes {
                directions,
                jacobian: &self.jacobian,
                offset,
                slopes,
                model,
            });
        }
        for (albedo, weights) in materials.albedo.iter().zip(&mut self.weights) {
            isa.run(FillWeightJacobian::<M> {
                directions,
                basis,
                jacobian: &self.jacobian,
                slopes: &self.slopes,
                albedo,
                roughness: &materials.roughness,
                metallic: &materials.metallic,
                functions,
                weights,
            });
        }
    }
}

/// Fills in the derivatives of the weights of one channel.
struct FillWeightJacobian<'a, M: Reflection> {
    directions: &'a Directions<f64>,
    basis: &'a Basis<f64>,
    jacobian: &'a NormalJacobian,
    slopes: &'a [Basis<f64>; OFFSETS],
    albedo: &'a Doubles,
    roughness: &'a Doubles,
    metallic: &'a Doubles,
    functions: &'a ExactFunctions<M>,
    weights: &'a mut [[Doubles; COEFFICIENTS]; OFFSETS],
}

impl<M: Reflection> Kernel for FillWeightJacobian<'_, M> {
    type Output = ();

    #[inline(always)]
    fn run<I: Isa>(self, _: I) {
        // kd and s_j, and their derivatives by the cosine.
        let (mut diffuse, mut by_diffuse) = <(Doubles, Doubles)>::default();
        let (mut rows, mut by_row) = <([Doubles; MAX_ROWS], [Doubles; MAX_ROWS])>::default();
        for x in 0..BLOCK {
            let material = Material {
                albedo: [self.albedo.0[x]],
                roughness: self.roughness.0[x],
                metallic: self.metallic.0[x],
            };
            let cosine = self.directions.cosine(x);
            let factors = M::factors(cosine, &material, M::functions_of(self.functions, x));
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
            let of_offset = &mut self.weights[t];
            of_offset.fill(Doubles::default());
            each_entry::<M, COEFFICIENTS>(|k, j, entry| {
                let (row, by_row) = (&rows[j], &by_row[j]);
                let (slope, lobe) = (&slopes.lobe[entry], &self.basis.lobe[entry]);
                let weights = &mut of_offset[k];
                for x in 0..BLOCK {
                    weights.0[x] += row.0[x] * slope.0[x] + cosine.0[x] * by_row.0[x] * lobe.0[x];
                }
            });
            for k in 0..OPEN_DIFFUSE {
                let weights = &mut of_offset[k];
                for x in 0..BLOCK {
                    weights.0[x] += diffuse.0[x] * slopes.diffuse[k].0[x]
                        + cosine.0[x] * by_diffuse.0[x] * self.basis.diffuse[k].0[x];
                }
            }
        }
    }
}
