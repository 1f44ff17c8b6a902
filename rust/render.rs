//! The forward model over many pixels in double precision: ground truth, relighting, residuals.

use glam::DVec3;

use crate::sh::COEFFICIENTS;
use crate::shade::{Frame, Material, shade};
use crate::{Error, Result, check, pool};

const CHUNK: usize = 1024;

/// Radiance of every pixel under every light: (light, pixel, channel).
///
/// `lighting` is (light, coefficient, channel). `threads` = 0 means one for each processor.
pub fn render(
    normals: &[DVec3],
    views: &[DVec3],
    materials: &[Material],
    lighting: &[f64],
    threads: usize,
) -> Result<Vec<f64>> {
    let pixels = normals.len();
    check::length("views", pixels, views.len())?;
    check::length("materials", pixels, materials.len())?;
    check::finite("lighting", lighting)?;
    check::unit_vectors("normals", normals)?;
    check::unit_vectors("views", views)?;
    let (lights, rest) = lighting.as_chunks::<{ COEFFICIENTS * 3 }>();
    if !rest.is_empty() {
        return Err(Error::argument(
            "lighting",
            "48 numbers a picture",
            lighting.len(),
        ));
    }

    let chunks = pool::map(threads, (0..pixels).step_by(CHUNK).collect(), |first| {
        let end = (first + CHUNK).min(pixels);
        let mut out = vec![0.0; lights.len() * (end - first) * 3];
        for p in first..end {
            let w = shade(&Frame::new(normals[p], views[p]), &materials[p]);
            for (i, light) in lights.iter().enumerate() {
                for c in 0..3 {
                    let radiance: f64 = (0..COEFFICIENTS).map(|k| w[c][k] * light[k * 3 + c]).sum();
                    out[(i * (end - first) + p - first) * 3 + c] = radiance;
                }
            }
        }
        out
    });

    let mut images = Vec::with_capacity(lights.len() * pixels * 3);
    for i in 0..lights.len() {
        for chunk in &chunks {
            let length = chunk.len() / lights.len();
            images.extend_from_slice(&chunk[i * length..][..length]);
        }
    }
    Ok(images)
}
