//! What one pixel costs under known lamps, and its normal equations.
//!
//! With intensities e_kc at the pixel, unit radiance I_kc ([`Surface`]), and SH light a_i beside the
//! lamps of picture i,
//!
//! ```text
//! model_ic = Σ_k e_kc I_kc + Σ_j w_cj a_ijc              residual_ic = model_ic − y_ic
//! cost     = Σ_ic w_ic residual_ic² + Σ_x p_x (x − mean_x)²
//! ```
//!
//! where a residual counts only if what the sample says is missed: y_ic itself, at least y_ic (of a
//! sample at the upper limit of its file), or at most y_ic. Unknowns are in the order of the
//! [`Arrowhead`](crate::pixel::arrowhead::Arrowhead): albedos, roughness, metallic, tangent offsets.

use std::ops::Range;

use glam::DVec3;

use super::ambient::{SLOPES_OF_SAMPLE, under, weight_slopes};
use super::surface::Surface;
use crate::reflectance::model::Model;
use crate::reflectance::planes::Material;
use crate::reflectance::reflection::{Reflection, Weights};
use crate::reflectance::shade::{Frame, shade};
use crate::reflectance::tangent_offset::OFFSETS;

/// Unknowns of a pixel: albedos, roughness, metallic, tangent offsets.
pub(super) const UNKNOWNS: usize = 7;
pub(super) const ROUGHNESS: usize = 3;
pub(super) const METALLIC: usize = 4;
pub(super) const OFFSET: usize = 5;

/// A sample says that radiance is at least this.
pub const AT_LEAST: u8 = 1;
/// A sample says that radiance is at most this.
pub const AT_MOST: u8 = 2;

/// Where a pixel is.
#[derive(Clone, Copy, Debug)]
pub(super) struct Point {
    pub(super) offset: [f64; OFFSETS],
    pub(super) normal: DVec3,
    pub(super) material: Material,
}

impl Point {
    pub(super) fn values(&self) -> [f64; UNKNOWNS] {
        let Material {
            albedo: [red, green, blue],
            roughness,
            metallic,
        } = self.material;
        let [a, b] = self.offset;
        [red, green, blue, roughness, metallic, a, b]
    }
}

/// Σ w J Jᵀ and Σ w J residual, with the prior.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Equations {
    /// On the diagonal and below it.
    pub(super) matrix: [[f64; UNKNOWNS]; UNKNOWNS],
    pub(super) gradient: [f64; UNKNOWNS],
}

/// Of all pixels: which lamps light a picture, and the SH light in it, if there is any.
#[derive(Clone, Debug)]
pub(super) struct PictureLight {
    pub(super) lamps: Range<usize>,
    pub(super) ambient: Option<Weights>,
}

/// What is known of one pixel.
#[derive(Clone, Copy, Debug)]
pub(super) struct Samples<'a> {
    pub(super) model: Model,
    pub(super) view: DVec3,
    pub(super) lights: &'a [PictureLight],
    /// Whether a picture has SH light.
    pub(super) any_ambient: bool,
    /// By picture.
    pub(super) targets: &'a [[f64; 3]],
    pub(super) weights: &'a [[f64; 3]],
    pub(super) limits: Option<&'a [[u8; 3]]>,
    /// By lamp.
    pub(super) directions: &'a [DVec3],
    pub(super) intensities: &'a [[f64; 3]],
    pub(super) prior_mean: [f64; UNKNOWNS],
    pub(super) prior_precision: [f64; UNKNOWNS],
}

impl Samples<'_> {
    /// Whether any sample counts.
    pub(super) fn any(&self) -> bool {
        self.weights.iter().flatten().any(|&weight| weight > 0.0)
    }

    /// The cost of a point, and the normal equations there; those of the tangent offsets if ∂n by
    /// them is given.
    pub(super) fn equations<M: Reflection>(
        &self,
        point: &Point,
        by_offset: Option<&[DVec3; 2]>,
    ) -> (f64, Equations) {
        let (mut cost, mut equations) = (0.0, Equations::default());
        self.each::<M>(point, by_offset, |c, slopes, weight, residual| {
            cost += weight * residual * residual;
            equations.add(c, slopes, weight, residual);
        });
        for (x, value) in point.values().into_iter().enumerate() {
            let deviation = value - self.prior_mean[x];
            cost += self.prior_precision[x] * deviation * deviation;
            equations.matrix[x][x] += self.prior_precision[x];
            equations.gradient[x] += self.prior_precision[x] * deviation;
        }
        (cost, equations)
    }

    /// Calls `add` with channel, derivatives (of its own albedo, roughness, metallic, tangent
    /// offsets), weight and residual of each sample that counts.
    #[inline(always)]
    fn each<M: Reflection>(
        &self,
        point: &Point,
        by_offset: Option<&[DVec3; 2]>,
        mut add: impl FnMut(usize, &[f64; SLOPES_OF_SAMPLE], f64, f64),
    ) {
        let directions = [point.normal, self.view];
        let surface = Surface::<true>::new(self.model, point.normal, self.view, &point.material);
        let weights = (self.any_ambient)
            .then(|| shade(&Frame::<M>::new(point.normal, self.view), &point.material));
        let weights_by =
            (self.any_ambient).then(|| weight_slopes::<M>(directions, &point.material, by_offset));
        for (i, light) in self.lights.iter().enumerate() {
            if self.weights[i] == [0.0; 3] {
                continue;
            }
            let mut model = [0.0; 3];
            let mut slopes = [[0.0; SLOPES_OF_SAMPLE]; 3];
            for k in light.lamps.clone() {
                let intensity = self.intensities[k];
                if intensity == [0.0; 3] {
                    continue;
                }
                let unit = surface.reflected(self.directions[k]);
                let turned = by_offset.map(|by| by.map(|change| unit.along(change)));
                for c in 0..3 {
                    model[c] += intensity[c] * unit.radiance[c];
                    slopes[c][0] += intensity[c] * unit.by_albedo[c];
                    slopes[c][1] += intensity[c] * unit.by_roughness[c];
                    slopes[c][2] += intensity[c] * unit.by_metallic[c];
                    if let Some([by_a, by_b]) = &turned {
                        slopes[c][3] += intensity[c] * by_a[c];
                        slopes[c][4] += intensity[c] * by_b[c];
                    }
                }
            }
            if let (Some(weights), Some(ambient)) = (&weights, &light.ambient) {
                for c in 0..3 {
                    model[c] += under(&weights[c], &ambient[c]);
                    if let Some(by) = &weights_by {
                        for x in 0..SLOPES_OF_SAMPLE {
                            slopes[c][x] += under(&by[c][x], &ambient[c]);
                        }
                    }
                }
            }
            for c in 0..3 {
                let residual = self.residual(i, c, model[c]);
                if residual != 0.0 || self.is_data(i, c) {
                    add(c, &slopes[c], self.weights[i][c], residual);
                }
            }
        }
    }

    /// Whether a sample says what radiance is, and no limit of it.
    #[inline]
    fn is_data(&self, picture: usize, channel: usize) -> bool {
        self.limits
            .is_none_or(|limits| limits[picture][channel] == 0)
    }

    /// By how much radiance misses what a sample says.
    #[inline]
    fn residual(&self, picture: usize, channel: usize, radiance: f64) -> f64 {
        let difference = radiance - self.targets[picture][channel];
        match self.limits.map(|limits| limits[picture][channel]) {
            Some(AT_LEAST) => difference.min(0.0),
            Some(AT_MOST) => difference.max(0.0),
            _ => difference,
        }
    }
}

impl Equations {
    /// Adds a sample of a channel.
    #[inline]
    fn add(
        &mut self,
        channel: usize,
        slopes: &[f64; SLOPES_OF_SAMPLE],
        weight: f64,
        residual: f64,
    ) {
        let weighted = slopes.map(|slope| weight * slope);
        self.matrix[channel][channel] += weighted[0] * slopes[0];
        self.gradient[channel] += weighted[0] * residual;
        for f in 1..SLOPES_OF_SAMPLE {
            let row = &mut self.matrix[ROUGHNESS + f - 1];
            row[channel] += weighted[0] * slopes[f];
            for g in 1..=f {
                row[ROUGHNESS + g - 1] += weighted[g] * slopes[f];
            }
            self.gradient[ROUGHNESS + f - 1] += weighted[f] * residual;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::reflectance::model::with_model;
    use crate::reflectance::tangent_offset::offset_normal;

    /// Half of the slope of the cost by each unknown is the gradient, with several lamps in a picture,
    /// SH light, limits that are missed and limits that are kept, and a prior.
    #[test]
    fn the_gradient_is_half_of_the_slope_of_the_cost() {
        let unit = |x: f64, y: f64| DVec3::new(x, y, 1.0).normalize();
        let directions = [
            unit(0.5, 0.1),
            unit(-0.3, 0.6),
            unit(0.2, -0.8),
            unit(-0.9, 0.2),
        ];
        let intensities = [[1.0, 0.8, 0.6], [0.5; 3], [0.0, 0.0, 2.0], [0.9, 1.1, 1.3]];
        let ambient =
            std::array::from_fn(|c| std::array::from_fn(|k| 0.6 / (1.0 + (k + c) as f64)));
        let light = |lamps, ambient| PictureLight { lamps, ambient };
        let lights = [
            light(0..2, None),
            light(2..3, Some(ambient)),
            light(3..4, None),
            light(4..4, Some(ambient)),
        ];
        let base = unit(0.1, 0.2);
        let at = |values: [f64; UNKNOWNS]| {
            let [red, green, blue, roughness, metallic, a, b] = values;
            Point {
                offset: [a, b],
                normal: offset_normal(base, [a, b]).normal,
                material: Material {
                    albedo: [red, green, blue],
                    roughness,
                    metallic,
                },
            }
        };
        let values = [0.3, 0.6, 0.8, 0.45, 0.35, 0.12, -0.07];
        for model in [Model::Paper, Model::Principled] {
            for limit in [0, AT_LEAST, AT_MOST] {
                let samples = Samples {
                    model,
                    view: unit(-0.1, 0.1),
                    lights: &lights,
                    any_ambient: true,
                    targets: &[[0.1, 0.9, 0.2], [0.5; 3], [0.0, 0.6, 2.0], [0.2, 0.1, 0.3]],
                    weights: &[[1.0, 2.0, 0.5], [1.0; 3], [0.0, 3.0, 1.0], [4.0, 1.0, 1.0]],
                    limits: Some(&[[limit; 3], [0, limit, limit], [limit; 3], [limit; 3]]),
                    directions: &directions,
                    intensities: &intensities,
                    prior_mean: [0.5, 0.5, 0.5, 0.3, 0.0, 0.0, 0.1],
                    prior_precision: [0.1, 0.2, 0.0, 0.3, 0.4, 0.5, 0.6],
                };
                let by_offset = offset_normal(base, [0.12, -0.07]).by_offset;
                let point = at(values);
                let (_, equations) =
                    with_model!(model, M => samples.equations::<M>(&point, Some(&by_offset)));
                let cost = |x: usize, t: f64| {
                    let mut moved = values;
                    moved[x] += t;
                    with_model!(model, M => samples.equations::<M>(&at(moved), None).0)
                };
                for x in 0..UNKNOWNS {
                    let slope = |h: f64| (cost(x, h) - cost(x, -h)) / (2.0 * h);
                    let expected = 0.5 * (4.0 * slope(1e-4) - slope(2e-4)) / 3.0;
                    let found = equations.gradient[x];
                    assert!(
                        (found - expected).abs() < 1e-8 * (1.0 + expected.abs()),
                        "{model:?}, limits {limit}, unknown {x}: {found} is not {expected}"
                    );
                }
            }
        }
    }
}
