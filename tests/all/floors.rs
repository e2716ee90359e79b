//! A module uses only floors below its own.

use std::path::{Path, PathBuf};

/// Top to bottom; names on one line share a floor and may not use each other.
const FLOORS: &[&[&str]] = &[
    &["cli", "http"],
    &["studio"],
    &["capture"],
    &["rig"],
    &["pipeline"],
    &["jobs"],
    &["session"],
    &["export"],
    &["reflectance"],
    &["alignment"],
    &["calibration"],
    &["light"],
    &["scene"],
    &["codec"],
    &["pair"],
    &["photometry"],
    &["raster"],
    &["log", "progress", "units"],
];

/// Pairs on one floor where the left may use the right: `serve` and `openapi` start the HTTP face.
const SAME_FLOOR_ALLOWED: &[(&str, &str)] = &[("cli", "http")];

fn floor(module: &str) -> Option<usize> {
    FLOORS.iter().position(|names| names.contains(&module))
}

fn rust_files(dir: &Path, out: &mut Vec<PathBuf>) {
    for entry in std::fs::read_dir(dir).unwrap() {
        let path = entry.unwrap().path();
        if path.is_dir() {
            rust_files(&path, out);
        } else if path.extension().is_some_and(|e| e == "rs") {
            out.push(path);
        }
    }
}

/// Modules of this crate that a source text names, as `crate::NAME` or inside `crate::{...}`.
fn modules_named(text: &str) -> Vec<String> {
    let code: String =
        text.lines().filter(|l| !l.trim_start().starts_with("//")).collect::<Vec<_>>().join("\n");
    let mut found = Vec::new();
    for (at, _) in code.match_indices("crate::") {
        let rest = &code[at + "crate::".len()..];
        if let Some(group) = rest.strip_prefix('{') {
            let mut depth = 0;
            let mut name = String::new();
            for c in group.chars() {
                match c {
                    '{' => depth += 1,
                    '}' if depth == 0 => break,
                    '}' => depth -= 1,
                    ',' if depth == 0 => found.push(std::mem::take(&mut name)),
                    c if depth == 0 => name.push(c),
                    _ => {}
                }
            }
            found.push(name);
        } else {
            found.push(rest.chars().take_while(|c| c.is_alphanumeric() || *c == '_').collect());
        }
    }
    found.into_iter().map(|n| n.trim().split("::").next().unwrap_or("").trim().to_owned()).collect()
}

fn violations(module: &str, text: &str) -> Vec<String> {
    let own = floor(module).unwrap_or_else(|| panic!("{module} has no floor: add it to FLOORS"));
    modules_named(text)
        .into_iter()
        .filter(|used| used != module)
        .filter(|used| {
            floor(used).is_some_and(|f| f <= own) && !SAME_FLOOR_ALLOWED.contains(&(module, used.as_str()))
        })
        .map(|used| format!("{module} uses {used}"))
        .collect()
}

#[test]
fn every_module_uses_only_floors_below_its_own() {
    let src = Path::new(env!("CARGO_MANIFEST_DIR")).join("src");
    let mut files = Vec::new();
    rust_files(&src, &mut files);
    let mut wrong = Vec::new();
    for file in &files {
        let inside = file.strip_prefix(&src).unwrap();
        let module = inside.iter().next().unwrap().to_str().unwrap().trim_end_matches(".rs");
        if matches!(module, "main" | "lib") {
            continue;
        }
        let text = std::fs::read_to_string(file).unwrap();
        wrong.extend(violations(module, &text).into_iter().map(|v| format!("{}: {v}", inside.display())));
    }
    assert!(wrong.is_empty(), "arrows that run upwards:\n{}", wrong.join("\n"));
}

#[test]
fn the_scan_sees_a_violation() {
    assert_eq!(violations("scene", "use crate::light::RayKernel;"), ["scene uses light"]);
    assert_eq!(violations("light", "use crate::{scene::Mesh, cli::run};"), ["light uses cli"]);
    assert!(violations("light", "// crate::cli\nuse crate::scene::Mesh;").is_empty());
    assert_eq!(violations("http", "use crate::cli;"), ["http uses cli"]);
}

#[test]
fn decoders_and_encoders_are_called_in_codec_alone() {
    let src = Path::new(env!("CARGO_MANIFEST_DIR")).join("src");
    let mut files = Vec::new();
    rust_files(&src, &mut files);
    for file in files.iter().filter(|f| !f.starts_with(src.join("codec"))) {
        let text = std::fs::read_to_string(file).unwrap();
        for decoder in ["rawloader::", "rawler::", "exr::", "tiff::", "tobj::"] {
            let direct = text.lines().any(|l| {
                let l = l.trim_start();
                !l.starts_with("//")
                    && (l.starts_with(&format!("use {decoder}")) || l.contains(&format!(" {decoder}")))
            });
            assert!(!direct, "{} calls {decoder} directly; that belongs in codec", file.display());
        }
    }
}
