//! What opening a session after a crash finds and puts right.
//!
//! Folders alone say what is there; the journal says what was meant. A pair that was begun and whose folder is whole
//! was stored, whatever the journal still lacks; one without a folder was interrupted, and is named.

use super::{Entry, Event, JOURNAL, Numbering, Session, SessionError, journal, store};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::path::PathBuf;

/// A pair that was begun and neither stored nor given up.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Interrupted {
    /// The number that it would have had.
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
    /// What people should know of it, in sentences: of pairs that were interrupted and are not `stored` by now, and of the
    /// rest; nothing where nothing was the matter.
    pub fn sentences(&self, stored: impl Fn(&str) -> bool) -> Vec<String> {
        let open = self.interrupted.iter().filter(|pair| !stored(&pair.name));
        let mut all: Vec<String> = open
            .map(|pair| {
                let Interrupted { name, begun, .. } = pair;
                format!("Pair {name} was interrupted before it was stored (begun {begun}): take or import it again.")
            })
            .collect();
        all.extend(self.completed.iter().map(|number| {
            format!("Pair {number:04} was stored whole just before the program was interrupted.")
        }));
        match self.removed.len() {
            0 => {}
            1 => all.push("An unfinished file or folder of an interrupted run was removed.".into()),
            n => all.push(format!("{n} unfinished files and folders of an interrupted run were removed.")),
        }
        if self.cut > 0 {
            all.push(
                "The journal's last line was unfinished and was cut off; it told of nothing that counts."
                    .into(),
            );
        }
        all
    }
}

impl Session {
    /// Puts right what a crash left; the session is open for writing.
    pub(super) fn recover(&self, numbering: &mut Numbering) -> Result<Recovery, SessionError> {
        let removed = store::remove_temporaries(&self.path).map_err(SessionError::io(&self.path))?;
        let cut = journal::mend_tail(&self.path.join(JOURNAL))?;
        let inside = |path: PathBuf| path.strip_prefix(&self.path).map(PathBuf::from).unwrap_or(path);
        let removed = removed.into_iter().map(inside).collect();
        let mut recovery = Recovery { removed, cut, ..Recovery::default() };
        let unsettled = unsettled(&self.journal()?);
        if !unsettled.is_empty() {
            // A folder may have got its name without that being on the disk yet.
            store::sync_folder(&self.pairs_dir()).map_err(SessionError::io(&self.pairs_dir()))?;
        }
        for (number, (name, begun)) in unsettled {
            // `count` has read every record that has a folder; one of another name is another pair.
            match self.pair(number) {
                Ok(record) if record.name == name => {
                    let verdict = record.verdict;
                    self.append_or_owe(numbering, Event::PairCommitted { number, name, verdict });
                    recovery.completed.push(number);
                }
                _ => {
                    self.append_or_owe(numbering, Event::PairInterrupted { number, name: name.clone() });
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
