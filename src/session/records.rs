//! Pairs' records, read once: a record that was not written since is not read again.

use super::{SessionError, from_json};
use crate::pair::PairRecord;
use std::collections::HashMap;
use std::fs::Metadata;
use std::os::unix::fs::MetadataExt;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, PoisonError};

/// Which writing of a file was read: records are written aside and renamed, which makes another inode.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Writing {
    device: u64,
    inode: u64,
    length: u64,
    modified: (i64, i64),
}

impl Writing {
    fn of(found: &Metadata) -> Self {
        Self {
            device: found.dev(),
            inode: found.ino(),
            length: found.len(),
            modified: (found.mtime(), found.mtime_nsec()),
        }
    }
}

/// By file, which writing of it was read, and what it said.
type Known = HashMap<PathBuf, (Writing, Arc<PairRecord>)>;

/// What was read of a session's pairs; clones share it, so that it may outlive the opening of a session.
#[derive(Clone, Debug, Default)]
pub struct Records(Arc<Mutex<Known>>);

impl Records {
    /// A record as it is on the disk now.
    pub(super) fn read(&self, file: &Path) -> Result<Arc<PairRecord>, SessionError> {
        // Asked before reading: what is written in between is read again next time.
        let now = Writing::of(&std::fs::metadata(file).map_err(SessionError::io(file))?);
        let known =
            |(writing, record): &(Writing, Arc<PairRecord>)| (*writing == now).then(|| record.clone());
        if let Some(record) = self.lock().get(file).and_then(known) {
            return Ok(record);
        }
        let record: Arc<PairRecord> = Arc::new(from_json(file)?);
        self.lock().insert(file.to_owned(), (now, record.clone()));
        Ok(record)
    }

    fn lock(&self) -> std::sync::MutexGuard<'_, Known> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}
