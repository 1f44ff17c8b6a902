//! Blocks of pixels of the principled model: the same as pixel by pixel, in loops over a few planes each.
//!
//! Ten rows, two functions each with derivatives are more planes than the compiler keeps apart in one
//! loop.

use super::{Mixer, ROWS, Surface, worth};
use crate::block::{BLOCK, ChannelFactors, ChannelSums, Materials, Plane};
use crate::lobe_table::VALUES;
use crate::sh::Real;
use crate::shade::BlockFunctions;

#[inline(always)]
pub(super) fn fill_factors<T: Real, const C: usize>(
    materials: &Materials<C>,
    functions: &BlockFunctions<T>,
    factors: &mut [ChannelFactors<T>; C],
) {
    let metallic = rounded(&materials.metallic);
    for c in 0..C {
        let albedo = rounded(&materials.albedo[c]);
        let [mut diffuse, mut of_a, mut of_b] = <[Plane<T>; 3]>::default();
        for x in 0..BLOCK {
            let mixer = Mixer::new(metallic.0[x], Surface::of(|f| functions[f].0[x]));
            let [mix, _] = mixer.mix(albedo.0[x], &mixer.metal(albedo.0[x]));
            diffuse.0[x] = mix.diffuse;
            of_a.0[x] = mix.a;
            of_b.0[x] = mix.b;
        }
        factors[c].diffuse = diffuse;
        for j in 0..ROWS {
            let (a, b, row) = (&functions[j], &functions[ROWS + j], &mut factors[c].rows[j]);
            for x in 0..BLOCK {
                row.0[x] = of_a.0[x] * a.0[x] + of_b.0[x] * b.0[x];
            }
        }
    }
}

#[inline(always)]
fn rounded<T: Real>(plane: &Plane<f64>) -> Plane<T> {
    let mut to = Plane::default();
    for x in 0..BLOCK {
        to.0[x] = T::from_f64(plane.0[x]);
    }
    to
}

#[inline(always)]
pub(super) fn pull_back<const C: usize>(
    materials: &Materials<C>,
    functions: &BlockFunctions<f32>,
    sums: &[ChannelSums; C],
    scale: f64,
    gradient: &mut Materials<C>,
) {
    let (values, slopes) = functions.split_at(VALUES);
    let known = rounded::<f32>(&materials.metallic);
    let [mut roughness, mut metallic] = <[Plane<f64>; 2]>::default();
    for c in 0..C {
        // Σ_j f_j g_j with a, b and their derivatives by roughness for f.
        let [mut by_a, mut by_b, mut by_a_slope, mut by_b_slope] = <[Plane; 4]>::default();
        for j in 0..ROWS {
            let g = &sums[c].rows[j];
            let (a, b) = (&values[j], &values[ROWS + j]);
            let (a_slope, b_slope) = (&slopes[j], &slopes[ROWS + j]);
            for x in 0..BLOCK {
                by_a.0[x] += a.0[x] * g.0[x];
                by_b.0[x] += b.0[x] * g.0[x];
                by_a_slope.0[x] += a_slope.0[x] * g.0[x];
                by_b_slope.0[x] += b_slope.0[x] * g.0[x];
            }
        }
        let rho = rounded::<f32>(&materials.albedo[c]);
        let [mut by_albedo, mut by_roughness, mut by_metallic] = <[Plane; 3]>::default();
        for x in 0..BLOCK {
            let mixer = Mixer::new(known.0[x], Surface::of(|f| values[f].0[x]));
            let metal = mixer.metal(rho.0[x]);
            let [mix, slope] = mixer.mix(rho.0[x], &metal);
            let change = mixer.along(rho.0[x], &metal, &Surface::of(|f| slopes[f].0[x]));
            let by = [sums[c].diffuse.0[x], by_a.0[x], by_b.0[x]];
            by_albedo.0[x] = worth(&slope, by);
            by_metallic.0[x] = worth(&mixer.by_metallic(rho.0[x], &metal), by);
            by_roughness.0[x] =
                worth(&change, by) + mix.a * by_a_slope.0[x] + mix.b * by_b_slope.0[x];
        }
        for x in 0..BLOCK {
            gradient.albedo[c].0[x] = scale * f64::from(by_albedo.0[x]);
            roughness.0[x] += scale * f64::from(by_roughness.0[x]);
            metallic.0[x] += scale * f64::from(by_metallic.0[x]);
        }
    }
    gradient.roughness = roughness;
    gradient.metallic = metallic;
}
