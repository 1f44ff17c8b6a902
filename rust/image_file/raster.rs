//! PNG, JPEG, TIFF and Radiance HDR in, PNG out.

use std::borrow::Cow;
use std::io::Cursor;
use std::path::Path;

use image::codecs::hdr::HdrDecoder;
use image::codecs::jpeg::JpegDecoder;
use image::metadata::Orientation;
use image::{DynamicImage, ImageDecoder};
use png::{BitDepth, Transformations};
use tiff::decoder::{ChunkType, DecodingResult};
use tiff::tags::Tag;

use super::{
    Format, MAX_PIXELS, broken, check_memory, check_size, content, guarded, write_atomically,
};
use crate::runtime::{Error, Result};

/// Most bytes that one byte of deflated data stands for: runs of 258 in two bits.
const DEFLATED: u64 = 1032;

/// Most pixels of a JPEG in one byte. Every block of 8 x 8 takes a bit or more in
/// some scan, and at the oddest sampling nine blocks cover 1024 pixels.
const JPEG_PIXELS: u64 = 1024;

/// Most pixels of a TIFF in one byte: a deflated byte holds 1032 of 8 bits, LZW
/// not more than 1500.
const TIFF_PIXELS: u64 = 2048;

/// Most pixels of an HDR file in one byte: the old kind of runs takes 12 bytes for
/// rows of up to 65281.
const HDR_PIXELS: u64 = 8192;

/// Most scans of a JPEG. Each goes over all of the picture, even where a few
/// bytes are all that it holds; writers make ten or so.
const MOST_SCANS: usize = 200;

/// Interleaved samples, as stored.
#[derive(Clone, Debug, PartialEq)]
pub enum Samples {
    /// 8-bit integers.
    U8(Vec<u8>),
    /// 16-bit integers.
    U16(Vec<u16>),
    /// Floats.
    F32(Vec<f32>),
}

impl Samples {
    fn len(&self) -> usize {
        match self {
            Self::U8(values) => values.len(),
            Self::U16(values) => values.len(),
            Self::F32(values) => values.len(),
        }
    }
}

/// A decoded picture file. No colour was converted and the orientation was not
/// applied.
#[derive(Clone, Debug, PartialEq)]
pub struct Raster {
    /// Which format the content is in.
    pub format: Format,
    /// Columns.
    pub width: usize,
    /// Rows.
    pub height: usize,
    /// 1 grey, 2 grey and alpha, 3 RGB, 4 RGB and alpha.
    pub channels: usize,
    /// `height * width * channels` samples.
    pub samples: Samples,
    /// Embedded ICC profile.
    pub icc_profile: Option<Vec<u8>>,
    /// Embedded EXIF block, beginning with its TIFF header. A TIFF file is its
    /// own EXIF block and has `None`.
    pub exif: Option<Vec<u8>>,
    /// EXIF orientation, 1 to 8.
    pub orientation: u8,
    /// Of a PNG with a cICP chunk: primaries and transfer function (Rec. ITU-T H.273).
    pub code_points: Option<[u8; 2]>,
    /// Of a PNG without an sRGB chunk: what its gAMA chunk says.
    pub gamma: Option<f32>,
    /// Of a PNG without an sRGB chunk: xy of red, green, blue, white in its cHRM chunk.
    pub chromaticities: Option<[f32; 8]>,
    /// Smaller pages of a TIFF, which are not read.
    pub passed_over: usize,
}

impl Raster {
    /// Of one format, size and number of channels; with samples and nothing beside.
    fn plain(format: Format, [width, height, channels]: [usize; 3], samples: Samples) -> Self {
        Self {
            format,
            width,
            height,
            channels,
            samples,
            icc_profile: None,
            exif: None,
            orientation: 1,
            code_points: None,
            gamma: None,
            chromaticities: None,
            passed_over: 0,
        }
    }
}

/// Reads the bytes of a picture file in the format of its content: PNG (1 to 16 bits, all
/// colour types), JPEG (grey or colour), TIFF (8 or 16-bit integers, floats,
/// the page of full resolution) or Radiance HDR.
///
/// With `indices`, a palette PNG gives its indices instead of colours and grey
/// below 8 bits is not spread over 0 to 255.
///
/// `path` is for the messages.
///
/// # Errors
/// [`Error::Content`] for other formats, CMYK, more than 2^28 pixels, and damaged or cut-off files.
pub fn decode_raster(bytes: &[u8], path: &Path, indices: bool) -> Result<Raster> {
    let raster = guarded(path, || match Format::of(bytes) {
        Some(Format::Png) => decode_png(bytes, path, indices),
        Some(Format::Jpeg) => decode_jpeg(bytes, path),
        Some(Format::Tiff) => decode_tiff(bytes, path),
        Some(Format::Hdr) => decode_hdr(bytes, path),
        _ => Err(content(
            path,
            "expected a PNG, JPEG, TIFF or HDR file, found something else",
        )),
    })?;
    let expected = raster.width * raster.height * raster.channels;
    if raster.samples.len() != expected {
        let found = format!("{} samples where {expected} are due", raster.samples.len());
        return Err(broken(path, raster.format, found));
    }
    Ok(raster)
}

fn decode_png(bytes: &[u8], path: &Path, indices: bool) -> Result<Raster> {
    let error = |error: png::DecodingError| broken(path, Format::Png, error);
    let mut decoder = png::Decoder::new(Cursor::new(bytes));
    decoder.set_transformations(match indices {
        true => Transformations::IDENTITY,
        false => Transformations::EXPAND, // palette and transparent colour resolved, >= 8 bits
    });
    decoder.set_ignore_text_chunk(true);
    let header = decoder.read_header_info().map_err(error)?;
    let (width, height) = (header.width as usize, header.height as usize);
    let bits = header.bits_per_pixel() as u64;
    let file_size = bytes.len() as u64;
    let most = file_size * 8 * DEFLATED / bits;
    check_size(path, width as u64, height as u64, most, file_size)?;
    let mut reader = decoder.read_info().map_err(error)?;
    let size = reader
        .output_buffer_size()
        .ok_or_else(|| broken(path, Format::Png, "its size"))?;
    check_memory(path, 2 * size as u64)?; // stored samples and those that are returned
    let mut buffer = vec![0; size];
    let output = reader.next_frame(&mut buffer).map_err(error)?;
    buffer.truncate(output.buffer_size());
    // The rest of the chunks, the end chunk included: a cut-off file fails here.
    reader.finish().map_err(error)?;

    let samples = match output.bit_depth {
        BitDepth::Sixteen => Samples::U16(
            buffer
                .as_chunks()
                .0
                .iter()
                .map(|&pair| u16::from_be_bytes(pair))
                .collect(),
        ),
        BitDepth::Eight => Samples::U8(buffer),
        few => Samples::U8(unpack(&buffer, width, height, few as usize)),
    };
    let info = reader.info();
    let exif = info.exif_metadata.as_ref().map(|exif| exif.to_vec());
    let shape = [width, height, output.color_type.samples()];
    let untold = info.srgb.is_none();
    Ok(Raster {
        orientation: exif_orientation(exif.as_deref()),
        icc_profile: info.icc_profile.as_ref().map(|profile| profile.to_vec()),
        exif,
        code_points: info
            .coding_independent_code_points
            .map(|cicp| [cicp.color_primaries, cicp.transfer_function]),
        gamma: info
            .gama_chunk
            .filter(|_| untold)
            .map(|gamma| gamma.into_value()),
        chromaticities: info.chrm_chunk.filter(|_| untold).map(|chrm| {
            let [red, green, blue, white] = [chrm.red, chrm.green, chrm.blue, chrm.white];
            let [rx, ry, gx, gy] = [red.0, red.1, green.0, green.1].map(|v| v.into_value());
            let [bx, by, wx, wy] = [blue.0, blue.1, white.0, white.1].map(|v| v.into_value());
            [rx, ry, gx, gy, bx, by, wx, wy]
        }),
        ..Raster::plain(Format::Png, shape, samples)
    })
}

/// Samples of 1, 2 or 4 bits, the first in the high bits, each row starting on
/// a byte.
fn unpack(buffer: &[u8], width: usize, height: usize, bits: usize) -> Vec<u8> {
    let stride = (width * bits).div_ceil(8);
    let mask = (1u8 << bits) - 1;
    let mut samples = Vec::with_capacity(width * height);
    for row in buffer.chunks_exact(stride) {
        samples.extend((0..width).map(|x| {
            let first_bit = x * bits;
            row[first_bit / 8] >> (8 - bits - first_bit % 8) & mask
        }));
    }
    samples
}

fn exif_orientation(exif: Option<&[u8]>) -> u8 {
    exif.and_then(Orientation::from_exif_chunk)
        .map_or(1, Orientation::to_exif)
}

fn decode_jpeg(bytes: &[u8], path: &Path) -> Result<Raster> {
    let error = |error: image::ImageError| broken(path, Format::Jpeg, error);
    // The decoder makes do with cut-off files, so the markers are checked first.
    let components = jpeg_components(bytes).map_err(|found| broken(path, Format::Jpeg, found))?;
    if components == 4 {
        return Err(content(
            path,
            "expected a grey or RGB JPEG, found CMYK: convert it to RGB",
        ));
    }
    let mut decoder = JpegDecoder::new(Cursor::new(bytes)).map_err(error)?;
    let (width, height) = decoder.dimensions();
    let file_size = bytes.len() as u64;
    let most = JPEG_PIXELS * file_size;
    check_size(path, width.into(), height.into(), most, file_size)?;
    // A progressive one has its coefficients, 16 bits each, beside its samples.
    check_memory(path, 9 * u64::from(width) * u64::from(height))?;
    let icc_profile = decoder.icc_profile().map_err(error)?;
    let exif = decoder.exif_metadata().map_err(error)?;
    let (channels, samples) = match DynamicImage::from_decoder(decoder).map_err(error)? {
        DynamicImage::ImageLuma8(image) => (1, image.into_raw()),
        image => (3, image.into_rgb8().into_raw()),
    };
    let shape = [width as usize, height as usize, channels];
    Ok(Raster {
        icc_profile,
        orientation: exif_orientation(exif.as_deref()),
        exif,
        ..Raster::plain(Format::Jpeg, shape, Samples::U8(samples))
    })
}

/// Walks the markers from start to end of image (ITU-T T.81, annex B) and
/// returns the number of colour components.
fn jpeg_components(bytes: &[u8]) -> std::result::Result<u8, &'static str> {
    const CUT_OFF: &str = "it is cut off: no end-of-image marker";
    let byte = |at: usize| bytes.get(at).copied().ok_or(CUT_OFF);
    let mut components = None;
    let mut scans = 0;
    let mut at = 2; // behind start of image
    loop {
        while byte(at)? != 0xff {
            at += 1; // stray bytes between segments are skipped, as everyone does
        }
        while byte(at)? == 0xff {
            at += 1;
        }
        let marker = byte(at)?;
        at += 1;
        match marker {
            0xd9 if scans > 0 => return components.ok_or("no frame header"),
            0xd9 => return Err("it ends before its first scan"),
            // Stuffing, restart and the like stand alone: inside a scan they are
            // data, so the walk goes on to the next marker.
            0x00 | 0x01 | 0xd0..=0xd8 => continue,
            _ => {}
        }
        let length = usize::from(u16::from_be_bytes([byte(at)?, byte(at + 1)?]));
        if matches!(marker, 0xc0..=0xcf) && !matches!(marker, 0xc4 | 0xc8 | 0xcc) {
            components = Some(byte(at + 7)?); // length 2, precision 1, height 2, width 2
        }
        scans += usize::from(marker == 0xda);
        if scans > MOST_SCANS {
            return Err("more than 200 scans");
        }
        at += length.max(2);
    }
}

fn decode_tiff(bytes: &[u8], path: &Path) -> Result<Raster> {
    use tiff::ColorType;
    let error = |error: tiff::TiffError| match error {
        tiff::TiffError::UnsupportedError(what) => {
            content(path, format!("expected a grey or RGB TIFF, found: {what}"))
        }
        error => broken(path, Format::Tiff, error),
    };
    let (page, passed_over) = full_page(bytes, path)?;
    let mut bytes = Cow::Borrowed(bytes);
    if let Some(page) = page {
        let file = TiffBytes(&bytes);
        if file.longest_text(page) > bytes.len() as u64 {
            return Err(broken(path, Format::Tiff, "a text longer than the file"));
        }
        if file.first_page() != Some(page) {
            check_memory(path, bytes.len() as u64)?;
            let at = file.word();
            put(bytes.to_mut(), at, page, at);
        }
    }
    let open = |bytes| {
        let mut limits = tiff::decoder::Limits::default();
        limits.decoding_buffer_size = MAX_PIXELS as usize * 16; // RGBA in float
        limits.intermediate_buffer_size = limits.decoding_buffer_size;
        limits.ifd_value_size = 1 << 26; // large profiles, long lists of strips
        tiff::decoder::Decoder::new(Cursor::new(bytes)).map(|decoder| decoder.with_limits(limits))
    };
    let mut decoder = open(&bytes[..]).map_err(error)?;
    let (width, height) = decoder.dimensions().map_err(error)?;
    let file_size = bytes.len() as u64;
    let most = TIFF_PIXELS * file_size;
    check_size(path, width.into(), height.into(), most, file_size)?;
    let (channels, bits) = match decoder.colortype().map_err(error)? {
        ColorType::Gray(bits) => (1, bits),
        ColorType::GrayA(bits) => (2, bits),
        ColorType::RGB(bits) => (3, bits),
        ColorType::RGBA(bits) => (4, bits),
        ColorType::Multiband {
            bit_depth,
            num_samples: channels @ 2..=4,
        } => (usize::from(channels), bit_depth),
        other => {
            return Err(content(
                path,
                format!("expected a grey or RGB TIFF, found {other:?}"),
            ));
        }
    };
    if bits < 8 {
        return Err(content(
            path,
            format!("expected 8 bits or more a sample, found {bits}"),
        ));
    }
    let samples = u64::from(width) * u64::from(height) * channels as u64;
    check_memory(path, 2 * samples * u64::from(bits).div_ceil(8))?;
    let orientation = decoder.find_tag_unsigned(Tag::Orientation).map_err(error)?;
    let profile = decoder.find_tag(Tag::IccProfile).map_err(error)?;
    let pixels = width as usize * height as usize;
    let (mut planes, mut plane) = (0, pixels);
    let planar: Option<u16> = decoder
        .find_tag_unsigned(Tag::PlanarConfiguration)
        .map_err(error)?;
    let tall;
    if planar == Some(2) && decoder.get_chunk_type() == ChunkType::Tile {
        let (_, side) = decoder.chunk_dimensions();
        let rows = height.div_ceil(side) * side;
        (planes, plane) = (channels, width as usize * rows as usize);
        check_size(path, width.into(), rows.into(), most, file_size)?;
        let values = 2 * u64::from(bits.div_ceil(8)) * (planes * plane) as u64;
        check_memory(path, file_size + values)?;
        tall = stacked_planes(&bytes, u64::from(rows) * channels as u64);
        decoder = open(&tall[..]).map_err(error)?;
    }
    let mut decoded = DecodingResult::U8(Vec::new());
    let layout = decoder.read_image_to_buffer(&mut decoded).map_err(error)?;
    planes = planes.max(layout.planes);
    let samples = match decoded {
        DecodingResult::U8(values) => Samples::U8(interleave(values, planes, plane, pixels)),
        DecodingResult::U16(values) => Samples::U16(interleave(values, planes, plane, pixels)),
        DecodingResult::F32(values) => Samples::F32(interleave(values, planes, plane, pixels)),
        DecodingResult::F16(values) => {
            let values = values.into_iter().map(|value| value.to_f32()).collect();
            Samples::F32(interleave(values, planes, plane, pixels))
        }
        DecodingResult::F64(values) => {
            let values = values.into_iter().map(|value| value as f32).collect();
            Samples::F32(interleave(values, planes, plane, pixels))
        }
        _ => {
            let expected = "expected 8 or 16-bit unsigned integers or floats";
            let found = format!("{bits}-bit {:?} samples", layout.sample_format);
            return Err(content(path, format!("{expected}, found {found}")));
        }
    };
    let shape = [width as usize, height as usize, channels];
    Ok(Raster {
        icc_profile: profile
            .map(|value| value.into_u8_vec())
            .transpose()
            .map_err(error)?,
        orientation: orientation
            .filter(|value| (1..=8).contains(value))
            .unwrap_or(1),
        passed_over,
        ..Raster::plain(Format::Tiff, shape, samples)
    })
}

/// Where the directory of the one picture in a TIFF is, and how many smaller pages there
/// are beside: thumbnails, the levels of a pyramid. `None` where no directory is whole,
/// which is the decoder's to refuse.
fn full_page(bytes: &[u8], path: &Path) -> Result<(Option<u64>, usize)> {
    let file = TiffBytes(bytes);
    let mut pages = file.pages();
    if pages.iter().all(|page| page.reduced) {
        // Beside thumbnails alone the picture lies in a directory below.
        let below: Vec<_> = pages.iter().flat_map(|page| file.below(page.at)).collect();
        pages.extend(below);
    }
    let total = pages.len();
    if pages.iter().any(|page| !page.reduced) {
        pages.retain(|page| !page.reduced);
    }
    let area = |page: &&Page| page.width.saturating_mul(page.height);
    let Some(largest) = pages.iter().max_by_key(area) else {
        return Ok((None, 0));
    };
    // The next level of a pyramid has half the sides, rounded up.
    let [width, height] = [largest.width, largest.height].map(|side| side.div_ceil(2));
    let is_level = |page: &&Page| page.width <= width && page.height <= height;
    let count = pages.len() - pages.iter().filter(is_level).count();
    if count > 1 {
        let found = format!("expected one picture, found {count} pages: save each as a file");
        return Err(content(path, found));
    }
    Ok((Some(largest.at), total - 1))
}

/// A page of a TIFF.
struct Page {
    /// Where its directory begins.
    at: u64,
    width: u64,
    height: u64,
    /// Whether it says that it is a smaller version, or a mask, of another.
    reduced: bool,
}

/// Most pages of a TIFF that are looked at.
const MOST_PAGES: usize = 1024;

/// The directories of a TIFF (TIFF 6.0, section 2; BigTIFF has 8 bytes where TIFF has 4).
struct TiffBytes<'a>(&'a [u8]);

/// One tag in a directory.
struct Entry {
    tag: u64,
    kind: u64,
    count: u64,
    /// Where it begins.
    at: u64,
}

impl TiffBytes<'_> {
    /// Bytes of an offset; the first directory's stands behind as many.
    fn word(&self) -> u64 {
        let big = matches!(self.0.get(2..4), Some([0x2b, 0] | [0, 0x2b]));
        if big { 8 } else { 4 }
    }

    fn number(&self, at: u64, size: u64) -> Option<u64> {
        let range = usize::try_from(at).ok()?..usize::try_from(at.checked_add(size)?).ok()?;
        let digits = self.0.get(range)?.iter();
        let join = |number: u64, &digit: &u8| number << 8 | u64::from(digit);
        Some(match self.0.starts_with(b"II") {
            true => digits.rev().fold(0, join),
            false => digits.fold(0, join),
        })
    }

    fn first_page(&self) -> Option<u64> {
        self.number(self.word(), self.word())
    }

    /// The tags of a directory, as far as it is whole, and where the next one begins.
    fn directory(&self, at: u64) -> (Vec<Entry>, u64) {
        let (count_size, entry_size) = if self.word() == 8 { (8, 20) } else { (2, 12) };
        let count = self.number(at, count_size).unwrap_or(0);
        let count = count.min(self.0.len() as u64 / entry_size);
        let start = at.saturating_add(count_size);
        let entries = (0..count).map_while(|k| {
            let at = start + k * entry_size;
            Some(Entry {
                tag: self.number(at, 2)?,
                kind: self.number(at + 2, 2)?,
                count: self.number(at + 4, self.word())?,
                at,
            })
        });
        let next = self.number(start + count * entry_size, self.word());
        (entries.collect(), next.unwrap_or(0))
    }

    /// Bytes that an entry's values take, and where they are: in it, if they fit.
    fn values(&self, entry: &Entry) -> (u64, u64) {
        let size = [1, 1, 2, 4, 8, 1, 1, 2, 4, 8, 4, 8, 4, 8, 8, 8, 8, 8];
        let kind = usize::try_from(entry.kind).unwrap_or(0).wrapping_sub(1);
        let size = size.get(kind).copied().unwrap_or(1);
        let inside = entry.at + 4 + self.word();
        let fits = entry.count.saturating_mul(size) <= self.word();
        let outside = || self.number(inside, self.word()).unwrap_or(u64::MAX);
        (size, if fits { inside } else { outside() })
    }

    /// Longest text that a directory tells of. The decoder of `tiff` 0.11 takes memory for
    /// texts of up to 4 GiB before it reads them, and prints a line about longer ones.
    fn longest_text(&self, at: u64) -> u64 {
        const ASCII: u64 = 2;
        let entries = self.directory(at).0.into_iter();
        let texts = entries.filter(|entry| entry.kind == ASCII);
        texts.map(|entry| entry.count).max().unwrap_or(0)
    }

    fn page(&self, at: u64) -> (Page, u64) {
        let (entries, next) = self.directory(at);
        let value = |tag| {
            let entry = entries.iter().find(|entry| entry.tag == tag)?;
            let (size, at) = self.values(entry);
            self.number(at, size)
        };
        let kinds = value(254).unwrap_or(0); // bits: smaller version, page, mask
        let page = Page {
            at,
            width: value(256).unwrap_or(0),
            height: value(257).unwrap_or(0),
            reduced: kinds & 0b101 != 0 || value(255) == Some(2),
        };
        (page, next)
    }

    /// All pages, in the order of the file.
    fn pages(&self) -> Vec<Page> {
        let mut pages: Vec<Page> = Vec::new();
        let mut next = self.first_page().unwrap_or(0);
        for _ in 0..MOST_PAGES {
            if next == 0 || pages.iter().any(|page| page.at == next) {
                break;
            }
            let (page, after) = self.page(next);
            if page.width > 0 || pages.is_empty() {
                pages.push(page);
            }
            next = after;
        }
        pages
    }

    /// Pages below one, by its tag SubIFDs.
    fn below(&self, at: u64) -> Vec<Page> {
        let (entries, _) = self.directory(at);
        let Some(entry) = entries.iter().find(|entry| entry.tag == 330) else {
            return Vec::new();
        };
        let (size, at) = self.values(entry);
        let places = (0..entry.count.min(MOST_PAGES as u64))
            .map_while(|k| self.number(at.checked_add(k * size)?, size));
        places.map(|place| self.page(place).0).collect()
    }
}

/// Writes a number of some bytes in a TIFF's byte order.
fn put(bytes: &mut [u8], at: u64, value: u64, size: u64) {
    let (at, size) = (at as usize, size as usize);
    match bytes.starts_with(b"II") {
        true => bytes[at..at + size].copy_from_slice(&value.to_le_bytes()[..size]),
        false => bytes[at..at + size].copy_from_slice(&value.to_be_bytes()[8 - size..]),
    }
}

/// A TIFF of tiles in separate planes as one in grey, whose planes lie one below the
/// other: it has the same tiles in the same order. The decoder of `tiff` 0.11 takes the
/// lowest tiles of all planes but the first for whole ones.
fn stacked_planes(bytes: &[u8], rows: u64) -> Vec<u8> {
    let mut tall = bytes.to_vec();
    let file = TiffBytes(bytes);
    let (entries, _) = file.directory(file.first_page().unwrap_or(0));
    for entry in entries {
        let first = || {
            let (size, at) = file.values(&entry);
            file.number(at, size).unwrap_or(0)
        };
        let value = match entry.tag {
            257 => rows,
            258 | 339 => first(), // bits, sample format: of one sample
            262 => u64::from(first() != 0), // white is zero, else black
            277 | 284 => 1,       // one sample, no planes
            338 => {
                put(&mut tall, entry.at, 65000, 2); // no alpha: a tag that nobody reads
                continue;
            }
            _ => continue,
        };
        let word = file.word();
        put(&mut tall, entry.at + 2, 4, 2); // LONG
        put(&mut tall, entry.at + 4, 1, word);
        put(&mut tall, entry.at + 4 + word, value, 4);
    }
    tall
}

/// Planes stored one after another, each beginning `plane` values behind the other, become
/// interleaved samples.
fn interleave<T: Copy>(values: Vec<T>, planes: usize, plane: usize, pixels: usize) -> Vec<T> {
    if planes <= 1 && plane == pixels || values.len() != planes * plane {
        return values; // a wrong length is found by the caller
    }
    (0..pixels)
        .flat_map(|pixel| (0..planes).map(move |k| k * plane + pixel))
        .map(|i| values[i])
        .collect()
}

fn decode_hdr(bytes: &[u8], path: &Path) -> Result<Raster> {
    let error = |error: image::ImageError| broken(path, Format::Hdr, error);
    // Not strict: the signature `#?RGBE` and odd optional lines are fine.
    let decoder = HdrDecoder::with_strictness(Cursor::new(bytes), false).map_err(error)?;
    let (width, height) = decoder.dimensions();
    let file_size = bytes.len() as u64;
    let most = HDR_PIXELS * file_size;
    check_size(path, width.into(), height.into(), most, file_size)?;
    check_memory(path, 12 * u64::from(width) * u64::from(height))?;
    let image = DynamicImage::from_decoder(decoder).map_err(error)?;
    let shape = [width as usize, height as usize, 3];
    let samples = Samples::F32(image.into_rgb32f().into_raw());
    Ok(Raster::plain(Format::Hdr, shape, samples))
}

/// Samples of a PNG to be written.
#[derive(Clone, Copy, Debug)]
pub enum PngSamples<'a> {
    /// 8 bits.
    U8(&'a [u8]),
    /// 16 bits.
    U16(&'a [u16]),
}

/// What a PNG says about the encoding of its samples.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PngTag {
    /// sRGB: the sRGB chunk.
    Srgb,
    /// Proportional to what they measure: a gAMA chunk of 1.
    Linear,
    /// Nothing.
    Untagged,
}

/// Writes what [`encode_png`] makes. The file is there as a whole or not at
/// all.
///
/// # Errors
/// As [`encode_png`]; [`Error::Io`] if the file cannot be written.
pub fn write_png(
    path: &Path,
    samples: PngSamples<'_>,
    shape: [usize; 3],
    tag: PngTag,
) -> Result<()> {
    write_atomically(path, &encode_png(samples, shape, tag)?)
}

/// The bytes of a PNG of 1 grey, 2 grey and alpha, 3 RGB or 4 RGBA channels.
/// Equal input gives equal bytes.
///
/// # Errors
/// [`Error::Argument`] if the samples are not `height * width * channels`.
pub fn encode_png(
    samples: PngSamples<'_>,
    [height, width, channels]: [usize; 3],
    tag: PngTag,
) -> Result<Vec<u8>> {
    let (count, depth) = match samples {
        PngSamples::U8(samples) => (samples.len(), BitDepth::Eight),
        PngSamples::U16(samples) => (samples.len(), BitDepth::Sixteen),
    };
    let pixels = (width as u64).saturating_mul(height as u64);
    let color = match channels {
        1 => png::ColorType::Grayscale,
        2 => png::ColorType::GrayscaleAlpha,
        3 => png::ColorType::Rgb,
        _ => png::ColorType::Rgba,
    };
    if !(1..=4).contains(&channels)
        || pixels == 0
        || pixels > MAX_PIXELS
        || count != width * height * channels
    {
        return Err(Error::argument(
            "image",
            format!("(H, W) or (H, W, 1 to 4) with 1 to {MAX_PIXELS} pixels"),
            format!("{count} samples as ({height}, {width}, {channels})"),
        ));
    }
    let mut bytes = Vec::new();
    // Both sides fit 32 bits because their product does.
    let mut encoder = png::Encoder::new(&mut bytes, width as u32, height as u32);
    encoder.set_color(color);
    encoder.set_depth(depth);
    match tag {
        PngTag::Srgb => encoder.set_source_srgb(png::SrgbRenderingIntent::Perceptual),
        PngTag::Linear => encoder.set_source_gamma(png::ScaledFloat::new(1.0)),
        PngTag::Untagged => {}
    }
    let encode = || -> std::result::Result<(), png::EncodingError> {
        let mut writer = encoder.write_header()?;
        match samples {
            PngSamples::U8(samples) => writer.write_image_data(samples)?,
            PngSamples::U16(samples) => {
                let big_endian: Vec<u8> = samples.iter().flat_map(|v| v.to_be_bytes()).collect();
                writer.write_image_data(&big_endian)?;
            }
        }
        writer.finish()
    };
    encode().map_err(|error| Error::argument("image", "samples for a PNG", error.to_string()))?;
    Ok(bytes)
}
