//! The pictures as an evaluation reads them, taken up one at a time: they never all lie there twice.

use crate::problem::widen;
use crate::reflectance::planes::{BLOCK, Plane};
use crate::runtime::check::LARGEST_F32;
use crate::runtime::memory::zeros;
use crate::runtime::{Error, Result, check, pool};

/// Blocks in a piece of work, of one picture.
const PIECE: usize = 64;

/// Linear radiance of each pixel, picture and channel.
///
/// Pictures in float64 keep what float32 leaves of them, as much again in float32. The fast
/// evaluation takes no notice of it.
#[derive(Clone, Debug)]
pub struct Targets {
    pixels: usize,
    layout: PlaneLayout,
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
            layout: PlaneLayout {
                pictures,
                channels,
                threads,
            },
            taken: 0,
            high_words: room("images", pixels, pictures, channels)?,
            low_words: Vec::new(),
        })
    }

    /// All pictures at once: (picture, pixel, channel).
    pub fn of(
        images: &[f32],
        pixels: usize,
        pictures: usize,
        channels: usize,
        threads: usize,
    ) -> Result<Self> {
        let mut targets = Self::new(pixels, pictures, channels, threads)?;
        check::length("images", pictures * pixels * channels, images.len())?;
        for picture in images.chunks(pixels * channels) {
            targets.push(picture)?;
        }
        Ok(targets)
    }

    /// Takes up the next picture, (pixel, channel); of float64 to 48 bits.
    pub fn push<T: Copy + Into<f64> + Sync>(&mut self, picture: &[T]) -> Result<()> {
        let i = self.next(picture)?;
        let layout = self.layout;
        let high = |value: T| value.into() as f32;
        layout.put(&mut self.high_words, i, picture, high);
        if size_of::<T>() > size_of::<f32>() {
            if self.low_words.is_empty() {
                self.low_words = room("images", self.pixels, layout.pictures, layout.channels)?;
            }
            let low = |value: T| (value.into() - f64::from(high(value))) as f32;
            layout.put(&mut self.low_words, i, picture, low);
        }
        Ok(())
    }

    /// The number of the next picture, which is checked.
    fn next<T: Copy + Into<f64>>(&mut self, picture: &[T]) -> Result<usize> {
        let i = self.taken;
        if i == self.layout.pictures {
            return Err(self.wrong_count(i + 1));
        }
        let size = self.pixels * self.layout.channels;
        check::length("images", size, picture.len())?;
        check::moderate_from("images", i * size, picture, LARGEST_F32)?;
        self.taken += 1;
        Ok(i)
    }

    /// Refuses pictures of which some are still to come.
    pub(crate) fn complete(&self) -> Result<()> {
        if self.taken < self.layout.pictures {
            return Err(self.wrong_count(self.taken));
        }
        Ok(())
    }

    fn wrong_count(&self, found: usize) -> Error {
        let expected = format!("{} pictures", self.layout.pictures);
        Error::argument("images", expected, found)
    }

    /// Pixels of a picture.
    pub fn pixels(&self) -> usize {
        self.pixels
    }

    /// Number of pictures.
    pub fn pictures(&self) -> usize {
        self.layout.pictures
    }

    /// Colour channels.
    pub fn channels(&self) -> usize {
        self.layout.channels
    }

    /// Of a block in float32, a plane for each picture.
    pub(crate) fn planes(&self, block: usize, channel: usize) -> &[Plane] {
        &self.high_words[(block * self.layout.channels + channel) * self.layout.pictures..]
            [..self.layout.pictures]
    }

    /// One target, with its low word where there is one.
    pub(crate) fn get(&self, block: usize, channel: usize, picture: usize, x: usize) -> f64 {
        let i = (block * self.layout.channels + channel) * self.layout.pictures + picture;
        let target = f64::from(self.high_words[i].0[x]);
        self.low_words
            .get(i)
            .map_or(target, |rest| target + f64::from(rest.0[x]))
    }

    /// Those of a whole block.
    pub(crate) fn copy(&self, block: usize, channel: usize, picture: usize, to: &mut Plane<f64>) {
        let i = (block * self.layout.channels + channel) * self.layout.pictures + picture;
        widen(&self.high_words[i], to);
        if let Some(rest) = self.low_words.get(i) {
            for x in 0..BLOCK {
                to.0[x] += f64::from(rest.0[x]);
            }
        }
    }
}

/// From (picture, pixel, channel) to planes (block, channel, picture), zero where no pixel is.
pub(crate) fn planes(
    name: &'static str,
    values: &[f32],
    pictures: usize,
    channels: usize,
    threads: usize,
) -> Result<Vec<Plane>> {
    let size = values.len() / pictures;
    let mut planes = room(name, size / channels, pictures, channels)?;
    let layout = PlaneLayout {
        pictures,
        channels,
        threads,
    };
    for (i, picture) in values.chunks(size).enumerate() {
        layout.put(&mut planes, i, picture, |value| value);
    }
    Ok(planes)
}

/// Room for so many pictures: (block, channel, picture).
fn room(name: &'static str, pixels: usize, pictures: usize, channels: usize) -> Result<Vec<Plane>> {
    zeros(name, pixels.div_ceil(BLOCK) * channels * pictures)
}

/// Where pictures lie in planes (block, channel, picture).
#[derive(Clone, Copy, Debug)]
struct PlaneLayout {
    pictures: usize,
    channels: usize,
    threads: usize,
}

impl PlaneLayout {
    /// Puts `part` of picture `i` into its planes.
    fn put<T: Copy + Sync>(
        &self,
        planes: &mut [Plane],
        i: usize,
        picture: &[T],
        part: impl Fn(T) -> f32 + Send + Sync,
    ) {
        let (pictures, channels) = (self.pictures, self.channels);
        let of_block = pictures * channels;
        let pieces = planes
            .chunks_mut(PIECE * of_block)
            .zip(picture.chunks(PIECE * BLOCK * channels))
            .collect();
        pool::map(
            self.threads,
            pieces,
            |(planes, values): (&mut [Plane], &[T])| {
                let blocks = planes.chunks_mut(of_block);
                for (block, values) in blocks.zip(values.chunks(BLOCK * channels)) {
                    for c in 0..channels {
                        let out = &mut block[c * pictures + i].0;
                        for (out, &value) in
                            out.iter_mut().zip(values[c..].iter().step_by(channels))
                        {
                            *out = part(value);
                        }
                    }
                }
            },
        );
    }
}
