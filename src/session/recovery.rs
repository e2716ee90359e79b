//! What opening a session after a crash finds and puts right.
//!
//! Folders alone say what is there; the journal says what was meant. A pair that was begun and whose folder is whole
//! was stored, whatever the journal still lacks; one without a folder was interrupted, and is named.

use super::{
    Entry, Event, InterruptedShot, JOURNAL, Numbering, PAIR_RECORD, Session, SessionError, journal, store,
};
use crate::pair::{Attempt, PairRecord};
use serde::{Deserialize, Serialize};
use std::borrow::Borrow;
use std::collections::BTreeMap;
use std::path::PathBuf;

/// A pair that was begun and neither stored nor given up.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Interrupted {
    /// The number that it would have had.
    pub number: u32,
    /// Which time it was shot, from 1.
    #[serde(default = "first")]
    pub attempt: u32,
    /// Its name.
    pub name: String,
    /// When it was begun, UTC.
    pub begun: String,
}

fn first() -> u32 {
    1
}

impl Interrupted {
    /// Whether it, or a later attempt at it, is among these by now.
    pub fn is_among(&self, pairs: &[impl Borrow<PairRecord>]) -> bool {
        pairs.iter().map(Borrow::borrow).any(|pair| pair.name == self.name && pair.attempt >= self.attempt)
    }
}

/// What was found and put right.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Recovery {
    /// Pairs whose frames are lost: they were never acknowledged.
    pub interrupted: Vec<Interrupted>,
    /// Pairs that are whole and that the journal did not yet call stored.
    pub completed: Vec<Attempt>,
    /// Calibration shots whose frames are lost.
    #[serde(default)]
    pub interrupted_shots: Vec<InterruptedShot>,
    /// Calibration shots that are whole and that the journal did not yet call stored.
    #[serde(default)]
    pub completed_shots: Vec<String>,
    /// Unfinished files and folders that were removed, from the session's folder.
    pub removed: Vec<PathBuf>,
    /// Bytes of an unfinished last line that were cut off the journal.
    pub cut: u64,
}

impl Recovery {
    /// What people should know of it, in sentences: of pairs that were interrupted and are not `stored` by now, and of the
    /// rest; nothing where nothing was the matter.
    pub fn sentences(&self, stored: impl Fn(&Interrupted) -> bool) -> Vec<String> {
        let open = self.interrupted.iter().filter(|pair| !stored(pair));
        let mut all: Vec<String> = open
            .map(|pair| {
                let Interrupted { number, attempt, name, begun } = pair;
                match attempt {
                    1 => format!("Pair {name} was interrupted before it was stored (begun {begun}): take or import it again."),
                    _ => format!("Pair {name} was being shot again when it was interrupted (begun {begun}): what there was of it stays as it is; shoot pair {number} again."),
                }
            })
            .collect();
        all.extend(
            self.completed
                .iter()
                .map(|pair| format!("Pair {pair} was stored whole just before the program was interrupted.")),
        );
        all.extend(self.interrupted_shots.iter().map(|InterruptedShot { name, begun }| {
            format!(
                "Calibration shot {name} was interrupted before it was stored (begun {begun}): take it again."
            )
        }));
        all.extend(self.completed_shots.iter().map(|name| {
            format!("Calibration shot {name} was stored whole just before the program was interrupted.")
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
        for (own, (name, begun)) in unsettled {
            let Attempt { number, attempt } = own;
            // `count` has read every record that has a folder; one of another name is another pair.
            match self.attempt(own) {
                Ok(record) if record.name == name => {
                    let verdict = record.verdict;
                    // One that cannot be read now goes without.
                    let digest = store::digest_file(&self.pair_dir(own).join(PAIR_RECORD)).ok();
                    let stored = Event::PairCommitted { number, attempt, name, verdict, record: digest };
                    self.append_or_owe(numbering, stored);
                    recovery.completed.push(own);
                }
                _ => {
                    self.append_or_owe(
                        numbering,
                        Event::PairInterrupted { number, attempt, name: name.clone() },
                    );
                    recovery.interrupted.push(Interrupted { number, attempt, name, begun });
                }
            }
        }
        self.recover_shots(numbering, &mut recovery)?;
        Ok(recovery)
    }
}

impl Session {
    /// What [`Session::recover`] would name, with nothing touched: nobody writes while the session is open for reading,
    /// so that a pair of which nothing was heard was interrupted.
    pub(super) fn interruptions(&self) -> Result<Recovery, SessionError> {
        let unsettled = unsettled(&self.journal()?).into_iter();
        let lost =
            unsettled.filter(|(own, (name, _))| !self.attempt(*own).is_ok_and(|found| found.name == *name));
        let interrupted = lost.map(|(own, (name, begun))| {
            let Attempt { number, attempt } = own;
            Interrupted { number, attempt, name, begun }
        });
        let interrupted = interrupted.collect();
        Ok(Recovery { interrupted, ..Recovery::default() })
    }
}

/// Pairs that were meant and of which nothing more was heard: name and time by attempt.
fn unsettled(journal: &[Entry]) -> BTreeMap<Attempt, (String, String)> {
    let mut open = BTreeMap::new();
    for entry in journal {
        match &entry.event {
            Event::PairIntended { number, attempt, name } => {
                let own = Attempt { number: *number, attempt: *attempt };
                open.insert(own, (name.clone(), entry.at.clone()));
            }
            Event::PairCommitted { number, attempt, .. }
            | Event::PairAbandoned { number, attempt, .. }
            | Event::PairInterrupted { number, attempt, .. } => {
                open.remove(&Attempt { number: *number, attempt: *attempt });
            }
            Event::SessionCreated | Event::Note { .. } => {}
        }
    }
    open
}
