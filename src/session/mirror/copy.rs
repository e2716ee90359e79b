//! One file from disk to disk: written aside, on the disk, read back, then named.

use crate::session::store;
use std::fs::{File, OpenOptions};
use std::io::{self, Read, Write};
use std::path::{Path, PathBuf};

/// Bytes after which it is asked whether to go on.
const PIECE: usize = 1 << 20;

/// Why a file was not copied.
#[derive(Debug)]
pub(super) enum CopyError {
    /// The copy's disk refused.
    Mirror(PathBuf, io::Error),
    /// The session's own disk refused.
    Source(PathBuf, io::Error),
    /// The original is not what was stored.
    Altered(PathBuf),
    /// What was read back is not what was written.
    ReadBack(PathBuf),
    /// Somebody wants it to stop.
    Stopped,
}

/// For `map_err`: a failure of the copy's disk.
pub(super) fn mirror(path: &Path) -> impl FnOnce(io::Error) -> CopyError + '_ {
    move |error| CopyError::Mirror(path.to_owned(), error)
}

/// For `map_err`: a failure of the session's disk.
pub(super) fn source(path: &Path) -> impl FnOnce(io::Error) -> CopyError + '_ {
    move |error| CopyError::Source(path.to_owned(), error)
}

/// Copies a file under a new name. It must have the BLAKE3 `digest`, where that is known, and is read back from the disk,
/// not out of memory where the system allows that. `go_on` is asked after every piece.
pub(super) fn copy(
    from: &Path,
    to: &Path,
    digest: Option<&str>,
    go_on: &dyn Fn() -> bool,
) -> Result<(), CopyError> {
    let mut original = File::open(from).map_err(source(from))?;
    let mut file = OpenOptions::new().write(true).create_new(true).open(to).map_err(mirror(to))?;
    let (mut hasher, mut piece) = (blake3::Hasher::new(), vec![0; PIECE]);
    loop {
        let read = original.read(&mut piece).map_err(source(from))?;
        if read == 0 {
            break;
        }
        hasher.update(&piece[..read]);
        file.write_all(&piece[..read]).map_err(mirror(to))?;
        if !go_on() {
            return Err(CopyError::Stopped);
        }
    }
    file.sync_all().map_err(mirror(to))?;
    let written = hasher.finalize().to_hex();
    if digest.is_some_and(|digest| digest != written.as_str()) {
        return Err(CopyError::Altered(from.to_owned()));
    }
    // Advice only; a file system that keeps it in memory nevertheless is none the worse.
    let _ = rustix::fs::fadvise(&file, 0, None, rustix::fs::Advice::DontNeed);
    drop(file);
    let (mut back, mut hasher) = (File::open(to).map_err(mirror(to))?, blake3::Hasher::new());
    loop {
        let read = back.read(&mut piece).map_err(mirror(to))?;
        if read == 0 {
            break;
        }
        hasher.update(&piece[..read]);
        if !go_on() {
            return Err(CopyError::Stopped);
        }
    }
    if hasher.finalize().to_hex() != written { Err(CopyError::ReadBack(to.to_owned())) } else { Ok(()) }
}

/// Copies a file to where none is, under a temporary name first.
pub(super) fn copy_aside(
    from: &Path,
    to: &Path,
    digest: Option<&str>,
    go_on: &dyn Fn() -> bool,
) -> Result<(), CopyError> {
    let folder = to.parent().unwrap_or(Path::new("."));
    std::fs::create_dir_all(folder).map_err(mirror(folder))?;
    let aside = store::temporary_path(folder);
    let copied =
        copy(from, &aside, digest, go_on).and_then(|()| std::fs::rename(&aside, to).map_err(mirror(to)));
    if copied.is_err() {
        // The first error is the one to tell; what stays is removed at the next look.
        let _ = std::fs::remove_file(&aside);
    }
    copied?;
    store::sync_folder(folder).map_err(mirror(folder))
}

/// Writes a small file anew, whole, and reads it back.
pub(super) fn write(to: &Path, bytes: &[u8]) -> Result<(), CopyError> {
    let folder = to.parent().unwrap_or(Path::new("."));
    std::fs::create_dir_all(folder).map_err(mirror(folder))?;
    store::write_atomic(to, bytes).map_err(mirror(to))?;
    let back = std::fs::read(to).map_err(mirror(to))?;
    if back == bytes { Ok(()) } else { Err(CopyError::ReadBack(to.to_owned())) }
}

/// A file's bytes; `None` where there is none.
pub(super) fn bytes_of(path: &Path) -> io::Result<Option<Vec<u8>>> {
    match std::fs::read(path) {
        Ok(bytes) => Ok(Some(bytes)),
        Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(None),
        Err(error) => Err(error),
    }
}

/// A file's length; `None` where there is none.
pub(super) fn length_of(path: &Path) -> io::Result<Option<u64>> {
    match std::fs::metadata(path) {
        Ok(data) => Ok(Some(data.len())),
        Err(error) if error.kind() == io::ErrorKind::NotFound => Ok(None),
        Err(error) => Err(error),
    }
}
