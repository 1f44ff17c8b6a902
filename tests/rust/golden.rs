//! Bands and whole pixels against 25-digit values (tests/data, made by make_golden.py).

use std::fs;
use std::path::Path;

use glam::DVec3;
use pbrfit::reflectance::ggx;
use pbrfit::reflectance::paper::Paper;
use pbrfit::reflectance::planes::Material;
use pbrfit::reflectance::shade::{Frame, shade, shade_vjp};
use serde_json::Value;

fn golden(name: &str, list: &str) -> Vec<Value> {
    let path = Path::new(env!("CARGO_MANIFEST_DIR"))
        .join("tests/data")
        .join(name);
    let content: Value = serde_json::from_str(&fs::read_to_string(path).unwrap()).unwrap();
    content[list].as_array().unwrap().clone()
}

/// A decimal string or number, or nested lists of them, flattened.
fn numbers(value: &Value) -> Vec<f64> {
    match value {
        Value::Array(values) => values.iter().flat_map(numbers).collect(),
        Value::String(text) => vec![text.parse().unwrap()],
        other => vec![other.as_f64().unwrap()],
    }
}

#[track_caller]
fn assert_close(what: &str, found: &[f64], expected: &[f64], tolerance: f64) {
    assert_eq!(found.len(), expected.len(), "{what}");
    for (i, (f, e)) in found.iter().zip(expected).enumerate() {
        // Written so that NaN fails.
        assert!(
            (f - e).abs() <= tolerance,
            "{what}[{i}]: {f} is not {e}, off by {:e}",
            f - e
        );
    }
}

#[test]
fn bands_and_slopes() {
    for row in golden("bands.json", "rows") {
        let r = row["r"].as_f64().unwrap();
        let found = ggx::bands(r);
        assert_close(
            &format!("h({r})"),
            &found.weight,
            &numbers(&row["h"]),
            1e-14,
        );
        assert_close(
            &format!("dh/dr({r})"),
            &found.slope,
            &numbers(&row["dh_dr"]),
            5e-14,
        );
    }
}

#[test]
fn weights_radiance_and_derivatives() {
    for case in golden("shading.json", "cases") {
        let get = |key: &str| numbers(&case[key]);
        let vector = |key: &str| DVec3::from_slice(&get(key));
        let material = Material {
            albedo: get("albedo").try_into().unwrap(),
            roughness: get("roughness")[0],
            metallic: get("metallic")[0],
        };
        let (normal, view) = (vector("normal"), vector("view"));
        let close = |what: &str, found: &[f64], expected: &[f64]| {
            let largest = expected.iter().fold(1.0_f64, |a, b| a.max(b.abs()));
            assert_close(
                &format!("{what} of {material:?}"),
                found,
                expected,
                1e-12 * largest,
            );
        };
        let weights = shade(&Frame::<Paper>::new(normal, view), &material);
        close("weights", weights.as_flattened(), &get("weights"));

        let lighting = get("lighting"); // (coefficient, channel)
        let mut by_albedo = [0.0; 3];
        let mut by_roughness = [0.0; 3];
        let mut by_metallic = [0.0; 3];
        let mut by_normal = [[0.0; 3]; 3];
        let mut radiance = [0.0; 3];
        for c in 0..3 {
            // The derivatives of I_c by the weights are the light of channel c.
            let mut cotangent = [[0.0; 16]; 3];
            for k in 0..16 {
                cotangent[c][k] = lighting[k * 3 + c];
                radiance[c] += weights[c][k] * lighting[k * 3 + c];
            }
            let (gradient, of_normal) = shade_vjp::<Paper, 3>(normal, view, &material, &cotangent);
            by_albedo[c] = gradient.albedo[c];
            by_roughness[c] = gradient.roughness;
            by_metallic[c] = gradient.metallic;
            by_normal[c] = of_normal.to_array();
        }
        close("radiance", &radiance, &get("radiance"));
        close("d_albedo", &by_albedo, &get("d_albedo"));
        close("d_roughness", &by_roughness, &get("d_roughness"));
        close("d_metallic", &by_metallic, &get("d_metallic"));
        // Not stated where rounding decides on which side of the clamp n·v is.
        if !case["d_normal"].is_null() {
            close("d_normal", by_normal.as_flattened(), &get("d_normal"));
        }
    }
}
