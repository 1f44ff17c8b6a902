//! The pictures as an evaluation reads them, taken up one at a time: they never all lie there twice.

use crate::problem::widen;
use crate::reflectance::planes::{BLOCK, Plane};
use crate::runtime::check::LARGEST_F32;
use crate::runtime::memory::zeros;
use crate::runtime::{Error, Result, check, pool};

/// Blocks in a piece of work, of one picture.
const PIECE: usize = 64;

/// Linear radiance, or weight, of each pixel, picture and channel.
///
/// Pictures in float64 keep what float32 leaves of them, as much again in float32. The fast
/// evaluation takes no notice of it.
#[derive(Clone, Debug)]
pub struct Targets {
    pub(crate) pixels: usize,
    pub(crate) pictures: usize,
    pub(crate) channels: usize,
    threads: usize,
    /// Pictures taken up so far.
    taken: usize,
    /// (block, channel, picture)
    high_words: Vec<Plane>,
    /// In the same order, once there is a picture in float64; else empty.
    low_words: Vec<Plane>,
}

impl Targets {
    /// Room for so many pictures of so many pixels, with 1 or 3 channels.
    pub fn new(pixels: usize, pictures: usize, channels: usize, threads: usize) -> Result<Self> {
        if pixels == 0 || pictures == 0 {
            let found = format!("{pictures} pictures of {pixels} pixels");
            let expected = "at least one picture and one pixel";
            return Err(Error::argument("images", expected, found));
        }
        if !matches!(channels, 1 | 3) {
            return Err(Error::argument("images", "1 or 3 channels", channels));
        }
        check::samples("images", "pictures", pictures, pixels)?;
        Ok(Self {
            pixels,
            pictures,
            channels,
            threads,
            taken: 0,
            high_words: zeros("images", pixels.div_ceil(BLOCK) * channels * pictures)?,
            low_words: Vec::new(),
        })
    }

    /// Takes up the next picture, (pixel, channel); of float64 to 48 bits.
    pub fn push<T: Copy + Into<f64> + Sync>(&mut self, picture: &[T]) -> Result<()> {
        let i = self.taken;
        if i == self.pictures {
            return Err(self.wrong_count(i + 1));
        }
        let size = self.pixels * self.channels;
        check::length("images", size, picture.len())?;
        check::moderate_from("images", i * size, picture, LARGEST_F32)?;
        self.taken += 1;
        let high = |value: T| value.into() as f32;
        let (shape, threads) = ([self.pictures, self.channels], self.threads);
        put(picture, i, shape, threads, high, &mut self.high_words);
        if size_of::<T>() > size_of::<f32>() {
            if self.low_words.is_empty() {
                self.low_words = zeros("images", self.high_words.len())?;
            }
            let low = |value: T| (value.into() - f64::from(high(value))) as f32;
            put(picture, i, shape, threads, low, &mut self.low_words);
        }
        Ok(())
    }

    /// Refuses pictures of which some are still to come.
    pub(crate) fn complete(&self) -> Result<()> {
        if self.taken < self.pictures {
            return Err(self.wrong_count(self.taken));
        }
        Ok(())
    }

    fn wrong_count(&self, found: usize) -> Error {
        let expected = format!("{} pictures", self.pictures);
        Error::argument("images", expected, found)
    }

    /// Of a block in float32, a plane for each picture.
    pub(crate) fn planes(&self, block: usize, channel: usize) -> &[Plane] {
        let first = (block * self.channels + channel) * self.pictures;
        &self.high_words[first..][..self.pictures]
    }

    /// One target, with its low word where there is one.
    pub(crate) fn get(&self, block: usize, channel: usize, picture: usize, x: usize) -> f64 {
        let i = (block * self.channels + channel) * self.pictures + picture;
        let target = f64::from(self.high_words[i].0[x]);
        self.low_words
            .get(i)
            .map_or(target, |rest| target + f64::from(rest.0[x]))
    }

    /// Those of a whole block.
    pub(crate) fn copy(&self, block: usize, channel: usize, picture: usize, to: &mut Plane<f64>) {
        let i = (block * self.channels + channel) * self.pictures + picture;
        widen(&self.high_words[i], to);
        if let Some(rest) = self.low_words.get(i) {
            for x in 0..BLOCK {
                to.0[x] += f64::from(rest.0[x]);
            }
        }
    }
}

/// Puts part of the values of picture number i, (pixel, channel), into its planes (block, channel,
/// picture).
fn put<T: Copy + Sync>(
    picture: &[T],
    i: usize,
    [pictures, channels]: [usize; 2],
    threads: usize,
    part: impl Fn(T) -> f32 + Send + Sync,
    planes: &mut [Plane],
) {
    let of_block = pictures * channels;
    let pieces = planes
        .chunks_mut(PIECE * of_block)
        .zip(picture.chunks(PIECE * BLOCK * channels))
        .collect();
    pool::map(threads, pieces, |(planes, values): (&mut [Plane], &[T])| {
        let blocks = planes.chunks_mut(of_block);
        for (block, values) in blocks.zip(values.chunks(BLOCK * channels)) {
            for c in 0..channels {
                let out = &mut block[c * pictures + i].0;
                for (out, &value) in out.iter_mut().zip(values[c..].iter().step_by(channels)) {
                    *out = part(value);
                }
            }
        }
    });
}
