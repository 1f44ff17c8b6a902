//! STUB of the branch, never merged.
#![allow(missing_docs)]
use crate::shade::Material;
use std::f64::consts::{FRAC_1_PI, PI};

#[derive(Clone, Copy, Debug, Default)]
pub struct Mix {
    pub diffuse: f64,
    pub a: f64,
    pub b: f64,
}

fn ab(r: f64, x: f64, n: usize) -> (f64, f64) {
    let a = r * r;
    let s = (1.0 - x * x).max(0.0).sqrt();
    let (mut base, mut grazing) = (0.0, 0.0);
    for i in 0..n {
        let u = (i as f64 + 0.5) / n as f64;
        let t2 = a * a * u / (1.0 - u);
        let c = 1.0 / (1.0 + t2).sqrt();
        let st = (1.0 - c * c).max(0.0).sqrt();
        for k in 0..n {
            let phi = PI * (k as f64 + 0.5) / n as f64;
            let vh = s * st * phi.cos() + x * c;
            let nl = 2.0 * vh * c - x;
            if nl <= 0.0 || vh <= 0.0 {
                continue;
            }
            let v = 0.5 * nl
                / (nl * (x * x * (1.0 - a * a) + a * a).sqrt()
                    + x * (nl * nl * (1.0 - a * a) + a * a).sqrt());
            let e = v * 4.0 * vh / c / (n * n) as f64;
            let g = (1.0 - vh.min(1.0)).powi(5);
            base += e * (1.0 - g);
            grazing += e * g;
        }
    }
    (base, grazing)
}

pub fn mixes(x: f64, material: &Material) -> [Mix; 3] {
    let r = material.roughness.max(1e-8);
    let (a0, b0) = ab(r, x, 200);
    let mut mean = 0.0;
    for i in 0..20 {
        let x = (f64::from(i) + 0.5) / 20.0;
        let (a, b) = ab(r, x, 60);
        mean += 2.0 * x * (a + b) / 20.0;
    }
    let e = a0 + b0;
    let gain = |f0: f64| {
        let f = f0 + (1.0 - f0) / 21.0;
        1.0 + f * mean / (1.0 - f * (1.0 - mean)) * (1.0 - e) / e
    };
    let m = material.metallic;
    material.albedo.map(|rho| Mix {
        diffuse: (1.0 - m) * rho * (1.0 - 0.04 * a0 - b0) * FRAC_1_PI,
        a: (1.0 - m) * gain(0.04) * 0.04 + m * gain(rho) * rho,
        b: (1.0 - m) * gain(0.04) + m * gain(rho),
    })
}
