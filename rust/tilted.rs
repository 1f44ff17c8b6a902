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

use crate::block::{BLOCK, Basis, DIFFUSE, Directions, Materials, Plane};
use crate::problem::Problem;
use crate::sh::COEFFICIENTS;
use crate::shade::{ExactFunctions, Factors, MAX_ROWS, Material, Reflection, each_entry};
use crate::simd::{Instructions, Isa, Kernel};
use crate::turns::{FillBasisSlopes, GivenDirections, Tilts, Turn, Turns};

/// Tilts of a pixel.
pub(crate) const TILTS: usize = 2;
/// A tilt moves no further in a step: 17 degrees from the given normal. Squares are far from
/// quadratic beyond.
pub(crate) const TILT_REACH: f64 = 0.3;
/// Steps lead to tilts of at most tan 60°, or of the length that there was.
pub(crate) const LONGEST_TILT: f64 = 1.732_050_807_568_877_2;

type Doubles = Plane<f64>;

/// The share of a step that is within reach, and where it leads.
///
/// Where it would lead too far from the given normal the tilt is shortened, its direction kept.
#[inline(always)]
pub(crate) fn within_reach(tilt: [f64; TILTS], step: [f64; TILTS]) -> (f64, [f64; TILTS]) {
    let length = |v: [f64; TILTS]| (v[0] * v[0] + v[1] * v[1]).sqrt();
    let share = shorter(length(step), TILT_REACH);
    let (before, far) = (length(tilt), [0, 1].map(|t| tilt[t] + share * step[t]));
    let longest = if before > LONGEST_TILT {
        before
    } else {
        LONGEST_TILT
    };
    let kept = shorter(length(far), longest);
    (share, far.map(|far| kept * far))
}

/// What makes a length at most `longest`: 1 or less.
#[inline(always)]
fn shorter(length: f64, longest: f64) -> f64 {
    if length > longest {
        longest / length
    } else {
        1.0
    }
}

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

#[cfg(test)]
mod tests {
    use super::*;

    fn length(v: [f64; TILTS]) -> f64 {
        v[0].hypot(v[1])
    }

    #[test]
    fn steps_within_reach_are_taken_whole() {
        assert_eq!(
            within_reach([0.5, -0.25], [0.125, 0.25]),
            (1.0, [0.625, 0.0])
        );
        assert_eq!(within_reach([0.1, 0.0], [TILT_REACH, 0.0]).0, 1.0);
    }

    #[test]
    fn long_steps_keep_their_direction() {
        let (share, there) = within_reach([0.1, 0.2], [3.0, -4.0]);
        assert!((share - TILT_REACH / 5.0).abs() < 1e-15);
        let step = [there[0] - 0.1, there[1] - 0.2];
        assert!((length(step) - TILT_REACH).abs() < 1e-15);
        assert!((step[0] * 4.0 + step[1] * 3.0).abs() < 1e-15);
    }

    #[test]
    fn tilts_grow_to_the_longest_or_stay_as_long_as_they_were() {
        let (_, there) = within_reach([LONGEST_TILT - 0.1, 0.0], [0.2, 0.0]);
        assert!((length(there) - LONGEST_TILT).abs() < 1e-15);
        let (_, there) = within_reach([0.0, 5.0], [0.2, 0.1]);
        assert!((length(there) - 5.0).abs() < 1e-14);
        let (_, there) = within_reach([0.0, 5.0], [0.0, -0.1]);
        assert_eq!(there, [0.0, 4.9]);
        assert_eq!(within_reach([3.0, 4.0], [0.0; 2]), (1.0, [3.0, 4.0]));
    }
}
