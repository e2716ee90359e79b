//! Checks what is kept beside the pairs: results of calibrations, the scene and the files it was imported from.

use super::{Check, Damage, differs};
use crate::session::kept::Kept;
use crate::session::store;
use serde::Deserialize;
use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

/// What `scene/scene.json` tells of the files that were imported.
#[derive(Deserialize)]
struct Scene {
    camera_files: Vec<Imported>,
    meshes: Vec<Imported>,
}

#[derive(Deserialize)]
struct Imported {
    file: String,
    blake3: String,
}

/// A file to check and the digests that it may have; none where nobody wrote them down.
pub(super) struct Expected {
    path: PathBuf,
    digests: BTreeSet<String>,
    /// Whether it must be there.
    stored: bool,
}

impl Check<'_> {
    /// Every kept file: of those that the journal knows, of the scene's list, and of the two folders.
    pub(super) fn expected(&mut self, mut journal: BTreeMap<PathBuf, Kept>) -> Vec<Expected> {
        let root = self.session.path().to_owned();
        let mut files: BTreeMap<PathBuf, (BTreeSet<String>, bool)> = BTreeMap::new();
        let list = Path::new("scene/scene.json");
        let found = self.files_in(Path::new("calibration"));
        for file in found.into_iter().chain(root.join(list).is_file().then(|| list.to_owned())) {
            files.insert(file, Default::default());
        }
        for (file, kept) in std::mem::take(&mut journal) {
            files.insert(file, (kept.digests, kept.stored));
        }
        for Imported { file, blake3 } in self.imported(&root.join(list)) {
            files.insert(Path::new("scene").join(file), (BTreeSet::from([blake3]), true));
        }
        // Files of former imports are named by the start of their digest, and nothing else is known of them.
        for file in self.files_in(Path::new("scene/originals")) {
            let name = file.file_name().unwrap_or_default().to_string_lossy().into_owned();
            let named = name.split_once('_').map(|(digest, _)| digest.to_owned());
            files.entry(file).or_insert_with(|| (named.into_iter().collect(), true));
        }
        files.into_iter().map(|(path, (digests, stored))| Expected { path, digests, stored }).collect()
    }

    pub(super) fn kept(&mut self, expected: &Expected) {
        let file = self.session.path().join(&expected.path);
        let digest = match store::digest_file(&file) {
            Ok(digest) => digest,
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => {
                if expected.stored {
                    self.tell(&file, Damage::Missing, "it was stored and is not there any more");
                }
                return;
            }
            Err(error) => return self.tell(&file, Damage::Unreadable, error.to_string()),
        };
        if expected.digests.is_empty() {
            let why =
                "its checksum was not written down when it was made; make or import it again to have that";
            return self.tell(&file, Damage::Unknown, why);
        }
        if expected.digests.iter().any(|known| !known.is_empty() && digest.starts_with(known.as_str())) {
            self.found.kept += 1;
            return;
        }
        let stored = expected.digests.iter().next_back().map(String::as_str).unwrap_or_default();
        self.tell(&file, Damage::Altered, differs(&digest, stored));
    }

    /// The files of a folder, from the session's; folders inside it are not its own.
    fn files_in(&mut self, folder: &Path) -> Vec<PathBuf> {
        let place = self.session.path().join(folder);
        let entries = match std::fs::read_dir(&place) {
            Ok(entries) => entries,
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => return vec![],
            Err(error) => {
                self.tell(&place, Damage::Unreadable, error.to_string());
                return vec![];
            }
        };
        let files = entries.flatten().filter(|entry| entry.path().is_file());
        let names = files.map(|file| file.file_name());
        let own = |name: &std::ffi::OsString| !name.to_string_lossy().starts_with(store::TEMPORARY_PREFIX);
        names.filter(own).map(|name| folder.join(name)).collect()
    }

    fn imported(&mut self, list: &Path) -> Vec<Imported> {
        if !list.is_file() {
            return vec![];
        }
        self.record::<Scene>(list)
            .map(|scene| scene.camera_files.into_iter().chain(scene.meshes).collect())
            .unwrap_or_default()
    }
}
