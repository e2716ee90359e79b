//! Checks `sequence.json`: that it can be read, and that the pairs of which it tells are there.

use super::{Check, Damage};
use crate::session::SEQUENCE;

impl Check<'_> {
    pub(super) fn sequence(&mut self) {
        let record = match self.session.sequence() {
            Ok(Some(record)) => record,
            Ok(None) => return,
            Err(error) => {
                let file = self.session.path().join(SEQUENCE);
                return self.tell(&file, Damage::Unreadable, error.to_string());
            }
        };
        for (position, place) in (1..).zip(&record.positions) {
            let position: u32 = position;
            for &pair in &place.pairs {
                let folder = self.session.pair_dir(pair);
                // What the journal misses has been told.
                if !folder.is_dir() && !self.is_told(&folder) {
                    let why =
                        format!("position {position} of the sequence has this pair, and it is not there");
                    self.tell(&folder, Damage::Missing, why);
                }
            }
        }
    }
}
