//! Losses to which a residual that fits badly adds less than its square: shadows, interreflections
//! and highlights that the model does not know then weigh less beside what it does know.
//!
//! ```text
//! squares   φ(e) = e²                                   φ'(e)/2 = e
//! Huber     φ(e) = a (2|e| − a),   a = min(|e|, δ)      φ'(e)/2 = e, at most δ in size
//! Cauchy    φ(e) = δ² ln(1 + u²),  u = e/δ              φ'(e)/2 = e / (1 + u²)
//! ```
//!
//! Huber's is e² up to δ and the line 2δ|e| − δ² beyond. All three are e² for small e, so the scale
//! δ says where they part.

use crate::reflectance::planes::{BLOCK, Plane};
use crate::runtime::simd::{Isa, Kernel};
use crate::runtime::{Error, Result};

/// Scales δ that are taken, in the unit of the residuals. The squares of all residuals and scales
/// then fit into float32.
const SCALES: std::ops::RangeInclusive<f64> = 1e-15..=1e15;
/// Sums of values that run side by side.
const LANES: usize = 16;

/// A robust loss and its scale δ, in the unit of the residuals.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Robust {
    /// Quadratic up to δ, linear beyond.
    Huber(f64),
    /// Logarithmic beyond δ; the slope of far outliers falls to 0.
    Cauchy(f64),
}

impl Robust {
    /// Whether the scale can be used.
    pub(crate) fn check(self) -> Result<()> {
        let (Self::Huber(scale) | Self::Cauchy(scale)) = self;
        if SCALES.contains(&scale) {
            return Ok(());
        }
        Err(Error::argument(
            "robust",
            "a scale from 1e-15 to 1e15",
            format!("{scale:e}"),
        ))
    }
}

/// Turns residuals e into ω φ'(e)/2 and returns Σ ω φ(e).
pub struct ApplyRobustLoss<'a> {
    /// φ
    pub loss: Robust,
    /// ω, a plane for each picture; or none, where all are 1.
    pub sample_weights: &'a [Plane],
    /// e, a plane for each picture; written.
    pub residuals: &'a mut [Plane],
}

impl Kernel for ApplyRobustLoss<'_> {
    type Output = f64;

    #[inline(always)]
    fn run<I: Isa>(self, _: I) -> f64 {
        match self.loss {
            Robust::Huber(scale) => self.with(Huber(scale as f32)),
            Robust::Cauchy(scale) => scale * scale * self.with(Cauchy((1.0 / scale) as f32)),
        }
    }
}

impl ApplyRobustLoss<'_> {
    #[inline(always)]
    fn with(self, shape: impl Shape) -> f64 {
        const ONES: &Plane = &Plane([1.0; BLOCK]);
        let mut values = Plane::default();
        let mut sums = [0.0; LANES];
        for (j, e) in self.residuals.iter_mut().enumerate() {
            let omega = self.sample_weights.get(j).unwrap_or(ONES);
            for x in 0..BLOCK {
                let (value, half_slope) = shape.at(e.0[x]);
                values.0[x] = omega.0[x] * value;
                e.0[x] = omega.0[x] * half_slope;
            }
            for values in values.0.as_chunks::<LANES>().0 {
                for i in 0..LANES {
                    sums[i] += values[i];
                }
            }
        }
        sums.iter().map(|&sum| f64::from(sum)).sum()
    }
}

/// A loss of one residual, free of branches so that a loop over it becomes vector code.
trait Shape: Copy {
    /// φ(e), in a unit of its own, and φ'(e)/2.
    fn at(self, e: f32) -> (f32, f32);
}

/// δ
#[derive(Clone, Copy)]
struct Huber(f32);

impl Shape for Huber {
    #[inline(always)]
    fn at(self, e: f32) -> (f32, f32) {
        let size = e.abs();
        let a = size.min(self.0);
        (a * (2.0 * size - a), a.copysign(e))
    }
}

/// 1/δ; values are in units of δ², which float32 need not hold.
#[derive(Clone, Copy)]
struct Cauchy(f32);

impl Shape for Cauchy {
    #[inline(always)]
    fn at(self, e: f32) -> (f32, f32) {
        // The square fits into float32, and beyond nothing is left of the slope.
        let u = (e * self.0).abs().min(1e19);
        let z = u * u;
        let (log, inverse) = log_1p(z);
        (log, e * inverse)
    }
}

/// ln(1 + z) and 1/(1 + z) for z in \[0, 1e38\], to 3·10⁻⁷ of themselves.
///
/// y = 1 + z is rounded, and what is lost counts where z is small. To first order
///
/// ```text
/// ln(1 + z) = ln y + (z − (y − 1)) / y
/// ```
///
/// With y = m 2ᵏ, m from √½ to √2, and s = (m − 1)/(m + 1), which is 0.172 at most,
///
/// ```text
/// ln y = k ln 2 + ln m,     ln m = 2 artanh s = 2s (1 + s²/3 + s⁴/5 + s⁶/7 + s⁸/9 + …)
/// ```
///
/// and the terms left out are 2·10⁻⁹ of the sum.
#[inline(always)]
fn log_1p(z: f32) -> (f32, f32) {
    const MANTISSA_BITS: u32 = 23;
    let y = 1.0 + z;
    let inverse = 1.0 / y;
    let bits = y.to_bits();
    // y ≥ 1, so the difference is not negative.
    let k = (bits - std::f32::consts::FRAC_1_SQRT_2.to_bits()) >> MANTISSA_BITS;
    let m = f32::from_bits(bits - (k << MANTISSA_BITS));
    let s = (m - 1.0) / (m + 1.0);
    let t = s * s;
    let series = 1.0 + t * (1.0 / 3.0 + t * (1.0 / 5.0 + t * (1.0 / 7.0 + t * (1.0 / 9.0))));
    let lost = (z - (y - 1.0)) * inverse;
    let k = k as i32; // which every processor turns into floats, several at a time
    let log = k as f32 * std::f32::consts::LN_2 + (2.0 * s * series + lost);
    (log, inverse)
}
