//! The rooms of `rust/`: each uses only lower ones, so there are no circles of rooms. Read off the
//! text: every path that begins with `crate::`, outside of comments and of tests.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};

/// The rooms, each with those that it may use.
const ROOMS: [(&str, &[&str]); 11] = [
    ("runtime", &[]),
    ("reflectance", &["runtime"]),
    ("block", &["runtime", "reflectance"]),
    ("transport", &["runtime", "reflectance", "block"]),
    ("problem", &["runtime", "reflectance", "block", "transport"]),
    ("pixel", &["runtime", "reflectance", "block", "problem"]),
    (
        "schur",
        &["runtime", "reflectance", "block", "problem", "pixel"],
    ),
    ("lamps", &["runtime", "reflectance", "problem", "pixel"]),
    ("environment", &["runtime", "reflectance", "problem"]),
    ("image_file", &["runtime"]),
    (
        "python",
        &[
            "runtime",
            "reflectance",
            "block",
            "transport",
            "problem",
            "pixel",
            "schur",
            "lamps",
            "environment",
            "image_file",
        ],
    ),
];

/// Rust files that may lie in `rust/` itself.
const LOOSE_MAX: usize = 8;

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("rust")
}

/// All Rust files in a folder and below it.
fn files(folder: &Path) -> Vec<PathBuf> {
    let entries = fs::read_dir(folder)
        .unwrap()
        .map(|entry| entry.unwrap().path());
    entries
        .flat_map(|path| {
            if path.is_dir() {
                files(&path)
            } else {
                vec![path]
            }
        })
        .filter(|path| path.extension().is_some_and(|extension| extension == "rs"))
        .collect()
}

/// The rooms that a file names, without its comments and the tests at its end.
fn rooms_used(text: &str) -> Vec<String> {
    let lines = text.lines().take_while(|line| *line != "#[cfg(test)]");
    let code: Vec<_> = lines.map(|line| line.split("//").next().unwrap()).collect();
    let paths = code.join("\n");
    assert!(!paths.contains("crate::{"), "expected one path a line");
    let name = |path: &str| {
        path.chars()
            .take_while(|c| c.is_alphanumeric() || *c == '_')
            .collect()
    };
    paths.split("crate::").skip(1).map(name).collect()
}

#[test]
fn each_room_uses_lower_rooms_only() {
    let rooms = BTreeMap::from(ROOMS);
    let mut wrong = Vec::new();
    for file in files(&root()) {
        let place = file.strip_prefix(root()).unwrap();
        let room = place.iter().next().unwrap().to_str().unwrap();
        if place.iter().count() == 1 {
            continue; // lib.rs names all
        }
        let lower = rooms
            .get(room)
            .unwrap_or_else(|| panic!("rust/{room} is no room of this test"));
        for used in rooms_used(&fs::read_to_string(&file).unwrap()) {
            let is_room = rooms.contains_key(used.as_str());
            if is_room && used != room && !lower.contains(&used.as_str()) {
                wrong.push(format!("{} uses {used}", place.display()));
            }
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

#[test]
fn few_files_lie_loose() {
    let loose = fs::read_dir(root())
        .unwrap()
        .filter(|entry| entry.as_ref().unwrap().path().is_file())
        .count();
    assert!(loose <= LOOSE_MAX, "{loose} files in rust/");
}

#[test]
fn rooms_are_read_as_rust_reads_them() {
    let text = "use crate::a::b; // crate::c\nuse crate::d;\n#[cfg(test)]\nuse crate::e;";
    assert_eq!(rooms_used(text), ["a", "d"]);
}
