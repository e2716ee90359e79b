//! Which numbers and names of pairs are taken.

use super::{Event, Session, SessionError, room};
use crate::pair::{Attempt, PairRecord, Verdict};
use std::collections::HashMap;

/// Numbers and names that are taken.
#[derive(Debug, Default)]
pub(super) struct Numbering {
    pub(super) next: u32,
    /// By name.
    pub(super) names: HashMap<String, Taken>,
    /// Bytes of the largest frame.
    pub(super) largest: u64,
    /// Bytes of the largest pair.
    pub(super) largest_pair: u64,
    /// The pair that the journal says is about to be shot or stored.
    pub(super) intended: Option<(Attempt, String)>,
    /// What the journal must still hear: it could not be written when it happened.
    pub(super) owed: Option<Event>,
}

/// What has been stored under a name.
#[derive(Debug)]
pub(super) struct Taken {
    pub(super) number: u32,
    /// The last of its attempts, whether its folder is still there or not.
    pub(super) attempts: u32,
    /// Whether any of them was accepted.
    pub(super) accepted: bool,
    /// Digests of all frames, by attempt.
    pub(super) files: Vec<(u32, Vec<String>)>,
}

/// Digests of a pair's frames.
pub(super) fn digests(record: &PairRecord) -> Vec<String> {
    record.frames().map(|(_, frame)| frame.blake3.clone()).collect()
}

impl Numbering {
    /// The number of the next pair that is shot: it skips those that imported pairs have for names.
    pub(super) fn next_shot(&self) -> u32 {
        let free = |number: &u32| !self.names.contains_key(&format!("{number:04}"));
        (self.next..=u32::MAX).find(free).unwrap_or(u32::MAX)
    }

    /// Takes in a pair that is on the disk.
    pub(super) fn take(&mut self, record: &PairRecord) {
        self.next = self.next.max(record.number.saturating_add(1));
        self.largest = self.largest.max(room::largest_frame(record));
        self.largest_pair = self.largest_pair.max(room::bytes_of(record));
        let number = record.number;
        let taken = self.names.entry(record.name.clone());
        let taken =
            taken.or_insert_with(|| Taken { number, attempts: 0, accepted: false, files: Vec::new() });
        taken.attempts = taken.attempts.max(record.attempt);
        taken.accepted |= record.verdict == Verdict::Accepted;
        taken.files.push((record.attempt, digests(record)));
    }
}

impl Session {
    /// Numbers spent and names taken, out of the folders and the journal: the number of a pair that was stored is never
    /// used again, not even when its folder was moved away.
    pub(super) fn count(&self) -> Result<Numbering, SessionError> {
        let mut numbering = Numbering { next: 1, ..Numbering::default() };
        self.attempts()?.values().flatten().for_each(|record| numbering.take(record));
        for entry in self.journal()? {
            if let Event::PairCommitted { number, attempt, name, .. } = entry.event {
                numbering.next = numbering.next.max(number.saturating_add(1));
                if let Some(taken) = numbering.names.get_mut(&name) {
                    taken.attempts = taken.attempts.max(attempt);
                }
            }
        }
        Ok(numbering)
    }
}
