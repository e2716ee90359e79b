//! Looking at sessions without keeping anybody from writing: pairs, files.

use super::{Desk, DeskError};
use crate::pair::PairRecord;
use crate::session::SessionFile;
use std::collections::BTreeMap;
use std::fs::File;
use std::sync::Arc;

impl Desk {
    /// All attempts at all pairs of a session, by number and in their order.
    pub fn attempts(&self, session: &str) -> Result<BTreeMap<u32, Vec<Arc<PairRecord>>>, DeskError> {
        Ok(self.reader(session)?.attempts()?)
    }

    /// All attempts at one pair, in their order; none if there is no such pair.
    pub fn attempts_at(&self, session: &str, number: u32) -> Result<Vec<Arc<PairRecord>>, DeskError> {
        Ok(self.reader(session)?.attempts_at(number)?)
    }

    /// The files of a session that may be seen.
    pub fn files(&self, session: &str) -> Result<Vec<SessionFile>, DeskError> {
        Ok(self.reader(session)?.files()?)
    }

    /// One of them, open for reading.
    pub fn open_file(&self, session: &str, id: &str) -> Result<(File, SessionFile), DeskError> {
        let missing = || DeskError::NoSuchFile { session: session.to_owned(), id: id.to_owned() };
        self.reader(session)?.open_file(id)?.ok_or_else(missing)
    }
}
