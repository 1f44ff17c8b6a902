//! Cauchy's loss, to which a residual that fits badly adds less than its square: shadows,
//! interreflections and highlights that the model does not know then weigh less beside what it does
//! know.
//!
//! ```text
//! φ(e) = δ² ln(1 + u²),   u = e/δ,   φ'(e)/2 = e / (1 + u²)
//! ```
//!
//! It is e² for small e, and logarithmic beyond the scale δ; the slope of far outliers falls to 0.

use crate::reflectance::planes::{BLOCK, Plane};
use crate::runtime::simd::{Isa, Kernel};
use crate::runtime::{Error, Result};

/// Scales δ that are taken, in the unit of the residuals. The squares of all residuals and scales
/// then fit into float32.
const SCALES: std::ops::RangeInclusive<f64> = 1e-15..=1e15;
/// Sums of values that run side by side.
const LANES: usize = 16;

/// Whether a scale can be used.
pub(super) fn check(scale: f64) -> Result<()> {
    if SCALES.contains(&scale) {
        return Ok(());
    }
    let expected = "a scale from 1e-15 to 1e15";
    Err(Error::argument("robust", expected, format!("{scale:e}")))
}

/// Turns residuals e into ω φ'(e)/2 and returns Σ ω φ(e).
pub struct ApplyRobustLoss<'a> {
    /// δ
    pub scale: f64,
    /// ω, a plane for each picture; or none, where all are 1.
    pub sample_weights: &'a [Plane],
    /// e, a plane for each picture; written.
    pub residuals: &'a mut [Plane],
}

impl Kernel for ApplyRobustLoss<'_> {
    type Output = f64;

    #[inline(always)]
    fn run<I: Isa>(self, _: I) -> f64 {
        const ONES: &Plane = &Plane([1.0; BLOCK]);
        let inverse = (1.0 / self.scale) as f32;
        // In units of δ², which float32 need not hold.
        let mut values = Plane::default();
        let mut sums = [0.0; LANES];
        for (j, e) in self.residuals.iter_mut().enumerate() {
            let omega = self.sample_weights.get(j).unwrap_or(ONES);
            for x in 0..BLOCK {
                // The square fits into float32, and beyond nothing is left of the slope.
                let u = (e.0[x] * inverse).abs().min(1e19);
                let (log, inverse) = log_1p(u * u);
                values.0[x] = omega.0[x] * log;
                e.0[x] = omega.0[x] * (e.0[x] * inverse);
            }
            for values in values.0.as_chunks::<LANES>().0 {
                for i in 0..LANES {
                    sums[i] += values[i];
                }
            }
        }
        let sum: f64 = sums.iter().map(|&sum| f64::from(sum)).sum();
        self.scale * self.scale * sum
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
