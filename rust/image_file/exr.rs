//! OpenEXR in and out.

use std::collections::HashSet;
use std::io::Cursor;
use std::path::Path;

use ::exr::block::UncompressedBlock;
use ::exr::block::chunk::{Chunk, CompressedBlock};
use ::exr::block::lines::LineRef;
use ::exr::block::reader::Reader;
use ::exr::compression::Compression;
use ::exr::meta::BlockDescription;
use ::exr::meta::attribute::{Chromaticities, IntegerBounds, SampleType, Text};
use ::exr::meta::header::Header;
use ::exr::prelude::{
    AnyChannel, AnyChannels, Encoding, FlatSamples, Image, SmallVec, Vec2, WritableImage, f16,
};

use super::{Format, Room, broken, check_size, content, guarded, write_atomically};
use crate::runtime::{Error, Result};

/// Largest accepted sum of samples over all channels: 4 GiB as float.
const MAX_SAMPLES: u64 = 1 << 30;

/// Pixels that a window may have however small the file: a crop may lie in a large empty frame.
const EMPTY_PIXELS: u64 = 1 << 24;

/// The same for samples, over all channels: 256 MiB as float.
const EMPTY_SAMPLES: u64 = 1 << 26;

/// Most samples in one byte of a file. All compressions but DWA end in deflated
/// or run-length data of what is 2 bytes or more a sample. In DWA one colour takes
/// 4 bytes for 8 x 8 samples, and these are deflated.
const SAMPLES: u64 = 1032;
const DWA_SAMPLES: u64 = 64 * 1032 / 4;

/// Primaries and white point of Rec.709 with D65, as every written file states
/// them: xy of red, green, blue, white.
const REC709: [(f32, f32); 4] = [(0.64, 0.33), (0.30, 0.60), (0.15, 0.06), (0.3127, 0.3290)];

/// One channel of an EXR file.
#[derive(Clone, Debug, PartialEq)]
pub struct ExrChannel {
    /// Full name, for example `R` or `albedo.R`.
    pub name: String,
    /// Row-major values of the display window.
    pub values: Vec<f32>,
}

/// What an EXR file holds.
#[derive(Clone, Debug, PartialEq)]
pub struct Exr {
    /// Width of the display window.
    pub width: usize,
    /// Height of the display window.
    pub height: usize,
    /// All channels of all parts, in the order of the file.
    pub channels: Vec<ExrChannel>,
    /// The attribute of that name: xy of red, green, blue, white.
    pub chromaticities: Option<[(f32, f32); 4]>,
    /// Names of colour spaces that parts state, as of [`COLOR_SPACE`].
    pub color_spaces: Vec<String>,
}

/// Attributes that name a part's colour space, the one that counts first: that of the Color Interop
/// Forum, and OpenImageIO's.
const COLOR_SPACE: [&str; 2] = ["colorInteropID", "oiio:ColorSpace"];

/// Reads the bytes of an EXR file: half, float or 32-bit integer channels (integers above 2^24 are
/// rounded to float), scan lines or tiles (the largest level), one or several parts.
///
/// With several parts a channel is named `part.channel`, unless the part has
/// no name or the channel already starts with it. The data window is placed
/// into the display window: NaN outside of it, cropped where it reaches over.
///
/// `path` is for the messages.
///
/// # Errors
/// [`Error::Content`] for deep or subsampled data, more than 2^28 pixels, and damaged files.
pub fn decode_exr(bytes: &[u8], path: &Path) -> Result<Exr> {
    guarded(path, || decode(bytes, path))
}

fn decode(bytes: &[u8], path: &Path) -> Result<Exr> {
    let error = |error: ::exr::error::Error| match error {
        ::exr::error::Error::NotSupported(what) => content(
            path,
            format!("expected flat pixels in one of the compressions up to DWAB, found: {what}"),
        ),
        error => broken(path, Format::Exr, error),
    };
    // Lenient about the attributes, which other programs sometimes write oddly.
    let reader = Reader::read_from_buffered(Cursor::new(bytes), false).map_err(error)?;
    let meta = reader.meta_data().clone();
    let headers = &meta.headers;
    let display = check_headers(headers, bytes.len() as u64, path)?;
    let (width, height) = (display.size.x(), display.size.y());
    let names = full_names(headers, path)?;
    let room = Room::of(path, 4 * (width * height * names.len()) as u64)?;
    let mut planes: Vec<_> = headers
        .iter()
        .map(|header| {
            let whole = header.data_window().contains(display);
            let untold = if whole { 0.0 } else { f32::NAN };
            // Made one by one: the system gives zeroed memory when it is first written to, where
            // copies of a zeroed plane would be written at once.
            let planes = header.channels.list.iter();
            planes
                .map(|_| vec![untold; width * height])
                .collect::<Vec<_>>()
        })
        .collect();
    drop(room); // taken, though perhaps not yet written to
    // A chunk is read into memory that grows by halves or more, and decoded by way of four copies.
    let block = headers.iter().map(Header::max_block_byte_size).max();
    let block = block.unwrap_or(0);
    let _room = Room::of(path, (4 * block + 3 * block.min(bytes.len())) as u64)?;

    // Strict about the chunks: each has to be there once, so that no damage can
    // pass for black rows. One thread: a pool would be dead in a forked child.
    let largest_level = Vec2(0, 0);
    let chunks = reader
        .filter_chunks(true, |_, tile, _| tile.level_index == largest_level)
        .map_err(error)?;
    let mut seen = HashSet::new();
    for chunk in chunks {
        let chunk = chunk.map_err(error)?;
        let Some(header) = headers.get(chunk.layer_index) else {
            return Err(broken(path, Format::Exr, "a chunk of no part"));
        };
        let _room = Room::of(path, of_dwa(&chunk, header, path)?)?;
        let block = UncompressedBlock::decompress_chunk(chunk, &meta, true).map_err(error)?;
        let index = block.index;
        if index.level != largest_level || !seen.insert((index.layer, index.pixel_position)) {
            return Err(broken(path, Format::Exr, "a chunk in the place of another"));
        }
        let origin = header.own_attributes.layer_position;
        let shift = [
            i64::from(origin.x()) - i64::from(display.position.x()),
            i64::from(origin.y()) - i64::from(display.position.y()),
        ];
        for line in block.lines(&header.channels) {
            let channel = line.location.channel;
            let plane = &mut planes[index.layer][channel];
            let kind = header.channels.list[channel].sample_type;
            place(&line, kind, shift, plane, width);
        }
    }

    let chromaticities = headers
        .iter()
        .find_map(|header| header.shared_attributes.chromaticities)
        .map(|c| [c.red, c.green, c.blue, c.white].map(|Vec2(x, y)| (x, y)));
    let named = |header: &Header| {
        let text = |name: &str| {
            let value = header.own_attributes.other.get(name.as_bytes())?;
            Some(value.to_text().ok()?.to_string())
        };
        COLOR_SPACE.into_iter().find_map(text)
    };
    let channels = names
        .into_iter()
        .zip(planes.into_iter().flatten())
        .map(|(name, values)| ExrChannel { name, values })
        .collect();
    Ok(Exr {
        width,
        height,
        channels,
        chromaticities,
        color_spaces: headers.iter().filter_map(named).collect(),
    })
}

/// Names of all channels of all parts.
fn full_names(headers: &[Header], path: &Path) -> Result<Vec<String>> {
    let mut names = Vec::new();
    let mut seen = HashSet::new();
    for header in headers {
        let part = header.own_attributes.layer_name.as_ref();
        let part = part.filter(|part| headers.len() > 1 && !part.as_slice().is_empty());
        let prefix = part.map(|part| format!("{part}.")).unwrap_or_default();
        for channel in &header.channels.list {
            let own = channel.name.to_string();
            let name = prefix.clone() + own.strip_prefix(&prefix).unwrap_or(&own);
            if !seen.insert(name.clone()) {
                let reason = format!("expected distinct channels, found {name} twice");
                return Err(content(path, reason));
            }
            names.push(name);
        }
    }
    Ok(names)
}

/// Copies one line of a block to where it lies in the display window; `shift`
/// is the data window's origin as seen from the display window's.
fn place(line: &LineRef<'_>, kind: SampleType, shift: [i64; 2], plane: &mut [f32], width: usize) {
    let location = line.location;
    let height = plane.len() / width;
    let y = location.position.y() as i64 + shift[1];
    let start = location.position.x() as i64 + shift[0];
    let end = (start + location.sample_count as i64).min(width as i64);
    if y < 0 || y >= height as i64 || end <= start.max(0) {
        return;
    }
    let skipped = (-start).max(0) as usize;
    let row = y as usize * width;
    let target = &mut plane[row + start.max(0) as usize..row + end as usize];
    match kind {
        SampleType::F16 => fill(target, line, skipped, |b| f16::from_ne_bytes(b).to_f32()),
        SampleType::F32 => fill(target, line, skipped, f32::from_ne_bytes),
        SampleType::U32 => fill(target, line, skipped, |b| u32::from_ne_bytes(b) as f32),
    }
}

fn fill<const BYTES: usize>(
    target: &mut [f32],
    line: &LineRef<'_>,
    skipped: usize,
    value: impl Fn([u8; BYTES]) -> f32,
) {
    for (to, &bytes) in target.iter_mut().zip(&line.value.as_chunks().0[skipped..]) {
        *to = value(bytes);
    }
}

/// Bytes that the decoder of a DWA chunk takes beside its blocks; 0 of other compressions.
///
/// In `exr` 1.74 that is up to eight times what each of the eleven 64-bit counters in front of the
/// chunk says. So the ones that size its buffers (all but the first, a version, and the last, a
/// kind) are held against the pixels of the block. Blocks of 8 x 8 are padded, hence the generous
/// factor.
fn of_dwa(chunk: &Chunk, header: &Header, path: &Path) -> Result<u64> {
    let bytes = match &chunk.compressed_block {
        _ if samples_in_a_byte(header) != DWA_SAMPLES => return Ok(0),
        CompressedBlock::ScanLine(block) => &block.compressed_pixels_le,
        CompressedBlock::Tile(block) => &block.compressed_pixels_le,
        _ => return Ok(0), // deep data is refused by the decompressor
    };
    let block = header
        .get_block_data_indices(&chunk.compressed_block)
        .and_then(|tile| header.get_absolute_block_pixel_coordinates(tile))
        .map_err(|error| broken(path, Format::Exr, error))?;
    let size = (header.channels.bytes_per_pixel * block.size.area()) as u64;
    if bytes.len() as u64 == size {
        return Ok(0); // stored raw
    }
    let counters = bytes.as_chunks().0.iter().skip(1).take(9);
    let counters = counters.map(|counter| u64::from_le_bytes(*counter));
    if counters.clone().any(|counter| counter > 64 * size + 4096) {
        return Err(broken(path, Format::Exr, "a DWA chunk with absurd sizes"));
    }
    Ok(8 * counters.sum::<u64>())
}

/// Refuses, before anything is allocated, what cannot be read (deep and subsampled data were
/// refused with the header). Returns the display window that all parts share.
fn check_headers(headers: &[Header], file_size: u64, path: &Path) -> Result<IntegerBounds> {
    let Some(first) = headers.first() else {
        let reason = "expected an EXR file with a picture, found none";
        return Err(content(path, reason));
    };
    let display = first.shared_attributes.display_window;
    let held = file_size * headers.iter().map(samples_in_a_byte).max().unwrap_or(0);
    let check = |size: Vec2<usize>| {
        let (width, height) = (size.x() as u64, size.y() as u64);
        check_size(path, width, height, EMPTY_PIXELS + held, file_size)
    };
    check(display.size)?;
    let (mut shown, mut stored) = (0, 0);
    for header in headers {
        if header.shared_attributes.display_window != display {
            let reason = "expected one display window for all parts, found several";
            return Err(content(path, reason));
        }
        check(header.layer_size)?;
        // At most 2^28 pixels, and as many channels as a file in memory can list.
        let channels = header.channels.list.len() as u64;
        shown += display.size.area() as u64 * channels;
        // Memory is taken for whole tiles, even where the picture is smaller.
        let block = match header.blocks {
            BlockDescription::Tiles(tiles) => tiles.tile_size.area() as u64,
            BlockDescription::ScanLines => 0,
        };
        if block > super::LARGEST_TILE.max(header.layer_size.area() as u64) {
            let found = format!("tiles of {block} pixels");
            return Err(broken(path, Format::Exr, found));
        }
        stored += block.max(header.layer_size.area() as u64) * channels;
        // The table of chunk offsets alone takes 8 bytes a chunk.
        if header.chunk_count as u64 > file_size / 8 {
            let found = format!("{} chunks in {file_size} bytes", header.chunk_count);
            return Err(broken(path, Format::Exr, found));
        }
    }
    let samples = shown.max(stored); // of what is returned, and of what chunks may hold
    if samples > MAX_SAMPLES {
        let reason = format!("expected at most {MAX_SAMPLES} samples, found {samples}");
        return Err(content(path, reason));
    }
    if samples > EMPTY_SAMPLES + held {
        let reason = format!("expected a sound file, found {samples} samples in {file_size} bytes");
        return Err(content(path, reason));
    }
    Ok(display)
}

fn samples_in_a_byte(header: &Header) -> u64 {
    match header.compression {
        Compression::DWAA(_) | Compression::DWAB(_) => DWA_SAMPLES,
        _ => SAMPLES,
    }
}

/// Writes one part of scan lines with ZIP compression and the chromaticities of Rec.709. Equal
/// input gives equal bytes. With `half`, values beyond 65504 become infinite.
///
/// The file is there as a whole or not at all.
///
/// # Errors
/// [`Error::Argument`] if there is no channel, a name comes twice or is empty, or a channel does
/// not hold `width * height` values; [`Error::Io`] if the file cannot be written.
pub fn write_exr(
    path: &Path,
    width: usize,
    height: usize,
    channels: Vec<ExrChannel>,
    half: bool,
) -> Result<()> {
    let pixels = width as u64 * height as u64;
    if channels.is_empty() || pixels == 0 || pixels > super::MAX_PIXELS {
        let expected = format!("at least one channel of 1 to {} pixels", super::MAX_PIXELS);
        let found = format!("{} channels of {height} x {width}", channels.len());
        return Err(Error::argument("channels", expected, found));
    }
    // Values of the image, and a file that grows by halves or more.
    let _room = Room::of(path, 12 * pixels * channels.len() as u64)?;
    let mut names = HashSet::new();
    let mut list = SmallVec::new();
    for ExrChannel { name, values } in channels {
        let Some(text) = Text::new_or_none(&name).filter(|_| (1..=255).contains(&name.len()))
        else {
            let (expected, found) = ("names of 1 to 255 letters", format!("{name:?}"));
            return Err(Error::argument("channels", expected, found));
        };
        if values.len() != width * height {
            let expected = format!("{height} x {width} values in {name}");
            return Err(Error::argument("channels", expected, values.len()));
        }
        let samples = if half {
            FlatSamples::F16(values.into_iter().map(f16::from_f32).collect())
        } else {
            FlatSamples::F32(values)
        };
        if !names.insert(name) {
            return Err(Error::argument("channels", "distinct names", text));
        }
        list.push(AnyChannel::new(text, samples));
    }
    let mut image = Image::from_encoded_channels(
        (width, height),
        Encoding::SMALL_LOSSLESS, // ZIP, 16 scan lines a block, top to bottom
        AnyChannels::sort(list),
    );
    let [red, green, blue, white] = REC709.map(|(x, y)| Vec2(x, y));
    image.attributes.chromaticities = Some(Chromaticities {
        red,
        green,
        blue,
        white,
    });
    let mut bytes = Cursor::new(Vec::new());
    image
        .write()
        .to_buffered(&mut bytes)
        .map_err(|error| match error {
            ::exr::error::Error::Io(source) => Error::io(path, source),
            error => {
                let reason = format!("expected channels that EXR can hold, found: {error}");
                content(path, reason)
            }
        })?;
    write_atomically(path, bytes.get_ref())
}
