//! The sessions of the folder: which are open, and how they are opened, made and let go.
//!
//! Opening takes as long as reading the session takes. Only who wants the same session waits for that: whoever opens,
//! makes, looks at or closes one has its turn meanwhile, and what is open is known at any time.

use super::{Desk, DeskError};
use crate::capture::events::Topic;
use crate::capture::place::PlaceError;
use crate::session::{self, Records, Recovery, Session, SessionError};
use serde_json::json;
use std::collections::{HashMap, HashSet};
use std::ops::Deref;
use std::path::PathBuf;
use std::sync::{Arc, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

/// Longest session name, in characters; some file systems end at 255 bytes.
pub(super) const NAME_LIMIT: usize = 80;

/// How long the mirror of a session that is let go may take to come into step.
const MIRROR_PATIENCE: Duration = Duration::from_secs(10);
/// How long somebody who looks at it may keep it open.
const READER_PATIENCE: Duration = Duration::from_secs(5);

/// What is open, and what is known of what is not.
#[derive(Default)]
pub(super) struct Sessions {
    pub(super) open: HashMap<String, Arc<Session>>,
    /// Those of them that were opened for one job, and that nobody has asked for since.
    lent: HashSet<String>,
    /// Whose turn somebody has.
    busy: HashSet<String>,
    /// What was read of their pairs, open or not.
    records: HashMap<String, Records>,
    /// What opening them put right.
    pub(super) recovered: HashMap<String, Recovery>,
    pub(super) current: Option<String>,
}

impl Sessions {
    fn records(&mut self, name: &str) -> Records {
        self.records.entry(name.to_owned()).or_default().clone()
    }
}

/// For what a session is opened.
#[derive(Clone, Copy, PartialEq)]
enum Purpose {
    /// Somebody asks for it: it stays open.
    Asked,
    /// The same, and it is made if it is not there.
    Made,
    /// One job.
    Lent,
}

/// The turn to open, make, look at or close one session.
struct Turn<'a> {
    desk: &'a Desk,
    name: &'a str,
}

impl Drop for Turn<'_> {
    fn drop(&mut self) {
        self.desk.sessions().busy.remove(self.name);
        self.desk.0.turned.notify_all();
    }
}

/// A session that was opened for one job: closed with it, unless somebody else asked for it meanwhile.
pub(super) struct Loan {
    session: Arc<Session>,
    /// Dropped last.
    _end: EndOfLoan,
}

impl Deref for Loan {
    type Target = Session;

    fn deref(&self) -> &Session {
        &self.session
    }
}

struct EndOfLoan(Desk, String);

impl Drop for EndOfLoan {
    fn drop(&mut self) {
        self.0.let_go(&self.1);
    }
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

    /// A session that is open now.
    pub(super) fn open_session(&self, name: &str) -> Option<Arc<Session>> {
        self.sessions().open.get(name).cloned()
    }

    /// A session that is open now because somebody asked for it.
    pub(super) fn entered_session(&self, name: &str) -> Option<Arc<Session>> {
        let sessions = self.sessions();
        sessions.open.get(name).filter(|_| !sessions.lent.contains(name)).cloned()
    }

    /// Waits until nobody has the turn of this session.
    fn turn<'a>(&'a self, name: &'a str) -> Turn<'a> {
        let mut sessions = self.sessions();
        while !sessions.busy.insert(name.to_owned()) {
            sessions = self.0.turned.wait(sessions).unwrap_or_else(PoisonError::into_inner);
        }
        Turn { desk: self, name }
    }

    /// The session, opened if need be; says whether it was made.
    fn opened(&self, name: &str, purpose: Purpose) -> Result<(Arc<Session>, bool), DeskError> {
        let path = self.place_of(name)?;
        let already = || {
            let mut sessions = self.sessions();
            let session = sessions.open.get(name).cloned()?;
            if purpose != Purpose::Lent {
                sessions.lent.remove(name);
            }
            Some((session, false))
        };
        if let Some(open) = already() {
            return Ok(open);
        }
        let _turn = self.turn(name);
        // Somebody else may have had it before.
        if let Some(open) = already() {
            return Ok(open);
        }
        let made = purpose == Purpose::Made && !path.join("session.json").is_file();
        let session = if made { Session::create(&path, name)? } else { found(Session::open(&path), name)? };
        let session = {
            let mut sessions = self.sessions();
            let session = Arc::new(session.remembering(&sessions.records(name)));
            sessions.open.insert(name.to_owned(), session.clone());
            if purpose == Purpose::Lent {
                sessions.lent.insert(name.to_owned());
            }
            if *session.recovery() != Recovery::default() {
                sessions.recovered.insert(name.to_owned(), session.recovery().clone());
            }
            session
        };
        let sentences = session.recovery().sentences(|_| false);
        if !sentences.is_empty() {
            let data = json!({ "code": "session_recovered", "session": name });
            self.0.events.tell(Topic::Recovery, sentences.join(" "), data);
        }
        self.mirror(&session);
        Ok((session, made))
    }

    /// Opens the named session, or makes it, and sends new pairs there. Says whether it was made.
    pub fn enter(&self, name: &str) -> Result<(Arc<Session>, bool), DeskError> {
        let name = checked_name(name)?;
        let (session, made) = self.opened(name, Purpose::Made)?;
        self.sessions().current = Some(name.to_owned());
        self.0.events.tell(Topic::Session, format!("Session {name}."), json!({ "session": name }));
        self.take_up_sequence(&session);
        Ok((session, made))
    }

    /// A session that is there; kept open, and thereby locked, from now on.
    pub fn session(&self, name: &str) -> Result<Arc<Session>, DeskError> {
        Ok(self.opened(name, Purpose::Asked)?.0)
    }

    /// A session that is there, for one job.
    pub(super) fn lend(&self, name: &str) -> Result<Loan, DeskError> {
        let (session, _) = self.opened(name, Purpose::Lent)?;
        Ok(Loan { session, _end: EndOfLoan(self.clone(), name.to_owned()) })
    }

    /// Closes a session that was lent, once nobody else has it; what it holds is in its mirror before.
    fn let_go(&self, name: &str) {
        let end = Instant::now() + READER_PATIENCE;
        while !self.closed_if_idle(name) && Instant::now() < end {
            // Somebody looks at it; nothing tells when he has seen enough.
            std::thread::sleep(Duration::from_millis(50));
        }
    }

    /// Closes a lent session that nobody has; says whether there is nothing left to close.
    fn closed_if_idle(&self, name: &str) -> bool {
        let _turn = self.turn(name);
        let closing = {
            let mut sessions = self.sessions();
            if !sessions.lent.contains(name) {
                return true;
            }
            if sessions.open.get(name).is_some_and(|session| Arc::strong_count(session) > 1) {
                return false;
            }
            sessions.lent.remove(name);
            sessions.open.remove(name)
        };
        if let Some(session) = closing {
            // How it stands is told as ever.
            let _stand = session.finish_mirror(MIRROR_PATIENCE);
        }
        true
    }

    /// A session that is there, to look at: the one that is open, else one that is not kept open and not kept from
    /// others. It is locked only while nobody here opens it, so that no wish of this program's own is refused for it.
    pub fn reader(&self, name: &str) -> Result<Arc<Session>, DeskError> {
        let path = self.place_of(name)?;
        if let Some(open) = self.open_session(name) {
            return Ok(open);
        }
        let _turn = self.turn(name);
        if let Some(open) = self.open_session(name) {
            return Ok(open);
        }
        let session = found(Session::open_shared(&path), name)?.unlocked()?;
        let records = self.sessions().records(name);
        Ok(Arc::new(session.remembering(&records)))
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

    /// The folder of a session that someone asks for: a bad name names nothing.
    fn place_of(&self, name: &str) -> Result<PathBuf, DeskError> {
        let bad = |_| DeskError::NoSuchSession(name.to_owned());
        checked_name(name).map(|name| self.0.folder.join(name)).map_err(bad)
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
