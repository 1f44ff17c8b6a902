//! Materials and lights together: the normal equations of pixels, and of lights with the pixels
//! solved for.

mod dense;
mod eliminated_block;
pub mod gauss_newton_hessian;
pub mod kept;
mod kernels;
pub mod light_equations;
mod light_system;
mod schur_complement;
mod tied;

/// How the pixels are solved for.
#[derive(Clone, Debug, Default)]
pub struct Elimination {
    /// Added to each A, as a share of its diagonal.
    pub damping: f64,
    /// Whether all channels have the same light.
    pub mono: bool,
    /// The prior of roughness, metallic unless it is known, and free tangent offsets.
    pub prior: Option<PriorTerm>,
}

/// A Gaussian prior where the unknowns stand: Σ a (v − c − o)² beside the squared residuals.
#[derive(Clone, Debug)]
pub struct PriorTerm {
    /// a: (pixel, F), for the F unknowns that are not albedo.
    pub precision: Vec<f64>,
    /// v − c − o: (pixel, F)
    pub deviation: Vec<f64>,
    /// Offsets o that the pixels of a cluster share, unknowns beside the lights.
    pub clusters: Option<Clusters>,
}

impl PriorTerm {
    /// Pixel, number f of the unknown, a and v − c − o, of `count` pixels from number `first` on.
    fn of_block(
        &self,
        first: usize,
        count: usize,
        unknowns: usize,
    ) -> impl Iterator<Item = (usize, usize, f64, f64)> {
        let range = first * unknowns..(first + count) * unknowns;
        let both = self.precision[range.clone()]
            .iter()
            .zip(&self.deviation[range]);
        both.enumerate()
            .map(move |(i, (&a, &deviation))| (i / unknowns, i % unknowns, a, deviation))
    }
}

/// Which pixels share an offset of their prior's mean.
#[derive(Clone, Debug)]
pub struct Clusters {
    /// (pixel): from 0, below `count`.
    pub of_pixels: Vec<usize>,
    /// How many clusters there are.
    pub count: usize,
}

/// What is left for the M shared unknowns: lights (light channel, picture, coefficient), then the
/// offsets (cluster, F) of the prior, if there are any.
#[derive(Clone, Debug)]
pub struct SchurComplement {
    /// S: (M, M).
    pub matrix: Vec<f64>,
    /// s: (M).
    pub gradient: Vec<f64>,
}
