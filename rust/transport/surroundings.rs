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
const LARGEST: f64 = 1e12;

/// Triangles in a tree of boxes.
#[derive(Clone)]
pub struct Surroundings {
    bvh: Bvh2,
    /// In the order of the tree's leaves.
    triangles: Vec<Triangle>,
}

impl std::fmt::Debug for Surroundings {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "Surroundings of {} triangles", self.triangles.len())
    }
}

impl Surroundings {
    /// Builds the tree; on one thread, so that it is always the same.
    pub fn new(triangles: &[[[f32; 3]; 3]]) -> Result<Self> {
        check::moderate(
            "triangles",
            triangles.as_flattened().as_flattened(),
            LARGEST,
        )?;
        if u32::try_from(triangles.len()).is_err() {
            return Err(Error::argument(
                "triangles",
                "fewer than 2³² triangles",
                triangles.len(),
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
        let triangles = bvh
            .primitive_indices
            .iter()
            .map(|&i| given[i as usize])
            .collect();
        Ok(Self { bvh, triangles })
    }

    /// How far a ray goes until it meets a triangle, from either side; None where it leaves.
    #[inline]
    pub fn distance(&self, origin: Vec3A, direction: Vec3A) -> Option<f32> {
        let mut hit = RayHit::none();
        self.bvh.ray_traverse(
            Ray::new(origin, direction, 0.0, f32::INFINITY),
            &mut hit,
            |ray, i| self.triangles[i].intersect(ray),
        );
        (hit.t < f32::INFINITY).then_some(hit.t)
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
