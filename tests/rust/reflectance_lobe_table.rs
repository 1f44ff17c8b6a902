//! Of what `reflectance/lobe_table` keeps to itself.

use super::*;

#[test]
fn the_file_was_made_with_the_same_numbers() {
    let number = |i: usize| f64::from(f32::from_le_bytes(FILE[i..i + 4].try_into().unwrap()));
    let count = |i: usize| u32::from_le_bytes(FILE[i..i + 4].try_into().unwrap()) as usize;
    assert_eq!(&FILE[..8], b"PBRLOBE1");
    assert_eq!([count(8), count(12)], CELLS);
    assert_eq!([number(16), number(24)], BEND);
    assert_eq!([number(20), number(28)], BENT);
}
