//! Real spherical harmonics up to l = 3.

use std::ops::{Add, Div, Mul, Sub};

/// Number of basis functions, (l+1)² for l = 3.
pub const COEFFICIENTS: usize = 16;

/// Bands, l = 0 to 3.
pub const BANDS: usize = 4;

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
    Copy
    + Default
    + Send
    + Sync
    + 'static
    + Add<Output = Self>
    + Sub<Output = Self>
    + Mul<Output = Self>
    + Div<Output = Self>
{
    /// Rounds.
    fn from_f64(value: f64) -> Self;
    /// Exact.
    fn to_f64(self) -> f64;
    /// Without its fraction; to a number that vectors convert to.
    fn truncated(self) -> i32;
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

    #[inline(always)]
    fn truncated(self) -> i32 {
        self as i32
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

    #[inline(always)]
    fn truncated(self) -> i32 {
        self as i32
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

/// Calls `put` with k, an axis and ∂Y_k/∂axis, for all of these that are not 0 everywhere; of the
/// polynomials as they stand in [`basis`].
///
/// Off the sphere these polynomials are one continuation of Y_k of many, so that only what lies in
/// the tangent plane of the direction is a derivative of Y_k.
#[inline(always)]
pub fn each_slope<T: Real>([x, y, z]: [T; 3], mut put: impl FnMut(usize, usize, T)) {
    const X: usize = 0;
    const Y: usize = 1;
    const Z: usize = 2;
    let of = T::from_f64;
    let (xx, yy, zz) = (x * x, y * y, z * z);
    let (one, five) = (of(1.0), of(5.0));
    put(1, Y, of(C1));
    put(2, Z, of(C1));
    put(3, X, of(C1));
    // xy, yz, 3z² − 1, xz, (x² − y²)/2
    put(4, X, of(C2) * y);
    put(4, Y, of(C2) * x);
    put(5, Y, of(C2) * z);
    put(5, Z, of(C2) * y);
    put(6, Z, of(6.0 * C20) * z);
    put(7, X, of(C2) * z);
    put(7, Z, of(C2) * x);
    put(8, X, of(C2) * x);
    put(8, Y, of(-C2) * y);
    // 3x²y − y³, and xyz
    put(9, X, of(6.0 * C33) * x * y);
    put(9, Y, of(3.0 * C33) * (xx - yy));
    put(10, X, of(C32) * y * z);
    put(10, Y, of(C32) * x * z);
    put(10, Z, of(C32) * x * y);
    // y (5z² − 1), 5z³ − 3z, x (5z² − 1)
    put(11, Y, of(C31) * (five * zz - one));
    put(11, Z, of(10.0 * C31) * y * z);
    put(12, Z, of(3.0 * C30) * (five * zz - one));
    put(13, X, of(C31) * (five * zz - one));
    put(13, Z, of(10.0 * C31) * x * z);
    // z (x² − y²)/2, and x³ − 3xy²
    put(14, X, of(C32) * x * z);
    put(14, Y, of(-C32) * y * z);
    put(14, Z, of(0.5 * C32) * (xx - yy));
    put(15, X, of(3.0 * C33) * (xx - yy));
    put(15, Y, of(-6.0 * C33) * x * y);
}

/// ∇Y_k of the polynomials in [`basis`]; see [`each_slope`].
pub fn slopes<T: Real>(direction: [T; 3]) -> [[T; 3]; COEFFICIENTS] {
    let mut slopes = [[T::default(); 3]; COEFFICIENTS];
    each_slope(direction, |k, axis, slope| slopes[k][axis] = slope);
    slopes
}

// Normalisation constants to 17 digits.
const C00: f64 = 0.282_094_791_773_878_14; // √(1/4π)
pub(crate) const C1: f64 = 0.488_602_511_902_919_9; // √(3/4π)
pub(crate) const C2: f64 = 1.092_548_430_592_079_2; // √(15/4π)
pub(crate) const C20: f64 = 0.315_391_565_252_520_05; // √(5/16π)
pub(crate) const C33: f64 = 0.590_043_589_926_643_5; // √(35/32π)
pub(crate) const C32: f64 = 2.890_611_442_640_554; // √(105/4π)
pub(crate) const C31: f64 = 0.457_045_799_464_465_8; // √(21/32π)
pub(crate) const C30: f64 = 0.373_176_332_590_115_4; // √(7/16π)
