//! Panoramas as light, with the full reflection models: kept blurred by lobes of many widths, of
//! which the table of lobes composes the mirror-like reflection of each pixel.

pub mod blurred;
pub mod lobes;
pub mod render;
