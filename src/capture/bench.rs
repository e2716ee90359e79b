//! The devices at hand: opened when they are needed, looked for again when they are missing, and described
//! in words at any time.

use super::engine::CameraState;
use super::error::CaptureError;
use crate::progress::Progress;
use crate::rig::{Camera, CameraError, CameraInfo, Closer, Flash, FlashError, LockReport, LockState};
use serde::Serialize;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

/// How long a pair waits for a flash controller that was pulled to be plugged in again, and how often it looks.
const REPLUG_PATIENCE: Duration = Duration::from_secs(5);
const REPLUG_GLANCE: Duration = Duration::from_millis(200);

/// What fires the flash.
pub enum FlashKind {
    /// A controller between the camera's sync contact and the flash.
    Controller(Box<dyn Flash>),
    /// The operator, who is asked to switch the flash off and on.
    Manual,
    /// Nothing: pairs are refused.
    None,
}

/// Opens the camera on a port, or the first that is found; called whenever one is needed and none is open.
pub type OpenCamera = Box<dyn Fn(Option<&str>) -> Result<Box<dyn Camera>, CameraError> + Send>;
/// Lists the cameras that can be opened.
pub type ListCameras = Box<dyn Fn() -> Result<Vec<CameraInfo>, CameraError> + Send + Sync>;
/// Opens a flash; called whenever one is needed and none is open.
pub type OpenFlash = Box<dyn Fn() -> Result<FlashKind, FlashError> + Send>;

/// How to come by the devices.
pub struct RigSource {
    /// Opens the camera.
    pub camera: OpenCamera,
    /// Lists the cameras.
    pub cameras: ListCameras,
    /// Opens the flash.
    pub flash: OpenFlash,
}

/// How one device stands, in words for the page.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct DeviceState {
    /// Whether it can be used now.
    pub ready: bool,
    /// What it is ("Canon EOS 5DS on usb:001,004"); empty when there is none.
    pub description: String,
    /// "ready", or what is the matter and what to do.
    pub words: String,
}

/// Both devices.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Devices {
    /// The camera.
    pub camera: DeviceState,
    /// The flash.
    pub flash: DeviceState,
}

impl Devices {
    /// Nobody has looked yet.
    pub(super) fn unknown() -> Self {
        let state =
            || DeviceState { ready: false, description: String::new(), words: "not looked for yet".into() };
        Self { camera: state(), flash: state() }
    }

    /// Whether a pair can be shot.
    pub fn ready(&self) -> bool {
        self.camera.ready && self.flash.ready
    }
}

/// Closes the gate past whoever has the bench; nothing where no controller is open.
#[derive(Clone, Default)]
pub(super) struct Gate(Arc<Mutex<Option<Closer>>>);

impl Gate {
    fn is_closed_by(&self, closer: Option<Closer>) {
        *self.0.lock().unwrap_or_else(PoisonError::into_inner) = closer;
    }

    /// Closes it now.
    pub(super) fn close(&self) -> Result<(), FlashError> {
        let closer = self.0.lock().unwrap_or_else(PoisonError::into_inner).clone();
        closer.map_or(Ok(()), |close| close())
    }
}

/// The open devices; belongs to the engine alone.
pub(super) struct Bench {
    open_camera: OpenCamera,
    open_flash: OpenFlash,
    camera: Option<Box<dyn Camera>>,
    /// The port that the operator chose; the first camera found without one.
    chosen: Option<String>,
    /// How the lock stood when the open camera was locked; forgotten with every trouble.
    lock: Option<LockReport>,
    flash: Option<FlashKind>,
    /// The gate may be open.
    pub(super) armed: bool,
    gate: Gate,
    /// A controller was open once, so that one that is missing now was pulled.
    had_controller: bool,
}

impl Bench {
    pub(super) fn new(open_camera: OpenCamera, open_flash: OpenFlash) -> Self {
        Self {
            open_camera,
            open_flash,
            camera: None,
            chosen: None,
            lock: None,
            flash: None,
            armed: false,
            gate: Gate::default(),
            had_controller: false,
        }
    }

    /// From now on, the camera on this port.
    pub(super) fn choose(&mut self, port: &str) {
        if self.chosen.as_deref() != Some(port) {
            self.chosen = Some(port.to_owned());
            self.camera = None;
            self.lock = None;
        }
    }

    /// Closes the gate past whoever has the bench.
    pub(super) fn gate(&self) -> Gate {
        self.gate.clone()
    }

    /// The camera, opened if need be.
    pub(super) fn camera(&mut self) -> Result<&mut dyn Camera, CameraError> {
        if self.camera.is_none() {
            self.camera = Some((self.open_camera)(self.chosen.as_deref())?);
        }
        match &mut self.camera {
            Some(camera) => Ok(camera.as_mut()),
            None => Err(CameraError::NotFound { hint: String::new() }),
        }
    }

    /// The flash, opened if need be.
    pub(super) fn flash(&mut self) -> Result<&mut FlashKind, FlashError> {
        if self.flash.is_none() {
            self.flash = Some((self.open_flash)()?);
            self.gate.is_closed_by(match &self.flash {
                Some(FlashKind::Controller(flash)) => flash.closer(),
                _ => None,
            });
            self.had_controller |= matches!(self.flash, Some(FlashKind::Controller(_)));
        }
        Ok(self.flash.get_or_insert(FlashKind::None))
    }

    /// Goes through the exposure lock, unless this camera stands locked since it was opened.
    pub(super) fn lock(&mut self) -> Result<LockReport, CameraError> {
        if let Some(report) = &self.lock {
            return Ok(report.clone());
        }
        let report = self.camera()?.lock()?;
        // What is wrong is looked at again next time: the operator mends it at the camera.
        if report.sentences(LockState::Wrong).is_empty() {
            self.lock = Some(report.clone());
        }
        Ok(report)
    }

    /// After a failure nothing is known of the camera's settings any more. The driver itself stays: it knows
    /// which camera it was, and how to find it again.
    pub(super) fn note_camera_error(&mut self, error: &CameraError) {
        if !matches!(error, CameraError::Busy(_)) {
            self.lock = None;
        }
        // Nobody chose this one, so that any other will do.
        if matches!(error, CameraError::NotFound { .. }) && self.chosen.is_none() {
            self.camera = None;
        }
    }

    /// Whether the flash's failure may be a matter of a cable that is plugged in again soon.
    pub(super) fn flash_may_return(&self, error: &CaptureError) -> bool {
        match error {
            CaptureError::Flash(FlashError::Silent { .. } | FlashError::Lost { .. }) => true,
            // A boot loader that is just starting says things that no controller says.
            CaptureError::Flash(FlashError::Open { .. } | FlashError::Firmware { .. })
            | CaptureError::NoFlash => self.had_controller,
            _ => false,
        }
    }

    /// Opens a controller anew that was lost or silent, waiting a while for one that was pulled.
    pub(super) fn recover_flash(&mut self, progress: &Progress) -> Result<Vec<String>, CaptureError> {
        let end = Instant::now() + REPLUG_PATIENCE;
        loop {
            self.flash = None;
            let trouble = match self.flash() {
                Ok(FlashKind::None) => CaptureError::NoFlash,
                Ok(_) => return Ok(vec!["opened anew".into()]),
                Err(error) => error.into(),
            };
            if Instant::now() >= end || !self.flash_may_return(&trouble) {
                return Err(trouble);
            }
            progress.check()?;
            std::thread::sleep(REPLUG_GLANCE);
        }
    }

    /// Brings the camera back; says in which steps.
    pub(super) fn recover_camera(&mut self) -> Result<Vec<String>, CameraError> {
        self.lock = None;
        self.camera()?.recover()
    }

    /// Ends live view, if a camera is open.
    pub(super) fn end_preview(&mut self) -> Result<(), CameraError> {
        self.camera.as_mut().map_or(Ok(()), |camera| camera.end_preview())
    }

    /// Everything that the camera tells of itself.
    pub(super) fn state(&mut self) -> Result<CameraState, CameraError> {
        let lock = self.lock()?;
        let camera = self.camera()?;
        Ok(CameraState {
            info: camera.info()?,
            settings: camera.settings()?,
            offered: camera.offered()?,
            lock,
        })
    }

    /// Has the lock gone through again at the next pair.
    pub(super) fn unlock(&mut self) {
        self.lock = None;
    }

    /// Lets a flash whose link failed go, so that the next use opens it anew.
    pub(super) fn note_flash_error(&mut self, error: &FlashError) {
        match error {
            FlashError::Open { .. }
            | FlashError::Firmware { .. }
            | FlashError::Silent { .. }
            | FlashError::Lost { .. } => {
                self.flash = None;
            }
            FlashError::Refused { .. } | FlashError::NotReady { .. } | FlashError::ReadyLow => {}
        }
    }

    /// Asks both devices how they stand, looking for those that are missing.
    pub(super) fn look(&mut self) -> Devices {
        let camera = match self.camera().and_then(|c| c.info()) {
            Ok(CameraInfo { model, port, .. }) => {
                DeviceState { ready: true, description: format!("{model} on {port}"), words: "ready".into() }
            }
            Err(error) => {
                self.note_camera_error(&error);
                DeviceState { ready: false, description: String::new(), words: error.to_string() }
            }
        };
        let flash = match self.flash() {
            Ok(FlashKind::Controller(flash)) => {
                let status = flash.status();
                DeviceState { ready: status.ready, description: status.description, words: status.words }
            }
            Ok(FlashKind::Manual) => DeviceState {
                ready: true,
                description: "Flash switched by hand".into(),
                words: "you will be asked to switch it off and on".into(),
            },
            Ok(FlashKind::None) => {
                self.flash = None;
                DeviceState { ready: false, description: String::new(), words: NO_FLASH.into() }
            }
            Err(error) => {
                self.note_flash_error(&error);
                DeviceState { ready: false, description: String::new(), words: error.to_string() }
            }
        };
        Devices { camera, flash }
    }
}

/// What to do when there is no flash.
pub(super) const NO_FLASH: &str = "no flash controller found: plug it in, or start again with `--flash PORT` if its USB \
                                   chip is none of the usual (`unlit flash ports`), or with `--flash manual` to \
                                   switch the flash by hand";
