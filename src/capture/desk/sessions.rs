//! The sessions of the folder: which are open, and how they are opened, made and let go.

use super::{Desk, DeskError};
use crate::capture::events::{Events, Topic};
use crate::capture::place::{PlaceError, name_of};
use crate::session::{self, Records, Recovery, Session, SessionError};
use serde_json::json;
use std::collections::HashMap;
use std::path::{Path, PathBuf};
use std::sync::{Arc, MutexGuard, PoisonError};

/// Longest session name, in characters; some file systems end at 255 bytes.
pub(super) const NAME_LIMIT: usize = 80;

/// What is open, and what is known of what is not.
#[derive(Default)]
pub(super) struct Sessions {
    pub(super) open: HashMap<String, Arc<Session>>,
    /// What was read of their pairs, open or not.
    records: HashMap<String, Records>,
    /// What opening them put right.
    pub(super) recovered: HashMap<String, Recovery>,
    pub(super) current: Option<String>,
}

impl Sessions {
    pub(super) fn get(
        &mut self,
        folder: &Path,
        name: &str,
        events: &Events,
    ) -> Result<Arc<Session>, DeskError> {
        if let Some(session) = self.open.get(name) {
            return Ok(session.clone());
        }
        let session = found(Session::open(&place_of(folder, name)?), name)?;
        let session = Arc::new(session.remembering(&self.records(name)));
        let sentences = session.recovery().sentences(|_| false);
        if !sentences.is_empty() {
            let data = json!({ "code": "session_recovered", "session": name });
            events.tell(Topic::Recovery, sentences.join(" "), data);
            self.recovered.insert(name.to_owned(), session.recovery().clone());
        }
        self.open.insert(name.to_owned(), session.clone());
        Ok(session)
    }

    /// A session that is not open, for a look. Locked only while the desk opens no other, so that no wish of this
    /// program's own is refused for it.
    pub(super) fn peek(&mut self, folder: &Path, name: &str) -> Result<Session, DeskError> {
        let session = found(Session::open_shared(&place_of(folder, name)?), name)?;
        Ok(session.unlocked()?.remembering(&self.records(name)))
    }

    fn records(&mut self, name: &str) -> Records {
        self.records.entry(name.to_owned()).or_default().clone()
    }
}

/// The folder of a session that someone asks for: a bad name names nothing.
fn place_of(folder: &Path, name: &str) -> Result<PathBuf, DeskError> {
    checked_name(name).map(|name| folder.join(name)).map_err(|_| DeskError::NoSuchSession(name.to_owned()))
}

fn found(opened: Result<Session, SessionError>, name: &str) -> Result<Session, DeskError> {
    match opened {
        Err(SessionError::NotASession { .. }) => Err(DeskError::NoSuchSession(name.to_owned())),
        other => Ok(other?),
    }
}

impl Desk {
    pub(super) fn sessions(&self) -> MutexGuard<'_, Sessions> {
        // Names and sessions are inserted whole.
        self.0.sessions.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Name of the session to which new pairs go.
    pub fn current(&self) -> Option<String> {
        self.sessions().current.clone()
    }

    /// Opens the named session, or makes it, and sends new pairs there. Says whether it was made.
    pub fn enter(&self, name: &str) -> Result<(Arc<Session>, bool), DeskError> {
        let name = checked_name(name)?;
        let path = self.0.folder.join(name);
        let (session, made) = {
            let mut sessions = self.sessions();
            let made = !path.join("session.json").is_file();
            let session = if made {
                let session = Arc::new(Session::create(&path, name)?);
                sessions.open.insert(name.to_owned(), session.clone());
                session
            } else {
                sessions.get(&self.0.folder, name, &self.0.events)?
            };
            sessions.current = Some(name.to_owned());
            (session, made)
        };
        self.mirror(&session);
        self.0.events.tell(Topic::Session, format!("Session {name}."), json!({ "session": name }));
        self.take_up_sequence(&session);
        Ok((session, made))
    }

    /// A session that is there; kept open, and thereby locked, from now on.
    pub fn session(&self, name: &str) -> Result<Arc<Session>, DeskError> {
        let session = self.sessions().get(&self.0.folder, name, &self.0.events)?;
        self.mirror(&session);
        Ok(session)
    }

    /// Closes a session that nobody but its processing kept open.
    pub(super) fn let_go(&self, session: &Arc<Session>) {
        let mut sessions = self.sessions();
        let name = name_of(session);
        // One is the desk's, one the job's.
        if sessions.current.as_deref() != Some(&name) && Arc::strong_count(session) == 2 {
            sessions.open.remove(&name);
        }
    }

    /// The named session, else the current one, else the day's, made if need be.
    pub(super) fn session_for_pair(&self, name: Option<&str>) -> Result<Arc<Session>, DeskError> {
        match name {
            Some(name) => self.session(name),
            None => match self.current() {
                Some(name) => self.session(&name),
                None => Ok(self.enter(session::utc_now().get(..10).unwrap_or("session"))?.0),
            },
        }
    }

    /// The names of all sessions of the folder, in order.
    pub(super) fn names(&self) -> Result<Vec<String>, DeskError> {
        let disk = |source| DeskError::Place(PlaceError::Disk { path: self.0.folder.clone(), source });
        let mut names = Vec::new();
        for entry in std::fs::read_dir(&self.0.folder).map_err(disk)? {
            let entry = entry.map_err(disk)?;
            if entry.path().join("session.json").is_file()
                && let Ok(name) = entry.file_name().into_string()
                && checked_name(&name).is_ok()
            {
                names.push(name);
            }
        }
        names.sort();
        Ok(names)
    }
}

fn checked_name(name: &str) -> Result<&str, DeskError> {
    let good = !name.is_empty()
        && name.chars().count() <= NAME_LIMIT
        && name.len() <= 200
        && !name.starts_with('.')
        && name.trim() == name
        && !name.contains(|c: char| matches!(c, '/' | '\\') || c.is_control());
    if good { Ok(name) } else { Err(DeskError::BadName(name.to_owned())) }
}
