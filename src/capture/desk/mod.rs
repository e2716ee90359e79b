//! Where wishes come in: sessions, pairs, calibration, processing. Each wish that takes time becomes a job,
//! so that whoever asked may leave; faces (HTTP, terminal) only translate.

mod calibration;
mod camera;
mod error;
mod glance;
mod mirror;
mod reading;
mod resume;
mod retry;
mod sequences;
mod sessions;
mod summary;
mod verify;
mod works;

pub use calibration::{CalibrationState, IncomingFrames, SeriesShot};
pub use error::DeskError;
pub use glance::Glance;
pub use summary::SessionSummary;

use super::Devices;
use super::card::CalibrationShot;
use super::engine::{AfterPair, Engine};
use super::events::{Events, Topic};
use super::place::name_of;
use super::thumbnail;
use crate::jobs::{Job, JobId, Ledger, Queue, Wish, WorkError};
use crate::pair::order::Slot;
use crate::pair::{FrameRecord, PairRecord};
use crate::pipeline::calibrate::guided::FitOrder;
use crate::pipeline::energy::{self, FlashAccount};
use crate::pipeline::flash::FlashOrder;
use crate::progress::Progress;
use crate::session::{Lock, Session, SessionError};
use serde_json::{Value, json};
use sessions::Sessions;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Condvar, Mutex, OnceLock};
use std::time::Duration;

/// What the desk keeps for itself in the folder of the sessions.
const OWN_FOLDER: &str = ".unlit";

/// What the flash calibration is made from.
#[derive(Clone, Debug, PartialEq)]
pub struct FlashCard {
    /// What is known beforehand.
    pub order: FlashOrder,
    /// The shots that were taken here, those with reasons left out. Those that wait come to them.
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
    /// Fits another calibration from the shots that wait for it.
    pub calibrate: Processing<FitOrder>,
    /// Brings cameras and meshes in.
    pub import_scene: Processing<SceneFiles>,
    /// Whether a scene is there.
    pub has_scene: Question,
    /// Whether a flash calibration is there.
    pub has_flash_calibration: Question,
    /// Whether everything is there that the model is made from, and the model is not, or not of that.
    pub needs_processing: Question,
}

struct Inner {
    engine: Arc<Engine>,
    queue: Queue,
    events: Events,
    folder: PathBuf,
    works: Works,
    after_pair: Option<AfterPair>,
    sessions: Mutex<Sessions>,
    /// Somebody's turn with a session is over.
    turned: Condvar,
    sequences: sequences::Sequences,
    /// Where second copies go, if that is wished.
    mirrors: OnceLock<PathBuf>,
    /// Held, never read: no second daemon works in this folder.
    _alone: Lock,
}

/// The desk; clones share it.
#[derive(Clone)]
pub struct Desk(Arc<Inner>, For);

/// On what account the next job is queued.
#[derive(Clone, Default)]
struct For {
    /// The job that it does again.
    retry_of: Option<JobId>,
    /// The wish that it fulfils, until it is queued.
    wish: Arc<Mutex<Option<Wish>>>,
}

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
                turned: Condvar::new(),
                sequences,
                mirrors: OnceLock::new(),
                _alone: alone,
            }),
            For::default(),
        ))
    }

    /// What happens.
    pub fn events(&self) -> &Events {
        &self.0.events
    }

    /// The job that `ask` asks this desk for, or asked before by the same wish; and whether it was before.
    pub fn once(
        &self,
        wish: Wish,
        ask: impl FnOnce(&Desk) -> Result<Job, DeskError>,
    ) -> Result<(Job, bool), DeskError> {
        self.0.queue.once(wish, |wish| {
            ask(&Desk(self.0.clone(), For { wish: Arc::new(Mutex::new(Some(wish))), ..For::default() }))
        })
    }

    /// Where this program keeps what is no session's. What has a temporary name there is removed at the next start.
    pub fn own_folder(&self) -> PathBuf {
        self.0.folder.join(OWN_FOLDER)
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

    /// A pair's small JPEG, made from the raw when it is first asked for, and the frame of which it is.
    pub fn thumbnail(
        &self,
        session: &str,
        number: u32,
        slot: Slot,
    ) -> Result<(PathBuf, FrameRecord), DeskError> {
        let session = self.reader(session)?;
        let record = self.pair(&session, number)?;
        let frame = frame_of(&record, slot)?;
        Ok((thumbnail::of_frame(&session, &record, frame)?, frame.clone()))
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

    /// A small JPEG of the light that the flash alone threw, made when it is first asked for, and the lit frame.
    pub fn known_light(&self, session: &str, number: u32) -> Result<(PathBuf, FrameRecord), DeskError> {
        let session = self.reader(session)?;
        let record = self.pair(&session, number)?;
        Ok((thumbnail::of_known_light(&session, &record)?, record.on))
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
