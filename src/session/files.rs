//! Which files of a session others may see, and by what name.
//!
//! A file is asked for by its id, a digest of its path inside the session: the same in every listing and after every
//! restart, and nothing that leads anywhere. An id is looked up among the files that are there to be shown:
//! originals, records, calibration, scene, results. Hidden files (locks, half-written ones) and caches are nobody's
//! business, and a link is no file: no step of the way to a file may be one, not even if it becomes one meanwhile.

use super::shots::SHOT_RECORD;
use super::verify::Frames;
use super::{PAIR_RECORD, Session, SessionError, from_json};
use crate::pair::FrameRecord;
use rustix::fs::{Mode, OFlags, open, openat};
use serde::Serialize;
use std::fs::File;
use std::path::Path;
use std::time::SystemTime;

/// Folders whose files are shown; of `derived/` the photographs' own maps, the rest are caches.
const SHOWN: [&str; 5] = ["pairs", "calibration", "scene", "model", "derived/views"];
/// Files at the top that are shown.
const TOP: [&str; 3] = [super::MANIFEST, super::JOURNAL, super::SEQUENCE];
/// No session of ours is deeper.
const DEEPEST: usize = 8;

/// What a file is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum FileKind {
    /// The camera's own file of a pair's frame.
    Original,
    /// What is written down of a pair or of the session.
    Record,
    /// Shots and fits of the calibration.
    Calibration,
    /// Imported cameras and meshes.
    Scene,
    /// One photograph's maps; they can be made again.
    Derived,
    /// The model and its report.
    Result,
}

/// One file.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct SessionFile {
    /// By which it is asked for.
    pub id: String,
    /// Path inside the session, with slashes.
    pub path: String,
    /// What it is.
    pub kind: FileKind,
    /// Length in bytes.
    pub bytes: u64,
    /// When it was written.
    pub modified: SystemTime,
    /// BLAKE3 as it was written down when the file was stored, hexadecimal; absent where none was.
    pub blake3: Option<String>,
}

/// The id of the file at this path inside a session.
pub fn file_id(path: &str) -> String {
    blake3::hash(path.as_bytes()).to_hex().chars().take(32).collect()
}

impl Session {
    /// Every file that may be seen, by path.
    pub fn files(&self) -> Result<Vec<SessionFile>, SessionError> {
        let mut paths = Vec::new();
        self.shown(&mut |path| {
            paths.push(path.to_owned());
            true
        })?;
        paths.sort();
        // What was removed since is not there any more.
        Ok(paths.into_iter().filter_map(|path| self.open_shown(path).ok()).map(|(_, about)| about).collect())
    }

    /// The file of this id, open for reading, if there is one.
    pub fn open_file(&self, id: &str) -> Result<Option<(File, SessionFile)>, SessionError> {
        let mut found = None;
        self.shown(&mut |path| {
            if file_id(path) == id {
                found = Some(path.to_owned());
            }
            found.is_none()
        })?;
        Ok(found.and_then(|path| self.open_shown(path).ok()))
    }

    /// Visits the paths of all shown files until `visit` says that it has seen enough.
    fn shown(&self, visit: &mut dyn FnMut(&str) -> bool) -> Result<(), SessionError> {
        for path in TOP {
            if self.path.join(path).is_file() && !visit(path) {
                return Ok(());
            }
        }
        for folder in SHOWN {
            match walk(&self.path, folder, DEEPEST, visit) {
                Ok(true) => {}
                Ok(false) => return Ok(()),
                Err(error) if error.kind() == std::io::ErrorKind::NotFound => {}
                Err(error) => return Err(SessionError::io(&self.path.join(folder))(error)),
            }
        }
        Ok(())
    }

    fn open_shown(&self, path: String) -> std::io::Result<(File, SessionFile)> {
        let file = open_inside(&self.path, &path)?;
        let metadata = file.metadata()?;
        if !metadata.is_file() {
            return Err(std::io::ErrorKind::NotFound.into());
        }
        let about = SessionFile {
            id: file_id(&path),
            kind: kind_of(&path),
            bytes: metadata.len(),
            modified: metadata.modified()?,
            blake3: self.digest_of(&path, metadata.len()),
            path,
        };
        Ok((file, about))
    }

    /// The digest that a record has of this file, if it has one and the length is still the same.
    fn digest_of(&self, path: &str, bytes: u64) -> Option<String> {
        let (folder, name) = path.rsplit_once('/')?;
        let folder_of = self.path.join(folder);
        let frames: Vec<FrameRecord> = if folder.starts_with("pairs/") {
            let record = self.records.read(&folder_of.join(PAIR_RECORD)).ok()?;
            record.frames().map(|(_, frame)| frame.clone()).collect()
        } else {
            let Frames { off, on } = from_json(&folder_of.join(SHOT_RECORD)).ok()?;
            vec![off, on]
        };
        let files = frames.into_iter().flat_map(|frame| {
            let jpeg = frame.jpeg.map(|jpeg| (jpeg.file, jpeg.bytes, jpeg.blake3));
            [Some((frame.file, frame.bytes, frame.blake3)), jpeg]
        });
        files.flatten().find(|(file, long, _)| file == name && *long == bytes).map(|(_, _, blake3)| blake3)
    }
}

fn kind_of(path: &str) -> FileKind {
    match path.split('/').next() {
        // A sidecar can be made again from the record, and counts as one.
        Some("pairs") if !path.ends_with(PAIR_RECORD) && !path.ends_with(".xmp") => FileKind::Original,
        Some("calibration") => FileKind::Calibration,
        Some("scene") => FileKind::Scene,
        Some("derived") => FileKind::Derived,
        Some("model") => FileKind::Result,
        _ => FileKind::Record,
    }
}

/// Visits the files below `folder`; `false` once `visit` has seen enough.
fn walk(
    root: &Path,
    folder: &str,
    deep: usize,
    visit: &mut dyn FnMut(&str) -> bool,
) -> std::io::Result<bool> {
    for entry in std::fs::read_dir(root.join(folder))? {
        let entry = entry?;
        // The type of a link is link: neither files nor folders are followed.
        let kind = entry.file_type()?;
        let Ok(name) = entry.file_name().into_string() else { continue };
        if name.starts_with('.') {
            continue;
        }
        let path = format!("{folder}/{name}");
        let go_on = if kind.is_file() {
            visit(&path)
        } else if kind.is_dir() && deep > 0 {
            walk(root, &path, deep - 1, visit)?
        } else {
            true
        };
        if !go_on {
            return Ok(false);
        }
    }
    Ok(true)
}

/// Opens a file below `root` step by step, so that none of the steps can be a link. Does not wait for a pipe's other
/// end.
fn open_inside(root: &Path, path: &str) -> std::io::Result<File> {
    let folder = OFlags::RDONLY | OFlags::DIRECTORY | OFlags::CLOEXEC;
    let file = OFlags::RDONLY | OFlags::NONBLOCK | OFlags::CLOEXEC | OFlags::NOFOLLOW;
    let mut at = open(root, folder, Mode::empty())?;
    let mut steps = path.split('/').peekable();
    while let Some(step) = steps.next() {
        let how = if steps.peek().is_some() { folder | OFlags::NOFOLLOW } else { file };
        at = openat(&at, step, how, Mode::empty())?;
    }
    Ok(at.into())
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::io::Read;
    use std::os::unix::fs::symlink;

    fn session() -> (tempfile::TempDir, Session) {
        let folder = tempfile::tempdir().unwrap();
        let session = Session::create(&folder.path().join("vase"), "vase").unwrap();
        (folder, session)
    }

    #[test]
    fn files_are_found_by_ids_that_tell_nothing_and_stay_the_same() {
        let (_folder, session) = session();
        std::fs::write(session.model_dir().join("model.glb"), b"glTF").unwrap();
        let files = session.files().unwrap();
        let paths: Vec<_> = files.iter().map(|f| (f.path.as_str(), f.kind)).collect();
        assert_eq!(
            paths,
            [
                ("journal.jsonl", FileKind::Record),
                ("model/model.glb", FileKind::Result),
                ("session.json", FileKind::Record)
            ]
        );
        assert_eq!(files[1].id, file_id("model/model.glb"));
        assert!(files[1].id.len() == 32 && files[1].id.chars().all(|c| c.is_ascii_hexdigit()));
        let (mut file, about) = session.open_file(&files[1].id).unwrap().unwrap();
        let mut text = String::new();
        file.read_to_string(&mut text).unwrap();
        assert_eq!((text.as_str(), about.bytes), ("glTF", 4));
        assert!(session.open_file("model/model.glb").unwrap().is_none());
    }

    #[test]
    fn what_is_hidden_linked_or_a_cache_is_not_shown() {
        let (folder, session) = session();
        std::fs::write(folder.path().join("secret"), b"secret").unwrap();
        std::fs::create_dir(folder.path().join("elsewhere")).unwrap();
        std::fs::write(folder.path().join("elsewhere/secret"), b"secret").unwrap();
        symlink(folder.path().join("secret"), session.model_dir().join("link")).unwrap();
        symlink(folder.path().join("elsewhere"), session.model_dir().join("folder")).unwrap();
        std::fs::create_dir(session.pairs_dir().join(".tmp-1")).unwrap();
        for path in [".lock", "pairs/.tmp-1/off.dng", "derived/manifest.json"] {
            std::fs::write(session.path().join(path), b"x").unwrap();
        }
        let shown: Vec<_> = session.files().unwrap().into_iter().map(|f| f.path).collect();
        assert_eq!(shown, ["journal.jsonl", "session.json"]);
        for path in [".lock", "model/link", "model/folder/secret", "../secret", "derived/manifest.json"] {
            assert!(session.open_file(&file_id(path)).unwrap().is_none(), "{path}");
        }
        // A folder that became a link after it was listed.
        assert!(open_inside(session.path(), "model/folder/secret").is_err());
        assert!(open_inside(session.path(), "model/link").is_err());
    }
}
