//! Calibration shots in the journal: what was begun, and what came of it.

use super::{Entry, Event, Numbering, Recovery, Session, SessionError, store};
use serde::{Deserialize, Serialize};
use serde_json::json;
use std::collections::{BTreeMap, BTreeSet};
use std::path::{Component, Path, PathBuf};

/// What the journal's note of a calibration shot that is about to be taken is called.
pub const SHOT_STARTED: &str = "calibration_shot_started";
/// The note of one that is whole on the disk.
pub const SHOT_STORED: &str = "calibration_shot_stored";
/// The note of one of which nothing was stored, and why.
pub const SHOT_ABANDONED: &str = "calibration_shot_abandoned";
/// The note of one that is about to be removed on request.
pub const SHOT_REMOVED: &str = "calibration_shot_removed";
/// The note of one in whose middle the program ended. Written when the session is opened again.
pub const SHOT_INTERRUPTED: &str = "calibration_shot_interrupted";

/// The note of a shot that waits for its calibration, once it is whole on the disk.
pub const FRAME_STORED: &str = "calibration_frame_stored";
/// The note of one that was removed, on request or because a record has its copy, once it is gone.
pub const FRAME_REMOVED: &str = "calibration_frame_removed";

/// Where shots wait for their calibration, from the session's folder: a folder a kind, in it one a shot.
pub const WAITING: &str = "calibration/waiting";

/// Where shots of the card are, from the session's folder.
pub(super) const SHOTS: &str = "calibration/flash";
/// Name of the record beside a calibration shot's frames.
pub(super) const SHOT_RECORD: &str = "shot.json";

/// A calibration shot that was begun and neither stored nor given up.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct InterruptedShot {
    /// Its name.
    pub name: String,
    /// When it was begun, UTC.
    pub begun: String,
}

impl Session {
    /// Settles the calibration shots that a crash left open.
    pub(super) fn recover_shots(
        &self,
        numbering: &mut Numbering,
        recovery: &mut Recovery,
    ) -> Result<(), SessionError> {
        let folder = self.calibration_dir().join("flash");
        let unsettled = unsettled(&self.journal()?);
        if !unsettled.is_empty() && folder.is_dir() {
            // A folder may have got its name without that being on the disk yet.
            store::sync_folder(&folder).map_err(SessionError::io(&folder))?;
        }
        for (name, begun) in unsettled {
            // A shot's folder gets its name when it is whole.
            let whole = folder.join(&name).join(SHOT_RECORD).is_file();
            let what = if whole { SHOT_STORED } else { SHOT_INTERRUPTED };
            let note = Event::Note { what: what.to_owned(), detail: json!({ "name": name }) };
            self.append_or_owe(numbering, note);
            if whole {
                recovery.completed_shots.push(name);
            } else {
                recovery.interrupted_shots.push(InterruptedShot { name, begun });
            }
        }
        Ok(())
    }
}

/// The calibration shot of which an event tells: its name and what became of it.
pub(super) fn told(event: &Event) -> Option<(&str, &str)> {
    let Event::Note { what, detail } = event else { return None };
    let known = [SHOT_STARTED, SHOT_STORED, SHOT_ABANDONED, SHOT_REMOVED, SHOT_INTERRUPTED];
    let what = known.into_iter().find(|known| known == what)?;
    Some((detail.get("name")?.as_str()?, what))
}

/// The folders, from the session's, of all shots that were ever removed; others may have their names since.
pub(super) fn removed(journal: &[Entry]) -> BTreeSet<PathBuf> {
    let folder = |entry: &Entry| {
        let Event::Note { what, detail } = &entry.event else { return None };
        let (place, name) = match what.as_str() {
            SHOT_REMOVED => (PathBuf::from(SHOTS), detail.get("name")?.as_str()?.to_owned()),
            FRAME_REMOVED => {
                let kind = plain(detail.get("kind")?.as_str()?)?;
                (Path::new(WAITING).join(kind), format!("{:04}", detail.get("shot")?.as_u64()?))
            }
            _ => return None,
        };
        Some(place.join(plain(&name)?))
    };
    journal.iter().filter_map(folder).collect()
}

/// A name that leads nowhere else.
fn plain(name: &str) -> Option<&str> {
    let mut parts = Path::new(name).components();
    (matches!(parts.next(), Some(Component::Normal(_))) && parts.next().is_none()).then_some(name)
}

/// Shots that were begun and of which nothing more was heard: when, by name.
fn unsettled(journal: &[Entry]) -> BTreeMap<String, String> {
    let mut open = BTreeMap::new();
    for entry in journal {
        match told(&entry.event) {
            Some((name, SHOT_STARTED)) => {
                open.insert(name.to_owned(), entry.at.clone());
            }
            Some((name, _)) => {
                open.remove(name);
            }
            None => {}
        }
    }
    open
}
