//! PNG, JPEG, TIFF and Radiance HDR in, PNG out.

use std::borrow::Cow;
use std::fs::File;
use std::io::{BufReader, Cursor, Read, Seek};
use std::path::Path;

use image::codecs::hdr::HdrDecoder;
use image::codecs::jpeg::JpegDecoder;
use image::metadata::Orientation;
use image::{DynamicImage, ImageDecoder};
use png::{BitDepth, Transformations};
use tiff::decoder::ifd::Entry;
use tiff::decoder::{ChunkType, Decoder as TiffDecoder, DecodingResult, Limits};
use tiff::tags::{ByteOrder, IfdPointer, Tag, Type};

use super::{Format, LARGEST_TILE, MAX_PIXELS, Room, broken, check_size, content, guarded};
use crate::runtime::{Error, Result};

/// Most bytes that one byte of deflated data stands for: runs of 258 in two bits.
const DEFLATED: u64 = 1032;

/// Most pixels of a JPEG in one byte. Every block of 8 x 8 takes a bit or more in
/// some scan, and at the oddest sampling nine blocks cover 1024 pixels.
const JPEG_PIXELS: u64 = 1024;

/// Most pixels of a TIFF in one byte: a deflated byte holds 1032 of 8 bits, LZW not more than 1500.
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

/// A decoded picture file. No colour was converted and the orientation was not applied.
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
    pub chromaticities: Option<[(f32, f32); 4]>,
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
/// below 8 bits is not spread over 0 to 255. `page` is the number of one of several pictures in
/// a TIFF, see [`count_tiff_pages`]; with `None` there has to be one.
///
/// `path` is for the messages.
///
/// # Errors
/// [`Error::Content`] for other formats, CMYK, more than 2^28 pixels, and damaged or cut-off files.
pub fn decode_raster(
    bytes: &[u8],
    path: &Path,
    indices: bool,
    page: Option<usize>,
) -> Result<Raster> {
    let raster = guarded(path, || match Format::of(bytes) {
        Some(Format::Png) => decode_png(bytes, path, indices),
        Some(Format::Jpeg) => decode_jpeg(bytes, path),
        Some(Format::Tiff) => decode_tiff(bytes, path, page),
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
    let _room = Room::of(path, 2 * size as u64)?; // stored samples and those that are returned
    let mut buffer = vec![0; size];
    let output = reader.next_frame(&mut buffer).map_err(error)?;
    buffer.truncate(output.buffer_size());
    // The rest of the chunks, the end chunk included: a cut-off file fails here.
    reader.finish().map_err(error)?;

    let samples = match output.bit_depth {
        BitDepth::Sixteen => {
            let pairs = buffer.as_chunks().0.iter();
            Samples::U16(pairs.map(|&pair| u16::from_be_bytes(pair)).collect())
        }
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
            let points = [chrm.red, chrm.green, chrm.blue, chrm.white];
            points.map(|(x, y)| (x.into_value(), y.into_value()))
        }),
        ..Raster::plain(Format::Png, shape, samples)
    })
}

/// Samples of 1, 2 or 4 bits, the first in the high bits, each row starting on a byte.
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
    let _room = Room::of(path, 9 * u64::from(width) * u64::from(height))?;
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

fn decode_tiff(bytes: &[u8], path: &Path, page: Option<usize>) -> Result<Raster> {
    use tiff::ColorType::{CMYK, Lab, Palette, YCbCr};
    let error = |error: tiff::TiffError| match error {
        tiff::TiffError::UnsupportedError(what) => {
            content(path, format!("expected a grey or RGB TIFF, found: {what}"))
        }
        error => broken(path, Format::Tiff, error),
    };
    let open = |bytes| TiffDecoder::new(Cursor::new(bytes)).map_err(error);
    let file_size = bytes.len() as u64;
    let mut decoder = open(Cow::Borrowed(bytes))?;
    let (pages, passed_over) = full_pages(&mut decoder, path)?;
    if let (None, count @ 2..) = (page, pages.len()) {
        let found = format!("expected one picture, found {count} pages: save each as a file");
        return Err(content(path, found));
    }
    let Some(page) = pages.get(page.unwrap_or(0)) else {
        return Err(broken(path, Format::Tiff, "fewer pages"));
    };
    let (at, index) = page.place;
    if let Some(index) = index {
        decoder.seek_to_image(index).map_err(error)?;
    } else {
        let _room = Room::of(path, file_size)?;
        // The decoder finds a directory below a page only if the file begins with it.
        let word = if bytes[2..4].contains(&43) { 8 } else { 4 }; // bytes of BigTIFF's offsets
        let offset = match decoder.byte_order() {
            ByteOrder::LittleEndian => at.0.to_le_bytes()[..word].to_vec(),
            ByteOrder::BigEndian => at.0.to_be_bytes()[8 - word..].to_vec(),
        };
        let patched = [&bytes[..word], &offset, &bytes[2 * word..]].concat();
        decoder = open(Cow::Owned(patched))?;
    }
    // `tiff` 0.11 takes memory for texts of up to the limit below before it reads them.
    let too_long = |entry: &Entry| entry.field_type() == Type::ASCII && entry.count() > file_size;
    let tags = decoder.image_ifd();
    if tags.directory().iter().any(|(_, entry)| too_long(entry)) {
        return Err(broken(path, Format::Tiff, "a text longer than the file"));
    }
    let mut limits = Limits::default();
    limits.decoding_buffer_size = MAX_PIXELS as usize * 16; // RGBA in float
    limits.intermediate_buffer_size = limits.decoding_buffer_size;
    limits.ifd_value_size = 1 << 26; // large profiles, long lists of strips
    decoder = decoder.with_limits(limits.clone());
    let (width, height) = decoder.dimensions().map_err(error)?;
    let most = TIFF_PIXELS * file_size;
    check_size(path, width.into(), height.into(), most, file_size)?;
    let color = decoder.colortype().map_err(error)?;
    let (channels, bits) = (usize::from(color.num_samples()), color.bit_depth());
    let jpeg = decoder.find_tag_unsigned(Tag::Compression).map_err(error)? == Some(7_u16);
    let unread = match color {
        YCbCr(8) => !jpeg, // there may be other coefficients than those of JPEG files
        color => matches!(color, Palette(_) | CMYK(_) | YCbCr(_) | Lab(_)),
    };
    if unread || !(1..=4).contains(&channels) {
        let found = format!("expected a grey or RGB TIFF, found {color:?}");
        return Err(content(path, found));
    }
    if bits < 8 {
        let found = format!("expected 8 bits or more a sample, found {bits}");
        return Err(content(path, found));
    }
    let samples = u64::from(width) * u64::from(height) * channels as u64;
    let copies = u64::from(bits).div_ceil(8) * 2 + 2; // half floats become floats beside them
    let _room = Room::of(path, samples * copies)?;
    let orientation = decoder.find_tag_unsigned(Tag::Orientation).map_err(error)?;
    let orientation = orientation.filter(|one| (1..=8).contains(one));
    let profile = decoder.find_tag_unsigned_vec(Tag::IccProfile);
    let layout = decoder.image_buffer_layout().map_err(error)?;
    let planes = layout.planes;
    let mut decoded = DecodingResult::U8(Vec::new());
    if planes > 1 && decoder.get_chunk_type() == ChunkType::Tile {
        read_planes_of_tiles(&mut decoder, &mut decoded, &limits).map_err(error)?;
    } else {
        decoder.read_image_to_buffer(&mut decoded).map_err(error)?;
    }
    let samples = match decoded {
        DecodingResult::U8(values) if matches!(color, YCbCr(_)) => Samples::U8(to_rgb(values)),
        DecodingResult::U8(values) => Samples::U8(interleave(values, planes, |value| value)),
        DecodingResult::U16(values) => Samples::U16(interleave(values, planes, |value| value)),
        DecodingResult::F16(values) => Samples::F32(interleave(values, planes, |v| v.to_f32())),
        DecodingResult::F32(values) => Samples::F32(interleave(values, planes, |value| value)),
        DecodingResult::F64(values) => Samples::F32(interleave(values, planes, |v| v as f32)),
        _ => {
            let expected = "expected 8 or 16-bit unsigned integers or floats";
            let found = format!("{bits}-bit {:?} samples", layout.sample_format);
            return Err(content(path, format!("{expected}, found {found}")));
        }
    };
    let shape = [width as usize, height as usize, channels];
    Ok(Raster {
        icc_profile: profile.map_err(error)?,
        orientation: orientation.unwrap_or(1),
        passed_over,
        ..Raster::plain(Format::Tiff, shape, samples)
    })
}

/// Most directories of a TIFF that are looked at.
const MOST_PAGES: usize = 1024;

/// Where the directory of a page begins, and its number; `None` if it lies below another page.
type Place = (IfdPointer, Option<usize>);

/// A page of a TIFF.
struct Page {
    place: Place,
    /// Width, height, then the bits of each sample.
    kind: Vec<u64>,
    /// Whether it says that it is a smaller version, or a mask, of another.
    reduced: bool,
}

/// The number of pictures in a TIFF file: pages of full resolution.
///
/// # Errors
/// [`Error::Content`] if they differ in size or bits, or the file has no page; [`Error::Io`] if
/// it cannot be read.
pub fn count_tiff_pages(path: &Path) -> Result<usize> {
    let file = File::open(path).map_err(|source| Error::io(path, source))?;
    guarded(path, || {
        let decoder = TiffDecoder::new(BufReader::new(file));
        let mut decoder = decoder.map_err(|error| broken(path, Format::Tiff, error))?;
        Ok(full_pages(&mut decoder, path)?.0.len())
    })
}

/// Reads a page and adds to `places` the directory of the next one and, beside a thumbnail,
/// those below it. `None` where its directory is not whole or without a size.
fn page<R: Read + Seek>(
    decoder: &mut TiffDecoder<R>,
    place: Place,
    places: &mut Vec<Place>,
) -> Option<Page> {
    let directory = decoder.read_directory(place.0).ok()?;
    places.extend(directory.next().map(|at| (at, place.1.map(|i| i + 1))));
    let few = |list: &Entry| list.count() <= MOST_PAGES as u64;
    let mut tags = decoder.read_directory_tags(&directory);
    let mut values = |tag| tags.find_tag_unsigned_vec::<u64>(tag).ok().flatten();
    let mut value = |tag| values(tag)?.first().copied();
    let kinds = value(Tag::NewSubfileType).unwrap_or(0); // bits: smaller version, page, mask
    let reduced = kinds & 0b101 != 0 || value(Tag::SubfileType) == Some(2);
    let mut kind = vec![value(Tag::ImageWidth)?, value(Tag::ImageLength)?];
    kind.extend(values(Tag::BitsPerSample).unwrap_or_default());
    if reduced && directory.get(Tag::SubIfd).is_some_and(few) {
        let below = values(Tag::SubIfd).unwrap_or_default();
        places.extend(below.into_iter().map(|at| (IfdPointer(at), None)));
    }
    Some(Page {
        place,
        kind,
        reduced,
    })
}

/// The pages of full resolution in a TIFF, and how many smaller ones there are beside:
/// thumbnails, the levels of a pyramid.
fn full_pages<R: Read + Seek>(
    decoder: &mut TiffDecoder<R>,
    path: &Path,
) -> Result<(Vec<Page>, usize)> {
    let mut pages: Vec<Page> = Vec::new();
    let mut places = Vec::from_iter(decoder.ifd_pointer().map(|at| (at, Some(0))));
    for _ in 0..MOST_PAGES {
        let Some(place) = places.pop() else { break };
        if pages.iter().all(|page| page.place.0 != place.0) {
            pages.extend(page(decoder, place, &mut places));
        }
    }
    let total = pages.len();
    if pages.iter().any(|page| !page.reduced) {
        pages.retain(|page| !page.reduced);
    }
    let area = |page: &&Page| page.kind[0].saturating_mul(page.kind[1]);
    let Some(largest) = pages.iter().max_by_key(area) else {
        return Err(broken(path, Format::Tiff, "no page"));
    };
    // The next level of a pyramid has half the sides, rounded up.
    let [width, height] = [0, 1].map(|side| largest.kind[side].div_ceil(2));
    pages.retain(|page| page.kind[0] > width || page.kind[1] > height);
    let count = pages.len();
    if pages.iter().any(|page| page.kind != pages[0].kind) {
        let found = format!("found {count} pages that differ: save each as a file");
        let expected = "expected one picture, or pages of one size and kind";
        return Err(content(path, format!("{expected}, {found}")));
    }
    Ok((pages, total - count))
}

/// Reads tiles of separate planes into planes one after another. `tiff` 0.11 takes the last row
/// of tiles to be cut off at the picture's edge in the first plane alone, so that it cannot
/// read the planes as a whole; the tiles by themselves it can.
fn read_planes_of_tiles<R: Read + Seek>(
    decoder: &mut TiffDecoder<R>,
    decoded: &mut DecodingResult,
    limits: &Limits,
) -> tiff::TiffResult<()> {
    let layout = decoder.image_buffer_layout()?;
    decoded.resize_to(&layout, limits)?;
    let (width, height) = decoder.dimensions()?;
    let (tile_width, tile_height) = decoder.chunk_dimensions();
    if u64::from(tile_width) * u64::from(tile_height) > LARGEST_TILE.max(layout.len as u64) {
        return Err(tiff::TiffError::LimitsExceeded); // before memory is taken for one
    }
    let across = width.div_ceil(tile_width);
    let tiles = across * height.div_ceil(tile_height);
    let stride = layout.len / height as usize; // bytes of a row of one plane
    let sample = stride / width as usize;
    let mut planes = decoded.as_buffer(0);
    let planes = planes.as_bytes_mut().chunks_exact_mut(layout.len);
    for (plane, bytes) in planes.enumerate() {
        for tile in 0..tiles {
            let index = plane as u32 * tiles + tile;
            let (wide, high) = decoder.chunk_data_dimensions(index);
            let row = wide as usize * sample;
            let mut lines = vec![0; row * high as usize];
            decoder.read_chunk_bytes(index, &mut lines)?;
            let top = (tile / across * tile_height) as usize * stride;
            let left = (tile % across * tile_width) as usize * sample;
            let target = bytes[top..].chunks_exact_mut(stride);
            for (line, to) in lines.chunks_exact(row).zip(target) {
                to[left..left + row].copy_from_slice(line);
            }
        }
    }
    Ok(())
}

/// Y, Cb and Cr as of JPEG files become R, G and B: Y = 0.299 R + 0.587 G + 0.114 B, and Cb and Cr
/// are B − Y and R − Y over 1.772 and 1.402, around 128.
fn to_rgb(mut samples: Vec<u8>) -> Vec<u8> {
    for pixel in samples.as_chunks_mut::<3>().0 {
        let [y, blue, red] = pixel.map(f32::from);
        let (red, blue) = (y + 1.402 * (red - 128.0), y + 1.772 * (blue - 128.0));
        let green = (y - 0.299 * red - 0.114 * blue) / 0.587;
        *pixel = [red, green, blue].map(|value| value.round() as u8); // saturates
    }
    samples
}

/// Planes stored one after another become interleaved samples of another type.
fn interleave<T: Copy, U>(values: Vec<T>, planes: usize, sample: impl Fn(T) -> U) -> Vec<U> {
    if planes == 1 {
        return values.into_iter().map(sample).collect(); // in place if the type stays
    }
    let pixels = values.len() / planes;
    let place = |i| i % planes * pixels + i / planes;
    (0..values.len())
        .map(|i| sample(values[place(i)]))
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
    let _room = Room::of(path, 12 * u64::from(width) * u64::from(height))?;
    let image = DynamicImage::from_decoder(decoder).map_err(error)?;
    let shape = [width as usize, height as usize, 3];
    let samples = Samples::F32(image.into_rgb32f().into_raw());
    Ok(Raster::plain(Format::Hdr, shape, samples))
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

/// The bytes of a PNG of 1 grey, 2 grey and alpha, 3 RGB or 4 RGBA channels.
/// Equal input gives equal bytes.
///
/// # Errors
/// [`Error::Argument`] if the samples are not `height * width * channels` integers.
pub fn encode_png(
    samples: &Samples,
    [height, width, channels]: [usize; 3],
    tag: PngTag,
) -> Result<Vec<u8>> {
    // Samples in the file's order, and a file that grows by halves or more.
    let _room = Room::of(Path::new("image"), 8 * samples.len() as u64)?;
    let (depth, data) = match samples {
        Samples::U8(samples) => (BitDepth::Eight, Cow::Borrowed(&samples[..])),
        Samples::U16(samples) => {
            let big_endian = samples.iter().flat_map(|value| value.to_be_bytes());
            (BitDepth::Sixteen, big_endian.collect())
        }
        Samples::F32(_) => return Err(Error::argument("image", "integers", "floats")),
    };
    let count = samples.len();
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
        let expected = format!("(H, W) or (H, W, 1 to 4) with 1 to {MAX_PIXELS} pixels");
        let found = format!("{count} samples as ({height}, {width}, {channels})");
        return Err(Error::argument("image", expected, found));
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
        writer.write_image_data(&data)?;
        writer.finish()
    };
    encode().map_err(|error| Error::argument("image", "samples for a PNG", error.to_string()))?;
    Ok(bytes)
}
