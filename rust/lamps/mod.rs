//! Lamps: light from single directions with the full reflection models.
//!
//! SH light cannot hold a sharp lamp, so nothing here is projected: reflection is evaluated point
//! by point. Of the paper that is eqs. 1 and 3-5 as they are, without the approximations of eq. 12
//! that [`shade`](crate::reflectance::shade) makes; of the principled model the BRDF whose integral
//! over SH light `shade` has. [`surface`] has the derivatives too, [`pixel_fit`] fits single pixels under
//! known lamps.

mod ambient;
pub mod descent;
pub mod judge;
mod microfacets;
pub mod number;
pub mod pixel_fit;
pub mod render;
pub mod samples;
pub mod surface;
pub mod system;
