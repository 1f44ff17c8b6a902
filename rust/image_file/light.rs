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

/// Averages light over the area that falls on each of `pixels`, (height, width, 3); `value` is that
/// of a sample of a channel, and grey is that of all three. Parts of old pixels count by their area.
///
/// Samples below and above the `data` are at a limit; `bounds` has the limits of colours by those of
/// the channels, at 9 red + 3 green + blue. Means that have a part in one are marked in `limits`,
/// zeros (height, width, 3), as `AT_LEAST` before `AT_MOST`; returns whether one was.
///
/// # Errors
/// [`crate::Error::Memory`].
pub fn averaged<T: Copy + PartialOrd>(
    stored: &Stored<'_, T>,
    [height, width]: [usize; 2],
    value: impl Fn(usize, T) -> f32,
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
    let mut ready = usize::MAX; // the row that `line` is of
    let mut marked = false;
    let lines = pixels.chunks_exact_mut(3 * width);
    let lines = lines.zip(limits.as_chunks_mut::<3>().0.chunks_exact_mut(width));
    for (y, (pixels, limits)) in lines.enumerate() {
        mean.fill(0.0);
        for (row, share) in parts(down, height, y) {
            let start = ((rows.start + row) * across + columns.start) * channels;
            let samples = &stored.samples[start..start + wide * channels];
            if ready != row {
                for c in 0..colors {
                    let from = samples[c..].iter().step_by(channels);
                    let to = line[c..].iter_mut().step_by(colors);
                    to.zip(from)
                        .for_each(|(to, &sample)| *to = value(c, sample));
                }
                ready = row;
            }
            if [down, wide] != [height, width] {
                let sums = mean.iter_mut().zip(&line);
                sums.for_each(|(sum, &light)| *sum += share * f64::from(light));
            }
            let Some([low, high]) = &data else { continue };
            let limit = |sample: &T| match sample {
                above if above > high => AT_LEAST,
                below if below < low => AT_MOST,
                _ => 0,
            };
            if samples.iter().fold(0, |any, sample| any | limit(sample)) == 0 {
                continue;
            }
            for (x, pixel) in samples.chunks_exact(channels).enumerate() {
                let of = [0, 1, 2].map(|c| usize::from(limit(&pixel[c.min(colors - 1)])));
                let found = bounds[9 * of[0] + 3 * of[1] + of[2]];
                if found == [0; 3] {
                    continue;
                }
                marked = true;
                let touched = x * width / wide..((x + 1) * width).div_ceil(wide);
                for of_pixel in &mut limits[touched] {
                    for (bound, found) in of_pixel.iter_mut().zip(found) {
                        if found != 0 && *bound != AT_LEAST {
                            *bound = found;
                        }
                    }
                }
            }
        }
        for (x, pixel) in pixels.as_chunks_mut::<3>().0.iter_mut().enumerate() {
            *pixel = std::array::from_fn(|c| {
                let c = c.min(colors - 1);
                if [down, wide] == [height, width] {
                    return line[x * colors + c];
                }
                let parts = shares[x].iter();
                let parts = parts.map(|(place, share)| share * mean[place * colors + c]);
                parts.sum::<f64>() as f32
            });
        }
    }
    Ok(marked)
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
