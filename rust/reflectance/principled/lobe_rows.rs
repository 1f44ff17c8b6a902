//! The rotation of spherical harmonics into the frame of a pixel: the rows of a lobe that is even
//! in y.
//!
//! The frame has the normal n as z, and its x towards the mirror direction R. With u = R − (n·R)n, of
//! length s = sin of the view angle, row (l, m) times sᵐ is a polynomial in n and u, so that nothing
//! is lost where R comes to n and the frame has no x. Harmonics of the frame are those homogeneous
//! harmonic polynomials that c = u + i n×u, of c·c = 0, makes of Y_k:
//!
//! ```text
//! sᵐ R_lm,k = N_lm Re[(c·∇)ᵐ Y_k](n)
//! ```
//!
//! As Y_k of band 1, 2, 3 is a form of as many arguments, Y, B(p,q) and T(p,q,r), which is 0 when
//! traced over any two of them, n×u can be put out of the way:
//!
//! ```text
//! l = 1:  Y(n), Y(u)                        l = 2:  B(n,n), B(n,u), 2B(u,u) + s²B(n,n)
//! l = 3:  T(n,n,n), T(n,n,u), 2T(n,u,u) + s²T(n,n,n), 4T(u,u,u) + 3s²T(n,n,u)
//! ```
//!
//! with N_lm so that the world's own frame gives R = 1. Slopes follow from the same forms, because
//! these are linear in each argument.

use crate::reflectance::planes::MAX_ENTRIES;
use crate::reflectance::sh::{self, COEFFICIENTS, Real};

type Vector<T> = [T; 3];

// N_lm over the constants of the forms below: rows are exact in the world's own frame.
const N20: f64 = 0.5 / sh::C20;
const N2: f64 = 1.0 / sh::C2;
const N30: f64 = 0.5 / sh::C30;
const N31: f64 = 0.75 / sh::C31;
const N32: f64 = 3.0 / sh::C32;
const N33: f64 = 0.25 / sh::C33;

/// First coefficient of bands 2 and 3, and how many these have.
const BAND_2: usize = 4;
const BAND_3: usize = 9;
const IN_BAND_2: usize = 5;
const IN_BAND_3: usize = 7;
/// Where the entries of bands 1, 2 and 3 begin.
const ENTRIES_1: usize = 1;
const ENTRIES_2: usize = 7;
const ENTRIES_3: usize = 22;

#[inline(always)]
fn dot<T: Real>(a: Vector<T>, b: Vector<T>) -> T {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

/// a + t b
#[inline(always)]
fn plus<T: Real>(a: Vector<T>, t: T, b: Vector<T>) -> Vector<T> {
    [a[0] + t * b[0], a[1] + t * b[1], a[2] + t * b[2]]
}

/// The coefficients of band 1 are y, z and x.
#[inline(always)]
fn linear<T: Real>([x, y, z]: Vector<T>) -> [T; 3] {
    [y, z, x]
}

/// B_k(p, ·) of band 2.
#[inline(always)]
fn quadratic<T: Real>([x, y, z]: Vector<T>) -> [Vector<T>; IN_BAND_2] {
    let of = T::from_f64;
    let (zero, half, minus) = (of(0.0), of(0.5 * sh::C2), of(-0.5 * sh::C2));
    [
        [half * y, half * x, zero],
        [zero, half * z, half * y],
        [of(-sh::C20) * x, of(-sh::C20) * y, of(2.0 * sh::C20) * z],
        [half * z, zero, half * x],
        [half * x, minus * y, zero],
    ]
}

/// T_k(p, q, ·) of band 3.
#[inline(always)]
fn cubic<T: Real>(p: Vector<T>, q: Vector<T>) -> [Vector<T>; IN_BAND_3] {
    let of = T::from_f64;
    let (xx, yy, zz) = (p[0] * q[0], p[1] * q[1], p[2] * q[2]);
    // Twice the products of different axes.
    let xy = p[0] * q[1] + p[1] * q[0];
    let xz = p[0] * q[2] + p[2] * q[0];
    let yz = p[1] * q[2] + p[2] * q[1];
    let zero = of(0.0);
    let c33 = of(sh::C33);
    let c32 = of(sh::C32 / 6.0);
    let c31 = of(sh::C31 / 3.0);
    let c30 = of(sh::C30);
    let (three, four) = (of(3.0), of(4.0));
    [
        [c33 * xy, c33 * (xx - yy), zero],
        [c32 * yz, c32 * xz, c32 * xy],
        [
            zero - c31 * xy,
            c31 * (four * zz - xx - three * yy),
            four * c31 * yz,
        ],
        [zero - c30 * xz, zero - c30 * yz, c30 * (zz + zz - xx - yy)],
        [
            c31 * (four * zz - three * xx - yy),
            zero - c31 * xy,
            four * c31 * xz,
        ],
        [c32 * xz, zero - c32 * yz, c32 * (xx - yy)],
        [c33 * (xx - yy), zero - c33 * xy, zero],
    ]
}

/// u = R − (n·R)n
#[inline(always)]
fn aside<T: Real>(normal: Vector<T>, mirror: Vector<T>) -> Vector<T> {
    let y = dot(normal, mirror);
    plus(mirror, T::from_f64(0.0) - y, normal)
}

/// sᵐ R_jk, coefficient by coefficient, the rows of its band beside each other.
#[inline(always)]
pub fn rows<T: Real>(normal: [T; 3], mirror: [T; 3]) -> [T; MAX_ENTRIES] {
    let of = T::from_f64;
    let (n, u) = (normal, aside(normal, mirror));
    let s2 = dot(u, u);
    let mut rows = [of(0.0); MAX_ENTRIES];
    rows[0] = of(1.0);
    let (of_n, of_u) = (linear(n), linear(u));
    for k in 0..3 {
        rows[ENTRIES_1 + 2 * k] = of_n[k];
        rows[ENTRIES_1 + 2 * k + 1] = of_u[k];
    }
    let (b_n, b_u) = (quadratic(n), quadratic(u));
    for k in 0..IN_BAND_2 {
        let (nn, nu, uu) = (dot(b_n[k], n), dot(b_n[k], u), dot(b_u[k], u));
        let first = ENTRIES_2 + 3 * k;
        rows[first] = of(N20) * nn;
        rows[first + 1] = of(2.0 * N2) * nu;
        rows[first + 2] = of(N2) * (uu + uu + s2 * nn);
    }
    let (t_nn, t_uu) = (cubic(n, n), cubic(u, u));
    for k in 0..IN_BAND_3 {
        let (nnn, nnu) = (dot(t_nn[k], n), dot(t_nn[k], u));
        let (nuu, uuu) = (dot(t_uu[k], n), dot(t_uu[k], u));
        let first = ENTRIES_3 + 4 * k;
        rows[first] = of(N30) * nnn;
        rows[first + 1] = of(N31) * nnu;
        rows[first + 2] = of(N32) * (nuu + nuu + s2 * nnn);
        rows[first + 3] = of(N33) * (of(4.0) * uuu + of(3.0) * s2 * nnu);
    }
    rows
}

/// How [`rows`] change where normal and mirror direction change so.
///
/// With y = n·R: dy = dn·R + n·dR, du = dR − dy n − y dn, ds² = 2u·du.
#[inline(always)]
pub fn along<T: Real>(
    [normal, mirror]: [[T; 3]; 2],
    [by_normal, by_mirror]: [[T; 3]; 2],
) -> [T; MAX_ENTRIES] {
    let of = T::from_f64;
    let (n, u) = (normal, aside(normal, mirror));
    let y = dot(normal, mirror);
    let dy = dot(by_normal, mirror) + dot(normal, by_mirror);
    let dn = by_normal;
    let du = plus(plus(by_mirror, of(0.0) - dy, n), of(0.0) - y, dn);
    let (s2, ds2) = (dot(u, u), of(2.0) * dot(u, du));
    let (two, three) = (of(2.0), of(3.0));
    let mut along = [of(0.0); MAX_ENTRIES];
    let (of_n, of_u) = (linear(dn), linear(du));
    for k in 0..3 {
        along[ENTRIES_1 + 2 * k] = of_n[k];
        along[ENTRIES_1 + 2 * k + 1] = of_u[k];
    }
    let (b_n, b_u) = (quadratic(n), quadratic(u));
    for k in 0..IN_BAND_2 {
        let nn = dot(b_n[k], n);
        let (d_nn, d_uu) = (two * dot(b_n[k], dn), two * dot(b_u[k], du));
        let d_nu = dot(b_u[k], dn) + dot(b_n[k], du);
        let first = ENTRIES_2 + 3 * k;
        along[first] = of(N20) * d_nn;
        along[first + 1] = of(2.0 * N2) * d_nu;
        along[first + 2] = of(N2) * (two * d_uu + s2 * d_nn + ds2 * nn);
    }
    let (t_nn, t_nu, t_uu) = (cubic(n, n), cubic(n, u), cubic(u, u));
    for k in 0..IN_BAND_3 {
        let (nnn, nnu) = (dot(t_nn[k], n), dot(t_nn[k], u));
        let d_nnn = three * dot(t_nn[k], dn);
        let d_nnu = two * dot(t_nu[k], dn) + dot(t_nn[k], du);
        let d_nuu = dot(t_uu[k], dn) + two * dot(t_nu[k], du);
        let d_uuu = three * dot(t_uu[k], du);
        let first = ENTRIES_3 + 4 * k;
        along[first] = of(N30) * d_nnn;
        along[first + 1] = of(N31) * d_nnu;
        along[first + 2] = of(N32) * (two * d_nuu + s2 * d_nnn + ds2 * nnn);
        along[first + 3] = of(N33) * (of(4.0) * d_uuu + three * (s2 * d_nnu + ds2 * nnu));
    }
    along
}

/// The adjoint of [`along`]: derivatives by normal and mirror direction from those by the rows of the
/// first K coefficients.
///
/// ```text
/// g_R = g_u − (g_u·n)n          g_n (in all) = g_n − y g_u − (g_u·n)R
/// ```
#[inline(always)]
pub fn adjoint<T: Real, const K: usize>(
    normal: [T; 3],
    mirror: [T; 3],
    cotangent: impl Fn(usize) -> T,
) -> [[T; 3]; 2] {
    let of = T::from_f64;
    let (n, u) = (normal, aside(normal, mirror));
    let s2 = dot(u, u);
    let (two, three) = (of(2.0), of(3.0));
    let zero = [of(0.0); 3];
    let (mut by_n, mut by_u, mut by_s2) = (zero, zero, of(0.0));
    // Band 1 has y, z, x.
    for (k, axis) in [1, 2, 0].into_iter().enumerate() {
        by_n[axis] = cotangent(ENTRIES_1 + 2 * k);
        by_u[axis] = cotangent(ENTRIES_1 + 2 * k + 1);
    }
    let (b_n, b_u) = (quadratic(n), quadratic(u));
    for k in 0..IN_BAND_2 {
        let first = ENTRIES_2 + 3 * k;
        let of_1 = of(2.0 * N2) * cotangent(first + 1);
        let of_2 = of(N2) * cotangent(first + 2);
        // Of B(n,n), B(n,u) and B(u,u).
        let of_nn = of(N20) * cotangent(first) + s2 * of_2;
        by_s2 = by_s2 + of_2 * dot(b_n[k], n);
        by_n = plus(plus(by_n, two * of_nn, b_n[k]), of_1, b_u[k]);
        by_u = plus(plus(by_u, two * (of_2 + of_2), b_u[k]), of_1, b_n[k]);
    }
    if K == COEFFICIENTS {
        let (t_nn, t_nu, t_uu) = (cubic(n, n), cubic(n, u), cubic(u, u));
        for k in 0..IN_BAND_3 {
            let first = ENTRIES_3 + 4 * k;
            let of_2 = of(N32) * cotangent(first + 2);
            let of_3 = of(N33) * cotangent(first + 3);
            // Of T(n,n,n), T(n,n,u), T(n,u,u) and T(u,u,u).
            let of_nnn = of(N30) * cotangent(first) + s2 * of_2;
            let of_nnu = of(N31) * cotangent(first + 1) + three * s2 * of_3;
            let of_nuu = of_2 + of_2;
            let of_uuu = of(4.0) * of_3;
            by_s2 = by_s2 + of_2 * dot(t_nn[k], n) + three * of_3 * dot(t_nn[k], u);
            by_n = plus(by_n, three * of_nnn, t_nn[k]);
            by_n = plus(by_n, two * of_nnu, t_nu[k]);
            by_n = plus(by_n, of_nuu, t_uu[k]);
            by_u = plus(by_u, of_nnu, t_nn[k]);
            by_u = plus(by_u, two * of_nuu, t_nu[k]);
            by_u = plus(by_u, three * of_uuu, t_uu[k]);
        }
    }
    by_u = plus(by_u, two * by_s2, u);
    let along_n = of(0.0) - dot(by_u, n);
    let y = of(0.0) - dot(n, mirror);
    let by_mirror = plus(by_u, along_n, n);
    [plus(plus(by_n, y, by_u), along_n, mirror), by_mirror]
}

const _: () = assert!(
    ENTRIES_3 + 4 * IN_BAND_3 == MAX_ENTRIES
        && BAND_2 + IN_BAND_2 == BAND_3
        && BAND_3 + IN_BAND_3 == COEFFICIENTS
);
