//! The numerical core of pbrfit: physically based materials and lighting from several pictures of
//! one view.
//!
//! A pixel's radiance in colour channel c is linear in the light, whose real spherical-harmonic
//! coefficients (l ≤ 3) are L_kc. Its weights are a matt part and a lobe, by one of two [`model`]s:
//!
//! ```text
//! I_c  = Σ_k w_ck L_kc                         w_ck = kd_c A_l Y_k(n) + Σ_j s_cj R_jk
//! paper:       s_cl = ks_c h_l(r)              R_lk = Y_k(mirror) in band l
//! principled:  s_cj = A_c a_j + B_c b_j        R_jk: the harmonics even in y of the pixel's frame
//! ```
//!
//! | module | holds |
//! |---|---|
//! | [`sh`] | the basis Y_k and the cosine transfer A_l |
//! | [`model`] | the reflection models, by name |
//! | [`shade`] | one pixel: material → weights w_ck, and the adjoint; what a model has to give |
//! | [`paper`] | kd and s of the paper's model, eq. 12 |
//! | [`ggx`] | its h_l(r), masking and Fresnel, with derivatives |
//! | [`principled`] | kd and s of the microfacet model of Blender, glTF and game engines |
//! | [`lobe_table`] | its a_j, b_j, mean albedo and κ by roughness and n·v, from a table |
//! | [`lobe_rows`] | its R_jk, and how these turn |
//! | [`tilt`] | a normal that turns away from the given one, and its derivatives |
//! | [`band_table`] | the paper's h_l(r) from a table, for the fast path |
//! | [`simd`] | the choice of vector instructions at run time |
//! | [`block`] | the same for a block of pixels in float32, and the products with lights and residuals |
//! | [`turns`] | blocks of pixels whose normals are free |
//! | [`robust`] | losses that outliers pull less at |
//! | [`problem`] | all pixels: loss and gradient |
//! | [`material_grid`] | all pixels: how well materials explain them when the lights are known |
//! | [`pixel_fit`] | all pixels: the best material when the lights are known |
//! | [`penalties`] | penalties on a map: neighbours alike, groups of pixels alike |
//! | [`normal_matrix`] | pixels: Gauss–Newton normal matrices, and how they are tied to the lights |
//! | [`reduced`] | lights with the pixels solved for: the Schur complement, as a matrix or applied |
//! | [`lbfgs`] | a bounded quasi-Newton method's vectors: pairs, their products, directions |
//! | [`render`] | all pixels: radiance in float64 |
//! | [`directional`] | the same under light from single directions, with either model's full BRDF |
//! | [`image_file`] | picture files |

mod arrow;
pub mod band_table;
pub mod block;
mod check;
mod descent;
pub mod directional;
#[cfg_attr(not(all(unix, feature = "python")), expect(dead_code))] // nobody ends
mod ending;
pub mod error;
mod evaluate;
pub mod ggx;
pub mod image_file;
pub mod lbfgs;
pub mod lobe_rows;
pub mod lobe_table;
pub mod material_grid;
pub mod model;
pub mod normal_matrix;
pub mod paper;
pub mod penalties;
pub mod pixel_fit;
mod pool;
pub mod principled;
pub mod problem;
mod product_form;
mod products;
#[cfg(feature = "python")]
mod python;
pub mod reduced;
mod remainders;
pub mod render;
mod residual_steps;
pub mod robust;
mod samples;
pub mod sh;
pub mod shade;
pub mod simd;
pub mod targets;
pub mod tilt;
mod tilted;
pub mod turns;

pub use error::{Error, Result};
