//! A normal beside the given one, by two numbers: its offset in the tangent plane.
//!
//! With unit tangents t₁ and t₂ at the given normal n₀, the normal of the offset (a, b) is
//!
//! ```text
//! n = u/|u|,     u = n₀ + a t₁ + b t₂,     |u|² = 1 + a² + b²
//! ```
//!
//! so that (0, 0) is the given normal, √(a² + b²) the tangent of the angle between both, and every
//! direction less than 90 degrees away has one offset.

use glam::DVec3;

/// Tangent offsets of a pixel, a and b.
pub const OFFSETS: usize = 2;

/// Largest size of a and of b that is taken, a tangent: a thousandth of a radian from 90 degrees.
pub const OFFSET_MAX: f64 = 1e3;

/// z of a unit normal up to which its tangents are those of the normal mirrored in the plane z = 0.
const FRAME_FROM: f64 = -0.99;

/// A normal at its offset, and the derivatives by that.
#[derive(Clone, Copy, Debug)]
pub struct OffsetNormal {
    /// n
    pub normal: DVec3,
    /// ∂n/∂a and ∂n/∂b
    pub by_offset: [DVec3; 2],
}

/// Unit tangents at a unit normal, orthogonal to it and to each other.
///
/// They are the x and y axes under the smallest rotation that takes +z to n = (x, y, z),
///
/// ```text
/// t₁ = (1 − x²/(1+z), −xy/(1+z), −x)          t₂ = (−xy/(1+z), 1 − y²/(1+z), −y)
/// ```
///
/// so neighbours with normals alike have frames alike. This has its one singularity at z = −1, which
/// no camera sees; near there, up to z = −0.99, the tangents are those of (x, y, −z) with their z
/// turned round.
#[inline(always)]
pub fn tangents(normal: DVec3) -> [DVec3; 2] {
    let DVec3 { x, y, z } = normal;
    let sign = if z > FRAME_FROM { 1.0 } else { -1.0 };
    let inverse = 1.0 / (1.0 + sign * z);
    let xy = -x * y * inverse;
    [
        DVec3::new(1.0 - x * x * inverse, xy, -sign * x),
        DVec3::new(xy, 1.0 - y * y * inverse, -sign * y),
    ]
}

/// The normal at the offset (a, b) from a given unit normal.
///
/// Its derivatives are those of u/|u|: ∂n/∂a = (I − n nᵀ) t₁/|u|.
#[inline(always)]
pub fn offset_normal(given: DVec3, [a, b]: [f64; 2]) -> OffsetNormal {
    let [t1, t2] = tangents(given);
    let u = given + a * t1 + b * t2;
    let inverse = 1.0 / u.dot(u).sqrt();
    let normal = inverse * u;
    let by = |t: DVec3| inverse * (t - normal.dot(t) * normal);
    OffsetNormal {
        normal,
        by_offset: [by(t1), by(t2)],
    }
}
