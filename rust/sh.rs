//! Real spherical harmonics up to l = 3.

use glam::DVec3;

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

/// Real SH basis of a unit direction, without Condon-Shortley phase, index k = l(l+1)+m, so that
/// Y₁₋₁ ∝ y, Y₁₀ ∝ z, Y₁₁ ∝ x and ∫ Y_j Y_k dω = δ_jk.
#[inline(always)]
pub fn basis(d: DVec3) -> [f64; COEFFICIENTS] {
    let DVec3 { x, y, z } = d;
    let (xx, yy, zz) = (x * x, y * y, z * z);
    [
        C00,
        C1 * y,
        C1 * z,
        C1 * x,
        C2 * x * y,
        C2 * y * z,
        C20 * (3.0 * zz - 1.0),
        C2 * x * z,
        0.5 * C2 * (xx - yy),
        C33 * y * (3.0 * xx - yy),
        C32 * x * y * z,
        C31 * y * (5.0 * zz - 1.0),
        C30 * z * (5.0 * zz - 3.0),
        C31 * x * (5.0 * zz - 1.0),
        0.5 * C32 * z * (xx - yy),
        C33 * x * (xx - 3.0 * yy),
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
