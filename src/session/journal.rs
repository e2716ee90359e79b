//! `journal.jsonl`: one JSON object a line, appended and on the disk before the next step is taken.
//!
//! The journal tells what was meant and what came of it; the folders alone say what is there.

use super::{SessionError, lines};
use crate::pair::{Attempt, Verdict};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::path::Path;
use std::time::{SystemTime, UNIX_EPOCH};

/// What happened.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "event", rename_all = "snake_case")]
pub enum Event {
    /// The session was made.
    SessionCreated,
    /// A pair is about to be shot or stored.
    PairIntended {
        /// Its number.
        number: u32,
        /// Which time it is shot, from 1.
        #[serde(default = "first", skip_serializing_if = "is_first")]
        attempt: u32,
        /// Its name.
        name: String,
    },
    /// A pair is whole on the disk.
    PairCommitted {
        /// Its number.
        number: u32,
        /// Which time it is shot, from 1.
        #[serde(default = "first", skip_serializing_if = "is_first")]
        attempt: u32,
        /// Its name.
        name: String,
        /// What the checks said.
        verdict: Verdict,
        /// BLAKE3 of its `pair.json`, hexadecimal; entries of before have none.
        #[serde(default, skip_serializing_if = "Option::is_none")]
        record: Option<String>,
    },
    /// Nothing was stored of a pair: a device or the disk gave up, or somebody wanted it so.
    PairAbandoned {
        /// Its number; the next pair has it.
        number: u32,
        /// Which time it is shot, from 1.
        #[serde(default = "first", skip_serializing_if = "is_first")]
        attempt: u32,
        /// Its name.
        name: String,
        /// Why.
        why: String,
    },
    /// Nothing was stored of a pair: the program ended in the middle of it. Written when the session is opened again.
    PairInterrupted {
        /// Its number; the next pair has it.
        number: u32,
        /// Which time it is shot, from 1.
        #[serde(default = "first", skip_serializing_if = "is_first")]
        attempt: u32,
        /// Its name.
        name: String,
    },
    /// Anything else that whoever writes it wants to find again.
    Note {
        /// A short, stable name.
        what: String,
        /// Whatever belongs to it.
        detail: serde_json::Value,
    },
}

fn first() -> u32 {
    1
}

fn is_first(attempt: &u32) -> bool {
    *attempt == 1
}

/// An event with its time.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Entry {
    /// UTC, `YYYY-MM-DDTHH:MM:SS.mmmZ`.
    pub at: String,
    /// What happened.
    #[serde(flatten)]
    pub event: Event,
}

/// Appends an event, now; on the disk when this returns.
pub(super) fn append(path: &Path, event: Event) -> Result<(), SessionError> {
    let line = serde_json::to_string(&Entry { at: now(), event })
        .map_err(|e| SessionError::Damaged { path: path.to_owned(), why: e.to_string() })?;
    lines::append_synced(path, &line).map_err(SessionError::io(path))
}

/// All entries, oldest first. A last line without its newline was never acknowledged and does not count.
pub(super) fn read(path: &Path) -> Result<Vec<Entry>, SessionError> {
    let parse = |(i, line): (usize, &str)| {
        serde_json::from_str(line).map_err(|e| SessionError::Damaged {
            path: path.to_owned(),
            why: format!("line {} is no journal entry ({e})", i + 1),
        })
    };
    lines::read(path).map_err(SessionError::io(path))?.lines().enumerate().map(parse).collect()
}

/// BLAKE3 of the records of the pairs that were stored; those of before have none.
pub(super) fn records(journal: &[Entry]) -> BTreeMap<Attempt, String> {
    let digest = |entry: &Entry| match &entry.event {
        Event::PairCommitted { number, attempt, record: Some(digest), .. } => {
            Some((Attempt { number: *number, attempt: *attempt }, digest.clone()))
        }
        _ => None,
    };
    journal.iter().filter_map(digest).collect()
}

/// Cuts off a last line that a crash left without its newline, and says how many bytes it had.
pub(super) fn mend_tail(path: &Path) -> Result<u64, SessionError> {
    lines::mend_tail(path).map_err(SessionError::io(path))
}

/// The present moment, UTC.
pub fn now() -> String {
    // A clock before 1970 is a clock that is not set; 1970 then says so.
    let since = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
    utc(since.as_secs(), since.subsec_millis())
}

/// Civil date of seconds since 1970, by the 400-year cycle of 146097 days counted from 1 March.
fn utc(seconds: u64, milliseconds: u32) -> String {
    let (days, second) = (seconds / 86_400 + 719_468, seconds % 86_400);
    let (era, day_of_era) = (days / 146_097, days % 146_097);
    let year_of_era = (day_of_era - day_of_era / 1460 + day_of_era / 36_524 - day_of_era / 146_096) / 365;
    let day_of_year = day_of_era - (365 * year_of_era + year_of_era / 4 - year_of_era / 100);
    let month_from_march = (5 * day_of_year + 2) / 153;
    let day = day_of_year - (153 * month_from_march + 2) / 5 + 1;
    let month = if month_from_march < 10 { month_from_march + 3 } else { month_from_march - 9 };
    let year = era * 400 + year_of_era + u64::from(month <= 2);
    let (hour, minute, second) = (second / 3600, second / 60 % 60, second % 60);
    format!("{year:04}-{month:02}-{day:02}T{hour:02}:{minute:02}:{second:02}.{milliseconds:03}Z")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn seconds_become_the_right_day() {
        assert_eq!(utc(0, 0), "1970-01-01T00:00:00.000Z");
        assert_eq!(utc(951_782_400, 0), "2000-02-29T00:00:00.000Z");
        assert_eq!(utc(1_795_314_030, 7), "2026-11-22T02:20:30.007Z");
        assert_eq!(utc(4_107_542_399, 0), "2100-02-28T23:59:59.000Z");
    }

    #[test]
    fn a_torn_last_line_is_cut_off_and_the_rest_stays() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("journal.jsonl");
        append(&path, Event::SessionCreated).unwrap();
        let mut torn = std::fs::read(&path).unwrap();
        torn.extend(b"{\"at\":\"2026");
        std::fs::write(&path, &torn).unwrap();
        assert_eq!(read(&path).unwrap().len(), 1);
        append(&path, Event::SessionCreated).unwrap();
        assert_eq!(read(&path).unwrap().len(), 2, "a line does not grow out of what is left of another");
        std::fs::write(&path, &torn).unwrap();
        assert_eq!((mend_tail(&path).unwrap(), mend_tail(&path).unwrap()), (11, 0));
        append(&path, Event::PairIntended { number: 1, attempt: 1, name: "0001".into() }).unwrap();
        assert_eq!(read(&path).unwrap().len(), 2);
    }
}
