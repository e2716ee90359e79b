//! How many more pairs the disk takes.

use super::{Numbering, Session, SessionError};
use crate::pair::PairRecord;
use serde::{Deserialize, Serialize};

/// Bytes that stay free for the journal and for what other programs do meanwhile.
const RESERVE: u64 = 64 << 20;

/// Room on the disk that a session lies on.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Room {
    /// Bytes that may still be written.
    pub free: u64,
    /// Bytes of the largest pair so far; 0 before the first.
    pub largest_pair: u64,
}

impl Room {
    /// How many more pairs as large as the largest so far fit; unknown before the first.
    pub fn pairs(&self) -> Option<u64> {
        self.free.saturating_sub(RESERVE).checked_div(self.largest_pair)
    }
}

/// Bytes of a pair's originals.
pub(super) fn bytes_of(record: &PairRecord) -> u64 {
    [&record.off, &record.on].map(|f| f.bytes + f.jpeg.as_ref().map_or(0, |jpeg| jpeg.bytes)).iter().sum()
}

impl Session {
    /// Room for more pairs.
    pub fn room(&self) -> Result<Room, SessionError> {
        self.room_after(&self.pairs()?)
    }

    /// The same, its pairs being these.
    pub fn room_after(&self, pairs: &[PairRecord]) -> Result<Room, SessionError> {
        let largest_pair = pairs.iter().map(bytes_of).max().unwrap_or(0);
        Ok(Room { free: self.free()?, largest_pair })
    }

    fn free(&self) -> Result<u64, SessionError> {
        let disk = rustix::fs::statvfs(&self.path).map_err(|e| SessionError::io(&self.path)(e.into()))?;
        Ok(disk.f_bavail.saturating_mul(disk.f_frsize))
    }

    /// Refuses where there is no room for two frames more, as large as those of the largest pair so far.
    pub fn require_room(&self) -> Result<(), SessionError> {
        let numbering = self.numbering()?;
        self.require_room_for(&numbering, None)
    }

    /// The same for a pair of `bytes`, if they are known.
    pub(super) fn require_room_for(
        &self,
        numbering: &Numbering,
        bytes: Option<u64>,
    ) -> Result<(), SessionError> {
        let (free, needed) = (self.free()?, bytes.unwrap_or(numbering.largest).saturating_add(RESERVE));
        if free < needed {
            return Err(SessionError::NoRoom { path: self.path.clone(), free, needed });
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn so_many_pairs_fit_as_the_reserve_leaves_room_for() {
        let room = |free, largest_pair| Room { free, largest_pair };
        assert_eq!(room(RESERVE + 1000, 100).pairs(), Some(10));
        assert_eq!(room(RESERVE + 99, 100).pairs(), Some(0));
        assert_eq!(room(5, 100).pairs(), Some(0));
        assert_eq!(room(RESERVE, 0).pairs(), None);
    }
}
