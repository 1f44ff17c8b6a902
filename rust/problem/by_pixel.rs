//! Arrays with some numbers for each pixel, filled block by block.

use crate::reflectance::planes::BLOCK;
use crate::runtime::memory::zeros;
use crate::runtime::{Result, pool};

/// S arrays with so many numbers for each of some pixels, `widths`, as zeros that `fill` writes to.
///
/// A piece of work is some blocks of pixels. What they need is made by `room`, once a piece; `fill` gets
/// it, the number of the first pixel of a block among all, the pixels of the block, and its part of
/// each array.
pub(crate) fn fill_by_pixel<T: Clone + Default + Send, R, const S: usize>(
    (name, threads): (&'static str, usize),
    pixels: &[usize],
    blocks: usize,
    widths: [usize; S],
    room: impl Fn() -> R + Send + Sync,
    fill: impl Fn(&mut R, usize, &[usize], [&mut [T]; S]) + Send + Sync,
) -> Result<[Vec<T>; S]> {
    let mut arrays = [const { Vec::new() }; S];
    for (array, width) in arrays.iter_mut().zip(widths) {
        *array = zeros(name, pixels.len() * width)?;
    }
    let mut rest = arrays.each_mut().map(Vec::as_mut_slice);
    let pieces = pixels
        .chunks(blocks * BLOCK)
        .map(|pixels| (pixels, split(&mut rest, widths, pixels.len())))
        .enumerate()
        .collect();
    pool::map(
        threads,
        pieces,
        |(piece, (pixels, mut rest)): (usize, (&[usize], _))| {
            let mut room = room();
            for (i, pixels) in pixels.chunks(BLOCK).enumerate() {
                let first = (piece * blocks + i) * BLOCK;
                let parts = split(&mut rest, widths, pixels.len());
                fill(&mut room, first, pixels, parts);
            }
        },
    );
    Ok(arrays)
}

/// The first `count` pixels' part of each array.
fn split<'a, T, const S: usize>(
    rest: &mut [&'a mut [T]; S],
    widths: [usize; S],
    count: usize,
) -> [&'a mut [T]; S] {
    std::array::from_fn(|s| {
        let part = rest[s].split_off_mut(..count * widths[s]);
        part.expect("numbers for each pixel")
    })
}
