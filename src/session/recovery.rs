//! What opening a session after a crash finds and puts right.
//!
//! Folders alone say what is there; the journal says what was meant. A pair that was begun and whose folder is whole
//! was stored, whatever the journal still lacks; one without a folder was interrupted, and is named.

use super::{Entry, Event, JOURNAL, Session, SessionError, journal, store};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::path::PathBuf;

/// A pair that was begun and neither stored nor given up.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Interrupted {
    /// The number that it would have had; the next pair has it.
    pub number: u32,
    /// Its name.
    pub name: String,
    /// When it was begun, UTC.
    pub begun: String,
}

/// What was found and put right.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Recovery {
    /// Pairs whose frames are lost: they were never acknowledged.
    pub interrupted: Vec<Interrupted>,
    /// Pairs that are whole and that the journal did not yet call stored.
    pub completed: Vec<u32>,
    /// Unfinished files and folders that were removed, from the session's folder.
    pub removed: Vec<PathBuf>,
    /// Bytes of an unfinished last line that were cut off the journal.
    pub cut: u64,
}

impl Recovery {
    /// What people should know of it, a sentence each; nothing where nothing was the matter.
    pub fn sentences(&self) -> Vec<String> {
        let mut all: Vec<String> = self
            .interrupted
            .iter()
            .map(|pair| {
                format!(
                    "Pair {} was interrupted before it was stored (begun {}): take it again.",
                    pair.name, pair.begun
                )
            })
            .collect();
        all.extend(self.completed.iter().map(|number| {
            format!("Pair {number} was stored whole just before the program was interrupted.")
        }));
        if !self.removed.is_empty() {
            let (n, s) = (self.removed.len(), if self.removed.len() == 1 { "" } else { "s" });
            all.push(format!("{n} unfinished file{s} or folder{s} of an interrupted run were removed."));
        }
        all
    }
}

impl Session {
    /// Puts right what a crash left; the session is open for writing.
    pub(super) fn recover(&self) -> Result<Recovery, SessionError> {
        let removed = store::remove_temporaries(&self.path).map_err(SessionError::io(&self.path))?;
        let file = self.path.join(JOURNAL);
        let cut = journal::mend_tail(&file)?;
        let inside = |path: PathBuf| path.strip_prefix(&self.path).map(PathBuf::from).unwrap_or(path);
        let removed = removed.into_iter().map(inside).collect();
        let mut recovery = Recovery { removed, cut, ..Recovery::default() };
        for (number, (name, begun)) in unsettled(&self.journal()?) {
            match self.pair(number) {
                Ok(record) if record.name == name => {
                    let verdict = record.verdict;
                    journal::append(&file, Event::PairCommitted { number, name, verdict })?;
                    recovery.completed.push(number);
                }
                // A folder that cannot be read is told by whoever reads the pairs.
                _ => {
                    journal::append(&file, Event::PairInterrupted { number, name: name.clone() })?;
                    recovery.interrupted.push(Interrupted { number, name, begun });
                }
            }
        }
        Ok(recovery)
    }
}

/// Pairs that were meant and of which nothing more was heard: name and time by number.
fn unsettled(journal: &[Entry]) -> BTreeMap<u32, (String, String)> {
    let mut open = BTreeMap::new();
    for entry in journal {
        match &entry.event {
            Event::PairIntended { number, name } => {
                open.insert(*number, (name.clone(), entry.at.clone()));
            }
            Event::PairCommitted { number, .. }
            | Event::PairAbandoned { number, .. }
            | Event::PairInterrupted { number, .. } => {
                open.remove(number);
            }
            Event::SessionCreated | Event::Note { .. } => {}
        }
    }
    open
}
