//! Serial ports behind which a flash controller may stand.

use std::path::PathBuf;

/// USB serial ports of this machine: names under `/dev/serial/by-id` first, because they survive replugging;
/// then `/dev/ttyACM*` and `/dev/ttyUSB*` that have no such name. Empty if there are none.
pub fn list() -> Vec<PathBuf> {
    let named = files_of("/dev/serial/by-id", |_| true);
    let known: Vec<PathBuf> = named.iter().filter_map(|path| path.canonicalize().ok()).collect();
    let bare = files_of("/dev", |name| name.starts_with("ttyACM") || name.starts_with("ttyUSB"));
    named.into_iter().chain(bare.into_iter().filter(|path| !known.contains(path))).collect()
}

/// Files of a folder, by name; a folder that is not there (no serial port was ever plugged in) has none.
fn files_of(folder: &str, wanted: impl Fn(&str) -> bool) -> Vec<PathBuf> {
    let Ok(entries) = std::fs::read_dir(folder) else { return Vec::new() };
    let mut paths: Vec<PathBuf> =
        entries.flatten().filter(|e| e.file_name().to_str().is_some_and(&wanted)).map(|e| e.path()).collect();
    paths.sort();
    paths
}
