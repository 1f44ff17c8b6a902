//! Any bytes as an EXR file.
#![no_main]

use std::path::Path;

use libfuzzer_sys::fuzz_target;
use pbrfit::image_file::decode_exr;

fuzz_target!(|bytes: &[u8]| {
    match decode_exr(bytes, Path::new("file.exr")) {
        Ok(exr) => {
            for channel in &exr.channels {
                assert_eq!(channel.values.len(), exr.width * exr.height);
            }
        }
        Err(error) => {
            let message = error.to_string();
            assert!(message.starts_with("file.exr: ") && !message.contains('\n'));
        }
    }
});
