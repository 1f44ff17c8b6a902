//! From a lobe at one direction to rows: least squares over roughness.
//!
//! A lobe has one or two parts p at each roughness r, g_p(ω; r): of the paper's model its radial
//! kernel, of the principled one what Schlick's Fresnel splits. Each is Σ_j s_pj(r) R_jk of the open
//! sky. Of a set of directions with weights, Σ_ω c_ω g_p(ω; r) Y_k(ω) is to be Σ_j s_pj(r) T_jk, as
//! well as it can for all r. With nodes r_n, weights u_p and S the matrix of the u_p s_pj(r_n),
//!
//! ```text
//! T_jk = Σ_ω c_ω q_j(ω) Y_k(ω)        q(ω) = (SᵀS + ε)⁻¹ Sᵀ [u_p g_p(ω; r_n)]
//! ```
//!
//! so that a ray costs its lobe at the nodes, one small product, and its harmonics.

use std::f32::consts::FRAC_1_PI;

use glam::Vec3A;

use crate::reflectance::ggx;
use crate::reflectance::lobe_table;
use crate::reflectance::model::Model;
use crate::reflectance::planes::MAX_ROWS;

/// Roughness at which lobes are compared. Below the first a lobe is narrower than what is known of
/// surroundings from a picture, and rows go on smoothly to the mirror.
const NODES: [f64; 12] = [
    0.1, 0.15, 0.2, 0.27, 0.34, 0.42, 0.5, 0.6, 0.7, 0.8, 0.9, 1.0,
];

/// Parts of a lobe at most, and with all nodes.
const PARTS: usize = 2;
const VALUES: usize = PARTS * NODES.len();

/// What 1 − Schlick's weight counts beside the latter: F0 goes from 0.04 to 1, and this is the
/// geometric mean.
const BASE_WEIGHT: f64 = 0.2;

/// ε as a share of the largest diagonal element: far above rounding, and far below what tells rows
/// apart.
const RIDGE: f64 = 1e-7;

/// Rays that are worked on together.
pub(super) const RAYS: usize = 64;

/// Some rays: their directions, axis by axis, and weights; those that are not used weigh 0.
pub(super) struct Batch {
    pub(super) direction: [[f32; RAYS]; 3],
    pub(super) weight: [f32; RAYS],
}

impl Batch {
    #[inline(always)]
    pub(super) fn dot(&self, with: Vec3A, x: usize) -> f32 {
        let [of_x, of_y, of_z] = &self.direction;
        with.x * of_x[x] + with.y * of_y[x] + with.z * of_z[x]
    }
}

/// q for one pixel.
pub(super) struct Dual {
    rows: usize,
    values: usize,
    /// (SᵀS + ε)⁻¹ Sᵀ u: by value, then row.
    matrix: [[f32; MAX_ROWS]; VALUES],
    view: Vec3A,
    normal: Vec3A,
    mirror: Vec3A,
    cosine: f32,
    model: Model,
}

impl Dual {
    /// Of a pixel with these directions; `cosine` is its clamped n·v.
    pub(super) fn new(model: Model, cosine: f64, normal: Vec3A, view: Vec3A) -> Self {
        let (rows, parts) = match model {
            Model::Paper => (4, 1),
            Model::Principled => (10, 2),
        };
        let mut functions = [[0.0; MAX_ROWS]; VALUES];
        for (n, &r) in NODES.iter().enumerate() {
            match model {
                Model::Paper => functions[n][..4].copy_from_slice(&ggx::bands(r).weight),
                Model::Principled => {
                    let [values, _, _] = lobe_table::values(r, cosine);
                    for j in 0..rows {
                        functions[n][j] = BASE_WEIGHT * values[j];
                        functions[NODES.len() + n][j] = values[rows + j];
                    }
                }
            }
        }
        let values = parts * NODES.len();
        let inverse = inverse_gram(&functions[..values], rows);
        let mut matrix = [[0.0; MAX_ROWS]; VALUES];
        for (i, (to, of_value)) in matrix.iter_mut().zip(&functions[..values]).enumerate() {
            let weight = if parts == 2 && i < NODES.len() {
                BASE_WEIGHT
            } else {
                1.0
            };
            for j in 0..rows {
                let sum: f64 = (0..rows).map(|l| inverse[j][l] * of_value[l]).sum();
                to[j] = (weight * sum) as f32;
            }
        }
        Self {
            rows,
            values,
            matrix,
            view,
            normal,
            mirror: 2.0 * normal.dot(view) * normal - view,
            cosine: cosine as f32,
            model,
        }
    }

    /// q of some rays, by row; of rays that are not used it is finite.
    #[inline(always)]
    pub(super) fn fill(&self, rays: &Batch, q: &mut [[f32; RAYS]; MAX_ROWS]) {
        let mut lobe = [[0.0; RAYS]; VALUES];
        match self.model {
            Model::Paper => {
                let mut u = [0.0; RAYS];
                for x in 0..RAYS {
                    u[x] = rays.dot(self.mirror, x);
                }
                for (values, &r) in lobe.iter_mut().zip(&NODES) {
                    for x in 0..RAYS {
                        let value = radial(r as f32, u[x]);
                        values[x] = if u[x] > 0.0 { value } else { 0.0 };
                    }
                }
            }
            Model::Principled => {
                let [mut n_h, mut n_l, mut schlick] = [[0.0; RAYS]; 3];
                for x in 0..RAYS {
                    // |v + l|² = 2 + 2 v·l, and v·h = |v + l|/2.
                    let v_l = rays.dot(self.view, x);
                    let length = (2.0 + 2.0 * v_l).max(f32::MIN_POSITIVE).sqrt();
                    n_l[x] = rays.dot(self.normal, x);
                    n_h[x] = (self.normal.dot(self.view) + n_l[x]) / length;
                    let left = 1.0 - (0.5 * length).min(1.0);
                    schlick[x] = left * left * (left * left) * left;
                }
                let (base, grazing) = lobe.split_at_mut(NODES.len());
                for (n, &r) in NODES.iter().enumerate() {
                    for x in 0..RAYS {
                        let value = principled(r as f32, n_h[x], n_l[x], self.cosine);
                        base[n][x] = value * (1.0 - schlick[x]);
                        grazing[n][x] = value * schlick[x];
                    }
                }
            }
        }
        for j in 0..self.rows {
            q[j] = [0.0; RAYS];
            for (values, of_value) in lobe[..self.values].iter().zip(&self.matrix) {
                for x in 0..RAYS {
                    q[j][x] += values[x] * of_value[j];
                }
            }
        }
    }

    pub(super) fn rows(&self) -> usize {
        self.rows
    }
}

/// The paper's lobe round about the mirror direction, whose bands are h_l: 4e/π / (1 + e − (1−e)u)²
/// with e = α² = r⁴ and the cosine u > 0.
#[inline(always)]
pub(super) fn radial(roughness: f32, u: f32) -> f32 {
    let e = roughness.powi(4);
    let root = 1.0 + e - (1.0 - e) * u;
    4.0 * FRAC_1_PI * e / (root * root)
}

/// D V n·l of the principled model.
#[inline(always)]
pub(super) fn principled(roughness: f32, n_h: f32, n_l: f32, n_v: f32) -> f32 {
    let a2 = roughness.powi(4);
    let root = n_h * n_h * (a2 - 1.0) + 1.0;
    let slanted = |x: f32| (x * x * (1.0 - a2) + a2).sqrt();
    let masked = 0.5 * n_l / (n_l * slanted(n_v) + n_v * slanted(n_l));
    FRAC_1_PI * a2 / (root * root) * masked
}

/// (SᵀS + ε)⁻¹ by Gauss–Jordan elimination; positive definite, so no pivot is looked for.
fn inverse_gram(functions: &[[f64; MAX_ROWS]], rows: usize) -> [[f64; MAX_ROWS]; MAX_ROWS] {
    let mut gram = [[0.0; MAX_ROWS]; MAX_ROWS];
    for i in 0..rows {
        for j in 0..rows {
            gram[i][j] = functions.iter().map(|f| f[i] * f[j]).sum();
        }
    }
    let largest = (0..rows).map(|i| gram[i][i]).fold(0.0, f64::max);
    let mut inverse = [[0.0; MAX_ROWS]; MAX_ROWS];
    for i in 0..rows {
        gram[i][i] += RIDGE * largest;
        inverse[i][i] = 1.0;
    }
    for pivot in 0..rows {
        let scale = 1.0 / gram[pivot][pivot];
        for j in 0..rows {
            gram[pivot][j] *= scale;
            inverse[pivot][j] *= scale;
        }
        for i in (0..rows).filter(|&i| i != pivot) {
            let factor = gram[i][pivot];
            for j in 0..rows {
                gram[i][j] -= factor * gram[pivot][j];
                inverse[i][j] -= factor * inverse[pivot][j];
            }
        }
    }
    inverse
}
