//! Does what the state machine asks: sole owner of camera and flash.
//!
//! Calls are serialised by one lock; whoever calls does the work on his own thread (the daemon's rig lane,
//! the terminal's main thread). What can be asked without waiting for a running pair (devices as last seen,
//! the operator's confirmation) does not take that lock.

use super::bench::{Bench, Devices, Gate, ListCameras, RigSource};
use super::card::{CalibrationShot, CardPlace};
use super::error::CaptureError;
use super::events::{Events, Topic};
use super::live::Live;
use super::place::{PairPlace, Place, PlaceError, name_of};
use super::prompt::Prompter;
use super::run::Run;
use super::wish::PairWish;
use crate::pair::{Limits, Offered, PairRecord, Settings, Verdict};
use crate::pipeline::levels;
use crate::pipeline::scale::SessionScale;
use crate::pipeline::stops::Earlier;
use crate::progress::Progress;
use crate::rig::{CameraError, CameraInfo, LockReport};
use crate::session::Session;
use serde_json::json;
use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError, TryLockError};
use std::time::{Duration, Instant};

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

/// How long a question about the camera waits for a pair that is being shot.
const BENCH_PATIENCE: Duration = Duration::from_secs(10);
/// How often a waiting question looks.
const GLANCE: Duration = Duration::from_millis(20);
/// How often a pair is tried when a device fails that can be brought back.
pub(super) const ATTEMPTS: u32 = 3;

/// Whether bringing the device back and shooting again may help; what only the operator can mend is told at once.
pub(super) fn worth_another_try(error: &CaptureError, bench: &Bench) -> bool {
    match error {
        CaptureError::Camera(error) => error.may_pass(),
        error => bench.flash_may_return(error),
    }
}

fn told(steps: &[String]) -> String {
    if steps.is_empty() { String::new() } else { format!(" ({})", steps.join(", ")) }
}

/// How the camera stands.
#[derive(Clone, Debug, PartialEq)]
pub struct CameraState {
    /// Who it is.
    pub info: CameraInfo,
    /// Its settings as it reports them.
    pub settings: Settings,
    /// What its dials offer.
    pub offered: Offered,
    /// The exposure lock.
    pub lock: LockReport,
}

/// The engine.
pub struct Engine {
    bench: Mutex<Bench>,
    gate: Gate,
    list_cameras: ListCameras,
    live: Live,
    /// Somebody asked for the devices while they were in use.
    look_again: AtomicBool,
    /// What the session last shot into (its folder) remembers of its pairs.
    memory: Mutex<Option<(PathBuf, Earlier)>>,
    devices: Mutex<Devices>,
    prompter: Prompter,
    events: Events,
    limits: Limits,
}

impl Engine {
    /// An engine that comes by its devices through `source`, judges by `limits` and tells `events`.
    /// No device is opened before it is needed.
    pub fn new(source: RigSource, limits: Limits, events: Events) -> Self {
        let bench = Bench::new(source.camera, source.flash);
        Self {
            gate: bench.gate(),
            bench: Mutex::new(bench),
            list_cameras: source.cameras,
            live: Live::default(),
            look_again: AtomicBool::new(false),
            memory: Mutex::default(),
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
            Err(TryLockError::WouldBlock) => {
                self.look_again.store(true, Ordering::Release);
                return self.devices();
            }
        };
        self.note_devices(seen.clone());
        seen
    }

    /// Closes the gate between camera and flash, past whoever uses the rig: for the end of the program. Where no
    /// controller is open, or its port is gone, the controller closes it itself, by its time to live or for silence.
    pub fn close_gate(&self) {
        if let Err(error) = self.gate.close() {
            tracing::warn!("the flash could not be disarmed: {error}");
        }
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
        self.shoot_pair_as(session, PairWish::default(), after_pair, progress)
    }

    /// The same in the order of frames that is wished, or once more under the number of a rejected pair.
    pub fn shoot_pair_as(
        &self,
        session: &Session,
        wish: PairWish,
        after_pair: Option<&AfterPair>,
        progress: &Progress,
    ) -> Result<PairRecord, CaptureError> {
        let mut memory = lock(&self.memory);
        let earlier = match memory.take() {
            Some((path, earlier))
                if path == session.path()
                    && earlier.is_by(&SessionScale::load(session).map_err(CaptureError::Levels)?) =>
            {
                earlier
            }
            _ => Earlier::load(session, progress)?,
        };
        let (_, earlier) = memory.insert((session.path().to_owned(), earlier));
        let mut place = PairPlace::new(session, wish, earlier)?;
        let _lines_say_which = tracing::error_span!("pair", number = place.tag()).entered();
        tracing::info!("is being shot");
        self.shoot(&mut place, progress)?;
        let measured = place.levels();
        let record = place.into_record().ok_or(PlaceError::Incomplete)?;
        if let Some(after_pair) = after_pair
            && record.verdict == Verdict::Accepted
        {
            after_pair(&record);
        }
        let data = json!({
            "session": name_of(session),
            "number": record.number,
            "attempt": record.attempt,
            "verdict": record.verdict,
        });
        let mut words = words_on(&record);
        if let Some(remark) =
            levels::remark(&measured, &record.on.settings).filter(|_| record.verdict == Verdict::Accepted)
        {
            words = format!("{words} {remark}");
        }
        self.events.tell(Topic::Pair, words, data);
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
        let data =
            json!({ "session": name_of(session), "kind": "flash", "shot": shot.name, "name": shot.name });
        self.events.tell(Topic::CalibrationShot, words, data);
        Ok(shot)
    }

    /// Shoots all frames into `place` and says how they were judged. A device that fails is brought back, and
    /// all frames are shot again: a pair is never made of frames from before and after a failure.
    fn shoot(&self, place: &mut dyn Place, progress: &Progress) -> Result<Verdict, CaptureError> {
        let mut bench = self.take_bench();
        let mut outcome =
            Run::new(&mut bench, place, &self.prompter, &self.limits, progress, &self.events).finish();
        for _ in 1..ATTEMPTS {
            let Err(error) = &outcome else { break };
            if !worth_another_try(error, &bench) || progress.is_cancelled() {
                break;
            }
            if let Err(error) = self.bring_back(&mut bench, error, progress) {
                outcome = Err(error);
                break;
            }
            outcome =
                Run::new(&mut bench, place, &self.prompter, &self.limits, progress, &self.events).finish();
        }
        let trouble =
            matches!(outcome, Err(CaptureError::Camera(_) | CaptureError::Flash(_) | CaptureError::NoFlash));
        // Somebody may have plugged something in or out while the bench was in use.
        if self.look_again.swap(false, Ordering::AcqRel) || trouble {
            let seen = bench.look();
            drop(bench);
            self.note_devices(seen);
        }
        outcome
    }

    /// Brings back what failed with `error`, and tells it.
    pub(super) fn bring_back(
        &self,
        bench: &mut Bench,
        error: &CaptureError,
        progress: &Progress,
    ) -> Result<(), CaptureError> {
        self.events.tell(Topic::Recovery, error.to_string(), json!({ "code": error.code() }));
        progress.report("Bringing the devices back", 0, 1);
        let (what, steps) = match error {
            CaptureError::Flash(_) | CaptureError::NoFlash => ("flash", bench.recover_flash(progress)?),
            _ => ("camera", bench.recover_camera()?),
        };
        let words = format!("The {what} is back{}.", told(&steps));
        self.events.tell(Topic::Recovery, words, json!({ "steps": steps }));
        Ok(())
    }

    pub(super) fn events(&self) -> &Events {
        &self.events
    }

    pub(super) fn prompter(&self) -> &Prompter {
        &self.prompter
    }

    /// The bench, once whoever has it is done; live view makes way.
    pub(super) fn take_bench(&self) -> MutexGuard<'_, Bench> {
        let _reserved = self.live.reserve();
        lock(&self.bench)
    }

    /// The bench, unless whoever has it does not let go in time: a pair may wait for the operator for ever.
    fn bench_within(&self, patience: Duration) -> Result<MutexGuard<'_, Bench>, CameraError> {
        let _reserved = self.live.reserve();
        let end = Instant::now() + patience;
        loop {
            match self.bench.try_lock() {
                Ok(bench) => return Ok(bench),
                Err(TryLockError::Poisoned(bench)) => return Ok(bench.into_inner()),
                Err(TryLockError::WouldBlock) if Instant::now() < end => std::thread::sleep(GLANCE),
                Err(TryLockError::WouldBlock) => {
                    return Err(CameraError::Busy(
                        "it is being used for a pair; ask again when that has ended".into(),
                    ));
                }
            }
        }
    }

    pub(super) fn live(&self) -> &Live {
        &self.live
    }

    /// A live picture; `None` while the camera is in use.
    pub(super) fn preview(&self) -> Option<Result<Vec<u8>, CameraError>> {
        let mut bench = match self.bench.try_lock() {
            Ok(bench) => bench,
            Err(TryLockError::Poisoned(bench)) => bench.into_inner(),
            Err(TryLockError::WouldBlock) => return None,
        };
        let picture = bench.camera().and_then(|camera| camera.preview());
        if let Err(error) = &picture {
            bench.note_camera_error(error);
        }
        Some(picture)
    }

    /// Ends live view at the camera, if there is one.
    pub(super) fn end_preview(&self) {
        let mut bench = lock(&self.bench);
        if let Err(error) = bench.end_preview() {
            tracing::warn!("live view could not be ended: {error}");
            bench.note_camera_error(&error);
        }
    }

    /// The cameras that can be opened now.
    pub fn cameras(&self) -> Result<Vec<CameraInfo>, CameraError> {
        (self.list_cameras)()
    }

    /// From now on, the camera on this port; says how the devices then stand.
    pub fn choose_camera(&self, port: &str) -> Result<Devices, CameraError> {
        let mut bench = self.bench_within(BENCH_PATIENCE)?;
        bench.choose(port);
        let seen = bench.look();
        drop(bench);
        self.note_devices(seen.clone());
        Ok(seen)
    }

    /// How the camera stands: its settings, what its dials offer, and the exposure lock, gone through now.
    pub fn camera_state(&self) -> Result<CameraState, CameraError> {
        let mut bench = self.bench_within(BENCH_PATIENCE)?;
        bench.unlock();
        let state = bench.state();
        if let Err(error) = &state {
            bench.note_camera_error(error);
        }
        state
    }
}

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    // Every value behind these locks is whole after each statement.
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}
