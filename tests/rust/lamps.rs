//! Light of lamps: slopes against values alone, and physics.

use super::Numbers;
use glam::{DQuat, DVec3};
use pbrfit::lamps::surface::{Reflected, Surface};
use pbrfit::reflectance::ggx::MIN_COSINE;
use pbrfit::reflectance::model::Model;
use pbrfit::reflectance::planes::Material;

const MODELS: [Model; 2] = [Model::Paper, Model::Principled];

/// df/dt at 0 by Ridders' method: central quotients extrapolated to step 0, for each entry the
/// extrapolation that changes least.
fn ridders(step: f64, f: impl Fn(f64) -> [f64; 3]) -> [f64; 3] {
    let (mut best, mut error) = ([0.0; 3], [f64::INFINITY; 3]);
    let mut previous: Vec<[f64; 3]> = Vec::new();
    for level in 0..8 {
        let h = step / f64::from(1 << level);
        let (high, low) = (f(h), f(-h));
        let mut row = vec![[0, 1, 2].map(|c| (high[c] - low[c]) / (2.0 * h))];
        for (order, coarse) in previous.iter().enumerate() {
            let power = 4_f64.powi(order as i32 + 1);
            row.push([0, 1, 2].map(|c| (power * row[order][c] - coarse[c]) / (power - 1.0)));
        }
        for order in 1..row.len() {
            for c in 0..3 {
                let change = (row[order][c] - row[order - 1][c]).abs();
                let change = change.max((row[order][c] - previous[order - 1][c]).abs());
                if change < error[c] {
                    (best[c], error[c]) = (row[order][c], change);
                }
            }
        }
        previous = row;
    }
    best
}

/// A surface under a lamp.
#[derive(Clone, Copy, Debug)]
struct Sight {
    model: Model,
    normal: DVec3,
    view: DVec3,
    light: DVec3,
    material: Material,
}

fn sight(model: Model, [normal, view, light]: [DVec3; 3], material: Material) -> Sight {
    Sight {
        model,
        normal,
        view,
        light,
        material,
    }
}

fn material(albedo: [f64; 3], roughness: f64, metallic: f64) -> Material {
    Material {
        albedo,
        roughness,
        metallic,
    }
}

impl Sight {
    fn radiance(&self) -> [f64; 3] {
        let surface = Surface::<false>::new(self.model, self.normal, self.view, &self.material);
        surface.reflected(self.light).radiance
    }

    fn slopes(&self) -> Reflected {
        let surface = Surface::<true>::new(self.model, self.normal, self.view, &self.material);
        surface.reflected(self.light)
    }

    /// A length over which radiance changes: of directions, beside the edges that n·l and n·v have.
    fn scale(&self) -> f64 {
        let alpha = self.material.roughness * self.material.roughness;
        let n_dot_v = self.normal.dot(self.view);
        alpha
            .min(self.normal.dot(self.light))
            .min((n_dot_v - MIN_COSINE).abs().max(1e-7))
    }

    fn check(&self) {
        let slopes = self.slopes();
        assert_eq!(slopes.radiance, self.radiance(), "{self:?}");
        let near = |what: &str, found: [f64; 3], step: f64, f: &dyn Fn(f64) -> Sight| {
            let expected = ridders(step, |t| f(t).radiance());
            for c in 0..3 {
                // Relative to the slope, or to the change over a step where it is next to nothing.
                let size = expected[c].abs().max(1e-3 * self.radiance()[c] / step);
                // Written so that NaN fails.
                assert!(
                    (found[c] - expected[c]).abs() <= 1e-6 * size,
                    "by {what}: {} is not {} of {self:?}",
                    found[c],
                    expected[c]
                );
            }
        };
        let step = 0.05 * self.scale();
        for tangent in tangents(self.normal) {
            near("normal", slopes.along(tangent), step, &|t| Sight {
                normal: (self.normal + t * tangent).normalize(),
                ..*self
            });
        }
        for tangent in tangents(self.light) {
            let found = [0, 1, 2].map(|c| DVec3::from(slopes.by_direction()[c]).dot(tangent));
            near("direction", found, step, &|t| Sight {
                light: (self.light + t * tangent).normalize(),
                ..*self
            });
        }
        for c in 0..3 {
            assert!(
                DVec3::from(slopes.by_direction()[c]).dot(self.light).abs()
                    < 1e-9 * (1.0 + 1.0 / step)
            );
        }
        let with = |change: &dyn Fn(&mut Material)| {
            let mut changed = *self;
            change(&mut changed.material);
            changed
        };
        // A channel sees its own albedo alone.
        near("albedo", slopes.by_albedo, 0.01, &|t| {
            with(&|material| material.albedo = material.albedo.map(|rho| rho + t))
        });
        near("metallic", slopes.by_metallic, 0.01, &|t| {
            with(&|material| material.metallic += t)
        });
        near(
            "roughness",
            slopes.by_roughness,
            0.02 * self.material.roughness,
            &|t| with(&|material| material.roughness += t),
        );
    }
}

fn tangents(direction: DVec3) -> [DVec3; 2] {
    let first = direction.any_orthonormal_vector();
    // Neither is an axis.
    let turned = DQuat::from_axis_angle(direction, 0.7) * first;
    [turned, direction.cross(turned)]
}

#[test]
fn slopes_are_those_of_the_values() {
    let mut numbers = Numbers(1);
    for model in MODELS {
        for _ in 0..100 {
            let normal = numbers.direction();
            let view = numbers.direction_over(normal, 0.05);
            let light = numbers.direction_over(normal, 0.05);
            sight(model, [normal, view, light], numbers.material()).check();
        }
    }
}

#[test]
fn slopes_hold_in_the_lobe() {
    let mut numbers = Numbers(2);
    for model in MODELS {
        for _ in 0..60 {
            let normal = numbers.direction();
            let view = numbers.direction_over(normal, 0.2);
            let material = numbers.material();
            let width = material.roughness * material.roughness;
            let mirror = 2.0 * normal.dot(view) * normal - view;
            let light = (mirror + width * numbers.direction()).normalize();
            if normal.dot(light) >= 0.05 {
                sight(model, [normal, view, light], material).check();
            }
        }
    }
}

#[test]
fn slopes_hold_at_the_borders_of_the_formulas() {
    let normal = DVec3::Z;
    let at = |cosine: f64, azimuth: f64| {
        let sine = (1.0 - cosine * cosine).sqrt();
        DVec3::new(sine * f64::cos(azimuth), sine * f64::sin(azimuth), cosine)
    };
    // n·v and n·l in turn: grazing, on both sides of the clamp of n·v, from behind, head on.
    let cosines = [
        (0.5, 1e-3),
        (0.5, 1e-6),
        (2e-4, 0.3),
        (1.1 * MIN_COSINE, 0.3),
        (0.9 * MIN_COSINE, 0.3),
        (-0.3, 0.5),
        (1e-3, 1e-3),
        (1.0, 0.4),
        (0.4, 1.0),
    ];
    for model in MODELS {
        for (n_dot_v, n_dot_l) in cosines {
            for roughness in [0.05, 0.4, 1.0] {
                for (metallic, albedo) in [(0.0, 0.0), (0.0, 1.0), (1.0, 0.0), (1.0, 1.0)] {
                    let vectors = [normal, at(n_dot_v, 0.4), at(n_dot_l, 2.9)];
                    let material = material([albedo, 0.3, 0.8], roughness, metallic);
                    sight(model, vectors, material).check();
                }
            }
        }
        // The lamp beside the camera, and the middle of the lobe, whose slopes by directions are 0.
        for (n_dot_v, azimuth) in [(0.6, 0.0), (0.6, std::f64::consts::PI)] {
            for roughness in [0.05, 1.0] {
                let vectors = [normal, at(n_dot_v, 0.4), at(n_dot_v, 0.4 + azimuth)];
                sight(model, vectors, material([0.2, 0.5, 0.9], roughness, 0.5)).check();
            }
        }
    }
}

#[test]
fn turning_surface_and_lamp_about_the_view_changes_nothing() {
    let mut numbers = Numbers(5);
    for model in MODELS {
        for _ in 0..100 {
            let normal = numbers.direction();
            let view = numbers.direction_over(normal, 0.0);
            let light = numbers.direction_over(normal, 0.0);
            let slopes = sight(model, [normal, view, light], numbers.material()).slopes();
            for c in 0..3 {
                let by_direction = DVec3::from(slopes.by_direction()[c]);
                let by_normal = slopes.along(view.cross(normal))[c];
                let change = by_normal + by_direction.dot(view.cross(light));
                let size = slopes.radiance[c] + by_normal.abs() + by_direction.length();
                assert!(change.abs() <= 1e-10 * size, "{change} beside {size}");
            }
        }
    }
}

#[test]
fn slopes_are_finite_everywhere() {
    let directions = [
        DVec3::Z,
        DVec3::X,
        -DVec3::Z,
        DVec3::new(1.0, 0.0, 1e-308).normalize(),
        DVec3::new(-1.0, 0.0, 3e-308).normalize(),
        DVec3::new(1e-17, 0.0, 1.0),
        DVec3::new(0.6, 0.0, 0.8),
        DVec3::new(-1.0, 1e-16, 1e-15),
        DVec3::new(-0.6, 0.0, 0.8),
    ];
    for model in MODELS {
        for view in directions {
            for light in directions {
                for roughness in [0.0, 5e-324, 1e-154, 1e-80, 1e-16, 1e-8, 1e-3, 1.0] {
                    let of_gray = material([0.0, 0.5, 1.0], roughness, 0.5);
                    let slopes = sight(model, [DVec3::Z, view, light], of_gray).slopes();
                    let by = [slopes.by_albedo, slopes.by_roughness, slopes.by_metallic];
                    for c in 0..3 {
                        let scalars = [slopes.radiance[c], by[0][c], by[1][c], by[2][c]];
                        let turned = [DVec3::X, DVec3::Y].map(|turned| slopes.along(turned)[c]);
                        assert!(
                            scalars.iter().chain(&turned).all(|x| x.is_finite())
                                && DVec3::from(slopes.by_direction()[c]).is_finite(),
                            "{view} {light} {roughness}: {slopes:?}"
                        );
                    }
                }
            }
        }
    }
}
