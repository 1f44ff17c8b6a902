//! Poisson's equation on the pixels of a picture, whose neighbours are coupled by weights.
//!
//! With weights w of pairs of neighbours and h of pixels, u minimises
//!
//! ```text
//! Σ_ab w_ab (u_b − u_a)²/2 + Σ_a h_a u_a²/2 − Σ_a f_a u_a,     so     A u = f,
//! (A u)_a = h_a u_a + Σ_b w_ab (u_a − u_b).
//! ```
//!
//! Conjugate gradients solve it, with a multigrid cycle as preconditioner B ≈ A⁻¹. The residual r of
//! an error e has rᵀ B r ≈ eᵀ A e, its energy, by which they stop.

mod multigrid;

use self::multigrid::{Grid, Multigrid};
use crate::runtime::{Result, check};

/// Steps at most: each leaves about a tenth of the error, nine tenths where weights jump everywhere.
const STEPS_MAX: usize = 200;

/// What couples the pixels of a picture: weights of 0 or more.
#[derive(Clone, Copy, Debug)]
pub struct Couplings<'a> {
    /// Rows and columns of pixels.
    pub shape: [usize; 2],
    /// Weights of pixels and their right neighbours; those of the last column are not used.
    pub across: &'a [f64],
    /// Weights of pixels and their lower neighbours; those of the last row are not used.
    pub down: &'a [f64],
    /// h. Where no pixel has any, f must have the sum 0, and u is one of those that solve it.
    pub held: &'a [f64],
}

/// u from f and a first guess, by `threads` (0: one for each processor), on which it does not depend.
///
/// The energy of its error is `enough` at most, about.
pub fn solve(
    couplings: Couplings,
    right: &[f64],
    start: &[f64],
    enough: f64,
    threads: usize,
) -> Result<Vec<f64>> {
    let Couplings {
        across, down, held, ..
    } = couplings;
    let pixels = couplings.shape.iter().product();
    for (name, values) in [("across", across), ("down", down), ("held", held)] {
        check::length(name, pixels, values.len())?;
        check::not_negative(name, values, check::LARGEST_F32)?;
    }
    for (name, values) in [("right", right), ("start", start)] {
        check::length(name, pixels, values.len())?;
        check::moderate(name, values, check::LARGEST_F32)?;
    }
    if pixels == 0 {
        return Ok(Vec::new());
    }
    let multigrid = Multigrid::new(Grid::finest(couplings, threads));
    let mut found = start.to_vec();
    let mut residual = multigrid.finest().residual(right, &found);
    let mut way: Vec<f64> = Vec::new();
    let mut before = 0.0;
    for _ in 0..STEPS_MAX {
        let better = multigrid.cycle(&residual);
        let energy = dot(&residual, &better);
        if energy <= enough {
            break;
        }
        if way.is_empty() {
            way = better;
        } else {
            let share = energy / before;
            for (way, better) in way.iter_mut().zip(&better) {
                *way = better + share * *way;
            }
        }
        let product = multigrid.finest().product(&way);
        let length = energy / dot(&way, &product);
        for (i, found) in found.iter_mut().enumerate() {
            *found += length * way[i];
            residual[i] -= length * product[i];
        }
        before = energy;
    }
    Ok(found)
}

fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}
