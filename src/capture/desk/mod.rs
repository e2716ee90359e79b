//! Where wishes come in: sessions, pairs, calibration, processing. Each wish that takes time becomes a job,
//! so that whoever asked may leave; faces (HTTP, terminal) only translate.

mod camera;
mod error;
mod works;

pub use error::DeskError;

use super::engine::{AfterPair, Engine};
use super::events::{Events, Topic};
use super::place::{CalibrationShot, PlaceError, name_of};
use super::thumbnail;
use super::{Devices, Frame};
use crate::jobs::{Queue, WorkError};
use crate::pair::{PairRecord, Plan, Verdict, Window};
use crate::pipeline::energy::{self, FlashAccount};
use crate::progress::Progress;
use crate::session::{self, Room, Session, SessionError};
use serde_json::{Value, json};
use std::collections::HashMap;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

/// Longest session name, in characters; some file systems end at 255 bytes.
const NAME_LIMIT: usize = 80;

/// What the flash calibration is made from.
#[derive(Clone, Debug, PartialEq)]
pub struct FlashCard {
    /// Reflectance of the card, 0..1.
    pub target_reflectance: f64,
    /// Inner and outer radius of the ring lamp, metres.
    pub ring_radii: [f64; 2],
    /// The shots, those with reasons left out.
    pub shots: Vec<CalibrationShot>,
}

/// What a scene is imported from. The folder is removed when this is dropped.
#[derive(Debug)]
pub struct SceneFiles {
    /// Holds the files.
    pub folder: tempfile::TempDir,
    /// BlocksExchange XML file, or folder of COLMAP's text files.
    pub cameras: PathBuf,
    /// The object first.
    pub meshes: Vec<PathBuf>,
    /// `m`, `cm` or `mm`.
    pub unit: String,
    /// Factor after the unit.
    pub scale: f64,
}

type Processing<T> = Arc<dyn Fn(&Session, T, &Progress) -> Result<Value, WorkError> + Send + Sync>;
type Question = Arc<dyn Fn(&Session) -> bool + Send + Sync>;

/// The processing that the desk sets off. The session stays locked for this program all the time, so the
/// work must not lock it again.
#[derive(Clone)]
pub struct Works {
    /// Makes the model from everything that the session holds.
    pub process: Processing<()>,
    /// Fits the flash calibration.
    pub calibrate_flash: Processing<FlashCard>,
    /// Brings cameras and meshes in.
    pub import_scene: Processing<SceneFiles>,
    /// Whether a scene is there.
    pub has_scene: Question,
    /// Whether a flash calibration is there.
    pub has_flash_calibration: Question,
}

/// A session in a few words.
#[derive(Clone, Debug, PartialEq)]
pub struct SessionSummary {
    /// Its name, which is its folder's.
    pub name: String,
    /// When it was made, UTC.
    pub created: String,
    /// Whether new pairs go there.
    pub current: bool,
    /// Pairs stored.
    pub pairs: usize,
    /// Those that processing uses.
    pub accepted: usize,
    /// Whether a scene is there.
    pub has_scene: bool,
    /// Whether a flash calibration is there.
    pub has_flash_calibration: bool,
    /// Exposures of its pairs.
    pub plan: Option<Plan>,
    /// Where the object is; the whole frame if absent.
    pub region: Option<Window>,
    /// Settings that the camera does not tell and the operator has confirmed.
    pub confirmed: Vec<String>,
    /// Finished results, paths inside the session.
    pub results: Vec<String>,
    /// Room on its disk.
    pub room: Option<Room>,
    /// What had to be put right when it was opened, in sentences; only of a session that is open for writing.
    pub recovered: Vec<String>,
    /// Why nothing else is known of it, if so.
    pub problem: Option<String>,
}

#[derive(Default)]

struct Sessions {
    open: HashMap<String, Arc<Session>>,
    current: Option<String>,
}

impl Sessions {
    fn get(&mut self, folder: &Path, name: &str, events: &Events) -> Result<Arc<Session>, DeskError> {
        if let Some(session) = self.open.get(name) {
            return Ok(session.clone());
        }
        let session = Arc::new(found(Session::open(&place_of(folder, name)?), name)?);
        let sentences = session.recovery().sentences(|_| false);
        if !sentences.is_empty() {
            let data = json!({ "code": "session_recovered", "session": name });
            events.tell(Topic::Recovery, sentences.join(" "), data);
        }
        self.open.insert(name.to_owned(), session.clone());
        Ok(session)
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

struct Inner {
    engine: Arc<Engine>,
    queue: Queue,
    events: Events,
    folder: PathBuf,
    works: Works,
    after_pair: Option<AfterPair>,
    sessions: Mutex<Sessions>,
}

/// The desk; clones share it.
#[derive(Clone)]
pub struct Desk(Arc<Inner>);

impl Desk {
    /// A desk over `engine` whose sessions live in `folder`. Jobs are told of through `events`.
    pub fn open(
        engine: Arc<Engine>,
        events: Events,
        folder: &Path,
        works: Works,
        after_pair: Option<AfterPair>,
    ) -> std::io::Result<Desk> {
        std::fs::create_dir_all(folder)?;
        let told = events.clone();
        let queue = Queue::start(move |job| {
            if let Some(problem) = &job.problem {
                told.tell(
                    Topic::Trouble,
                    problem.words.clone(),
                    json!({ "code": problem.code, "job": job.id }),
                );
            }
            told.tell(Topic::Job, job.stage.clone(), json!(job));
        })?;
        let sessions = Mutex::default();
        let folder = folder.canonicalize()?;
        Ok(Desk(Arc::new(Inner { engine, queue, events, folder, works, after_pair, sessions })))
    }

    /// What happens.
    pub fn events(&self) -> &Events {
        &self.0.events
    }

    /// All jobs.
    pub fn queue(&self) -> &Queue {
        &self.0.queue
    }

    /// The devices as last seen.
    pub fn devices(&self) -> Devices {
        self.0.engine.devices()
    }

    /// Looks for the devices.
    pub fn look(&self) -> Devices {
        self.0.engine.look()
    }

    /// What the operator is asked at the moment.
    pub fn prompt(&self) -> Option<String> {
        self.0.engine.prompt()
    }

    /// The operator has done what was asked; `false` if nothing was asked.
    pub fn confirm(&self) -> bool {
        self.0.engine.confirm()
    }

    fn sessions(&self) -> MutexGuard<'_, Sessions> {
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
        self.0.events.tell(Topic::Session, format!("Session {name}."), json!({ "session": name }));
        Ok((session, made))
    }

    /// A session that is there; kept open, and thereby locked, from now on.
    pub fn session(&self, name: &str) -> Result<Arc<Session>, DeskError> {
        self.sessions().get(&self.0.folder, name, &self.0.events)
    }

    /// The named session, else the current one, else the day's, made if need be.
    fn session_for_pair(&self, name: Option<&str>) -> Result<Arc<Session>, DeskError> {
        match name {
            Some(name) => self.session(name),
            None => match self.current() {
                Some(name) => self.session(&name),
                None => Ok(self.enter(session::utc_now().get(..10).unwrap_or("session"))?.0),
            },
        }
    }

    /// All sessions of the folder, by name.
    pub fn summaries(&self) -> Result<Vec<SessionSummary>, DeskError> {
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
        Ok(names.iter().map(|name| self.summary(name).unwrap_or_else(|e| unreadable(name, &e))).collect())
    }

    /// One session in a few words. A session that is not open is opened for reading and closed again.
    pub fn summary(&self, name: &str) -> Result<SessionSummary, DeskError> {
        let sessions = self.sessions();
        let session = match sessions.open.get(name) {
            Some(session) => session.clone(),
            None => Arc::new(found(Session::open_shared(&place_of(&self.0.folder, name)?), name)?),
        };
        let current = sessions.current.as_deref() == Some(name);
        // Whoever asks for a session must not wait for this one's disk.
        drop(sessions);
        let manifest = session.manifest();
        let pairs = session.pairs()?;
        let results = ["model/model.glb", "model/report.html", "model/reflectance.exr", "model/stddev.exr"];
        Ok(SessionSummary {
            name: name.to_owned(),
            created: manifest.created,
            plan: manifest.plan,
            region: manifest.region,
            confirmed: manifest.confirmed,
            current,
            pairs: pairs.len(),
            accepted: pairs.iter().filter(|p| p.verdict == Verdict::Accepted).count(),
            has_scene: (self.0.works.has_scene)(&session),
            has_flash_calibration: (self.0.works.has_flash_calibration)(&session),
            results: results
                .into_iter()
                .filter(|file| session.path().join(file).is_file())
                .map(str::to_owned)
                .collect(),
            room: session.room_after(&pairs).ok(),
            recovered: session.recovery().sentences(|name| pairs.iter().any(|p| p.name == name)),
            problem: None,
        })
    }

    /// A pair's small JPEG, made from the raw when it is first asked for.
    pub fn thumbnail(&self, session: &str, number: u32, frame: Frame) -> Result<PathBuf, DeskError> {
        let session = self.session(session)?;
        let record = self.pair(&session, number)?;
        Ok(thumbnail::of_frame(&session, &record, frame)?)
    }

    /// What a session's pairs tell of the flash.
    pub fn flash_account(&self, session: &str) -> Result<FlashAccount, DeskError> {
        Ok(energy::account(&*self.session(session)?)?)
    }

    fn pair(&self, session: &Session, number: u32) -> Result<PairRecord, DeskError> {
        if !session.pair_dir(number).is_dir() {
            return Err(DeskError::NoSuchPair { session: name_of(session), number });
        }
        Ok(session.pair(number)?)
    }

    /// Cancels everything and waits a moment for it to end; says whether it did.
    pub fn close(&self, patience: Duration) -> bool {
        self.0.queue.shut_down(patience)
    }
}

fn unreadable(name: &str, error: &DeskError) -> SessionSummary {
    SessionSummary {
        name: name.to_owned(),
        created: String::new(),
        current: false,
        pairs: 0,
        accepted: 0,
        has_scene: false,
        has_flash_calibration: false,
        plan: None,
        region: None,
        confirmed: Vec::new(),
        results: Vec::new(),
        room: None,
        recovered: Vec::new(),
        problem: Some(error.to_string()),
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
