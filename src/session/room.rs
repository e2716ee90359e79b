//! How many more pairs the disk takes.

use super::{Numbering, Session, SessionError};
use crate::pair::{FrameRecord, PairRecord};
use serde::{Deserialize, Serialize};
use std::borrow::Borrow;
use std::path::Path;

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
    /// Room on the disk that `path` lies on, where no pair is known.
    pub fn of_disk(path: &Path) -> Result<Room, SessionError> {
        let disk = rustix::fs::statvfs(path).map_err(|e| SessionError::io(path)(e.into()))?;
        Ok(Room { free: disk.f_bavail.saturating_mul(disk.f_frsize), largest_pair: 0 })
    }

    /// How many more pairs as large as the largest so far fit; unknown before the first.
    pub fn pairs(&self) -> Option<u64> {
        self.free.saturating_sub(RESERVE).checked_div(self.largest_pair)
    }
}

/// Bytes of a pair's originals.
pub(super) fn bytes_of(record: &PairRecord) -> u64 {
    record.frames().map(|(_, frame)| bytes_of_frame(frame)).sum()
}

/// Bytes of the largest of its frames.
pub(super) fn largest_frame(record: &PairRecord) -> u64 {
    record.frames().map(|(_, frame)| bytes_of_frame(frame)).max().unwrap_or(0)
}

fn bytes_of_frame(frame: &FrameRecord) -> u64 {
    frame.bytes + frame.jpeg.as_ref().map_or(0, |jpeg| jpeg.bytes)
}

/// What there must be room for.
pub(super) enum Wanted {
    /// So many frames, each as large as the largest so far.
    Frames(u64),
    /// So many bytes.
    Bytes(u64),
}

impl Session {
    /// Room for more pairs.
    pub fn room(&self) -> Result<Room, SessionError> {
        self.room_after(&self.pairs()?)
    }

    /// The same, its pairs being these.
    pub fn room_after(&self, pairs: &[impl Borrow<PairRecord>]) -> Result<Room, SessionError> {
        let largest_pair = pairs.iter().map(|pair| bytes_of(pair.borrow())).max().unwrap_or(0);
        Ok(Room { free: self.free()?, largest_pair })
    }

    /// Room for more pairs, told without reading a file or waiting for anybody; while a pair is being stored, the pairs are
    /// not known.
    pub fn room_at_a_glance(&self) -> Result<Room, SessionError> {
        let numbering = self.numbering.as_ref().and_then(|numbering| numbering.try_lock().ok());
        Ok(Room { free: self.free()?, largest_pair: numbering.map_or(0, |numbering| numbering.largest_pair) })
    }

    fn free(&self) -> Result<u64, SessionError> {
        Room::of_disk(&self.path).map(|room| room.free)
    }

    /// Refuses where there is no room for two frames more, as large as the largest so far.
    pub fn require_room(&self) -> Result<(), SessionError> {
        let numbering = self.numbering()?;
        self.require_room_for(&numbering, Wanted::Frames(2))
    }

    /// The same for what is wanted.
    pub(super) fn require_room_for(&self, numbering: &Numbering, wanted: Wanted) -> Result<(), SessionError> {
        let bytes = match wanted {
            Wanted::Frames(frames) => numbering.largest.saturating_mul(frames),
            Wanted::Bytes(bytes) => bytes,
        };
        let (free, needed) = (self.free()?, bytes.saturating_add(RESERVE));
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
