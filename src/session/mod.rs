//! The session folder: layout, journal, atomic writes, checksums, lock.
//!
//! A photographer can read it without us: `pairs/NNNN/{off,on}.EXT` are the camera's own files, never
//! altered, `pair.json` beside them says what they are. A rejected pair that was shot again lies beside itself, in
//! `pairs/NNNN-2` and so on. A pair's folder gets its final name only when
//! everything in it is on the disk, so that killing the program at any moment loses nothing that was
//! acknowledged and leaves nothing half-done under a name that counts. One program at a time may write
//! (`.lock`, held as long as the [`Session`] lives); several may read together.

mod attempts;
mod commit;
mod error;
mod files;
mod journal;
mod kept;
pub mod lines;
mod lock;
mod mirror;
mod numbering;
mod records;
mod recovery;
mod room;
mod sequence;
mod shots;
mod sidecars;
pub mod store;
mod verify;

pub use commit::{
    Commit, More, NewFrame, NewPair, Prepared, Staged, Stager, frame_files, frame_record, original_file_name,
};
pub use error::SessionError;
pub(crate) use error::advice;
pub use files::{FileKind, SessionFile, file_id};
pub use journal::{Entry, Event, now as utc_now};
pub use lock::{Holder, Lock};
pub use mirror::{MirrorPatience, MirrorState, MirrorStatus};
pub use records::Records;
pub use recovery::{Interrupted, Recovery};
pub use room::Room;
pub use sequence::{
    Between, MOST_POSITIONS, PositionRecord, SEQUENCE_SCHEMA, SequencePlan, SequenceRecord, Stage, UnderWay,
};
pub use shots::{
    FRAME_REMOVED, FRAME_STORED, InterruptedShot, SHOT_ABANDONED, SHOT_INTERRUPTED, SHOT_REMOVED,
    SHOT_STARTED, SHOT_STORED, WAITING,
};
pub use verify::{Damage, Finding, Verification};

use crate::pair::{Attempt, Lighting, Plan, Window};
use lock::Access;
use numbering::{Numbering, digests};
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};
use std::sync::{Mutex, MutexGuard, OnceLock, PoisonError};

/// The layout that this program writes; 3 knows orders of frames and pairs that were shot again, and reads 2 as it is.
pub const SCHEMA: u32 = 3;

const MANIFEST: &str = "session.json";
const JOURNAL: &str = "journal.jsonl";
const SEQUENCE: &str = "sequence.json";
const LOCK: &str = ".lock";
const PAIR_RECORD: &str = "pair.json";
const FOLDERS: [&str; 5] = ["pairs", "calibration", "scene", "derived", "model"];

/// `session.json`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Manifest {
    /// Version of the layout.
    pub schema: u32,
    /// The session's name.
    pub name: String,
    /// When it was made, UTC.
    pub created: String,
    /// The software that made it.
    pub software: String,
    /// At which settings its pairs are shot; set by the first pair, or before.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub plan: Option<Plan>,
    /// Where the object is; the whole frame if absent.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub region: Option<Window>,
    /// Settings of the exposure lock that the camera does not tell and the operator has confirmed, by name.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub confirmed: Vec<String>,
    /// Polariser and flash power of the pairs that come, as the operator told them.
    #[serde(default, skip_serializing_if = "Lighting::is_untold")]
    pub lighting: Lighting,
}

/// An open session; closing it (dropping) gives the lock back.
#[derive(Debug)]
pub struct Session {
    path: PathBuf,
    manifest: Mutex<Manifest>,
    /// What commits need to know; `None` when open for reading.
    numbering: Option<Mutex<Numbering>>,
    /// What opening it put right.
    recovery: Recovery,
    /// Pairs' records as last read.
    records: Records,
    /// The second copy, if there is one.
    mirror: OnceLock<mirror::Mirror>,
    /// The lock lives as long as the file is open.
    lock: Lock,
}

impl Session {
    /// Makes a session in a new or empty folder and opens it for writing.
    pub fn create(path: &Path, name: &str) -> Result<Session, SessionError> {
        std::fs::create_dir_all(path).map_err(SessionError::io(path))?;
        // What an interrupted `create` may have left is ours to complete.
        let ours = |name: &str| {
            name == LOCK
                || name == JOURNAL
                || FOLDERS.contains(&name)
                || name.starts_with(store::TEMPORARY_PREFIX)
        };
        for entry in std::fs::read_dir(path).map_err(SessionError::io(path))? {
            let entry = entry.map_err(SessionError::io(path))?;
            if !ours(&entry.file_name().to_string_lossy()) {
                return Err(SessionError::NotEmpty { path: path.to_owned() });
            }
        }
        let lock = Lock::of_session(path, Access::Alone)?;
        for folder in FOLDERS.map(|f| path.join(f)) {
            std::fs::create_dir_all(&folder).map_err(SessionError::io(&folder))?;
        }
        let manifest = Manifest {
            schema: SCHEMA,
            name: name.to_owned(),
            created: journal::now(),
            software: concat!("unlit ", env!("CARGO_PKG_VERSION")).to_owned(),
            plan: None,
            region: None,
            confirmed: Vec::new(),
            lighting: Lighting::default(),
        };
        journal::append(&path.join(JOURNAL), Event::SessionCreated)?;
        let file = path.join(MANIFEST);
        store::write_atomic(&file, &to_json(&file, &manifest)?).map_err(SessionError::io(&file))?;
        if let Some(parent) = path.canonicalize().ok().as_deref().and_then(Path::parent) {
            store::sync_folder(parent).map_err(SessionError::io(parent))?;
        }
        Self::load(path, lock, Access::Alone)
    }

    /// Opens a session for writing; nobody else may have it open. Puts right what a crash left behind:
    /// [`Session::recovery`].
    pub fn open(path: &Path) -> Result<Session, SessionError> {
        require_manifest(path)?;
        let lock = Lock::of_session(path, Access::Alone)?;
        Self::load(path, lock, Access::Alone)
    }

    /// Opens a session for reading, together with other readers. Nothing is put right; [`Session::recovery`] names the
    /// pairs that were interrupted.
    pub fn open_shared(path: &Path) -> Result<Session, SessionError> {
        require_manifest(path)?;
        let lock = Lock::of_session(path, Access::Shared)?;
        Self::load(path, lock, Access::Shared)
    }

    fn load(path: &Path, lock: Lock, access: Access) -> Result<Session, SessionError> {
        let file = path.join(MANIFEST);
        let manifest: Manifest = from_json(&file)?;
        if manifest.schema > SCHEMA {
            let path = path.to_owned();
            return Err(SessionError::TooNew { path, found: manifest.schema, known: SCHEMA });
        }
        let mut session = Session {
            path: path.to_owned(),
            manifest: Mutex::new(manifest),
            numbering: None,
            recovery: Recovery::default(),
            records: Records::default(),
            mirror: OnceLock::new(),
            lock,
        };
        if access == Access::Shared {
            // A journal that cannot be read keeps nobody from the pairs; verifying names it.
            session.recovery = session.interruptions().unwrap_or_default();
        } else {
            // Pairs that cannot be read are told before anything is called settled.
            let mut numbering = session.count()?;
            session.recovery = session.recover(&mut numbering)?;
            session.numbering = Some(Mutex::new(numbering));
            if let Err(error) = session.settle_sequence() {
                // Whoever asks for the sequence is told; it keeps nobody from the pairs.
                tracing::error!("the sequence could not be settled: {error}");
            }
        }
        Ok(session)
    }

    /// A session open for reading whose lock is given back: for a look that takes time, keeps nobody from writing, and
    /// may be out of date at once.
    pub fn unlocked(self) -> Result<Session, SessionError> {
        self.lock.release().map_err(SessionError::io(&self.path.join(LOCK)))?;
        Ok(Session { numbering: None, ..self })
    }

    /// The session, remembering with `records` what was read of its pairs before.
    pub fn remembering(mut self, records: &Records) -> Session {
        self.records = records.clone();
        self
    }

    /// What opening the session put right.
    pub fn recovery(&self) -> &Recovery {
        &self.recovery
    }

    fn numbering(&self) -> Result<MutexGuard<'_, Numbering>, SessionError> {
        let numbering =
            self.numbering.as_ref().ok_or_else(|| SessionError::ReadOnly { path: self.path.clone() })?;
        // Whoever panicked inside changed nothing: numbers and names are written last.
        Ok(numbering.lock().unwrap_or_else(PoisonError::into_inner))
    }

    /// The session's folder.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// `session.json`.
    pub fn manifest(&self) -> Manifest {
        self.manifest.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }

    /// Changes `session.json`; on the disk when this returns. Nothing changes if it cannot be written.
    fn amend(&self, change: impl FnOnce(&mut Manifest)) -> Result<(), SessionError> {
        let _alone = self.numbering()?;
        let mut manifest = self.manifest.lock().unwrap_or_else(PoisonError::into_inner);
        let mut changed = manifest.clone();
        change(&mut changed);
        if changed != *manifest {
            let file = self.path.join(MANIFEST);
            store::write_atomic(&file, &to_json(&file, &changed)?).map_err(SessionError::io(&file))?;
            *manifest = changed;
            self.wake_mirror(0);
        }
        Ok(())
    }

    /// Says in `session.json` that what follows is more than programs of before know of.
    fn raise_schema(&self) -> Result<(), SessionError> {
        self.amend(|manifest| manifest.schema = manifest.schema.max(SCHEMA))
    }

    /// Sets the exposures at which pairs are shot from now on.
    pub fn set_plan(&self, plan: Plan) -> Result<(), SessionError> {
        self.amend(|manifest| manifest.plan = Some(plan))
    }

    /// Sets where the object is; `None` is the whole frame.
    pub fn set_region(&self, region: Option<Window>) -> Result<(), SessionError> {
        self.amend(|manifest| manifest.region = region)
    }

    /// Says how the pairs that come are lit and seen; those that are there keep what was told of them.
    pub fn set_lighting(&self, lighting: Lighting) -> Result<(), SessionError> {
        self.amend(|manifest| manifest.lighting = lighting)
    }

    /// Notes that the operator has checked these settings of the exposure lock by eye.
    pub fn confirm(&self, names: &[String]) -> Result<(), SessionError> {
        self.amend(|manifest| {
            manifest.confirmed.extend(names.iter().cloned());
            manifest.confirmed.sort();
            manifest.confirmed.dedup();
        })
    }

    /// `pairs/`.
    pub fn pairs_dir(&self) -> PathBuf {
        self.path.join("pairs")
    }

    /// `pairs/NNNN`, or `pairs/NNNN-2` and so on: the folder of a record; of a number alone, that of its first attempt.
    pub fn pair_dir(&self, attempt: impl Into<Attempt>) -> PathBuf {
        self.pairs_dir().join(attempt.into().to_string())
    }

    /// `calibration/`: shots and fitted results.
    pub fn calibration_dir(&self) -> PathBuf {
        self.path.join("calibration")
    }

    /// `scene/`: imported cameras and meshes.
    pub fn scene_dir(&self) -> PathBuf {
        self.path.join("scene")
    }

    /// `derived/`: anything that can be made again.
    pub fn derived_dir(&self) -> PathBuf {
        self.path.join("derived")
    }

    /// `model/`: the results.
    pub fn model_dir(&self) -> PathBuf {
        self.path.join("model")
    }

    /// The number that the next shot pair gets, unless another is committed in between.
    pub fn next_pair_number(&self) -> Result<u32, SessionError> {
        Ok(self.numbering()?.next_shot())
    }

    /// The whole journal, oldest entry first.
    pub fn journal(&self) -> Result<Vec<Entry>, SessionError> {
        journal::read(&self.path.join(JOURNAL))
    }

    /// Appends an event to the journal; on the disk when this returns.
    pub fn record(&self, event: Event) -> Result<(), SessionError> {
        // Appending needs the right to write, and no other line in between.
        self.append(&mut *self.numbering()?, event)
    }

    /// Appends what is owed to the journal, and an event.
    fn append(&self, numbering: &mut Numbering, event: Event) -> Result<(), SessionError> {
        let file = self.path.join(JOURNAL);
        if let Some(owed) = numbering.owed.clone() {
            journal::append(&file, owed)?;
            numbering.owed = None;
        }
        let items = usize::from(matches!(event, Event::PairCommitted { .. }));
        journal::append(&file, event)?;
        self.wake_mirror(items);
        Ok(())
    }

    fn wake_mirror(&self, items: usize) {
        if let Some(mirror) = self.mirror.get() {
            mirror.wake(items);
        }
    }

    /// The same of what has happened already, whatever the disk says: if it cannot be written now, it is owed.
    fn append_or_owe(&self, numbering: &mut Numbering, event: Event) {
        if let Err(error) = self.append(numbering, event.clone()) {
            tracing::error!("the journal could not be written: {error}");
            // One place is enough: nothing else is begun before it is paid.
            numbering.owed.get_or_insert(event);
        }
    }
}

fn require_manifest(path: &Path) -> Result<(), SessionError> {
    if path.join(MANIFEST).is_file() {
        Ok(())
    } else {
        Err(SessionError::NotASession { path: path.to_owned() })
    }
}

fn from_json<T: serde::de::DeserializeOwned>(file: &Path) -> Result<T, SessionError> {
    let bytes = std::fs::read(file).map_err(SessionError::io(file))?;
    serde_json::from_slice(&bytes)
        .map_err(|e| SessionError::Damaged { path: file.to_owned(), why: e.to_string() })
}

fn to_json<T: Serialize>(file: &Path, value: &T) -> Result<Vec<u8>, SessionError> {
    let mut bytes = serde_json::to_vec_pretty(value)
        .map_err(|e| SessionError::Damaged { path: file.to_owned(), why: e.to_string() })?;
    bytes.push(b'\n');
    Ok(bytes)
}
