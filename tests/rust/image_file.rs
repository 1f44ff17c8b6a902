//! Picture files written, read back, cut off and damaged.

use std::fs;
use std::path::Path;

use pbrfit::Error;
use pbrfit::image_file::{
    Exr, ExrChannel, Format, PngTag, Samples, decode_exr, decode_icc, decode_raster, encode_png,
    write_atomically, write_exr,
};

fn channel(name: &str, values: &[f32]) -> ExrChannel {
    ExrChannel {
        name: name.into(),
        values: values.into(),
    }
}

fn read_exr(path: &Path) -> Exr {
    decode_exr(&fs::read(path).unwrap(), path).unwrap()
}

fn is_empty(folder: &Path) -> bool {
    fs::read_dir(folder).unwrap().next().is_none()
}

#[test]
fn exr_survives_the_round_trip_bit_for_bit() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("Größe 測定.exr");
    let odd = [0.0, -1.5, f32::INFINITY, 1e-40, f32::MAX, 0.1];
    let channels = vec![channel("R", &odd), channel("albedo.R", &[1.0; 6])];
    write_exr(&path, 3, 2, channels.clone(), false).unwrap();
    let read = read_exr(&path);
    assert_eq!((read.width, read.height), (3, 2));
    assert_eq!(read.channels, channels);
    assert_eq!(
        read.chromaticities,
        Some([0.64, 0.33, 0.30, 0.60, 0.15, 0.06, 0.3127, 0.3290])
    );

    let nan = vec![channel("Y", &[f32::NAN])];
    write_exr(&path, 1, 1, nan, false).unwrap();
    assert!(read_exr(&path).channels[0].values[0].is_nan());
}

#[test]
fn half_rounds_to_eleven_bits_and_overflows_to_infinity() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("half.exr");
    write_exr(&path, 3, 1, vec![channel("Y", &[0.1, 65504.0, 1e6])], true).unwrap();
    // 0.1 = 1638.4 / 16384, so the nearest half is 1638 / 16384.
    let expected = [1638.0 / 16384.0, 65504.0, f32::INFINITY];
    assert_eq!(read_exr(&path).channels[0].values, expected);
}

#[test]
fn equal_input_gives_equal_bytes_in_any_channel_order() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    let values: Vec<f32> = (0..64 * 64).map(|i| (i as f32).sin()).collect();
    let [g, b] = [channel("G", &values), channel("B", &values)];
    write_exr(&path("a"), 64, 64, vec![g.clone(), b.clone()], false).unwrap();
    write_exr(&path("b"), 64, 64, vec![b, g], false).unwrap();
    assert_eq!(fs::read(path("a")).unwrap(), fs::read(path("b")).unwrap());
}

#[test]
fn png_survives_the_round_trip() {
    for channels in 1..=4 {
        let eight: Vec<u8> = (0..3 * 5 * channels)
            .map(|i| (i * 37 % 256) as u8)
            .collect();
        let sixteen: Vec<u16> = (0..3 * 5 * channels)
            .map(|i| (i * 9973 % 65536) as u16)
            .collect();
        for samples in [Samples::U8(eight), Samples::U16(sixteen)] {
            let bytes = encode_png(&samples, [3, 5, channels], PngTag::Srgb).unwrap();
            let read = decode_raster(&bytes, Path::new("a.png"), false, None).unwrap();
            assert_eq!((read.height, read.width, read.channels), (3, 5, channels));
            assert_eq!(read.samples, samples);
        }
    }
}

#[test]
fn wrong_shapes_are_arguments_and_leave_no_file() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a");
    let wrong: [Vec<ExrChannel>; 4] = [
        vec![],
        vec![channel("Y", &[1.0])],
        vec![channel("", &[1.0; 4])],
        vec![channel("Y", &[1.0; 4]), channel("Y", &[1.0; 4])],
    ];
    for channels in wrong {
        let error = write_exr(&path, 2, 2, channels, false).unwrap_err();
        assert!(
            matches!(
                error,
                Error::Argument {
                    name: "channels",
                    ..
                }
            ),
            "{error}"
        );
    }
    for shape in [
        [2, 2, 0],
        [2, 2, 5],
        [0, 2, 1],
        [2, 3, 1],
        [usize::MAX, 2, 1],
    ] {
        let error = encode_png(&Samples::U8(vec![0; 4]), shape, PngTag::Untagged).unwrap_err();
        assert!(
            matches!(error, Error::Argument { name: "image", .. }),
            "{error}"
        );
    }
    assert!(is_empty(folder.path()));
}

#[test]
fn a_file_that_cannot_be_written_leaves_nothing_behind() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("taken");
    fs::create_dir(&path).unwrap(); // a folder cannot be replaced by a file
    let error = write_exr(&path, 1, 1, vec![channel("Y", &[1.0])], false).unwrap_err();
    assert!(
        matches!(&error, Error::Io { path: named, .. } if *named == path),
        "{error}"
    );
    let error = write_atomically(&path, b"PNG").unwrap_err();
    assert!(matches!(error, Error::Io { .. }), "{error}");
    fs::remove_dir(&path).unwrap();
    assert!(is_empty(folder.path()));
    let nowhere = folder.path().join("none/a.exr");
    let error = write_exr(&nowhere, 1, 1, vec![channel("Y", &[1.0])], false).unwrap_err();
    assert!(matches!(error, Error::Io { .. }), "{error}");
}

#[test]
fn cut_off_files_are_errors_that_name_them() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("cut.file");
    write_exr(&path, 5, 20, vec![channel("Y", &[0.25; 100])], false).unwrap();
    let bytes = fs::read(&path).unwrap();
    for length in 0..bytes.len() {
        let error = decode_exr(&bytes[..length], &path).unwrap_err();
        assert!(error.to_string().contains("cut.file: expected"), "{error}");
    }
    let bytes = encode_png(&Samples::U8(vec![7; 300]), [10, 10, 3], PngTag::Srgb).unwrap();
    for length in 0..bytes.len() {
        let error = decode_raster(&bytes[..length], &path, false, None).unwrap_err();
        assert!(error.to_string().contains("cut.file: expected"), "{error}");
    }
}

#[test]
fn a_picture_of_absurd_size_is_refused_before_it_is_allocated() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("huge");
    write_exr(&path, 1, 1, vec![channel("Y", &[1.0])], false).unwrap();
    let mut bytes = fs::read(&path).unwrap();
    let name = b"displayWindow\0box2i\0";
    let start = bytes
        .windows(name.len())
        .position(|window| window == name)
        .unwrap();
    let corner = start + name.len() + 4 + 8; // behind the size and the upper left corner
    bytes[corner..corner + 4].copy_from_slice(&99_999i32.to_le_bytes());
    bytes[corner + 4..corner + 8].copy_from_slice(&99_999i32.to_le_bytes());
    let error = decode_exr(&bytes, &path).unwrap_err().to_string();
    assert!(error.contains("found 100000 x 100000"), "{error}");

    let hdr = b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 100000 +X 100000\n\x02\x02\x00\x04";
    let error = decode_raster(hdr, &path, false, None)
        .unwrap_err()
        .to_string();
    assert!(error.contains("found 100000 x 100000"), "{error}");
}

#[test]
fn formats_are_told_by_their_first_bytes() {
    assert_eq!(Format::of(b"\x76\x2f\x31\x01\x02"), Some(Format::Exr));
    assert_eq!(Format::of(b"#?RGBE\n"), Some(Format::Hdr));
    assert_eq!(Format::of(b"MM\0\x2a"), Some(Format::Tiff));
    assert_eq!(Format::of(b"GIF89a"), None);
    assert_eq!(Format::of(b""), None);
}

#[test]
fn a_damaged_profile_is_an_error() {
    let error = decode_icc(&[0; 200], 256, Path::new("a.png"))
        .unwrap_err()
        .to_string();
    assert!(
        error.starts_with("a.png: expected a usable ICC profile, found a damaged"),
        "{error}"
    );
}
