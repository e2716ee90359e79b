//! Looking at sessions without keeping anybody from writing: pairs, files.

use super::sessions::Sessions;
use super::{Desk, DeskError};
use crate::pair::PairRecord;
use crate::session::{Session, SessionFile};
use std::collections::BTreeMap;
use std::fs::File;
use std::path::Path;
use std::sync::Arc;

impl Sessions {
    /// A session to look at: the one that is open, else one that keeps nobody from writing.
    pub(super) fn reader(&mut self, folder: &Path, name: &str) -> Result<Arc<Session>, DeskError> {
        match self.open.get(name) {
            Some(session) => Ok(session.clone()),
            None => Ok(Arc::new(self.peek(folder, name)?)),
        }
    }
}

impl Desk {
    /// A session that is there, to look at: it is not kept open, and not kept from others.
    pub fn reader(&self, name: &str) -> Result<Arc<Session>, DeskError> {
        self.sessions().reader(&self.0.folder, name)
    }

    /// All attempts at all pairs of a session, by number and in their order.
    pub fn attempts(&self, session: &str) -> Result<BTreeMap<u32, Vec<PairRecord>>, DeskError> {
        Ok(self.reader(session)?.attempts()?)
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
