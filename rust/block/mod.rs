//! A block of pixels: what is done to it in an evaluation, each step over all its pixels.
//!
//! For one colour channel, with W (pixel, K), lights L (picture, K) and targets T:
//!
//! ```text
//! I = W Lᵀ,   e = ω (I − T),   ∂/∂W = e L,   ∂/∂L = eᵀ W        (of ½ Σ ω (I − T)²)
//! ```
//!
//! W does not depend on the picture, so its derivative is reduced to the material once per pixel.
//! Factors that depend on the material are float64 and rounded once; the products are float32.
//!
//! Values lie in planes, pixel beside pixel. The three products keep a small rectangle of results
//! in registers (pictures or coefficients by vectors of pixels), so that every number loaded is
//! used several times. The remaining steps are plain loops that the compiler turns into vectors.

pub mod adjoint;
pub mod basis;
pub mod bounced;
pub mod factors;
pub mod normal_jacobian;
pub mod radiance;
pub mod weights;
