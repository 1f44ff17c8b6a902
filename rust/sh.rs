//! Real spherical harmonics up to l = 3.

use std::ops::{Add, Mul, Sub};

/// Number of basis functions, (l+1)² for l = 3.
pub const COEFFICIENTS: usize = 16;

/// Band l of coefficient k = l(l+1)+m.
pub const BAND_OF: [usize; COEFFICIENTS] = [0, 1, 1, 1, 2, 2, 2, 2, 2, 3, 3, 3, 3, 3, 3, 3];

/// The clamped-cosine transfer A_l (paper eq. 7; A₃ = 0). The paper's text says that it vanishes
/// beyond l = 1; its own equation, and the integral, have A₂ = π/4.
pub const COSINE_TRANSFER: [f64; 4] = {
    use std::f64::consts::PI;
    [PI, 2.0 * PI / 3.0, PI / 4.0, 0.0]
};

/// Precision of basis functions, weights and radiance.
pub trait Real:
    Copy + Default + Send + Sync + Add<Output = Self> + Sub<Output = Self> + Mul<Output = Self>
{
    /// Rounds.
    fn from_f64(value: f64) -> Self;
    /// Exact.
    fn to_f64(self) -> f64;
}

impl Real for f32 {
    #[inline(always)]
    fn from_f64(value: f64) -> Self {
        value as Self
    }

    #[inline(always)]
    fn to_f64(self) -> f64 {
        self.into()
    }
}

impl Real for f64 {
    #[inline(always)]
    fn from_f64(value: f64) -> Self {
        value
    }

    #[inline(always)]
    fn to_f64(self) -> f64 {
        self
    }
}

/// Real SH basis of a unit direction, without Condon-Shortley phase, index k = l(l+1)+m, so that
/// Y₁₋₁ ∝ y, Y₁₀ ∝ z, Y₁₁ ∝ x and ∫ Y_j Y_k dω = δ_jk.
#[inline(always)]
pub fn basis<T: Real>([x, y, z]: [T; 3]) -> [T; COEFFICIENTS] {
    let of = T::from_f64;
    let (xx, yy, zz) = (x * x, y * y, z * z);
    let (one, three, five) = (of(1.0), of(3.0), of(5.0));
    [
        of(C00),
        of(C1) * y,
        of(C1) * z,
        of(C1) * x,
        of(C2) * x * y,
        of(C2) * y * z,
        of(C20) * (three * zz - one),
        of(C2) * x * z,
        of(0.5 * C2) * (xx - yy),
        of(C33) * y * (three * xx - yy),
        of(C32) * x * y * z,
        of(C31) * y * (five * zz - one),
        of(C30) * z * (five * zz - three),
        of(C31) * x * (five * zz - one),
        of(0.5 * C32) * z * (xx - yy),
        of(C33) * x * (xx - three * yy),
    ]
}

// Normalisation constants to 17 digits.
const C00: f64 = 0.282_094_791_773_878_14; // √(1/4π)
const C1: f64 = 0.488_602_511_902_919_9; // √(3/4π)
const C2: f64 = 1.092_548_430_592_079_2; // √(15/4π)
const C20: f64 = 0.315_391_565_252_520_05; // √(5/16π)
const C33: f64 = 0.590_043_589_926_643_5; // √(35/32π)
const C32: f64 = 2.890_611_442_640_554; // √(105/4π)
const C31: f64 = 0.457_045_799_464_465_8; // √(21/32π)
const C30: f64 = 0.373_176_332_590_115_4; // √(7/16π)
