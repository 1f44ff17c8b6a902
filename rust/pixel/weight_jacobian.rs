//! How the weights of a block of pixels change with the tilts of their normals.
//!
//! With the clamped x = n·v the derivative of w_ck (see [`shade`](crate::shade)) by the tilt a is
//!
//! ```text
//! ∂w_ck/∂a = kd_c A_l ∇Y_k(n)·∂n/∂a + (dkd_c/dx) (∂x/∂a) A_l Y_k(n)
//!          + Σ_j s_cj ∂R_jk/∂a + (ds_cj/dx) (∂x/∂a) R_jk
//! ```
//!
//! and the same for b. No picture changes it, so a sample costs a sum over k, as radiance does.

use crate::block::basis::{Basis, DIFFUSE};
use crate::block::normal_jacobian::{FillBasisSlopes, GivenDirections, Tilts, Turn, Turns};
use crate::problem::Problem;
use crate::reflectance::planes::{BLOCK, Directions, Doubles, Materials};
use crate::reflectance::planes::{MAX_ROWS, Material};
use crate::reflectance::reflection::{ExactFunctions, Factors, Reflection, each_entry};
use crate::reflectance::sh::COEFFICIENTS;
use crate::reflectance::tangent_offset::TILTS;
use crate::runtime::simd::{Instructions, Isa, Kernel};

/// The normals of up to [`BLOCK`] pixels, and the derivatives of their weights.
pub(crate) struct Tilted {
    given: GivenDirections,
    pub(crate) tilts: Tilts,
    turns: Turns,
    /// Derivatives of the basis functions, by tilt.
    slopes: [Basis<f64>; TILTS],
    /// ∂w_ck by each tilt, by channel.
    pub(crate) weights: Vec<[[Doubles; COEFFICIENTS]; TILTS]>,
}

impl Tilted {
    pub(crate) fn new(channels: usize) -> Self {
        Self {
            given: GivenDirections::default(),
            tilts: Tilts::default(),
            turns: Turns::default(),
            slopes: Default::default(),
            weights: vec![[[Doubles::default(); COEFFICIENTS]; TILTS]; channels],
        }
    }

    /// Takes up pixels, whose tilts are still to come.
    pub(crate) fn place(&mut self, problem: &Problem, pixels: &[usize]) {
        self.given = problem.picked_given(pixels);
    }

    /// Gives the pixels tilts, and works out where they look.
    pub(crate) fn turn(
        &mut self,
        isa: Instructions,
        tilts: &Tilts,
        directions: &mut Directions<f64>,
    ) {
        self.tilts = *tilts;
        isa.run(Turn {
            given: &self.given,
            tilts,
            directions,
            turns: &mut self.turns,
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
        for (tilt, slopes) in self.slopes.iter_mut().enumerate() {
            isa.run(FillBasisSlopes {
                directions,
                turns: &self.turns,
                tilt,
                slopes,
                model,
            });
        }
        for (albedo, weights) in materials.albedo.iter().zip(&mut self.weights) {
            isa.run(FillWeightSlopes::<M> {
                directions,
                basis,
                turns: &self.turns,
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
struct FillWeightSlopes<'a, M: Reflection> {
    directions: &'a Directions<f64>,
    basis: &'a Basis<f64>,
    turns: &'a Turns,
    slopes: &'a [Basis<f64>; TILTS],
    albedo: &'a Doubles,
    roughness: &'a Doubles,
    metallic: &'a Doubles,
    functions: &'a ExactFunctions<M>,
    weights: &'a mut [[Doubles; COEFFICIENTS]; TILTS],
}

impl<M: Reflection> Kernel for FillWeightSlopes<'_, M> {
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
        for t in 0..TILTS {
            let (cosine, slopes) = (&self.turns.cosine[t], &self.slopes[t]);
            let of_tilt = &mut self.weights[t];
            of_tilt.fill(Doubles::default());
            each_entry::<M, COEFFICIENTS>(|k, j, entry| {
                let (row, by_row) = (&rows[j], &by_row[j]);
                let (slope, lobe) = (&slopes.lobe[entry], &self.basis.lobe[entry]);
                let weights = &mut of_tilt[k];
                for x in 0..BLOCK {
                    weights.0[x] += row.0[x] * slope.0[x] + cosine.0[x] * by_row.0[x] * lobe.0[x];
                }
            });
            for k in 0..DIFFUSE {
                let weights = &mut of_tilt[k];
                for x in 0..BLOCK {
                    weights.0[x] += diffuse.0[x] * slopes.diffuse[k].0[x]
                        + cosine.0[x] * by_diffuse.0[x] * self.basis.diffuse[k].0[x];
                }
            }
        }
    }
}
