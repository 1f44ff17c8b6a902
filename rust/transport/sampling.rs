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

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::{PI, TAU};

    const COUNT: usize = 2048;

    /// Normals and views: seen from above, aslant, at the horizon and from below.
    fn looks() -> impl Iterator<Item = (Vec3A, Vec3A)> {
        let normal = Vec3A::new(0.48, 0.6, 0.64);
        let (x, _) = normal.any_orthonormal_pair();
        [0.0f32, 20.0, 45.0, 70.0, 85.0, 90.0, 100.0]
            .map(move |degrees| {
                let (sin, cos) = degrees.to_radians().sin_cos();
                (normal, cos * normal + sin * x)
            })
            .into_iter()
    }

    fn sum(rays: &Rays, f: impl Fn(Vec3A) -> f32) -> f64 {
        let (mut sum, mut count) = (0.0, 0);
        rays.each(|direction, weight| {
            assert!((direction.length() - 1.0).abs() < 1e-5);
            assert!(rays.normal.dot(direction) > 0.0);
            assert!(weight.is_finite() && weight > 0.0);
            sum += f64::from(weight * f(direction));
            count += 1;
        });
        let cosine = COSINE_SHARES * rays.count / SHARES;
        assert!((cosine..=rays.count).contains(&count), "{count} rays");
        sum
    }

    /// The lobe over its directions above the horizon, by the midpoint rule about the mirror
    /// direction, with the lobe's own distribution along the angle.
    fn lobe_above(roughness: f64, normal: Vec3A, view: Vec3A) -> f64 {
        const POLAR: usize = 500;
        const AROUND: usize = 200;
        let mirror = 2.0 * normal.dot(view) * normal - view;
        let along = f64::from(normal.dot(mirror));
        let across = (1.0 - along * along).max(0.0).sqrt();
        let e = roughness.powi(4);
        let (low, high) = (1.0 / (1.0 + e), 0.5 / e);
        let mut above = 0;
        for i in 0..POLAR {
            let u = (i as f64 + 0.5) / POLAR as f64;
            let z = (1.0 + e - 1.0 / (low + u * (high - low))) / (1.0 - e);
            let radius = (1.0 - z * z).max(0.0).sqrt();
            for j in 0..AROUND {
                let turn = TAU * (j as f64 + 0.5) / AROUND as f64;
                above += usize::from(along * z + across * radius * turn.cos() > 0.0);
            }
        }
        4.0 / (1.0 + e) * above as f64 / (POLAR * AROUND) as f64
    }

    #[test]
    fn the_cosine_integrates_to_pi() {
        for (normal, view) in looks() {
            for seed in 0..5 {
                let rays = Rays::new(normal, view, COUNT, seed);
                let found = sum(&rays, |direction| normal.dot(direction));
                assert!((found - PI).abs() < 5e-3 * PI, "{found} for view {view}");
            }
        }
    }

    #[test]
    fn lobes_integrate_to_their_share_above_the_horizon() {
        for (normal, view) in looks() {
            let mirror = 2.0 * normal.dot(view) * normal - view;
            for roughness in [0.15, 0.2, 0.3, 0.4, 0.5, 0.7, 0.9] {
                let expected = lobe_above(roughness, normal, view);
                let rays = Rays::new(normal, view, COUNT, 3);
                let found = sum(&rays, |direction| {
                    let u = mirror.dot(direction);
                    if u > 0.0 {
                        radial(roughness as f32, u)
                    } else {
                        0.0
                    }
                });
                assert!(
                    (found - expected).abs() < 0.03 * 4.0,
                    "{found}, expected {expected}, for view {view}, roughness {roughness}"
                );
            }
        }
    }

    /// Y_k over the whole half space against n·ω, by bands: A_l Y_k(n).
    #[test]
    fn harmonics_integrate_against_the_cosine_as_they_should() {
        use crate::reflectance::sh::{BAND_OF, COSINE_TRANSFER, basis};
        for (normal, view) in looks() {
            let rays = Rays::new(normal, view, COUNT, 8);
            let at_normal: [f32; 16] = basis(normal.to_array());
            for k in 0..16 {
                let found = sum(&rays, |direction| {
                    let y: [f32; 16] = basis(direction.to_array());
                    normal.dot(direction) * y[k]
                });
                let expected = COSINE_TRANSFER[BAND_OF[k]] * f64::from(at_normal[k]);
                let holds = (found - expected).abs() < 0.02;
                assert!(holds, "{found}, expected {expected}");
            }
        }
    }

    #[test]
    fn rays_follow_from_their_seed() {
        let all = |seed: u64| {
            let mut found = Vec::new();
            let rays = Rays::new(Vec3A::Z, Vec3A::new(0.6, 0.0, 0.8), 60, seed);
            rays.each(|direction, weight| found.push((direction.to_array(), weight)));
            found
        };
        assert_eq!(all(5), all(5));
        for seed in [0, 4, 6, u64::MAX] {
            assert_ne!(all(5), all(seed));
        }
    }
}
