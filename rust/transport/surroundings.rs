//! Triangles that light meets, and rays that ask what they hit. The one place that names obvhs.

use glam::Vec3A;
use obvhs::BvhBuildParams;
use obvhs::bvh2::Bvh2;
use obvhs::bvh2::builder::build_bvh2_from_tris;
use obvhs::ray::{Ray, RayHit};
use obvhs::triangle::Triangle;
use std::time::Duration;

use crate::runtime::{Error, Result, check};

/// Largest coordinate that is taken: its square is finite in float32.
pub const LARGEST: f64 = 1e12;

/// Triangles in a tree of boxes.
#[derive(Clone)]
pub struct Surroundings {
    bvh: Bvh2,
    /// In the order of the tree's leaves.
    triangles: Vec<Triangle>,
    /// Which surface each is of.
    surfaces: Vec<u8>,
}

/// Where a ray meets a triangle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Hit {
    /// Along the ray.
    pub distance: f32,
    /// Number of the surface that the triangle is of.
    pub surface: u8,
}

impl std::fmt::Debug for Surroundings {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "Surroundings of {} triangles", self.triangles.len())
    }
}

impl Surroundings {
    /// Builds the tree; on one thread, so that it is always the same. Each triangle is of a surface,
    /// which has a number.
    pub fn new(triangles: &[[[f32; 3]; 3]], surfaces: &[u8]) -> Result<Self> {
        check::length("surfaces", triangles.len(), surfaces.len())?;
        let coordinates = triangles.as_flattened().as_flattened();
        check::moderate("triangles", coordinates, LARGEST)?;
        let count = triangles.len();
        if u32::try_from(count).is_err() {
            return Err(Error::argument(
                "triangles",
                "fewer than 2³² of them",
                count,
            ));
        }
        let given: Vec<_> = triangles
            .iter()
            .map(|corners| {
                let [v0, v1, v2] = corners.map(Vec3A::from);
                Triangle { v0, v1, v2 }
            })
            .collect();
        let bvh = if given.is_empty() {
            Bvh2::default()
        } else {
            let mut unused = Duration::default();
            build_bvh2_from_tris(&given, BvhBuildParams::medium_build(), &mut unused)
        };
        let order = || bvh.primitive_indices.iter().map(|&i| i as usize);
        let triangles = order().map(|i| given[i]).collect();
        let surfaces = order().map(|i| surfaces[i]).collect();
        Ok(Self {
            bvh,
            triangles,
            surfaces,
        })
    }

    /// The first triangle that a ray meets, from either side; None where it leaves.
    #[inline]
    pub fn hit(&self, origin: Vec3A, direction: Vec3A) -> Option<Hit> {
        let mut hit = RayHit::none();
        self.bvh.ray_traverse(
            Ray::new(origin, direction, 0.0, f32::INFINITY),
            &mut hit,
            |ray, i| self.triangles[i].intersect(ray),
        );
        (hit.t < f32::INFINITY).then(|| Hit {
            distance: hit.t,
            surface: self.surfaces[hit.primitive_id as usize],
        })
    }

    /// The highest number of a surface.
    pub fn last_surface(&self) -> u8 {
        self.surfaces.iter().copied().max().unwrap_or(0)
    }

    /// Whether a ray meets any triangle.
    #[inline]
    pub fn blocks(&self, origin: Vec3A, direction: Vec3A) -> bool {
        !self
            .bvh
            .ray_traverse_miss(Ray::new(origin, direction, 0.0, f32::INFINITY), |ray, i| {
                self.triangles[i].intersect(ray)
            })
    }
}

#[cfg(test)]
#[path = "../../tests/rust/transport_surroundings.rs"]
mod tests;
