//! Blocks of pixels of the principled model: the same as pixel by pixel, in loops over a few planes
//! each.
//!
//! Ten rows, two functions each with derivatives are more planes than the compiler keeps apart in one
//! loop.

use super::{Mixer, ROWS, Surface, worth};
use crate::reflectance::lobe_table::SECTION;
use crate::reflectance::planes::{
    BLOCK, BlockFunctions, ChannelFactors, ChannelSums, Materials, Plane,
};
use crate::reflectance::sh::Real;

#[inline(always)]
pub(super) fn fill_factors<T: Real, const C: usize>(
    materials: &Materials<C>,
    functions: &BlockFunctions<T>,
    factors: &mut [ChannelFactors<T>; C],
) {
    let metallic = rounded(&materials.metallic);
    let albedo: [Plane<T>; C] = std::array::from_fn(|c| rounded(&materials.albedo[c]));
    let [mut diffuse, mut of_a, mut of_b] = [[Plane::<T>::default(); C]; 3];
    for x in 0..BLOCK {
        let mixer = Mixer::new(metallic.0[x], Surface::of(|f| functions[f].0[x]));
        for c in 0..C {
            let albedo = albedo[c].0[x];
            let [mix, _] = mixer.mix(albedo, &mixer.metal(albedo));
            diffuse[c].0[x] = mix.diffuse;
            of_a[c].0[x] = mix.a;
            of_b[c].0[x] = mix.b;
        }
    }
    for c in 0..C {
        factors[c].diffuse = diffuse[c];
        for j in 0..ROWS {
            let (a, b, row) = (&functions[j], &functions[ROWS + j], &mut factors[c].rows[j]);
            for x in 0..BLOCK {
                row.0[x] = of_a[c].0[x] * a.0[x] + of_b[c].0[x] * b.0[x];
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
    let (values, slopes) = functions.split_at(SECTION);
    let known = rounded::<f32>(&materials.metallic);
    // Σ_j f_j g_j with a, b and their derivatives by roughness for f.
    let [mut by_a, mut by_b, mut by_a_slope, mut by_b_slope] = [[Plane::default(); C]; 4];
    for c in 0..C {
        for j in 0..ROWS {
            let g = &sums[c].rows[j];
            let (a, b) = (&values[j], &values[ROWS + j]);
            let (a_slope, b_slope) = (&slopes[j], &slopes[ROWS + j]);
            for x in 0..BLOCK {
                by_a[c].0[x] += a.0[x] * g.0[x];
                by_b[c].0[x] += b.0[x] * g.0[x];
                by_a_slope[c].0[x] += a_slope.0[x] * g.0[x];
                by_b_slope[c].0[x] += b_slope.0[x] * g.0[x];
            }
        }
    }
    let rho: [Plane; C] = std::array::from_fn(|c| rounded(&materials.albedo[c]));
    let mut by_albedo = [Plane::default(); C];
    let [mut by_roughness, mut by_metallic] = <[Plane; 2]>::default();
    for x in 0..BLOCK {
        let mixer = Mixer::new(known.0[x], Surface::of(|f| values[f].0[x]));
        let slope = Surface::of(|f| slopes[f].0[x]);
        let (mut of_roughness, mut of_metallic) = (0.0, 0.0);
        for c in 0..C {
            let rho = rho[c].0[x];
            let metal = mixer.metal(rho);
            let [mix, with_albedo] = mixer.mix(rho, &metal);
            let by = [sums[c].diffuse.0[x], by_a[c].0[x], by_b[c].0[x]];
            by_albedo[c].0[x] = worth(&with_albedo, by);
            of_metallic += worth(&mixer.by_metallic(rho, &metal), by);
            of_roughness += worth(&mixer.along(rho, &metal, &slope), by)
                + mix.a * by_a_slope[c].0[x]
                + mix.b * by_b_slope[c].0[x];
        }
        by_roughness.0[x] = of_roughness;
        by_metallic.0[x] = of_metallic;
    }
    let scaled = |to: &mut Plane<f64>, from: &Plane| {
        for x in 0..BLOCK {
            to.0[x] = scale * f64::from(from.0[x]);
        }
    };
    for c in 0..C {
        scaled(&mut gradient.albedo[c], &by_albedo[c]);
    }
    scaled(&mut gradient.roughness, &by_roughness);
    scaled(&mut gradient.metallic, &by_metallic);
}
