//! Where the pixels look, block by block, as a [`Problem`](super::Problem) keeps it.

use glam::DVec3;

use super::low_words::{self, DirectionLowWords};
use crate::block::normal_jacobian::GivenDirections;
use crate::reflectance::planes::{BLOCK, Directions};
use crate::runtime::Result;
use crate::runtime::memory::zeros;

/// What is kept of normals and views, by block.
#[derive(Debug)]
pub(super) enum Geometry {
    Known {
        directions: Vec<Directions>,
        low_words: Vec<DirectionLowWords>,
    },
    Free(Vec<GivenDirections>),
}

impl Geometry {
    pub(super) fn known(normals: &[DVec3], views: &[DVec3]) -> Result<Self> {
        let blocks = normals.len().div_ceil(BLOCK);
        let mut directions: Vec<Directions> = zeros("normals", blocks)?;
        for (p, (&normal, &view)) in normals.iter().zip(views).enumerate() {
            directions[p / BLOCK].set(p % BLOCK, normal, view);
        }
        Ok(Self::Known {
            directions,
            low_words: low_words::of_directions(normals, views)?,
        })
    }
}
