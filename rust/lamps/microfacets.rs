//! What of a BRDF depends on the half vector or on n·l, each beside its derivatives.

use std::f64::consts::FRAC_1_PI;

use glam::DVec3;

/// Fresnel's equations for unpolarised light at an index of refraction of 1.5, 0.04 head on.
#[inline(always)]
pub(super) fn glass(cosine: f64) -> f64 {
    // In the form of R. L. Cook, K. E. Torrance, "A reflectance model for computer graphics", 1982,
    // with g = √(1.5² − 1 + c²).
    let c = cosine;
    let g = (1.25 + c * c).sqrt();
    let (across, along) = ((g - c) / (g + c), (c * (g + c) - 1.0) / (c * (g - c) + 1.0));
    0.5 * across * across * (1.0 + along * along)
}

/// Its slope. With s = (g−c)/(g+c), p = P/Q, P = cg + c² − 1, Q = cg − c² + 1 and g′ = c/g,
///
/// ```text
/// F  = ½ s² (1 + p²)                           F′ = s s′ (1 + p²) + s² p p′
/// s′ = 2(cg′ − g)/(g+c)² = −2.5/(g (g+c)²)     p′ = (P′Q − PQ′)/Q²,   P′, Q′ = g + c²/g ± 2c.
/// ```
#[inline(always)]
pub(super) fn glass_by_cosine(cosine: f64) -> f64 {
    let c = cosine;
    let g = (1.25 + c * c).sqrt();
    let (sum, difference) = (g + c, g - c);
    let across = difference / sum;
    let by_across = -2.5 / (g * sum * sum);
    let (p, q) = (c * sum - 1.0, c * difference + 1.0);
    let middle = g + c * c / g;
    let along = p / q;
    let by_along = ((middle + 2.0 * c) - along * (middle - 2.0 * c)) / q;
    across * by_across * (1.0 + along * along) + across * across * along * by_along
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
pub(super) fn distribution(normal: DVec3, half: DVec3, alpha: f64) -> (f64, [f64; 2]) {
    let cosine = normal.dot(half);
    let sine2 = (normal.cross(half).length_squared()).max(f64::EPSILON * f64::EPSILON);
    let flat = alpha * alpha * cosine * cosine;
    let denominator = sine2 + flat;
    let root = alpha / denominator;
    let value = FRAC_1_PI * root * root;
    let by_alpha = 2.0 * FRAC_1_PI * root / denominator * ((sine2 - flat) / denominator);
    let turned = 4.0 * cosine * ((1.0 - alpha) * (1.0 + alpha)) / denominator;
    (value, [by_alpha, value * turned])
}

/// S(x) = √(x²(1−α²) + α²)
///
/// The root is of x² + α² (1−x²), whose terms may both underflow; one that is taken of neither does
/// not.
#[inline]
pub(super) fn slanted(x: f64, alpha: f64) -> f64 {
    x.hypot(alpha * ((1.0 - x) * (1.0 + x)).max(0.0).sqrt())
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
pub(super) fn masked_cosine(
    n_dot_v: f64,
    of_view: f64,
    n_dot_l: f64,
    alpha: f64,
) -> (f64, [f64; 3]) {
    let (x, y) = (n_dot_v, n_dot_l);
    let (of_x, of_y) = (of_view, slanted(y, alpha));
    let t = y * of_x + x * of_y;
    let share = y / t;
    let flat = |x: f64| alpha * ((1.0 - x) * (1.0 + x)).max(0.0);
    let slope = x * ((1.0 - alpha) * (1.0 + alpha)) / of_x;
    let by_x = -0.5 * share * (share * slope + of_y / t);
    let by_y = 0.5 * (alpha / of_y) * (alpha * x / t) / t;
    let by_alpha = -0.5 * share * (share * (flat(x) / of_x) + x / t * (flat(y) / of_y));
    (
        0.5 * y / t,
        [by_x, by_y.min(f64::MAX), by_alpha.max(-f64::MAX)],
    )
}
