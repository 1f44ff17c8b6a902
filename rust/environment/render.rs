//! Many pixels under a panorama.

use std::f64::consts::PI;

use glam::DVec3;

use super::blurred::Blurred;
use super::lobes::{LOBES, lobes};
use crate::problem::render::pictures;
use crate::reflectance::ggx::{DIELECTRIC_F0, MIN_COSINE};
use crate::reflectance::lobe_table;
use crate::reflectance::model::Model;
use crate::reflectance::planes::Material;
use crate::reflectance::principled::{self, Mixer};
use crate::runtime::{Result, check};

/// Pixels in a piece of work.
const PIECE: usize = 1024;

/// Radiance of every pixel: (pixel, channel).
///
/// With the lobes of [`super::lobes`], L_k the panorama at d_k with blur λ_k, and E its irradiance,
///
/// ```text
/// I = kd E(n) + Σ_k (A a_k + B b_k) L_k
/// paper:       A = F0, B = 1             kd = (1 − F0)(1 − s)(1 − m) ρ/π
/// principled:  A = (1−m) 0.04 G + m M ρ  B = (1−m) G + m M         kd as for light of harmonics
/// ```
///
/// where s is the mean over light from everywhere of (1−v·h)⁵, [`mean_schlick`].
///
/// The light is turned by `turn` radians about +Y, from +Z towards +X. `threads` = 0 means one for
/// each processor; the result does not depend on it.
pub fn render_environment(
    normals: &[DVec3],
    views: &[DVec3],
    materials: &[Material],
    light: &Blurred,
    turn: f64,
    threads: usize,
    model: Model,
) -> Result<Vec<f64>> {
    let pixels = check::pixels(normals, views, materials.len())?;
    let (sine, cosine) = turn.sin_cos();
    // A direction is looked up where it was before the turn.
    let back = |d: DVec3| DVec3::new(cosine * d.x - sine * d.z, d.y, sine * d.x + cosine * d.z);
    pictures(1, pixels, PIECE, threads, |first, parts| {
        for (i, pixel) in parts[0].as_chunks_mut::<3>().0.iter_mut().enumerate() {
            let p = first + i;
            *pixel = reflected(normals[p], views[p], &materials[p], light, &back, model);
        }
    })
}

/// ∫ (1−v·h)⁵ (n·l) dl/π over the hemisphere, by x = n·v: a polynomial in 1 − x, fitted to
/// quadrature, off by at most 8·10⁻⁶.
fn mean_schlick(x: f64) -> f64 {
    let t = 1.0 - x.min(1.0);
    8.233e-5 + t * (2.0221e-3 + t * (9.30996e-3 + t * (7.79715e-3 + t * 8.95196e-3)))
}

fn reflected(
    normal: DVec3,
    view: DVec3,
    material: &Material,
    light: &Blurred,
    back: &impl Fn(DVec3) -> DVec3,
    model: Model,
) -> [f64; 3] {
    let facing = normal.dot(view);
    let n_dot_v = facing.max(MIN_COSINE);
    // Away from the viewer, in the plane of normal and view.
    let away = facing * normal - view;
    let away = away.try_normalize().unwrap_or(DVec3::ZERO);
    let mirror = facing.clamp(-1.0, 1.0).acos();
    let hemispheres = light.hemispheres(back(normal));
    let matt = hemispheres[1];
    let of_lobes = lobes(model, material.roughness, n_dot_v);
    let (mut base, mut grazing) = ([0.0; 3], [0.0; 3]);
    for (k, lobe) in of_lobes.iter().enumerate() {
        let radiance = if k >= LOBES - 2 {
            hemispheres[k + 2 - LOBES]
        } else {
            let (sine, cosine) = (mirror + lobe.angle).sin_cos();
            let direction = sine * away + cosine * normal;
            light.radiance(back(direction), lobe.level)
        };
        for c in 0..3 {
            base[c] += lobe.base * radiance[c];
            grazing[c] += lobe.grazing * radiance[c];
        }
    }
    let m = material.metallic;
    match model {
        Model::Paper => {
            let transmitted = 1.0 - mean_schlick(n_dot_v);
            [0, 1, 2].map(|c| {
                let rho = material.albedo[c];
                let f0 = DIELECTRIC_F0 * (1.0 - m) + m * rho;
                let body = (1.0 - f0) * transmitted * (1.0 - m) * rho;
                body * matt[c] + f0 * base[c] + grazing[c]
            })
        }
        Model::Principled => {
            let [values, _, _] = lobe_table::values(material.roughness, n_dot_v);
            let mixer = Mixer::new(m, principled::Surface::of(|f| values[f]));
            [0, 1, 2].map(|c| {
                let rho = material.albedo[c];
                let [mix, _] = mixer.mix(rho, &mixer.metal(rho));
                PI * mix.diffuse * matt[c] + mix.a * base[c] + mix.b * grazing[c]
            })
        }
    }
}
