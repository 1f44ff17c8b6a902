//! Of what `transport/table` keeps to itself.

use super::*;
use crate::reflectance::lobe_table;
use crate::reflectance::planes::Material;
use crate::reflectance::reflection::Factors;
use crate::reflectance::shade::{factors_at, shade};
use crate::transport::tests::Numbers;

const MODELS: [Model; 2] = [Model::Paper, Model::Principled];

type Corners = [[[f32; 3]; 3]; 2];

/// A square of `half` its side about a middle.
fn square(middle: [f32; 3], u: [f32; 3], v: [f32; 3]) -> Corners {
    let [middle, u, v] = [middle, u, v].map(Vec3A::from);
    let [a, b, c, d] = [-u - v, u - v, u + v, v - u].map(|side| (middle + side).to_array());
    [[a, b, c], [a, c, d]]
}

/// A cube of 2 about the origin, each face a surface from number 1 on.
fn cube() -> Surroundings {
    let mut triangles = Vec::new();
    for axis in 0..3 {
        for side in [-1.0, 1.0] {
            let turned = |by: usize, size: f32| {
                let mut vector = [0.0; 3];
                vector[(axis + by) % 3] = size;
                vector
            };
            triangles.extend(square(turned(0, side), turned(1, 1.0), turned(2, 1.0)));
        }
    }
    let surfaces: Vec<u8> = (0..12).map(|i| 1 + i / 2).collect();
    Surroundings::new(&triangles, &surfaces).unwrap()
}

fn picture<'a>(size: [usize; 2], samples: &'a [f32], nearest: &'a [u32]) -> Radiance<'a> {
    Radiance {
        samples,
        size,
        half_width: 0.5,
        nearest,
    }
}

fn nothing() -> Surroundings {
    Surroundings::new(&[], &[]).unwrap()
}

struct Pixels {
    points: Vec<DVec3>,
    normals: Vec<DVec3>,
    views: Vec<DVec3>,
    seeds: Vec<u64>,
}

impl Pixels {
    /// Within the cube, seen at up to so many degrees.
    fn new(count: usize, degrees: f32) -> Self {
        let mut numbers = Numbers(9);
        let mut found = Self {
            points: Vec::new(),
            normals: Vec::new(),
            views: Vec::new(),
            seeds: (0..count as u64).map(|i| 1000 + 7 * i).collect(),
        };
        for _ in 0..count {
            let point = std::array::from_fn(|_| f64::from(0.6 * numbers.signed()));
            let normal = numbers.direction();
            let (x, y) = normal.any_orthonormal_pair();
            let (sin, cos) = (degrees * numbers.next()).to_radians().sin_cos();
            let (across, along) = (std::f32::consts::TAU * numbers.next()).sin_cos();
            let view = cos * normal + sin * (along * x + across * y);
            found.points.push(DVec3::from(point));
            found.normals.push(normal.as_dvec3().normalize());
            found.views.push(view.as_dvec3().normalize());
        }
        found
    }

    fn origins(&self) -> Origins<'_> {
        Origins {
            points: &self.points,
            normals: &self.normals,
            views: &self.views,
            seeds: &self.seeds,
        }
    }

    fn transfer(&self, surroundings: &Surroundings, model: Model, rays: usize) -> Transfer {
        transfer(surroundings, self.origins(), model, rays, None, 1).unwrap()
    }

    /// Radiance of a pixel under uniform light of radiance 1, with rows of a transfer: of a
    /// white surface and one that is a metal. And as in the open.
    fn radiance<M: Reflection>(&self, found: &Transfer, p: usize, roughness: f64) -> [[f64; 2]; 2] {
        let frame = Frame::<M>::new(self.normals[p], self.views[p]);
        [0.0, 1.0].map(|metallic| {
            let material = Material {
                albedo: [0.8],
                roughness,
                metallic,
            };
            let factors = factors_at(&frame, &material);
            let y = 4.0 * std::f64::consts::PI; // of Y_0 for a light of 1
            let rows = found.rows_of::<M>(p);
            let blocked: f64 = (0..=M::ROWS)
                .map(|s| {
                    let factor = match s {
                        0 => factors.diffuse(0),
                        s => factors.row(0, s - 1),
                    };
                    factor * f64::from(rows[s][0])
                })
                .sum();
            [blocked, shade(&frame, &material)[0][0]].map(|w| w * y.sqrt())
        })
    }
}

#[test]
fn with_nothing_about_rows_are_those_of_the_model() {
    let pixels = Pixels::new(150, 100.0);
    for model in MODELS {
        let found = pixels.transfer(&nothing(), model, 2048);
        let none = Pixels::new(0, 0.0).transfer(&cube(), model, 64);
        assert!(none.rows.is_empty());
        with_model!(model, M => for p in 0..150 {
            let open = Frame::<M>::new(pixels.normals[p], pixels.views[p]);
            let mut expected = vec![[0.0; COEFFICIENTS]; 1 + M::ROWS];
            expected[0] = open.diffuse.map(|y| y as f32);
            each_entry::<M, COEFFICIENTS>(|k, row, entry| {
                expected[1 + row][k] = open.lobe[entry] as f32;
            });
            assert_eq!(found.rows_of::<M>(p), expected);
        });
    }
}

/// The least squares are exact in a closed box, for every lobe is: what is left is the rays' noise,
/// which falls as their number grows.
#[test]
fn what_is_left_in_a_closed_box_is_the_rays_noise() {
    let pixels = Pixels::new(25, 60.0);
    let left = |rays: usize| {
        let found = pixels.transfer(&cube(), Model::Principled, rays);
        let squares: f64 = (0..25)
            .flat_map(|p| with_model!(Model::Principled, M => pixels.radiance::<M>(&found, p, 0.5)))
            .map(|[left, _]| left * left)
            .sum();
        squares.sqrt()
    };
    let (few, many) = (left(300), left(15_000));
    assert!(many < 0.15 * few, "{few}, then {many}");
}

/// A wall that hides all with x > 0 from a floor leaves the matt row of half of the sky, by
/// quadrature.
#[test]
fn a_long_wall_hides_half_of_the_sky() {
    let wall = square([1e-2, 0.0, 0.0], [0.0, 50.0, 0.0], [0.0, 0.0, 50.0]);
    let surroundings = Surroundings::new(&wall, &[0, 0]).unwrap();
    let pixels = Pixels {
        points: vec![DVec3::new(0.0, 0.0, 1e-4)],
        normals: vec![DVec3::Z],
        views: vec![DVec3::new(-0.6, 0.0, 0.8)],
        seeds: vec![4],
    };
    let mut expected = [0.0; COEFFICIENTS];
    const POLAR: usize = 200;
    const AROUND: usize = 400;
    for i in 0..POLAR {
        // dω n·ω = ½ d(z²) dφ
        let z2 = (i as f64 + 0.5) / POLAR as f64;
        for j in 0..AROUND {
            let turn = std::f64::consts::TAU * (j as f64 + 0.5) / AROUND as f64;
            let (sin, cos) = turn.sin_cos();
            if cos > 0.0 {
                continue;
            }
            let radius = (1.0 - z2).sqrt();
            let y = sh::basis([radius * cos, radius * sin, z2.sqrt()]);
            let area = std::f64::consts::PI / (POLAR * AROUND) as f64;
            for k in 0..COEFFICIENTS {
                expected[k] += area * y[k];
            }
        }
    }
    for model in MODELS {
        let found = pixels.transfer(&surroundings, model, 10_000);
        for k in 0..COEFFICIENTS {
            let row = f64::from(found.rows[k]);
            assert!(
                (row - expected[k]).abs() < 2e-3,
                "{model:?}: {row} at {k}, expected {}",
                expected[k]
            );
        }
    }
}

/// A wall in the mirror direction hides a narrow lobe and no matt light to speak of; one at its
/// side does not touch the lobe.
#[test]
fn a_small_screen_hides_what_is_mirrored_there() {
    let view = DVec3::new(-0.6, 0.0, 0.8);
    let pixels = Pixels {
        points: vec![DVec3::ZERO],
        normals: vec![DVec3::Z],
        views: vec![view],
        seeds: vec![0],
    };
    let screen = |x: f32| {
        let wall = square([x, 0.0, 8.0], [3.0, 0.0, 0.0], [0.0, 3.0, 0.0]);
        Surroundings::new(&wall, &[0, 0]).unwrap()
    };
    for model in MODELS {
        let share = |surroundings: &Surroundings| {
            let found = pixels.transfer(surroundings, model, 8192);
            let [_, [left, open]] = with_model!(model, M => pixels.radiance::<M>(&found, 0, 0.15));
            left / open
        };
        let (hidden, beside) = (share(&screen(6.0)), share(&screen(-6.0)));
        assert!(hidden.abs() < 0.1, "{model:?}: {hidden}");
        assert!((beside - 1.0).abs() < 0.03, "{model:?}: {beside}");
    }
}

/// Twice as bright pictures bring twice as much, and the sum of two the sum.
#[test]
fn what_is_brought_is_linear_in_the_pictures() {
    let pixels = Pixels::new(10, 60.0);
    let mut numbers = Numbers(2);
    let samples: Vec<f32> = (0..16)
        .flat_map(|_| {
            let (a, b) = (numbers.next(), numbers.next());
            [a, b, a + b, 2.0 * a]
        })
        .collect();
    let nearest: Vec<u32> = (0..6 * 16).map(|i| i % 16).collect();
    let given = picture([4, 4], &samples, &nearest);
    for model in MODELS {
        let found = transfer(&cube(), pixels.origins(), model, 500, Some(given), 1).unwrap();
        for of_row in found.bounced.chunks(4) {
            let [a, b, sum, twice] = of_row.try_into().unwrap();
            assert!((a + b - sum).abs() < 1e-4 * (1.0 + a.abs() + b.abs()));
            assert!((2.0 * a - twice).abs() < 1e-4 * (1.0 + a.abs()));
        }
    }
}

#[test]
fn points_are_looked_up_where_they_are_seen() {
    // Two rows, four columns; each pixel shows its own number.
    let samples: Vec<f32> = (0..8).map(|i| i as f32).collect();
    // Surface 1 is shown by pixel 5 alone; surface 2 by 0 and 3.
    let nearest = [[5; 8], [0, 0, 3, 3, 0, 0, 3, 3]].concat();
    let shows = |half_width: f32, point: [f32; 3], surface: u8| {
        let given = picture([2, 4], &samples, &nearest);
        let given = Radiance {
            half_width,
            ..given
        };
        given.at(Vec3A::from(point), surface)[0]
    };
    shows(0.5, [0.0; 3], 0); // at the camera itself: some pixel
    for (half_width, point, surface, expected) in [
        // At depth 2 a picture of half width 0.5 spans x from -1 to 1, and y from -0.5 to 0.5.
        (0.5, [-0.9, 0.4, -2.0], 0, 0.0),
        (0.5, [-0.3, 0.4, -2.0], 0, 1.0),
        (0.5, [0.3, 0.1, -2.0], 0, 2.0),
        (0.5, [0.9, 0.4, -2.0], 0, 3.0),
        (0.5, [-0.9, -0.4, -2.0], 0, 4.0),
        (0.5, [0.9, -0.1, -2.0], 0, 7.0),
        (0.5, [9.0, 0.1, -2.0], 0, 3.0), // beyond the edge
        (0.5, [0.3, -9.0, -2.0], 0, 6.0),
        // Behind the camera: the edge in the point's direction.
        (0.5, [-5.0, 0.1, 2.0], 0, 0.0),
        (0.5, [5.0, 0.1, 2.0], 0, 3.0),
        (0.5, [5.0, -0.1, 0.0], 0, 7.0),
        (0.5, [0.2, 5.0, 2.0], 0, 2.0),
        (0.5, [0.2, -5.0, 2.0], 0, 6.0),
        // Orthographic: x from -1 to 1 whatever the depth.
        (0.0, [-0.9, 0.4, -7.0], 0, 0.0),
        (0.0, [0.9, -0.4, 7.0], 0, 7.0),
        // Surfaces that another pixel shows.
        (0.5, [0.9, 0.4, -2.0], 1, 5.0),
        (0.5, [-0.9, 0.4, -2.0], 2, 0.0),
        (0.5, [0.9, -0.4, -2.0], 2, 3.0),
    ] {
        let found = shows(half_width, point, surface);
        assert_eq!(found, expected, "{point:?} on {surface}");
    }
}

/// The functions that the least squares take are those of the model's factors: a₀ and b₀ of the
/// table are what its first row integrates to.
#[test]
fn the_lobes_of_rays_are_those_of_the_table() {
    let view = DVec3::new(-0.6, 0.0, 0.8);
    let [normal, toward] = [DVec3::Z, view].map(|v| v.as_vec3a());
    let rays = Rays::new(normal, toward, 60_000, 0);
    for roughness in [0.3, 0.6, 1.0] {
        let [values, _, _] = lobe_table::values(roughness, 0.8);
        let mut sums = [0.0; 2];
        rays.each(|direction, weight| {
            let half = (toward + direction).normalize();
            let schlick = (1.0 - toward.dot(half)).powi(5);
            let lobe = weight
                * super::super::dual::principled(
                    roughness as f32,
                    normal.dot(half),
                    normal.dot(direction),
                    0.8,
                );
            sums[0] += f64::from(lobe * (1.0 - schlick));
            sums[1] += f64::from(lobe * schlick);
        });
        let uniform = (4.0 * std::f64::consts::PI).sqrt();
        for (sum, value) in sums.iter().zip([values[0], values[10]]) {
            let expected = uniform * value;
            let holds = (sum - expected).abs() < 0.01 * expected;
            assert!(holds, "roughness {roughness}: {sum}, expected {expected}");
        }
    }
}
