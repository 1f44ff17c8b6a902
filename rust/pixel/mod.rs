//! Pixels for themselves, the lights known: their samples, and the materials that explain them best.

pub(crate) mod arrowhead;
pub(crate) mod descent;
pub mod material_grid;
pub(crate) mod offset_step;
pub mod pixel_fit;
mod product_form;
mod products;
mod residual_steps;
pub(crate) mod samples;
mod weight_jacobian;
