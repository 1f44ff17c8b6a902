//! Penalties on a map of one number a pixel: their values, and gradients added to what is there.
//!
//! Both run on one thread: they read and write each number once or twice, and take a small share of
//! an evaluation.

use crate::runtime::simd::{Instructions, Isa, Kernel};
use crate::runtime::{Error, Result, check};

/// Pairs of a run that are handled at once: their numbers stay in the fastest cache.
const PIECE: usize = 512;
/// Parts that a sum is kept in, which the compiler can put into vector registers.
const PARTS: usize = 8;

/// Pairs of neighbours, for Σ (v_second − v_first)².
#[derive(Clone, Debug)]
pub struct Neighbours {
    pixels: usize,
    runs: Vec<Run>,
}

/// Pairs of consecutive pixels: (first, second), (first + 1, second + 1), …
#[derive(Clone, Debug)]
struct Run {
    first: usize,
    second: usize,
    length: usize,
}

impl Neighbours {
    /// Pairs (first, second) of pixels, which are numbered from 0 to `pixels` − 1.
    ///
    /// Any order will do; pairs that go on in both pixels are fastest, as they come from the rows
    /// of a picture.
    ///
    /// # Errors
    /// If a pixel is none of those.
    pub fn new(pixels: usize, pairs: impl IntoIterator<Item = [usize; 2]>) -> Result<Self> {
        let mut runs: Vec<Run> = Vec::new();
        for [first, second] in pairs {
            if let Some(&outside) = [first, second].iter().find(|&&p| p >= pixels) {
                let expected = format!("indices below {pixels}");
                return Err(Error::argument("neighbours", expected, outside));
            }
            match runs.last_mut() {
                Some(run)
                    if run.length < PIECE
                        && (first, second) == (run.first + run.length, run.second + run.length) =>
                {
                    run.length += 1;
                }
                _ => runs.push(Run {
                    first,
                    second,
                    length: 1,
                }),
            }
        }
        Ok(Self { pixels, runs })
    }

    /// w Σ (v_second − v_first)² over the pairs; its gradient is added to `gradient`.
    ///
    /// # Errors
    /// If there is not one value and one derivative a pixel.
    pub fn add_penalty(&self, values: &[f64], weight: f64, gradient: &mut [f64]) -> Result<f64> {
        check::length("values", self.pixels, values.len())?;
        check::length("gradient", self.pixels, gradient.len())?;
        Ok(Instructions::best().run(AddChanges {
            runs: &self.runs,
            values,
            weight,
            gradient,
        }))
    }
}

/// Plain loops: they are compiled for wide vectors here, and give the same bits with all of them.
struct AddChanges<'a> {
    runs: &'a [Run],
    values: &'a [f64],
    weight: f64,
    gradient: &'a mut [f64],
}

impl Kernel for AddChanges<'_> {
    type Output = f64;

    #[inline(always)]
    fn run<I: Isa>(self, _isa: I) -> f64 {
        let mut changes = [0.0; PIECE];
        let mut total = 0.0;
        for run in self.runs {
            let changes = &mut changes[..run.length];
            let first = &self.values[run.first..][..run.length];
            let second = &self.values[run.second..][..run.length];
            for ((change, a), b) in changes.iter_mut().zip(first).zip(second) {
                *change = b - a;
            }
            total += sum_of_squares(changes);
            // One after the other: the two parts of the gradient may overlap.
            for (g, change) in self.gradient[run.first..].iter_mut().zip(&*changes) {
                *g -= 2.0 * self.weight * change;
            }
            for (g, change) in self.gradient[run.second..].iter_mut().zip(&*changes) {
                *g += 2.0 * self.weight * change;
            }
        }
        self.weight * total
    }
}

#[inline(always)]
fn sum_of_squares(values: &[f64]) -> f64 {
    let (pieces, rest) = values.as_chunks::<PARTS>();
    let mut parts = [0.0; PARTS];
    for piece in pieces {
        for i in 0..PARTS {
            parts[i] += piece[i] * piece[i];
        }
    }
    parts.iter().sum::<f64>() + rest.iter().map(|v| v * v).sum::<f64>()
}

/// Pixels in groups, for Σ (v − mean of its group)². Group 0 takes no part.
#[derive(Clone, Debug)]
pub struct Groups {
    labels: Vec<u32>,
    counts: Vec<f64>,
}

impl Groups {
    /// From the group of each pixel, numbered without large gaps.
    ///
    /// # Errors
    /// If a label is larger than the number of pixels.
    pub fn new(labels: Vec<u32>) -> Result<Self> {
        let largest = labels.iter().max().map_or(0, |&label| label as usize);
        if largest > labels.len() {
            let expected = format!("labels up to the number of pixels, {}", labels.len());
            return Err(Error::argument("labels", expected, largest));
        }
        let mut counts = vec![0.0; largest + 1];
        for &label in &labels {
            counts[label as usize] += 1.0;
        }
        Ok(Self { labels, counts })
    }

    /// w Σ (v − mean of its group)²; its gradient is added to `gradient`.
    ///
    /// # Errors
    /// If there is not one value and one derivative a pixel.
    pub fn add_penalty(&self, values: &[f64], weight: f64, gradient: &mut [f64]) -> Result<f64> {
        check::length("values", self.labels.len(), values.len())?;
        check::length("gradient", self.labels.len(), gradient.len())?;
        let mut means = vec![0.0; self.counts.len()];
        for (&label, &value) in self.labels.iter().zip(values) {
            means[label as usize] += value;
        }
        for (mean, &count) in means.iter_mut().zip(&self.counts) {
            *mean /= f64::max(count, 1.0);
        }
        let mut total = 0.0;
        for ((&label, &value), g) in self.labels.iter().zip(values).zip(gradient) {
            let deviation = if label == 0 {
                0.0
            } else {
                value - means[label as usize]
            };
            total += deviation.powi(2);
            *g += 2.0 * weight * deviation;
        }
        Ok(weight * total)
    }
}
