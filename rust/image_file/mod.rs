//! Picture files in and out: the one place that names `exr`, `image`, `png`, `tiff` and `moxcms`.
//!
//! Nothing here decides on a colour: samples come out as they are stored, with
//! what the file says about them beside, and go through curves that are given. Every decoder gets a whole file in
//! memory and every encoder makes one, so a half-read or half-written file
//! cannot be mistaken for a whole one.

mod exr;
mod icc;
mod light;
mod raster;

use std::cell::Cell;
use std::ffi::OsString;
use std::fs::{self, File};
use std::io::Write;
use std::panic::{self, AssertUnwindSafe, catch_unwind};
use std::path::{Path, PathBuf};
use std::sync::Once;
use std::sync::atomic::{AtomicU64, Ordering};

pub use self::exr::{Exr, ExrChannel, decode_exr, write_exr};
pub use self::icc::{IccProfile, decode_icc};
pub use self::light::{Stored, averaged};
pub use self::raster::{PngTag, Raster, Samples, count_tiff_pages, decode_raster, encode_png};

use crate::runtime::ending::{self, Unfinished};
use crate::runtime::{Error, Result};

/// Largest accepted picture, in pixels: 16384 by 16384.
pub const MAX_PIXELS: u64 = 1 << 28;

/// Most pixels of a tile that is larger than the picture.
const LARGEST_TILE: u64 = 1 << 22;

/// The file formats that are read.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Format {
    /// OpenEXR.
    Exr,
    /// Portable network graphics.
    Png,
    /// JPEG (JFIF or EXIF).
    Jpeg,
    /// TIFF, BigTIFF included.
    Tiff,
    /// Radiance RGBE.
    Hdr,
}

impl Format {
    /// The format by the first bytes of the file; its name is not consulted.
    pub fn of(bytes: &[u8]) -> Option<Self> {
        let starts: [(&[u8], Self); 9] = [
            (b"\x76\x2f\x31\x01", Self::Exr),
            (b"\x89PNG\r\n\x1a\n", Self::Png),
            (b"\xff\xd8\xff", Self::Jpeg),
            (b"II\x2a\0", Self::Tiff),
            (b"MM\0\x2a", Self::Tiff),
            (b"II\x2b\0", Self::Tiff),
            (b"MM\0\x2b", Self::Tiff),
            (b"#?RADIANCE", Self::Hdr),
            (b"#?RGBE", Self::Hdr),
        ];
        starts
            .into_iter()
            .find(|(start, _)| bytes.starts_with(start))
            .map(|(_, format)| format)
    }

    /// As users know it.
    pub fn name(self) -> &'static str {
        match self {
            Self::Exr => "EXR",
            Self::Png => "PNG",
            Self::Jpeg => "JPEG",
            Self::Tiff => "TIFF",
            Self::Hdr => "HDR",
        }
    }
}

/// Letters of a reason that are shown.
const LONGEST_REASON: usize = 400;

/// An error about a file. Reasons quote what files hold, so they are made one
/// printable line of bounded length here.
fn content(path: &Path, reason: impl ToString) -> Error {
    let reason = reason.to_string();
    let mut line = String::with_capacity(reason.len().min(LONGEST_REASON));
    for (shown, letter) in reason.chars().enumerate() {
        if shown == LONGEST_REASON {
            line.push('…');
            break;
        }
        // What Debug escapes moves the cursor, hides other letters or has no shape at all; quotation
        // marks and backslashes are fine.
        match letter {
            '\'' | '"' | '\\' => line.push(letter),
            letter => line.extend(letter.escape_debug()),
        }
    }
    Error::Content {
        path: path.to_owned(),
        reason: line,
    }
}

fn broken(path: &Path, format: Format, error: impl std::fmt::Display) -> Error {
    content(
        path,
        format!("expected a whole {} file, found: {error}", format.name()),
    )
}

/// Refuses a size, before anything is allocated for it, that is beyond the limit or more than
/// `most` pixels, which is what no encoder could have squeezed into a file of `file_size` bytes.
fn check_size(path: &Path, width: u64, height: u64, most: u64, file_size: u64) -> Result<()> {
    // Both sides are at most 32 bits wide in every format, so the product cannot wrap.
    let pixels = width * height;
    if pixels == 0 || pixels > MAX_PIXELS {
        let reason = format!("expected 1 to {MAX_PIXELS} pixels, found {width} x {height}");
        return Err(content(path, reason));
    }
    if pixels > most {
        return Err(content(
            path,
            format!("expected a sound file, found {width} x {height} pixels in {file_size} bytes"),
        ));
    }
    Ok(())
}

/// Bytes that a decoder takes for tables and lines, beside pixels.
const TABLES: u64 = 4 << 20;

/// Bytes that decoders and encoders at work may still take.
static PROMISED: AtomicU64 = AtomicU64::new(0);

/// Memory that a decoder or encoder may take until this is dropped.
struct Room(u64);

impl Room {
    /// Refuses what the machine has no memory for, as far as it can be asked, beside what was
    /// promised to other threads: the libraries of formats end the process where memory is refused.
    fn of(path: &Path, pixels: u64) -> Result<Self> {
        let bytes = pixels + TABLES;
        let room = Self(bytes);
        let promised = PROMISED.fetch_add(bytes, Ordering::Relaxed) + bytes;
        let all = usize::try_from(promised).unwrap_or(usize::MAX);
        let found = Vec::<u8>::new().try_reserve_exact(all);
        found.map_err(|_| {
            let mebibytes = bytes.div_ceil(1 << 20);
            let expected = format!("expected {mebibytes} MiB of memory for its pixels");
            content(path, expected + ", found less")
        })?;
        Ok(room)
    }
}

impl Drop for Room {
    fn drop(&mut self) {
        PROMISED.fetch_sub(self.0, Ordering::Relaxed);
    }
}

/// Runs a decoder on bytes that nobody vouches for. These libraries return
/// errors for bad files; should one panic after all, that too is a fact about
/// the file and becomes an error that names it, and nothing is printed.
fn guarded<T>(path: &Path, decode: impl FnOnce() -> Result<T>) -> Result<T> {
    quiet_guarded_panics();
    GUARDED.set(true);
    let result = catch_unwind(AssertUnwindSafe(decode));
    GUARDED.set(false);
    result.unwrap_or_else(|_| {
        Err(content(
            path,
            "expected a sound file, found one its decoder gave up on",
        ))
    })
}

thread_local! {
    /// Whether this thread is inside of [`guarded`].
    static GUARDED: Cell<bool> = const { Cell::new(false) };
}

/// Lets the hook that prints panics pass over those that [`guarded`] catches.
fn quiet_guarded_panics() {
    static ONCE: Once = Once::new();
    ONCE.call_once(|| {
        let before = panic::take_hook();
        panic::set_hook(Box::new(move |info| {
            if !GUARDED.get() {
                before(info);
            }
        }));
    });
}

/// Writes a file, which appears under its name only when all of it is there: the bytes go
/// to a new file in the same folder, which is then renamed.
///
/// # Errors
/// [`Error::Io`] if the file cannot be written.
pub fn write_atomically(path: &Path, bytes: &[u8]) -> Result<()> {
    static COUNTER: AtomicU64 = AtomicU64::new(0);
    let unique = COUNTER.fetch_add(1, Ordering::Relaxed);
    let name = OsString::from(format!(".pbrfit-{}-{unique}.tmp", std::process::id()));
    let temporary: PathBuf = path.with_file_name(name);
    let noted = ending::unfinished(Unfinished {
        temporary: temporary.clone(),
        ..Unfinished::default()
    });
    let write = || {
        let mut file = File::options()
            .write(true)
            .create_new(true)
            .open(&temporary)?;
        file.write_all(bytes)?;
        drop(file);
        fs::rename(&temporary, path)
    };
    let written = write().map_err(|source| {
        let _ = fs::remove_file(&temporary); // the first error is the one to report
        Error::io(path, source)
    });
    ending::finished(noted);
    written
}
