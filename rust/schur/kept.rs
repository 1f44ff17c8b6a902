//! Eliminated pixels, kept for many products with the Schur complement.

use super::kernels::{Collect, Eliminated, Project};
use super::light_system::UnknownLights;
use super::tied::{SharedSums, Tied};
use crate::reflectance::planes::Plane;
use crate::reflectance::sh::COEFFICIENTS;
use crate::runtime::simd::Instructions;
use crate::runtime::{Result, pool};

/// The system of the lights at one x, some pixels eliminated once for all: S v without the pictures.
///
/// What is kept of a pixel, w_ck and R, is rounded to float32, 4 bytes for each of C (K + N D) numbers
/// (D = 3, or 5 where normals are free), and N C more where samples have weights. Rows of R are
/// orthonormal, however singular a pixel is, so S v is known to 10⁻⁶ of Wᵀ Ω W v. s is float64.
#[derive(Debug)]
pub struct KeptSystem {
    pub(super) unknown: UnknownLights,
    pub(super) threads: usize,
    pub(super) isa: Instructions,
    pub(super) gradient: Vec<f64>,
    pub(super) pieces: Vec<Box<dyn Products>>,
}

impl KeptSystem {
    /// s: (M).
    pub fn gradient(&self) -> &[f64] {
        &self.gradient
    }

    /// S v, for v as the shared unknowns are.
    pub fn product(&self, v: &[f64]) -> Result<Vec<f64>> {
        let (light_step, offset_step) = self.unknown.padded(v)?;
        let light_step: Vec<_> = light_step
            .iter()
            .map(|light| light.map(|l| l as f32))
            .collect();
        let parts = pool::map(self.threads, self.pieces.iter().collect(), |pixels| {
            let mut sums = self.unknown.sums();
            pixels.add(self.isa, &light_step, offset_step, &mut sums);
            self.unknown.collected(&sums)
        });
        self.unknown.total(parts.iter())
    }
}

/// Some blocks of pixels.
pub(super) trait Products: std::fmt::Debug + Send + Sync {
    /// Adds Wᵀ (Ω − Rᵀ R) W v.
    fn add(
        &self,
        isa: Instructions,
        light_step: &[[f32; COEFFICIENTS]],
        offset_step: &[f64],
        sums: &mut SharedSums,
    );
}

impl<const D: usize, const U: usize> Products for Vec<(Eliminated<f32, D>, Option<Tied<U>>)> {
    fn add(
        &self,
        isa: Instructions,
        light_step: &[[f32; COEFFICIENTS]],
        offset_step: &[f64],
        sums: &mut SharedSums,
    ) {
        let mut values = vec![Plane::default(); light_step.len()];
        for (pixels, tied) in self {
            let mut whitened = [Plane::default(); U];
            isa.run(Project {
                pixels,
                lights: light_step,
                radiance: &mut values,
                sums: &mut whitened,
            });
            if let Some(tied) = tied {
                let mut exact = whitened.map(|plane| Plane(plane.0.map(f64::from)));
                tied.subtract(offset_step, &mut exact);
                tied.add_product(offset_step, &exact, &mut sums.offsets);
                whitened = exact.map(|plane| Plane(plane.0.map(|value| value as f32)));
            }
            isa.run(Collect {
                pixels,
                values: &mut values,
                whitened: &whitened,
                sums: &mut sums.lights,
            });
        }
    }
}
