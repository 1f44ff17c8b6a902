//! Lights with the materials of the pixels solved for: the Schur complement of the normal equations.
//!
//! The normal matrix of materials and lights is an arrow (see [`normal_matrix`](crate::normal_matrix)):
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
//! cost a ninth. Where normals are free two more rows are dense, those of the tilts.
//!
//! Damping adds a share of its diagonal to A. An unknown on a bound that its slope pushes against is
//! held: its row is 0, and it does not move. So is one on which no radiance depends. Tilts have no
//! bounds; they move no further than 0.3 at once. They are the last unknowns, and U is
//! triangular, so what the tilts do is Uᵀ of their own rows: with these scaled down, −Uᵀ (U g + …)
//! is the step that is best for the other unknowns with the shorter tilts.

use super::light_system::Lights;
use super::{Elimination, Reduced, ReducedProduct};
use crate::pixel::samples::by_kind;
use crate::problem::Problem;
use crate::reflectance::reflection::Reflection;
use crate::runtime::Result;

impl Problem {
    /// S and s of some pixels at x.
    pub fn reduced(&self, x: &[f64], pixels: &[usize], how: &Elimination) -> Result<Reduced> {
        by_kind!(self, reduced(self, x, pixels, how))
    }

    /// S v and s of some pixels at x, for v (light channel, picture, coefficient).
    pub fn reduced_product(
        &self,
        x: &[f64],
        pixels: &[usize],
        v: &[f64],
        how: &Elimination,
    ) -> Result<ReducedProduct> {
        by_kind!(self, reduced_product(self, x, pixels, v, how))
    }

    /// Where the unknowns of some pixels go when the lights move by v (light channel, picture,
    /// coefficient): (pixel, D). Materials are clipped to \[0, 1\]; tilts move by 0.3 at most, and
    /// grow no longer than tan 60°.
    pub fn follow_lights(
        &self,
        x: &[f64],
        pixels: &[usize],
        v: &[f64],
        how: &Elimination,
    ) -> Result<Vec<f64>> {
        by_kind!(self, follow_lights(self, x, pixels, v, how))
    }
}

fn reduced<M: Reflection, const C: usize, const D: usize, const U: usize>(
    problem: &Problem,
    x: &[f64],
    pixels: &[usize],
    how: &Elimination,
) -> Result<Reduced> {
    Lights::<M, C, D, U>::new(problem, x, pixels, how)?.reduced()
}

fn reduced_product<M: Reflection, const C: usize, const D: usize, const U: usize>(
    problem: &Problem,
    x: &[f64],
    pixels: &[usize],
    v: &[f64],
    how: &Elimination,
) -> Result<ReducedProduct> {
    Lights::<M, C, D, U>::new(problem, x, pixels, how)?.product(v)
}

fn follow_lights<M: Reflection, const C: usize, const D: usize, const U: usize>(
    problem: &Problem,
    x: &[f64],
    pixels: &[usize],
    v: &[f64],
    how: &Elimination,
) -> Result<Vec<f64>> {
    Lights::<M, C, D, U>::new(problem, x, pixels, how)?.follow(v)
}
