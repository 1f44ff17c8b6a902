//! What of a BRDF depends on the half vector or on n·l, each beside its derivatives.

use std::f64::consts::FRAC_1_PI;

use glam::DVec3;

use super::number::{Number, Vector, cross, dot, length_squared};

/// Fresnel's equations for unpolarised light at an index of refraction of 1.5, 0.04 head on; and
/// their slope. With s = (g−c)/(g+c), p = P/Q, P = cg + c² − 1, Q = cg − c² + 1 and g′ = c/g,
///
/// ```text
/// F  = ½ s² (1 + p²)                           F′ = s s′ (1 + p²) + s² p p′
/// s′ = 2(cg′ − g)/(g+c)² = −2.5/(g (g+c)²)     p′ = (P′Q − PQ′)/Q²,   P′, Q′ = g + c²/g ± 2c.
/// ```
#[inline(always)]
pub(super) fn glass<T: Number>(cosine: T) -> [T; 2] {
    // In the form of R. L. Cook, K. E. Torrance, "A reflectance model for computer graphics", 1982,
    // with g = √(1.5² − 1 + c²).
    let c = cosine;
    let g = (c * c + 1.25).sqrt();
    let (sum, difference) = (g + c, g - c);
    let across = difference / sum;
    let (p, q) = (c * sum - 1.0, c * difference + 1.0);
    let along = p / q;
    let by_across = g.all(-2.5) / (g * sum * sum);
    let middle = g + c * c / g;
    let by_along = ((middle + c * 2.0) - along * (middle - c * 2.0)) / q;
    let both = along * along + 1.0;
    [
        across * across * both * 0.5,
        across * by_across * both + across * across * along * by_along,
    ]
}

/// D of the angle θ between n and h; and its derivatives: by α, and T of that by a direction.
///
/// The root of D cancels where α is small: 1 − (n·h)² has lost all digits at the angles where a
/// narrow lobe lives. But (n·h)²(α²−1) + 1 = sin²θ + α² cos²θ = q, and sin θ = |n×h| keeps its digits:
///
/// ```text
/// D = (α/q)² / π.
/// ```
///
/// At θ = 0 this is 1/(πα²), which overflows. But rounded unit vectors that are equal may differ by
/// ε = 2⁻⁵², and so sin θ counts as no less than that. D stays below 1/(4πε²), a lobe with α ≫ ε is
/// as it was, and narrower ones fade to what a mirror shows of a point, nothing.
///
/// Where n turns by dn in its tangent plane, d(sin²θ) = −2 cos θ h·dn and d(cos²θ) = 2 cos θ h·dn,
/// and h and n may be exchanged:
///
/// ```text
/// ∂D/∂α = 2α (sin²θ − α² cos²θ)/(π q³)
/// ∂D/∂n = T (h − cos θ n),   ∂D/∂h = T (n − cos θ h),   T = 4D cos θ (1−α²)/q.
/// ```
#[inline(always)]
pub(super) fn distribution<T: Number>(normal: DVec3, half: Vector<T>, alpha: f64) -> (T, [T; 2]) {
    let cosine = dot(half, normal);
    let sine2 = length_squared(cross(half, normal));
    let sine2 = sine2.max(cosine.all(f64::EPSILON * f64::EPSILON));
    let flat = cosine * cosine * (alpha * alpha);
    let inverse = cosine.all(1.0) / (sine2 + flat);
    let root = inverse * alpha;
    let value = root * root * FRAC_1_PI;
    let by_alpha = root * inverse * (2.0 * FRAC_1_PI) * ((sine2 - flat) * inverse);
    let turned = cosine * (4.0 * (1.0 - alpha) * (1.0 + alpha)) * inverse;
    (value, [by_alpha, value * turned])
}

/// Smith's G₁(x) of the paper, and its derivatives by x and by r: those of
/// [`smith_g1`](crate::reflectance::ggx::smith_g1).
#[inline(always)]
pub(super) fn masking<T: Number>(x: T, r: f64) -> (T, [T; 2]) {
    let k = 0.5 * r * r * r * r;
    let inverse = x.all(1.0) / (x * (1.0 - k) + k);
    let value = x * inverse;
    (
        value,
        [
            inverse * inverse * k,
            value * inverse * (x - 1.0) * (2.0 * r * r * r),
        ],
    )
}

/// S(x) = √(x²(1−α²) + α²)
///
/// The root is of x² + α² (1−x²), whose terms may both underflow; S is no less than the root of
/// either.
#[inline(always)]
pub(super) fn slanted<T: Number>(x: T, alpha: f64) -> T {
    let of_alpha = flat(x).sqrt() * alpha;
    (x * x + of_alpha * of_alpha).sqrt().max(x).max(of_alpha)
}

/// 1 − x²
#[inline(always)]
fn flat<T: Number>(x: T) -> T {
    ((x.all(1.0) - x) * (x + 1.0)).max(x.all(0.0))
}

/// V (n·l) of the principled model, at most 1/(4 n·v), with S(n·v) ([`slanted`]); and its derivatives
/// by n·v, n·l and α.
///
/// With x = n·v, y = n·l and t = y S(x) + x S(y), V y = W = ½ y/t. From S′ = x(1−α²)/S and ∂S/∂α =
/// α(1−x²)/S, and because S(y) − y S′(y) = α²/S(y),
///
/// ```text
/// ∂W/∂x = −½ (y/t) ((y/t) S′(x) + S(y)/t)
/// ∂W/∂y =  ½ (α/S(y)) (α x/t)/t
/// ∂W/∂α = −½ (y/t) ((y/t) ∂S(x)/∂α + (x/t) ∂S(y)/∂α).
/// ```
///
/// All quotients are of numbers that go to 0 together. Derivatives by y and α overflow at angles and
/// roughnesses of 10⁻³⁰⁸, where D is 0; they are kept finite, so that the product is 0.
#[inline(always)]
pub(super) fn masked_cosine<T: Number>(
    n_dot_v: f64,
    of_view: f64,
    n_dot_l: T,
    alpha: f64,
) -> (T, [T; 3]) {
    let (x, y) = (n_dot_v, n_dot_l);
    let (of_x, of_y) = (of_view, slanted(y, alpha));
    let t = y * of_x + of_y * x;
    let share = y / t;
    let (by_y, inverse) = (y.all(alpha) / of_y, y.all(1.0) / t);
    let slope = x * ((1.0 - alpha) * (1.0 + alpha)) / of_x;
    let by_x = share * (share * slope + of_y * inverse) * -0.5;
    let by_alpha = share * (alpha * flat(x) / of_x) + inverse * x * (by_y * flat(y));
    let by_alpha = share * by_alpha * -0.5;
    let by_y = by_y * 0.5 * (inverse * (alpha * x)) * inverse;
    (
        share * 0.5,
        [
            by_x,
            by_y.min(y.all(f64::MAX)),
            by_alpha.max(y.all(-f64::MAX)),
        ],
    )
}
