//! Blocks of pixels of the principled model: the same as pixel by pixel, in loops over a few planes each.
//!
//! Ten rows, two functions each with derivatives are more planes than the compiler keeps apart in one
//! loop.

use super::{Mixer, ROWS, Surface, worth};
use crate::block::{BLOCK, ChannelFactors, ChannelSums, Materials, Plane};
use crate::lobe_table::{Row, TABLE, VALUES};
use crate::sh::Real;
use crate::shade::BlockFunctions;
use crate::simd::Isa;

type Doubles = Plane<f64>;

/// Pixels looked up before their functions go to planes: a cache line of each.
const TOGETHER: usize = 8;

#[inline(always)]
pub(super) fn fill_functions<I: Isa>(
    isa: I,
    cosine: &Doubles,
    roughness: &Doubles,
    by_cosine: bool,
    functions: &mut BlockFunctions,
) {
    let table = &*TABLE;
    let orders = if by_cosine { 3 } else { 2 };
    for first in (0..BLOCK).step_by(TOGETHER) {
        let mut rows = [[Row::default(); TOGETHER]; 3];
        for i in 0..TOGETHER {
            let x = first + i;
            let of_pixel = table.rows(isa, roughness.0[x], cosine.0[x], by_cosine);
            for (row, of_pixel) in rows.iter_mut().zip(of_pixel) {
                row[i] = of_pixel;
            }
        }
        for (planes, rows) in functions.chunks_mut(VALUES).zip(&rows[..orders]) {
            for f in 0..VALUES {
                let plane = &mut planes[f].0[first..first + TOGETHER];
                for i in 0..TOGETHER {
                    plane[i] = rows[i].0[f];
                }
            }
        }
    }
}

#[inline(always)]
pub(super) fn fill_factors<T: Real, const C: usize>(
    materials: &Materials<C>,
    functions: &BlockFunctions,
    factors: &mut [ChannelFactors<T>; C],
) {
    for c in 0..C {
        let [mut diffuse, mut of_a, mut of_b] = <[Doubles; 3]>::default();
        for x in 0..BLOCK {
            let mixer = Mixer::new(materials.metallic.0[x], Surface::of(|f| functions[f].0[x]));
            let albedo = materials.albedo[c].0[x];
            let [mix, _] = mixer.mix(albedo, &mixer.metal(albedo));
            diffuse.0[x] = mix.diffuse;
            of_a.0[x] = mix.a;
            of_b.0[x] = mix.b;
        }
        for x in 0..BLOCK {
            factors[c].diffuse.0[x] = T::from_f64(diffuse.0[x]);
        }
        for j in 0..ROWS {
            let (a, b, row) = (&functions[j], &functions[ROWS + j], &mut factors[c].rows[j]);
            for x in 0..BLOCK {
                row.0[x] = T::from_f64(of_a.0[x] * a.0[x] + of_b.0[x] * b.0[x]);
            }
        }
    }
}

#[inline(always)]
pub(super) fn pull_back<const C: usize>(
    materials: &Materials<C>,
    functions: &BlockFunctions,
    sums: &[ChannelSums; C],
    scale: f64,
    gradient: &mut Materials<C>,
) {
    let (values, slopes) = functions.split_at(VALUES);
    let [mut roughness, mut metallic] = <[Doubles; 2]>::default();
    for c in 0..C {
        // Σ_j f_j g_j with a, b and their derivatives by roughness for f.
        let [mut by_a, mut by_b, mut by_a_slope, mut by_b_slope] = <[Doubles; 4]>::default();
        for x in 0..BLOCK {
            let (mut a, mut b, mut a_slope, mut b_slope) = (0.0, 0.0, 0.0, 0.0);
            for j in 0..ROWS {
                let g = f64::from(sums[c].rows[j].0[x]);
                a += values[j].0[x] * g;
                b += values[ROWS + j].0[x] * g;
                a_slope += slopes[j].0[x] * g;
                b_slope += slopes[ROWS + j].0[x] * g;
            }
            by_a.0[x] = a;
            by_b.0[x] = b;
            by_a_slope.0[x] = a_slope;
            by_b_slope.0[x] = b_slope;
        }
        let mut albedo = Doubles::default();
        for x in 0..BLOCK {
            let mixer = Mixer::new(materials.metallic.0[x], Surface::of(|f| values[f].0[x]));
            let rho = materials.albedo[c].0[x];
            let metal = mixer.metal(rho);
            let [mix, by_albedo] = mixer.mix(rho, &metal);
            let change = mixer.along(rho, &metal, &Surface::of(|f| slopes[f].0[x]));
            let by = [f64::from(sums[c].diffuse.0[x]), by_a.0[x], by_b.0[x]];
            albedo.0[x] = scale * worth(&by_albedo, by);
            metallic.0[x] += scale * worth(&mixer.by_metallic(rho, &metal), by);
            roughness.0[x] +=
                scale * (worth(&change, by) + mix.a * by_a_slope.0[x] + mix.b * by_b_slope.0[x]);
        }
        gradient.albedo[c] = albedo;
    }
    gradient.roughness = roughness;
    gradient.metallic = metallic;
}
