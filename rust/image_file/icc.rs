//! ICC profiles: the curves and the matrix they stand for.

use std::path::Path;

use moxcms::{ColorProfile, DataColorSpace, ParametricCurve, ToneReprCurve};

use super::{content, guarded};
use crate::runtime::Result;

/// A profile of the matrix-and-curves kind, or of grey.
#[derive(Clone, Debug, PartialEq)]
pub struct IccProfile {
    /// Linear light of the levels 0, 1/(n-1), ..., 1: one curve of a grey
    /// profile, else those of red, green and blue.
    pub curves: Vec<Vec<f32>>,
    /// Linear RGB to CIE XYZ under D50, the profile connection space; `None` of a grey profile.
    pub to_xyz: Option<[[f64; 3]; 3]>,
}

/// Evaluates the curves of a profile at `levels` evenly spaced levels. A
/// profile that also has lookup tables is used by its curves and matrix.
///
/// # Errors
/// [`crate::Error::Content`] for a damaged profile and for one that is not a
/// grey or an RGB profile made of curves and a matrix (CMYK, Lab, tables only).
pub fn decode_icc(profile: &[u8], levels: usize, path: &Path) -> Result<IccProfile> {
    guarded(path, || {
        let advice = "convert the picture to sRGB or give its colour space";
        let refused = |found: String| {
            let reason = format!("expected a usable ICC profile, found {found}: {advice}");
            content(path, reason)
        };
        let profile = ColorProfile::new_from_slice(profile)
            .map_err(|error| refused(format!("a damaged one ({error})")))?;
        if profile.pcs != DataColorSpace::Xyz {
            let found = format!("one that connects through {:?}", profile.pcs);
            return Err(refused(found));
        }
        let curve = |curve: &Option<ToneReprCurve>| {
            let last = levels.max(2) - 1;
            let linear = |level: usize| evaluate(curve.as_ref()?, level as f64 / last as f64);
            (0..=last)
                .map(|level| linear(level).map(|value| value as f32))
                .collect()
        };
        let (curves, to_xyz) = match profile.color_space {
            DataColorSpace::Gray => (vec![curve(&profile.gray_trc)], None),
            DataColorSpace::Rgb if profile.is_matrix_shaper() => {
                let curves = [&profile.red_trc, &profile.green_trc, &profile.blue_trc];
                (curves.map(curve).into(), Some(profile.colorant_matrix().v))
            }
            DataColorSpace::Rgb => return Err(refused("one made of lookup tables only".into())),
            other => return Err(refused(format!("one for {other:?} pictures"))),
        };
        let curves: Option<Vec<Vec<f32>>> = curves.into_iter().collect();
        let curves = curves.ok_or_else(|| refused("one without a usable tone curve".into()))?;
        Ok(IccProfile { curves, to_xyz })
    })
}

/// Linear light is 0 to 1. Beyond this a curve is none, and a matrix of the largest
/// numbers that profiles can hold would overflow on it.
const LARGEST: f64 = 1e6;

/// Linear light at `x` in [0, 1] (ICC.1:2022, 10.6 and 10.18), or `None` if the curve has no value
/// there. In double precision: the evaluators of `moxcms` 0.8 use a fast power that is -4 at 0.
fn evaluate(curve: &ToneReprCurve, x: f64) -> Option<f64> {
    let value = match curve {
        ToneReprCurve::Lut(table) => match table.as_slice() {
            [] => x,
            [gamma] => x.powf(f64::from(*gamma) / 256.0),
            table => {
                let position = x * (table.len() - 1) as f64;
                let below = (position as usize).min(table.len() - 2);
                let [low, high] = [table[below], table[below + 1]].map(f64::from);
                (low + (high - low) * (position - below as f64)) / 65535.0
            }
        },
        ToneReprCurve::Parametric(parameters) => {
            let p = ParametricCurve::new(parameters)?;
            let [g, a, b, c, d, e, f] = [p.g, p.a, p.b, p.c, p.d, p.e, p.f].map(f64::from);
            if x >= d {
                (a * x + b).max(0.0).powf(g) + e
            } else {
                c * x + f
            }
        }
    };
    (value.abs() <= LARGEST).then_some(value) // NaN is not
}
