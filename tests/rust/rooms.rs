//! The rooms of `rust/`: each uses only lower ones, and files of a room do not use each other in
//! circles. Read off the text: every path that begins with `crate::`, `$crate::`, `super::` or
//! `self::`, outside of comments and of tests.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};

/// The rooms, each with those that it may use.
const ROOMS: [(&str, &[&str]); 9] = [
    ("runtime", &[]),
    ("reflectance", &["runtime"]),
    ("block", &["runtime", "reflectance"]),
    ("problem", &["runtime", "reflectance", "block"]),
    ("pixel", &["runtime", "reflectance", "block", "problem"]),
    (
        "schur",
        &["runtime", "reflectance", "block", "problem", "pixel"],
    ),
    ("lbfgs", &["runtime"]),
    ("image_file", &["runtime"]),
    (
        "python",
        &[
            "runtime",
            "reflectance",
            "block",
            "problem",
            "pixel",
            "schur",
            "lbfgs",
            "image_file",
        ],
    ),
];

/// Rust files that may lie in `rust/` itself.
const LOOSE_MAX: usize = 8;

/// A module's path from the crate's root, as `["pixel", "samples"]`.
type Module = Vec<String>;

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("rust")
}

/// All modules that are files, with their code.
fn modules() -> BTreeMap<Module, String> {
    fn collect(folder: &Path, path: &[String], found: &mut BTreeMap<Module, String>) {
        for entry in fs::read_dir(folder).unwrap() {
            let file = entry.unwrap().path();
            let name = file.file_stem().unwrap().to_str().unwrap().to_owned();
            let mut module = path.to_vec();
            if file.is_dir() {
                module.push(name);
                collect(&file, &module, found);
            } else if file.extension().is_some_and(|e| e == "rs") {
                if !["lib", "mod"].contains(&name.as_str()) {
                    module.push(name);
                }
                found.insert(module, code(&fs::read_to_string(&file).unwrap()));
            }
        }
    }
    let mut found = BTreeMap::new();
    collect(&root(), &[], &mut found);
    found
}

/// Without comments, and without the tests at a file's end.
fn code(text: &str) -> String {
    let lines = text.lines().take_while(|line| *line != "#[cfg(test)]");
    let without = lines.map(|line| line.split("//").next().unwrap());
    without.collect::<Vec<_>>().join("\n")
}

/// What a path in `code` may begin with, and where it then leads from `module`.
fn starts(module: &[String]) -> [(&'static str, Module); 3] {
    let parent = module[..module.len().saturating_sub(1)].to_vec();
    [
        ("crate::", Vec::new()),
        ("super::", parent),
        ("self::", module.to_vec()),
    ]
}

/// The names of paths that begin at `text`: `a::{b::c, d}` is `a::b::c` and `a::d`.
fn paths(text: &str) -> Vec<Module> {
    let text = text.trim_start();
    if let Some(group) = text.strip_prefix('{') {
        let (mut depth, mut begin, mut found) = (0, 0, Vec::new());
        for (i, c) in group.char_indices() {
            match c {
                '{' => depth += 1,
                '}' if depth > 0 => depth -= 1,
                ',' | '}' if depth == 0 => {
                    found.extend(paths(&group[begin..i]));
                    begin = i + 1;
                    if c == '}' {
                        break;
                    }
                }
                _ => {}
            }
        }
        return found;
    }
    let end = text
        .find(|c: char| !c.is_alphanumeric() && c != '_')
        .unwrap_or(text.len());
    let (name, rest) = text.split_at(end);
    if name.is_empty() {
        return Vec::new();
    }
    let further = rest.strip_prefix("::").map(paths).unwrap_or_default();
    let of_name = |rest: &Module| [vec![name.to_owned()], rest.clone()].concat();
    if further.is_empty() {
        vec![of_name(&Vec::new())]
    } else {
        further.iter().map(of_name).collect()
    }
}

/// The modules that each module uses.
fn uses() -> BTreeMap<Module, BTreeSet<Module>> {
    let modules = modules();
    let used = |module: &Module, code: &String| {
        let mut used = BTreeSet::new();
        for (start, from) in starts(module) {
            for (at, _) in code.match_indices(start) {
                // `super::super::` counts once, from its first.
                if code[..at].ends_with("super::") {
                    continue;
                }
                let (mut from, mut rest) = (from.clone(), &code[at + start.len()..]);
                while let Some(next) = rest.strip_prefix("super::") {
                    from.pop();
                    rest = next;
                }
                for path in paths(rest) {
                    let mut whole = [from.clone(), path].concat();
                    while !modules.contains_key(&whole) {
                        whole.pop();
                    }
                    used.insert(whole);
                }
            }
        }
        used.remove(module);
        used
    };
    modules
        .iter()
        .map(|(module, code)| (module.clone(), used(module, code)))
        .collect()
}

/// A circle that begins and ends at `module`, or nothing.
fn circle(module: &Module, uses: &BTreeMap<Module, BTreeSet<Module>>) -> Option<Vec<Module>> {
    let mut seen = BTreeSet::new();
    let mut waiting = vec![vec![module.clone()]];
    while let Some(way) = waiting.pop() {
        for next in &uses[way.last().unwrap()] {
            let further = [way.clone(), vec![next.clone()]].concat();
            if next == module {
                return Some(further);
            }
            if seen.insert(next.clone()) {
                waiting.push(further);
            }
        }
    }
    None
}

#[test]
fn each_room_uses_lower_rooms_only() {
    let rooms = BTreeMap::from(ROOMS);
    let mut wrong = Vec::new();
    for (module, uses) in uses() {
        let Some(room) = module.first() else {
            continue; // lib.rs names all
        };
        let lower = rooms
            .get(room.as_str())
            .unwrap_or_else(|| panic!("rust/{room} is no room of this test"));
        for used in uses {
            let allowed = used
                .first()
                .is_some_and(|other| other == room || lower.contains(&other.as_str()));
            if !allowed {
                wrong.push(format!("{} uses {}", module.join("::"), used.join("::")));
            }
        }
    }
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

#[test]
fn files_do_not_use_each_other_in_circles() {
    let mut uses = uses();
    for (module, used) in &mut uses {
        // A file may name what its parent module declares beside it.
        used.retain(|other| !module.starts_with(other));
    }
    for module in uses.keys() {
        if let Some(circle) = circle(module, &uses) {
            let names: Vec<_> = circle.iter().map(|module| module.join("::")).collect();
            panic!("{}", names.join(" uses "));
        }
    }
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
fn paths_are_read_as_rust_reads_them() {
    let names = |text: &str| -> Vec<String> {
        let found = paths(text);
        found.iter().map(|path| path.join("::")).collect()
    };
    assert_eq!(names("a::b(c)"), ["a::b"]);
    assert_eq!(names("a::{self, B, c::{d, E as F}};"), {
        ["a::self", "a::B", "a::c::d", "a::c::E"]
    });
    assert_eq!(names("{Error, a::b}"), ["Error", "a::b"]);
    assert_eq!(
        code("use crate::a; // crate::b\n#[cfg(test)]\nmod tests"),
        "use crate::a; "
    );
}

#[test]
fn a_circle_is_found() {
    let module = |name: &str| vec![name.to_owned()];
    let uses = BTreeMap::from([
        (module("a"), BTreeSet::from([module("b")])),
        (module("b"), BTreeSet::from([module("c")])),
        (module("c"), BTreeSet::from([module("b")])),
    ]);
    assert_eq!(circle(&module("a"), &uses), None);
    let found = circle(&module("b"), &uses);
    assert_eq!(found, Some(vec![module("b"), module("c"), module("b")]));
}
