//! Light, materials and normals of a pixel: what makes weights of them, and the derivatives.

pub mod band_table;
pub mod ggx;
pub mod lobe_table;
pub mod model;
pub mod paper;
pub mod planes;
pub mod principled;
pub mod reflection;
pub mod sh;
pub mod shade;
pub mod tangent_offset;
