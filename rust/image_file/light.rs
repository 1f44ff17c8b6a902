//! Samples through curves to linear light, averaged down on the way.

use std::ops::Range;

use crate::runtime::Result;
use crate::runtime::check::{AT_LEAST, AT_MOST};
use crate::runtime::memory::zeros;

/// Samples (H, W, C) as a file stores them, and the rows and columns of them that are used.
pub struct Stored<'a, T> {
    /// Row by row; the last of two or four channels is alpha.
    pub samples: &'a [T],
    /// W and C.
    pub shape: [usize; 2],
    /// In [0, H) and [0, W).
    pub used: [Range<usize>; 2],
}

/// Averages light over the area that falls on each of `pixels`, (height, width, 3); `curve` gives the
/// values of a channel's samples, and grey is that of all three. Parts of old pixels count by their
/// area.
///
/// Samples below and above the `data` are at a limit; `bounds` has the limits of colours by those of
/// the channels, at 9 red + 3 green + blue. Means that have a part in one are marked in `limits`,
/// zeros (height, width, 3), as `AT_LEAST` before `AT_MOST`; returns whether one was.
///
/// # Errors
/// [`crate::Error::Memory`].
pub fn averaged<T: Copy + PartialOrd, V: Fn(T) -> f32>(
    stored: &Stored<'_, T>,
    [height, width]: [usize; 2],
    curve: impl Fn(usize) -> V,
    (data, bounds): (Option<[T; 2]>, &[[u8; 3]; 27]),
    pixels: &mut [f32],
    limits: &mut [u8],
) -> Result<bool> {
    let ([across, channels], [rows, columns]) = (stored.shape, &stored.used);
    let (down, wide) = (rows.len(), columns.len());
    let colors = channels - usize::from(channels.is_multiple_of(2));
    let shares: Vec<Vec<_>> = (0..width)
        .map(|x| parts(wide, width, x).collect())
        .collect();
    let mut line = zeros::<f32>("pixels", wide * colors)?; // light of a row of samples
    let mut mean = zeros::<f64>("pixels", wide * colors)?; // of rows
    let mut limits_of = Limits {
        colors: bounds.map(|[red, green, blue]| u32::from_le_bytes([red, green, blue, 0])),
        of_samples: zeros("limits", wide * channels)?,
        of_pixels: zeros("limits", wide)?,
        of_means: zeros("limits", width)?,
    };
    let mut ready = usize::MAX; // the row that these are of
    let (mut limited, mut marked) = (false, false);
    let lines = pixels.chunks_exact_mut(3 * width);
    let lines = lines.zip(limits.as_chunks_mut::<3>().0.chunks_exact_mut(width));
    for (y, (pixels, limits)) in lines.enumerate() {
        mean.fill(0.0);
        for (row, share) in parts(down, height, y) {
            if ready != row {
                ready = row;
                let start = ((rows.start + row) * across + columns.start) * channels;
                let samples = &stored.samples[start..start + wide * channels];
                for c in 0..colors {
                    let (to, value) = (line[c..].iter_mut().step_by(colors), curve(c));
                    let from = samples[c..].iter().step_by(channels);
                    to.zip(from).for_each(|(to, &sample)| *to = value(sample));
                }
                limited = data.is_some_and(|data| limits_of.read(samples, channels, data, &shares));
                marked |= limited;
            }
            if [down, wide] != [height, width] {
                let sums = mean.iter_mut().zip(&line);
                sums.for_each(|(sum, &light)| *sum += share * f64::from(light));
            }
            if limited {
                for (bounds, found) in limits.iter_mut().zip(&limits_of.of_means) {
                    let found = found.to_le_bytes();
                    *bounds = std::array::from_fn(|c| stronger(bounds[c] | found[c]));
                }
            }
        }
        let pixels = pixels.as_chunks_mut::<3>().0;
        if [down, wide] != [height, width] {
            match colors {
                1 => means(mean.as_chunks::<1>().0, &shares, pixels),
                _ => means(mean.as_chunks::<3>().0, &shares, pixels),
            }
        } else {
            let light = |x: usize| [0, 1, 2].map(|c: usize| line[x * colors + c.min(colors - 1)]);
            (pixels.iter_mut().enumerate()).for_each(|(x, pixel)| *pixel = light(x));
        }
    }
    Ok(marked)
}

/// Means over columns, by their shares; grey is that of all three colours.
fn means<const C: usize>(mean: &[[f64; C]], shares: &[Vec<(usize, f64)>], pixels: &mut [[f32; 3]]) {
    for (pixel, parts) in pixels.iter_mut().zip(shares) {
        let mut sum = [0.0; C];
        for (place, share) in parts {
            for c in 0..C {
                sum[c] += share * mean[*place][c];
            }
        }
        *pixel = std::array::from_fn(|c| sum[c.min(C - 1)] as f32);
    }
}

/// Limits of a row. Several of a sample are or-ed: they are bits. Three colours are a number's bytes.
struct Limits {
    /// Of colours, by those of the channels.
    colors: [u32; 27],
    of_samples: Vec<u8>,
    of_pixels: Vec<u32>,
    /// Of means that have a part in the row.
    of_means: Vec<u32>,
}

impl Limits {
    /// Finds those of a row of samples; returns whether there is one.
    fn read<T: Copy + PartialOrd>(
        &mut self,
        samples: &[T],
        channels: usize,
        [low, high]: [T; 2],
        shares: &[Vec<(usize, f64)>],
    ) -> bool {
        let mut any = 0;
        for (limit, &sample) in self.of_samples.iter_mut().zip(samples) {
            *limit = AT_LEAST * u8::from(sample > high) + AT_MOST * u8::from(sample < low);
            any |= *limit;
        }
        if any == 0 {
            return false;
        }
        let pixels = self.of_samples.chunks_exact(channels);
        for (limits, pixel) in self.of_pixels.iter_mut().zip(pixels) {
            let [red, green, blue] = match *pixel {
                [grey] | [grey, _] => [grey; 3],
                [red, green, blue, ..] => [red, green, blue],
                [] => [0; 3],
            };
            *limits = self.colors[usize::from(9 * red + 3 * green + blue)];
        }
        let mut any = 0;
        for (limits, parts) in self.of_means.iter_mut().zip(shares) {
            *limits = (parts.iter()).fold(0, |found, (place, _)| found | self.of_pixels[*place]);
            any |= *limits;
        }
        any != 0
    }
}

/// `AT_LEAST` where a mean has a part in a sample of either limit.
fn stronger(bits: u8) -> u8 {
    if bits & AT_LEAST == 0 { bits } else { AT_LEAST }
}

/// The places among `old` along a side that one of `new` covers, and its share of each: in units
/// of 1 / (old new) of the side one of the new begins at place old, and one of the old at i new.
fn parts(old: usize, new: usize, place: usize) -> impl Iterator<Item = (usize, f64)> {
    let (start, end) = (place * old, (place + 1) * old);
    (start / new..end.div_ceil(new)).map(move |i| {
        let common = end.min((i + 1) * new) - start.max(i * new);
        (i, common as f64 / old as f64)
    })
}
