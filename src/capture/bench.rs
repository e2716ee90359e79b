//! The devices at hand: opened when they are needed, looked for again when they are missing, and described
//! in words at any time.

use crate::rig::{Camera, CameraError, CameraInfo, Flash, FlashError};
use serde::Serialize;

/// What fires the flash.
pub enum FlashKind {
    /// A controller between the camera's sync contact and the flash.
    Controller(Box<dyn Flash>),
    /// The operator, who is asked to switch the flash off and on.
    Manual,
    /// Nothing: pairs are refused.
    None,
}

/// Opens a camera; called whenever one is needed and none is open.
pub type OpenCamera = Box<dyn Fn() -> Result<Box<dyn Camera>, CameraError> + Send>;
/// Opens a flash; called whenever one is needed and none is open.
pub type OpenFlash = Box<dyn Fn() -> Result<FlashKind, FlashError> + Send>;

/// How to come by the devices.
pub struct RigSource {
    /// Opens the camera.
    pub camera: OpenCamera,
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

/// The open devices; belongs to the engine alone.
pub(super) struct Bench {
    source: RigSource,
    camera: Option<Box<dyn Camera>>,
    flash: Option<FlashKind>,
}

impl Bench {
    pub(super) fn new(source: RigSource) -> Self {
        Self { source, camera: None, flash: None }
    }

    /// The camera, opened if need be.
    pub(super) fn camera(&mut self) -> Result<&mut dyn Camera, CameraError> {
        if self.camera.is_none() {
            self.camera = Some((self.source.camera)()?);
        }
        match &mut self.camera {
            Some(camera) => Ok(camera.as_mut()),
            None => Err(CameraError::NotFound { hint: String::new() }),
        }
    }

    /// The flash, opened if need be.
    pub(super) fn flash(&mut self) -> Result<&mut FlashKind, FlashError> {
        if self.flash.is_none() {
            self.flash = Some((self.source.flash)()?);
        }
        Ok(self.flash.get_or_insert(FlashKind::None))
    }

    /// Lets a camera that failed go, so that the next use opens it anew. One that was merely busy stays.
    pub(super) fn note_camera_error(&mut self, error: &CameraError) {
        if !matches!(error, CameraError::Busy(_)) {
            self.camera = None;
        }
    }

    /// Lets a flash whose link failed go, so that the next use opens it anew.
    pub(super) fn note_flash_error(&mut self, error: &FlashError) {
        match error {
            FlashError::Open { .. } | FlashError::Silent { .. } | FlashError::Lost { .. } => {
                self.flash = None;
            }
            FlashError::Refused { .. } | FlashError::NotReady { .. } => {}
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
pub(super) const NO_FLASH: &str = "no flash controller found: plug it in, or start again with `--flash manual` \
                                   to switch the flash by hand";
