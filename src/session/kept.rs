//! Files that are replaced as a whole when they are made or imported anew: results of calibrations, the scene.
//!
//! The journal hears of each twice: before it is written, what it will be, and afterwards, that it is. A program that is
//! killed in between leaves the former or the new file, and both are known.

use super::{Entry, Event, Session, SessionError, store};
use serde_json::{Value, json};
use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};

const INTENDED: &str = "file_intended";
const STORED: &str = "file_stored";

/// What the journal knows of a file.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct Kept {
    /// BLAKE3 of what it may hold.
    pub(super) digests: BTreeSet<String>,
    /// BLAKE3 of whatever it ever held.
    pub(super) former: BTreeSet<String>,
    /// Whether it must be there.
    pub(super) stored: bool,
}

impl Session {
    /// Writes a file of the session so that it holds what it held before or all of `bytes`, and its BLAKE3 into the
    /// journal; on the disk when this returns. Its folder is made if need be.
    pub fn keep(&self, file: &Path, bytes: &[u8]) -> Result<(), SessionError> {
        let inside = file.strip_prefix(self.path()).unwrap_or(file);
        let note = |what: &str| {
            let detail = json!({ "file": inside, "bytes": bytes.len(), "blake3": store::digest(bytes) });
            self.record(Event::Note { what: what.to_owned(), detail })
        };
        let folder = file.parent().unwrap_or(self.path());
        std::fs::create_dir_all(folder).map_err(SessionError::io(folder))?;
        note(INTENDED)?;
        store::write_atomic(file, bytes).map_err(SessionError::io(file))?;
        note(STORED)
    }
}

/// What the journal knows of kept files, by their paths from the session's folder.
pub(super) fn kept(journal: &[Entry]) -> BTreeMap<PathBuf, Kept> {
    let mut files: BTreeMap<PathBuf, Kept> = BTreeMap::new();
    for entry in journal {
        let Event::Note { what, detail } = &entry.event else { continue };
        let text = |key: &str| detail.get(key).and_then(Value::as_str).map(str::to_owned);
        let (Some(file), Some(digest)) = (text("file"), text("blake3")) else { continue };
        match what.as_str() {
            INTENDED => {}
            STORED => {
                let kept = files.entry(file.clone().into()).or_default();
                kept.digests.clear();
                kept.stored = true;
            }
            _ => continue,
        }
        let kept = files.entry(file.into()).or_default();
        kept.digests.insert(digest.clone());
        kept.former.insert(digest);
    }
    files
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn until_a_file_is_stored_it_may_still_be_the_former_one() {
        let entry = |what: &str, digest: &str| Entry {
            at: String::new(),
            event: Event::Note {
                what: what.into(),
                detail: json!({ "file": "calibration/flash.json", "bytes": 2, "blake3": digest }),
            },
        };
        let known = |entries: &[Entry]| {
            let kept = kept(entries).remove(Path::new("calibration/flash.json")).unwrap();
            (kept.digests.into_iter().collect::<Vec<_>>().join(" "), kept.stored)
        };
        let told = [entry(INTENDED, "a"), entry(STORED, "a"), entry(INTENDED, "b"), entry(STORED, "b")];
        assert_eq!(known(&told[..1]), ("a".into(), false));
        assert_eq!(known(&told[..2]), ("a".into(), true));
        assert_eq!(known(&told[..3]), ("a b".into(), true));
        assert_eq!(known(&told), ("b".into(), true));
        assert!(kept(&[entry("something_else", "a")]).is_empty());
    }
}
