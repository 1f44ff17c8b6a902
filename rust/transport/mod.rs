//! What surroundings block of a pixel's light, and what they bring in its place.
//!
//! Radiance stays linear in the light where geometry blocks some of it. With V(ω) = 1 where a ray
//! from the pixel leaves the scene,
//!
//! ```text
//! I = kd Σ_k L_k ∫ V Y_k (n·ω)⁺ dω + Σ_k L_k ∫ V Y_k f(ω; r) dω
//! ```
//!
//! for the lobe f of the material. Without V the first integral is A_l Y_k(n), and the second is
//! Σ_j s_j(r) R_jk with the rows R of a [`Reflection`](crate::reflectance::reflection::Reflection)
//! model and functions s_j of roughness that no direction changes. With V it is written in the *same
//! functions of roughness*,
//!
//! ```text
//! ∫ V Y_k f(ω; r) dω ≈ Σ_j s_j(r) T_jk
//! ```
//!
//! with rows T in the place of R, the best in the sense of least squares over roughness. So factors,
//! slopes and all that is made of them stay as they are, and with nothing blocked T is R to the last
//! bit. Unlike a row of R, one of T sees every band.
//!
//! [`surroundings`] casts the rays, [`sampling`] chooses them, [`dual`] has the least squares,
//! [`table`] the sums over rays.

mod dual;
mod sampling;
pub mod surroundings;
pub mod table;

#[cfg(test)]
#[path = "../../tests/rust/transport.rs"]
mod tests;
