//! Materials and lights together: the normal equations of pixels, and of lights with the pixels
//! solved for.

mod dense;
mod eliminated_block;
pub mod gauss_newton_hessian;
pub mod kept;
mod kernels;
mod light_system;
mod schur_complement;

/// How the pixels are solved for.
#[derive(Clone, Copy, Debug, Default)]
pub struct Elimination<'a> {
    /// Added to each A, as a share of its diagonal.
    pub damping: f64,
    /// Whether all channels have the same light.
    pub mono: bool,
    /// The prior of roughness, metallic unless it is known, and free tangent offsets.
    pub prior: Option<PriorTerm<'a>>,
}

/// A Gaussian prior where the unknowns stand: Σ a (v − c)² beside the squared residuals.
#[derive(Clone, Copy, Debug)]
pub struct PriorTerm<'a> {
    /// a: (pixel, F), for the F unknowns that are not albedo.
    pub precision: &'a [f64],
    /// v − c: (pixel, F)
    pub deviation: &'a [f64],
}

/// What is left for the lights, M unknowns (light channel, picture, coefficient).
#[derive(Clone, Debug)]
pub struct SchurComplement {
    /// S: (M, M).
    pub matrix: Vec<f64>,
    /// s: (M).
    pub gradient: Vec<f64>,
}

/// The same without a matrix.
#[derive(Clone, Debug)]
pub struct SchurProduct {
    /// S v: (M).
    pub product: Vec<f64>,
    /// s: (M).
    pub gradient: Vec<f64>,
}
