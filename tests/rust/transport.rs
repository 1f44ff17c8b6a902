//! Of what `transport` keeps to itself.

use glam::Vec3A;

/// Numbers without a pattern, the same each time.
pub(super) struct Numbers(pub(super) u64);

impl Numbers {
    /// In [0, 1).
    pub(super) fn next(&mut self) -> f32 {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let z = (self.0 ^ (self.0 >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        ((z ^ (z >> 27)) >> 40) as f32 / (1u64 << 24) as f32
    }

    /// In [-1, 1).
    pub(super) fn signed(&mut self) -> f32 {
        2.0 * self.next() - 1.0
    }

    /// A unit vector, all alike.
    pub(super) fn direction(&mut self) -> Vec3A {
        loop {
            let inside = Vec3A::from_array(std::array::from_fn(|_| self.signed()));
            if (0.01..1.0).contains(&inside.length_squared()) {
                return inside.normalize();
            }
        }
    }
}
