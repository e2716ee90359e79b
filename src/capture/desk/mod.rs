//! Where wishes come in: sessions, pairs, calibration, processing. Each wish that takes time becomes a job,
//! so that whoever asked may leave; faces (HTTP, terminal) only translate.

mod camera;
mod error;
mod glance;
mod mirror;
mod reading;
mod resume;
mod retry;
mod sequences;
mod verify;
mod works;

pub use error::DeskError;
pub use glance::Glance;

use super::Devices;
use super::engine::{AfterPair, Engine};
use super::events::{Events, Topic};
use super::place::{CalibrationShot, PlaceError, name_of};
use super::thumbnail;
use crate::jobs::{Job, JobId, Ledger, Queue, WorkError};
use crate::pair::order::Slot;
use crate::pair::{FrameRecord, PairRecord, Plan, Verdict, Window};
use crate::pipeline::energy::{self, FlashAccount};
use crate::progress::Progress;
use crate::session::{self, Lock, MirrorStatus, Records, Recovery, Room, Session, SessionError};
use serde_json::{Value, json};
use std::collections::HashMap;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, MutexGuard, OnceLock, PoisonError};
use std::time::Duration;

/// Longest session name, in characters; some file systems end at 255 bytes.
const NAME_LIMIT: usize = 80;

/// What the desk keeps for itself in the folder of the sessions.
const OWN_FOLDER: &str = ".unlit";

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
    /// Whether everything is there that the model is made from, and the model is not, or not of that.
    pub needs_processing: Question,
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
    /// What had to be put right when it was opened, in sentences; of one that is not open, what will have to be.
    pub recovered: Vec<String>,
    /// Its second copy; `None` without `--mirror`, and of a session that is not open for writing.
    pub mirror: Option<MirrorStatus>,
    /// Why nothing else is known of it, if so.
    pub problem: Option<String>,
}

#[derive(Default)]
struct Sessions {
    open: HashMap<String, Arc<Session>>,
    /// What was read of their pairs, open or not.
    records: HashMap<String, Records>,
    /// What opening them put right.
    recovered: HashMap<String, Recovery>,
    current: Option<String>,
}

impl Sessions {
    fn get(&mut self, folder: &Path, name: &str, events: &Events) -> Result<Arc<Session>, DeskError> {
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
    fn peek(&mut self, folder: &Path, name: &str) -> Result<Session, DeskError> {
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

struct Inner {
    engine: Arc<Engine>,
    queue: Queue,
    events: Events,
    folder: PathBuf,
    works: Works,
    after_pair: Option<AfterPair>,
    sessions: Mutex<Sessions>,
    sequences: sequences::Sequences,
    /// Where second copies go, if that is wished.
    mirrors: OnceLock<PathBuf>,
    /// Held, never read: no second daemon works in this folder.
    _alone: Lock,
}

/// The desk; clones share it.
#[derive(Clone)]
pub struct Desk(Arc<Inner>, Option<JobId>);

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
        let alone = Lock::of_folder(folder).map_err(std::io::Error::other)?;
        let told = events.clone();
        let notice = move |job: &Job| {
            if let Some(problem) = &job.problem {
                told.tell(
                    Topic::Trouble,
                    problem.words.clone(),
                    json!({ "code": problem.code, "job": job.id }),
                );
            }
            told.tell(Topic::Job, job.stage.clone(), json!(job));
        };
        let told = events.clone();
        let trouble =
            move |words: String| told.tell(Topic::Trouble, words, json!({ "code": "jobs_not_kept" }));
        let queue = match Ledger::open(&folder.join(OWN_FOLDER), resume::words_on_interrupted) {
            Ok(ledger) => Queue::resume(ledger, notice, trouble)?,
            Err(error) => {
                let words = format!("What jobs are asked for is not written down: {error}.");
                tracing::warn!("{words}");
                trouble(words);
                Queue::start(notice)?
            }
        };
        let sessions = Mutex::default();
        let sequences = Default::default();
        let folder = folder.canonicalize()?;
        Ok(Desk(
            Arc::new(Inner {
                engine,
                queue,
                events,
                folder,
                works,
                after_pair,
                sessions,
                sequences,
                mirrors: OnceLock::new(),
                _alone: alone,
            }),
            None,
        ))
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
    fn let_go(&self, session: &Arc<Session>) {
        let mut sessions = self.sessions();
        let name = name_of(session);
        // One is the desk's, one the job's.
        if sessions.current.as_deref() != Some(&name) && Arc::strong_count(session) == 2 {
            sessions.open.remove(&name);
        }
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
        let names = self.names()?;
        Ok(names.iter().map(|name| self.summary(name).unwrap_or_else(|e| unreadable(name, &e))).collect())
    }

    /// The names of all sessions of the folder, in order.
    fn names(&self) -> Result<Vec<String>, DeskError> {
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

    /// One session in a few words. A session that is not open is opened for reading and closed again.
    pub fn summary(&self, name: &str) -> Result<SessionSummary, DeskError> {
        let mut sessions = self.sessions();
        let session = sessions.reader(&self.0.folder, name)?;
        let current = sessions.current.as_deref() == Some(name);
        let recovery = sessions.recovered.get(name).unwrap_or(session.recovery()).clone();
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
            recovered: recovery.sentences(|pair| pair.is_among(&pairs)),
            mirror: session.mirror(),
            problem: None,
        })
    }

    /// A pair's small JPEG, made from the raw when it is first asked for.
    pub fn thumbnail(&self, session: &str, number: u32, slot: Slot) -> Result<PathBuf, DeskError> {
        let session = self.reader(session)?;
        let record = self.pair(&session, number)?;
        Ok(thumbnail::of_frame(&session, &record, frame_of(&record, slot)?)?)
    }

    /// What a session's pairs tell of the flash.
    pub fn flash_account(&self, session: &str) -> Result<FlashAccount, DeskError> {
        Ok(energy::account(&*self.reader(session)?)?)
    }

    fn pair(&self, session: &Session, number: u32) -> Result<PairRecord, DeskError> {
        match session.pair(number) {
            Err(SessionError::NoSuchPair { .. }) => {
                Err(DeskError::NoSuchPair { session: name_of(session), number })
            }
            other => Ok(other?),
        }
    }

    /// A small JPEG of the light that the flash alone threw, made when it is first asked for.
    pub fn known_light(&self, session: &str, number: u32) -> Result<PathBuf, DeskError> {
        let session = self.reader(session)?;
        let record = self.pair(&session, number)?;
        Ok(thumbnail::of_known_light(&session, &record)?)
    }

    /// Takes no more jobs, cancels everything and closes the gate at once; then waits a moment for all to end and says
    /// whether it did. A pair that is being stored is stored.
    pub fn close(&self, patience: Duration) -> bool {
        let ended = self.0.queue.shut_down(patience, || self.close_gate());
        // A pair that was between two steps may have opened it since.
        self.close_gate();
        ended
    }

    /// Closes the gate now, whoever uses the rig.
    pub fn close_gate(&self) {
        self.0.engine.close_gate();
    }
}

/// A frame of a pair, which need not have all there may be.
fn frame_of(record: &PairRecord, slot: Slot) -> Result<&FrameRecord, DeskError> {
    record.frame(slot).ok_or(DeskError::NoSuchFrame { number: record.number, slot })
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
        mirror: None,
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
