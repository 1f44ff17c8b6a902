//! Panoramas as light: what must hold whatever the table of lobes is.

use pbrfit::environment::blurred::{Blurred, COLUMNS, LEVELS};
use pbrfit::environment::lobes::{CELLS, lobes, nodes};
use pbrfit::reflectance::lobe_table;
use pbrfit::reflectance::model::Model;

const MODELS: [Model; 2] = [Model::Paper, Model::Principled];

#[test]
fn a_grey_panorama_stays_grey_in_all_levels() {
    let light = Blurred::new(&[[0.25, 1.0, 4.0]; 8], 2, 1).unwrap();
    assert_eq!(light.levels.len(), LEVELS);
    assert_eq!(light.levels[0].columns, COLUMNS);
    for grid in light.levels.iter().chain(&light.hemispheres) {
        for texel in &grid.texels {
            for (found, expected) in texel.iter().zip([0.25, 1.0, 4.0]) {
                assert!((found / expected - 1.0).abs() < 1e-6);
            }
        }
    }
}

#[test]
fn a_panorama_needs_pixels_of_its_shape() {
    let error = Blurred::new(&[[1.0; 3]; 7], 2, 1).unwrap_err().to_string();
    assert_eq!(error, "pixels: expected 8 numbers, found 7");
    assert!(Blurred::new(&[], 0, 1).is_err());
}

#[test]
fn lobes_are_nowhere_negative_and_continuous_across_nodes() {
    for model in MODELS {
        assert_eq!(nodes(model).len(), (CELLS[0] + 1) * (CELLS[1] + 1));
        for node in nodes(model) {
            for lobe in node.as_chunks::<4>().0 {
                assert!(lobe[2] >= 0.0 && lobe[3] >= 0.0, "{lobe:?}");
                assert!((0.0..=(LEVELS - 1) as f32).contains(&lobe[1]), "{lobe:?}");
            }
        }
        for cell in 1..CELLS[0] {
            let r = cell as f64 / CELLS[0] as f64;
            for x in [1e-4, 0.03, 0.3, 1.0] {
                for (below, above) in
                    lobes(model, r - 1e-9, x)
                        .iter()
                        .zip(lobes(model, r + 1e-9, x))
                {
                    assert!((below.angle - above.angle).abs() < 1e-6);
                    assert!((below.base - above.base).abs() < 1e-6);
                }
            }
        }
    }
}

#[test]
fn the_principled_lobes_reflect_what_its_table_of_energies_says() {
    for r in [0.1, 0.25, 0.4, 0.55, 0.7, 0.85, 1.0] {
        for x in [0.16f64, 0.36, 0.64, 1.0] {
            let found = lobes(Model::Principled, r, x);
            let [values, _, _] = lobe_table::values(r, x);
            let uniform = 2.0 * std::f64::consts::PI.sqrt();
            let base: f64 = found.iter().map(|lobe| lobe.base).sum();
            let grazing: f64 = found.iter().map(|lobe| lobe.grazing).sum();
            assert!((base - uniform * values[0]).abs() < 6e-3, "{r} {x}: {base}");
            assert!(
                (grazing - uniform * values[10]).abs() < 6e-3,
                "{r} {x}: {grazing}"
            );
        }
    }
}
