//! The numerical core of pbrfit: physically based materials and lighting from several pictures of
//! one view.
//!
//! A pixel's radiance in colour channel c is linear in the light, whose real spherical-harmonic
//! coefficients (l ≤ 3) are L_kc. Its weights are a matt part and a lobe, by one of two
//! [models](reflectance::model):
//!
//! ```text
//! I_c  = Σ_k w_ck L_kc                         w_ck = kd_c A_l Y_k(n) + Σ_j s_cj R_jk
//! paper:       s_cl = ks_c h_l(r)              R_lk = Y_k(mirror) in band l
//! principled:  s_cj = A_c a_j + B_c b_j        R_jk: the harmonics even in y of the pixel's frame
//! ```
//!
//! A room, that is a folder, uses only those above it in this table:
//!
//! | room | holds |
//! |---|---|
//! | [`runtime`] | errors, checks of arguments, threads, vector instructions, the end of the process |
//! | [`reflectance`] | one pixel: harmonics, both reflection models, weights and their derivatives |
//! | [`block`] | the vector kernels over blocks of pixels |
//! | [`transport`] | rays, and the rows of pixels whose light is blocked |
//! | [`problem`] | all pixels: pictures, loss and gradient, rendering |
//! | [`pixel`] | pixels one by one, the lights known: samples, grid, Levenberg–Marquardt |
//! | [`schur`] | pixels and lights together: Gauss–Newton Hessians and the Schur complement |
//! | [`lamps`] | direct light of lamps with its derivatives, and pixels one by one under known lamps |
//! | [`environment`] | panoramas, blurred, as light of the full models |
//! | [`poisson`] | heights that slopes of neighbours tell; it uses `runtime` alone |
//! | [`image_file`] | picture files; it uses `runtime` alone |
//! | `python` | the extension module, the one place that names pyo3 and numpy |

pub mod block;
pub mod environment;
pub mod image_file;
pub mod lamps;
pub mod pixel;
pub mod poisson;
pub mod problem;
#[cfg(feature = "python")]
mod python;
pub mod reflectance;
pub mod runtime;
pub mod schur;
pub mod transport;

pub use self::runtime::{Error, Result};

// The tests are a part of the crate, which is compiled once for all of them.
#[cfg(test)]
extern crate self as pbrfit;
#[cfg(test)]
#[path = "../tests/rust/mod.rs"]
mod tests;
