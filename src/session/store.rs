//! Files that are whole or not there: write aside, fsync, rename, fsync the folder.
//!
//! Temporary names begin with [`TEMPORARY_PREFIX`], so that whatever a crash leaves behind is known and can
//! be removed by whoever holds the session alone.

use std::fs::{File, OpenOptions};
use std::io::{self, BufWriter, Write};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};

/// How every temporary file and folder name begins.
pub const TEMPORARY_PREFIX: &str = ".tmp-";

/// A name in `folder` that nothing else uses: process and count make it unique.
pub(super) fn temporary_path(folder: &Path) -> PathBuf {
    static COUNT: AtomicU64 = AtomicU64::new(0);
    let count = COUNT.fetch_add(1, Ordering::Relaxed);
    folder.join(format!("{TEMPORARY_PREFIX}{}-{count}", std::process::id()))
}

/// Writes `bytes` to `path` so that it holds either what it held before or all of `bytes`, even if the
/// machine stops half-way. The folder must exist.
pub fn write_atomic(path: &Path, bytes: &[u8]) -> io::Result<()> {
    write_atomic_with(path, |file| file.write_all(bytes))
}

/// The same of what `write` writes, piece by piece.
pub fn write_atomic_with(
    path: &Path,
    write: impl FnOnce(&mut BufWriter<File>) -> io::Result<()>,
) -> io::Result<()> {
    let folder = folder_of(path);
    let temporary = temporary_path(folder);
    let written = new_synced(&temporary, write).and_then(|()| std::fs::rename(&temporary, path));
    if let Err(error) = written {
        // The temporary file may not even be there; the first error is the one to tell.
        let _ = std::fs::remove_file(&temporary);
        return Err(error);
    }
    sync_folder(folder)
}

/// Writes a new file and waits until it is on the disk.
pub(super) fn write_synced(path: &Path, bytes: &[u8]) -> io::Result<()> {
    new_synced(path, |file| file.write_all(bytes))
}

fn new_synced(path: &Path, write: impl FnOnce(&mut BufWriter<File>) -> io::Result<()>) -> io::Result<()> {
    let mut file = BufWriter::new(OpenOptions::new().write(true).create_new(true).open(path)?);
    write(&mut file)?;
    file.flush()?;
    file.get_ref().sync_all()
}

/// Appends `line` and a newline in one write, and waits until they are on the disk. What could not be written whole, as
/// on a full disk, is cut off again.
pub fn append_line_synced(path: &Path, line: &str) -> io::Result<()> {
    let mut file = OpenOptions::new().append(true).create(true).open(path)?;
    let before = file.metadata()?.len();
    let written = file.write_all(format!("{line}\n").as_bytes()).and_then(|()| file.sync_data());
    written.inspect_err(|_| {
        // If even that fails, the next line does it; the first error is the one to tell.
        let _ = file.set_len(before);
    })
}

/// Waits until the folder's own entries (new names, renames) are on the disk.
pub fn sync_folder(folder: &Path) -> io::Result<()> {
    File::open(folder)?.sync_all()
}

/// BLAKE3 of a file, hexadecimal, read in pieces.
pub fn digest_file(path: &Path) -> io::Result<String> {
    let mut hasher = blake3::Hasher::new();
    hasher.update_reader(File::open(path)?)?;
    Ok(hasher.finalize().to_hex().to_string())
}

/// BLAKE3 of bytes, hexadecimal.
pub fn digest(bytes: &[u8]) -> String {
    blake3::hash(bytes).to_hex().to_string()
}

/// Removes everything under `folder` that a crash left under a temporary name, and says what that was. What somebody who
/// reads the session writes beside it may get its own name meanwhile: what has gone is as good as removed.
pub(crate) fn remove_temporaries(folder: &Path) -> io::Result<Vec<PathBuf>> {
    let mut removed = vec![];
    for entry in std::fs::read_dir(folder)? {
        let entry = entry?;
        let Some(kind) = unless_gone(entry.file_type())? else { continue };
        if entry.file_name().to_string_lossy().starts_with(TEMPORARY_PREFIX) {
            let path = entry.path();
            let gone =
                if kind.is_dir() { std::fs::remove_dir_all(&path) } else { std::fs::remove_file(&path) };
            removed.extend(unless_gone(gone)?.map(|()| path));
        } else if kind.is_dir() {
            removed.extend(unless_gone(remove_temporaries(&entry.path()))?.unwrap_or_default());
        }
    }
    Ok(removed)
}

/// `None` of what has gone in the meantime.
fn unless_gone<T>(done: io::Result<T>) -> io::Result<Option<T>> {
    match done {
        Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(None),
        done => done.map(Some),
    }
}

fn folder_of(path: &Path) -> &Path {
    match path.parent() {
        Some(folder) if !folder.as_os_str().is_empty() => folder,
        _ => Path::new("."),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_is_replaced_whole_and_nothing_temporary_stays() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.json");
        write_atomic(&path, b"first").unwrap();
        write_atomic(&path, b"second").unwrap();
        assert_eq!(std::fs::read(&path).unwrap(), b"second");
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1);
    }

    #[test]
    fn what_readers_write_and_name_meanwhile_keeps_nobody_from_cleaning() {
        let folder = tempfile::tempdir().unwrap();
        let inner = folder.path().join("derived/thumbnails");
        std::fs::create_dir_all(&inner).unwrap();
        let over = std::sync::atomic::AtomicBool::new(false);
        std::thread::scope(|scope| {
            scope.spawn(|| {
                while !over.load(Ordering::Relaxed) {
                    // A reader whose file was taken for a leftover makes it again.
                    let _taken = write_atomic(&inner.join("a.jpg"), b"small");
                }
            });
            let cleaned: Vec<_> = (0..2000).map(|_| remove_temporaries(folder.path())).collect();
            over.store(true, Ordering::Relaxed);
            for removed in cleaned {
                removed.unwrap();
            }
        });
        std::fs::write(inner.join(".tmp-1-1"), b"left").unwrap();
        assert_eq!(remove_temporaries(folder.path()).unwrap(), [inner.join(".tmp-1-1")]);
    }

    #[test]
    fn a_write_into_a_missing_folder_fails_and_leaves_nothing() {
        let folder = tempfile::tempdir().unwrap();
        assert!(write_atomic(&folder.path().join("none/a.json"), b"x").is_err());
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0);
    }

    #[test]
    fn the_digest_of_a_file_is_that_of_its_bytes() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a");
        std::fs::write(&path, b"abc").unwrap();
        assert_eq!(digest_file(&path).unwrap(), digest(b"abc"));
        assert_eq!(digest(b"abc"), "6437b3ac38465133ffb63b75273a8db548c558465d79db03fd359c6cd5bd9d85");
    }
}
