//! Tests of what Python does not see of the core.

mod environment;
mod lamps;
mod normals;
mod objective;
mod poisson;

use glam::DVec3;
use pbrfit::reflectance::planes::Material;

/// Numbers in \[0, 1\) that look random.
struct Numbers(u64);

impl Numbers {
    fn next(&mut self) -> f64 {
        // splitmix64 (Steele, Lea, Flood 2014)
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((z ^ (z >> 31)) >> 11) as f64 / (1_u64 << 53) as f64
    }

    fn between(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.next()
    }

    fn direction(&mut self) -> DVec3 {
        let (z, angle) = (self.between(-1.0, 1.0), std::f64::consts::TAU * self.next());
        let rho = (1.0 - z * z).sqrt();
        DVec3::new(rho * angle.cos(), rho * angle.sin(), z)
    }

    /// On the side of a normal, with a cosine of `least` or more.
    fn direction_over(&mut self, normal: DVec3, least: f64) -> DVec3 {
        loop {
            let direction = self.direction();
            if direction.dot(normal) >= least {
                return direction;
            }
        }
    }

    fn material(&mut self) -> Material {
        Material {
            albedo: [self.next(), self.next(), self.next()],
            roughness: self.between(0.05, 1.0),
            metallic: self.next(),
        }
    }
}
