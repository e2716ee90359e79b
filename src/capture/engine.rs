//! Does what the state machine asks: sole owner of camera and flash.
//!
//! Calls are serialised by one lock; whoever calls does the work on his own thread (the daemon's rig lane,
//! the terminal's main thread). What can be asked without waiting for a running pair (devices as last seen,
//! the operator's confirmation) does not take that lock.

use super::bench::{Bench, Devices, NO_FLASH, RigSource};
use super::events::{Events, Topic};
use super::place::{CalibrationShot, CardPlace, PairPlace, Place, PlaceError, name_of};
use super::prompt::Prompter;
use super::run::Run;
use crate::pair::{Limits, PairRecord, Verdict};
use crate::progress::{Cancelled, Progress};
use crate::rig::{CameraError, FlashError};
use crate::session::Session;
use serde_json::json;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError, TryLockError};

/// Why a pair was not stored.
#[derive(Debug, thiserror::Error)]
pub enum CaptureError {
    /// The camera.
    #[error(transparent)]
    Camera(#[from] CameraError),
    /// The flash.
    #[error(transparent)]
    Flash(#[from] FlashError),
    /// There is no flash.
    #[error("{NO_FLASH}")]
    NoFlash,
    /// The session folder.
    #[error("the pair could not be stored: {0}")]
    Place(#[from] PlaceError),
    /// On request.
    #[error(transparent)]
    Cancelled(#[from] Cancelled),
}

impl CaptureError {
    /// Stable name for scripts.
    pub fn code(&self) -> &'static str {
        match self {
            CaptureError::Camera(error) => error.code(),
            CaptureError::Flash(FlashError::Open { .. }) => "flash_not_opened",
            CaptureError::Flash(FlashError::Silent { .. }) => "flash_silent",
            CaptureError::Flash(FlashError::Refused { .. }) => "flash_refused",
            CaptureError::Flash(FlashError::NotReady { .. }) => "flash_not_ready",
            CaptureError::Flash(FlashError::Lost { .. }) => "flash_lost",
            CaptureError::NoFlash => "flash_missing",
            CaptureError::Place(_) => "session_not_written",
            CaptureError::Cancelled(_) => "cancelled",
        }
    }
}

/// Called on each accepted pair before it is announced: the studio's operator walks on, a turntable turns.
pub type AfterPair = Arc<dyn Fn(&PairRecord) + Send + Sync>;

/// What became of a pair, in one sentence.
pub fn words_on(record: &PairRecord) -> String {
    match record.verdict {
        Verdict::Accepted => format!("Pair {} is good.", record.number),
        Verdict::Rejected => {
            let reasons: Vec<&str> = record.reasons.iter().map(|r| r.sentence.as_str()).collect();
            format!("Pair {} was rejected: {}", record.number, reasons.join(" "))
        }
    }
}

/// The engine.
pub struct Engine {
    bench: Mutex<Bench>,
    devices: Mutex<Devices>,
    prompter: Prompter,
    events: Events,
    limits: Limits,
}

impl Engine {
    /// An engine that comes by its devices through `source`, judges by `limits` and tells `events`.
    /// No device is opened before it is needed.
    pub fn new(source: RigSource, limits: Limits, events: Events) -> Self {
        Self {
            bench: Mutex::new(Bench::new(source)),
            devices: Mutex::new(Devices::unknown()),
            prompter: Prompter::new(events.clone()),
            events,
            limits,
        }
    }

    /// The devices as last seen; never waits.
    pub fn devices(&self) -> Devices {
        lock(&self.devices).clone()
    }

    /// Looks for the devices, unless a pair is being shot right now: then they are as last seen.
    pub fn look(&self) -> Devices {
        let seen = match self.bench.try_lock() {
            Ok(mut bench) => bench.look(),
            Err(TryLockError::Poisoned(bench)) => bench.into_inner().look(),
            Err(TryLockError::WouldBlock) => return self.devices(),
        };
        self.note_devices(seen.clone());
        seen
    }

    /// What the operator is asked at the moment.
    pub fn prompt(&self) -> Option<String> {
        self.prompter.open()
    }

    /// The operator has done what was asked. `false` if nothing was asked.
    pub fn confirm(&self) -> bool {
        self.prompter.confirm()
    }

    fn note_devices(&self, seen: Devices) {
        let changed = {
            let mut devices = lock(&self.devices);
            let changed = *devices != seen;
            devices.clone_from(&seen);
            changed
        };
        if changed {
            let words = format!("Camera: {}. Flash: {}.", seen.camera.words, seen.flash.words);
            self.events.tell(Topic::Devices, words, json!(seen));
        }
    }

    /// Shoots the session's next pair and returns it as stored, accepted or rejected. Blocks until it is on
    /// the disk or has failed; `progress` cancels it between two steps. `after_pair` is called on an
    /// accepted pair before anybody hears of it.
    pub fn shoot_pair(
        &self,
        session: &Session,
        after_pair: Option<&AfterPair>,
        progress: &Progress,
    ) -> Result<PairRecord, CaptureError> {
        let mut place = PairPlace::new(session).map_err(PlaceError::from)?;
        self.shoot(&mut place, progress)?;
        let record = place.into_record().ok_or(PlaceError::Incomplete)?;
        if let Some(after_pair) = after_pair
            && record.verdict == Verdict::Accepted
        {
            after_pair(&record);
        }
        let data = json!({
            "session": name_of(session),
            "number": record.number,
            "verdict": record.verdict,
        });
        self.events.tell(Topic::Pair, words_on(&record), data);
        Ok(record)
    }

    /// Shoots the calibration card at `distance_m` metres with and without flash, as [`Engine::shoot_pair`]
    /// does with a pair.
    pub fn shoot_card(
        &self,
        session: &Session,
        distance_m: f64,
        progress: &Progress,
    ) -> Result<CalibrationShot, CaptureError> {
        let mut place = CardPlace::new(session, distance_m)?;
        self.shoot(&mut place, progress)?;
        let shot = place.into_shot().ok_or(PlaceError::Incomplete)?;
        let words = format!("Calibration shot {} at {} m is stored.", shot.name, shot.distance_m);
        let data = json!({ "session": name_of(session), "name": shot.name });
        self.events.tell(Topic::CalibrationShot, words, data);
        Ok(shot)
    }

    /// Shoots two frames into `place` and says how they were judged.
    fn shoot(&self, place: &mut dyn Place, progress: &Progress) -> Result<Verdict, CaptureError> {
        let mut bench = lock(&self.bench);
        let outcome = Run::new(&mut bench, place, &self.prompter, &self.limits, progress).finish();
        if let Err(CaptureError::Camera(_) | CaptureError::Flash(_) | CaptureError::NoFlash) = outcome {
            let seen = bench.look();
            drop(bench);
            self.note_devices(seen);
        }
        outcome
    }
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    // Every value behind these locks is whole after each statement.
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}
