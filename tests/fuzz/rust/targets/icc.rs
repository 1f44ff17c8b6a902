//! Any bytes as an ICC profile.
#![no_main]

use std::path::Path;

use libfuzzer_sys::fuzz_target;
use pbrfit::image_file::decode_icc;

fuzz_target!(|bytes: &[u8]| {
    match decode_icc(bytes, 256, Path::new("file.png")) {
        Ok(profile) => {
            for curve in &profile.curves {
                assert_eq!(curve.len(), 256);
                assert!(curve.iter().all(|value| value.is_finite()));
            }
            if let Some(matrix) = profile.to_xyz {
                assert!(matrix.iter().flatten().all(|value| value.is_finite()));
            }
        }
        Err(error) => {
            let message = error.to_string();
            assert!(message.starts_with("file.png: ") && !message.contains('\n'));
        }
    }
});
