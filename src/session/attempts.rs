//! Reads the pairs that are there, and each of the times that they were shot.

use super::{PAIR_RECORD, Session, SessionError};
use crate::pair::{Attempt, PairRecord, current};
use std::collections::BTreeMap;
use std::sync::Arc;

impl Session {
    /// All pairs, ascending by number, each as the attempt that counts: the last accepted one, or else the last. A pair
    /// whose record is damaged is an error that names it.
    pub fn pairs(&self) -> Result<Vec<Arc<PairRecord>>, SessionError> {
        Ok(self.attempts()?.values().filter_map(|attempts| current(attempts).cloned()).collect())
    }

    /// All attempts at all pairs, by number and in their order.
    pub fn attempts(&self) -> Result<BTreeMap<u32, Vec<Arc<PairRecord>>>, SessionError> {
        let mut all: BTreeMap<u32, Vec<Arc<PairRecord>>> = BTreeMap::new();
        for attempt in self.folders()? {
            all.entry(attempt.number).or_default().push(self.shared(attempt)?);
        }
        Ok(all)
    }

    /// The attempts that have a folder, ascending.
    fn folders(&self) -> Result<Vec<Attempt>, SessionError> {
        let folder = self.pairs_dir();
        let mut found = Vec::new();
        for entry in std::fs::read_dir(&folder).map_err(SessionError::io(&folder))? {
            let name = entry.map_err(SessionError::io(&folder))?.file_name();
            found.extend(Attempt::from_folder(&name.to_string_lossy()));
        }
        found.sort_unstable();
        Ok(found)
    }

    /// One pair's record, of the attempt that counts.
    pub fn pair(&self, number: u32) -> Result<PairRecord, SessionError> {
        let path = || self.path.clone();
        let attempts = self.attempts_at(number)?;
        let record = current(&attempts).ok_or_else(|| SessionError::NoSuchPair { path: path(), number })?;
        Ok(PairRecord::clone(record))
    }

    /// All attempts at one pair, in their order; none if there is no such pair.
    pub fn attempts_at(&self, number: u32) -> Result<Vec<Arc<PairRecord>>, SessionError> {
        let folders = self.folders()?.into_iter().filter(|attempt| attempt.number == number);
        folders.map(|attempt| self.shared(attempt)).collect()
    }

    /// The record of one attempt at a pair.
    pub fn attempt(&self, attempt: Attempt) -> Result<PairRecord, SessionError> {
        Ok(Arc::unwrap_or_clone(self.shared(attempt)?))
    }

    fn shared(&self, attempt: Attempt) -> Result<Arc<PairRecord>, SessionError> {
        let file = self.pair_dir(attempt).join(PAIR_RECORD);
        let record = self.records.read(&file)?;
        if Attempt::from(&*record) != attempt {
            let why = format!("it says that it is pair {}, not {attempt}", Attempt::from(&*record));
            return Err(SessionError::Damaged { path: file, why });
        }
        Ok(record)
    }
}
