//! Lights with the materials of the pixels solved for: the Schur complement of the normal equations.
//!
//! The Gauss–Newton Hessian of materials and lights is an arrowhead (see
//! [`gauss_newton_hessian`](super::gauss_newton_hessian)):
//! pixels touch the lights only. So each pixel's unknowns are eliminated by themselves, and what is
//! left is a system of the lights' size, however many pixels there are:
//!
//! ```text
//! S = G − Σ_p B_pᵀ A_p⁻¹ B_p              s = g_L − Σ_p B_pᵀ A_p⁻¹ g_p
//! S δL = −s                               δθ_p = −A_p⁻¹ (g_p + B_p δL)
//! ```
//!
//! With U_p A_p U_pᵀ = 1, the inverse of Cholesky's factor, A⁻¹ = Uᵀ U, and B = Jᵀ Ω W splits into
//! rows R = U Jᵀ Ω, a number for each unknown and sample, times the weights w_ck of the pixel. Then
//!
//! ```text
//! S v = Σ_p Wᵀ (Ω − Rᵀ R) W v             s = Σ_p Wᵀ (Ω (I − T) − Rᵀ U g)
//! ```
//!
//! which needs no matrix, and costs about what an evaluation does; or, for some pixels, S itself as
//! products of R W. The row of an albedo has entries in its own channel alone, so of five rows three
//! cost a ninth. Where normals are free two more rows are dense, those of the tangent offsets.
//!
//! Offsets o that pixels of a cluster share in a Gaussian prior Σ a (v − c − o)² are shared unknowns
//! too, with B = −diag(a) in the columns of their own cluster: their rows of S v are
//! Σ_p a (o + Uᵀ (R W v − U a o)), and those of s are Σ_p a (Uᵀ U g − (v − c − o)).
//!
//! Damping adds a share of its diagonal to A. An unknown on a bound that its slope pushes against
//! is held: its row is 0, and it does not move. So is one on which no radiance depends. Tangent
//! offsets have no bounds; they move no further than 0.3 at once. They are the last unknowns, and U
//! is triangular, so what the offsets do is Uᵀ of their own rows: with these scaled down,
//! −Uᵀ (U g + …) is the step that is best for the other unknowns with the shorter offsets.

use super::kept::KeptSystem;
use super::light_system::LightSystem;
use super::{Elimination, SchurComplement};
use crate::pixel::samples::by_kind;
use crate::problem::Problem;
use crate::runtime::Result;

impl Problem {
    /// S and s of some pixels at x.
    pub fn schur_complement(
        &self,
        x: &[f64],
        pixels: &[usize],
        elimination: &Elimination,
    ) -> Result<SchurComplement> {
        by_kind!(self, self.options.free_normals, M, C, D, U => {
            LightSystem::<M, C, D, U>::new(self, x, pixels, elimination)?.schur_complement()
        })
    }

    /// s of some pixels at x, and S v for any number of v, without the matrix.
    pub fn kept_system(
        &self,
        x: &[f64],
        pixels: &[usize],
        elimination: &Elimination,
    ) -> Result<KeptSystem> {
        by_kind!(self, self.options.free_normals, M, C, D, U => {
            LightSystem::<M, C, D, U>::new(self, x, pixels, elimination)?.keep()
        })
    }

    /// Where the unknowns of some pixels go when the shared unknowns move by v: (pixel, D). Materials are clipped to \[0, 1\]; tangent offsets move by 0.3 at
    /// most, and grow no longer than tan 60°.
    pub fn back_substitute(
        &self,
        x: &[f64],
        pixels: &[usize],
        v: &[f64],
        elimination: &Elimination,
    ) -> Result<Vec<f64>> {
        by_kind!(self, self.options.free_normals, M, C, D, U => {
            LightSystem::<M, C, D, U>::new(self, x, pixels, elimination)?.back_substitute(v)
        })
    }
}
