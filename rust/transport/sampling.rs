//! Which rays a pixel sends: from the cosine and from lobes of a few widths, by multiple importance
//! sampling.
//!
//! Of N rays as many shares come from densities p_t(ω): the cosine about the normal, and the paper's
//! lobe about the mirror direction at a few values of roughness. With the balance heuristic a ray
//! weighs 1/(N p), p the mean of the densities (E. Veach and L. Guibas, "Optimally combining sampling
//! techniques for Monte Carlo rendering", SIGGRAPH 1995), which no integrand here exceeds by much.
//! Points in the unit square are those of a lattice, (i + ½)/N and the fractions of i times the
//! golden ratio, shifted for each pixel by numbers of its own: what is left of noise differs from
//! pixel to pixel, and is always the same for one.

use std::f32::consts::{FRAC_1_PI, TAU};

use glam::Vec3A;

use super::dual::radial;

/// Roughness of the lobes that rays are drawn from.
const LOBES: [f32; 3] = [0.2, 0.4, 0.7];

/// Shares of the rays: those of the cosine count as many as all lobes.
const COSINE_SHARES: usize = LOBES.len();
const SHARES: usize = COSINE_SHARES + LOBES.len();

/// Rays of one pixel.
pub(super) struct Rays {
    normal: Vec3A,
    mirror: Vec3A,
    count: usize,
    shift: [f32; 2],
}

impl Rays {
    /// About `count` of them; `seed` is the pixel's own number.
    pub(super) fn new(normal: Vec3A, view: Vec3A, count: usize, seed: u64) -> Self {
        let bits = mixed(seed);
        Self {
            normal,
            mirror: 2.0 * normal.dot(view) * normal - view,
            count: count.next_multiple_of(SHARES),
            shift: [fraction(bits), fraction(bits.rotate_left(32))],
        }
    }

    /// Calls `f` with the directions above the horizon and their weights dω.
    pub(super) fn each(&self, mut f: impl FnMut(Vec3A, f32)) {
        let of_share = self.count / SHARES;
        let cosine = COSINE_SHARES * of_share;
        let frame = self.normal.any_orthonormal_pair();
        for i in 0..cosine {
            let [u, turn] = self.point(i, cosine);
            let z = (1.0 - u).sqrt();
            self.give(around(self.normal, frame, z, turn), &mut f);
        }
        let frame = self.mirror.any_orthonormal_pair();
        for roughness in LOBES {
            let e = roughness.powi(4);
            for i in 0..of_share {
                let [u, turn] = self.point(i, of_share);
                // The inverse of the lobe's distribution of u: 1/(1+e−(1−e)z) is linear in it.
                let (low, high) = (1.0 / (1.0 + e), 0.5 / e);
                let z = (1.0 + e - 1.0 / (low + u * (high - low))) / (1.0 - e);
                self.give(around(self.mirror, frame, z.clamp(0.0, 1.0), turn), &mut f);
            }
        }
    }

    fn give(&self, direction: Vec3A, f: &mut impl FnMut(Vec3A, f32)) {
        let cosine = self.normal.dot(direction);
        if cosine > 0.0 {
            let density = self.density(direction, cosine);
            f(direction, 1.0 / (self.count as f32 * density));
        }
    }

    /// Mean of the densities.
    fn density(&self, direction: Vec3A, cosine: f32) -> f32 {
        let mut sum = COSINE_SHARES as f32 * FRAC_1_PI * cosine;
        let u = self.mirror.dot(direction);
        if u > 0.0 {
            for roughness in LOBES {
                // The lobe's integral over the half space is h_0 = 4/(1+e).
                sum += radial(roughness, u) * 0.25 * (1.0 + roughness.powi(4));
            }
        }
        sum / SHARES as f32
    }

    fn point(&self, i: usize, count: usize) -> [f32; 2] {
        const GOLDEN: f64 = 0.618_033_988_749_894_9;
        let along = (i as f32 + 0.5) / count as f32;
        let across = (i as f64 * GOLDEN).fract() as f32;
        [along + self.shift[0], across + self.shift[1]].map(f32::fract)
    }
}

/// A direction whose cosine with `axis` is `z`, turned by a share of a full turn.
fn around(axis: Vec3A, (x, y): (Vec3A, Vec3A), z: f32, turn: f32) -> Vec3A {
    let radius = (1.0 - z * z).max(0.0).sqrt();
    let (sin, cos) = (TAU * turn).sin_cos();
    axis * z + x * (radius * cos) + y * (radius * sin)
}

/// Bits that have nothing to do with those of the numbers beside it (the finaliser of G. Steele et
/// al., "Fast splittable pseudorandom number generators", OOPSLA 2014).
fn mixed(seed: u64) -> u64 {
    let mut z = seed.wrapping_add(1).wrapping_mul(0x9E37_79B9_7F4A_7C15);
    z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
    z ^ (z >> 31)
}

/// In [0, 1), from the upper bits.
fn fraction(bits: u64) -> f32 {
    (bits >> 40) as f32 / (1u64 << 24) as f32
}
