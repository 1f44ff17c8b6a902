//! Any bytes as a PNG, JPEG, TIFF or HDR file.
#![no_main]

use std::path::Path;

use libfuzzer_sys::fuzz_target;
use pbrfit::image_file::{Samples, decode_raster};

fuzz_target!(|bytes: &[u8]| {
    for indices in [false, true] {
        match decode_raster(bytes, Path::new("file.png"), indices, None) {
            Ok(raster) => {
                let samples = match &raster.samples {
                    Samples::U8(samples) => samples.len(),
                    Samples::U16(samples) => samples.len(),
                    Samples::F32(samples) => samples.len(),
                };
                assert_eq!(samples, raster.width * raster.height * raster.channels);
                assert!((1..=4).contains(&raster.channels));
                assert!((1..=8).contains(&raster.orientation));
            }
            Err(error) => {
                let message = error.to_string();
                assert!(message.starts_with("file.png: ") && !message.contains('\n'));
            }
        }
    }
});
