//! What capture asks of a camera and of a flash, whatever stands behind them.

use crate::pair::Settings;
use serde::{Deserialize, Serialize};
use std::time::Duration;

/// A camera as it introduces itself.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct CameraInfo {
    /// Model name as the driver gives it.
    pub model: String,
    /// Port by which it is opened again (`usb:001,004`, `ptpip:127.0.0.1:1234:1235`).
    pub port: String,
    /// Body serial number.
    pub serial: Option<String>,
}

/// One file straight from the camera, byte for byte.
#[derive(Clone, Debug, PartialEq)]
pub struct ShotFile {
    /// The camera's own name for it (`capt0000.cr2`); not unique.
    pub name: String,
    /// Its bytes.
    pub bytes: Vec<u8>,
}

/// What went wrong at the camera, and what the operator can do.
#[derive(Debug, thiserror::Error)]
pub enum CameraError {
    /// No camera answers.
    #[error("no camera found{hint}: is it plugged in, switched on and awake?")]
    NotFound {
        /// What was looked for, led by a space; may be empty.
        hint: String,
    },
    /// Another program holds the port.
    #[error("camera {port} is held by another program (often gvfs: `gio mount -s gphoto2` frees it)")]
    Claimed {
        /// The port.
        port: String,
    },
    /// The camera says it is busy; trying again is worth it.
    #[error("camera is busy: {0}")]
    Busy(String),
    /// The deadline passed; the camera host was killed and will be started anew.
    #[error(
        "camera did not finish {operation} within {deadline:?}; its driver was stopped and is started again at the next try"
    )]
    Deadline {
        /// What was asked.
        operation: String,
        /// How long it had.
        deadline: Duration,
    },
    /// The camera refused.
    #[error("camera refused to {operation}: {reason}")]
    Refused {
        /// What was asked.
        operation: String,
        /// What the driver said.
        reason: String,
    },
    /// The camera host process could not be run or spoken to.
    #[error("camera host process failed: {0}")]
    Host(String),
}

/// A tethered camera. All calls block up to their deadline.
pub trait Camera: Send {
    /// Who it is.
    fn info(&mut self) -> Result<CameraInfo, CameraError>;

    /// Settings as the camera reports them now.
    fn settings(&mut self) -> Result<Settings, CameraError>;

    /// Releases the shutter once and brings the file; returns only when the camera is ready for the next.
    fn shoot(&mut self) -> Result<ShotFile, CameraError>;
}

/// How the flash stands, in words for the page.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct FlashStatus {
    /// What it is ("unlit flash controller 1 on ttyACM0").
    pub description: String,
    /// Whether it answers and is safe to use.
    pub ready: bool,
    /// What is the matter, or "ready".
    pub words: String,
}

/// One closing of the camera's sync contact, as the controller saw it.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct FlashShot {
    /// Running number of the sync on the board.
    pub number: u32,
    /// Whether the board let it through to the flash.
    pub triggered: bool,
    /// Tag given when arming; 0 when not armed.
    pub tag: u32,
    /// Light energy measured, in the board's counts; `None` when no pulse was seen.
    pub energy_counts: Option<f64>,
}

/// What went wrong at the flash, and what the operator can do.
#[derive(Debug, thiserror::Error)]
pub enum FlashError {
    /// The port could not be opened.
    #[error(
        "flash controller port {port} cannot be opened: {reason}; is it plugged in, and may you use it (group dialout)?"
    )]
    Open {
        /// The device path.
        port: String,
        /// What the system said.
        reason: String,
    },
    /// The board stays silent.
    #[error("flash controller on {port} does not answer {request}; unplug it, plug it in again and retry")]
    Silent {
        /// The device path.
        port: String,
        /// The request.
        request: String,
    },
    /// The board refused.
    #[error("flash controller refused {request}: {word} (error {code})")]
    Refused {
        /// The request.
        request: String,
        /// The board's error code.
        code: u32,
        /// The board's word for it.
        word: String,
    },
    /// The flash has not recycled.
    #[error("flash is still recycling; wait {wait_ms} ms")]
    NotReady {
        /// How long to wait.
        wait_ms: u64,
    },
    /// The link broke.
    #[error("flash controller on {port} was unplugged or its link broke: {reason}")]
    Lost {
        /// The device path.
        port: String,
        /// What the system said.
        reason: String,
    },
}

/// A flash controller between the camera's sync contact and the flash.
pub trait Flash: Send {
    /// How it stands.
    fn status(&mut self) -> FlashStatus;

    /// Lets exactly the next sync through, once, if it comes within `time_to_live`. Waits for the flash to recycle.
    fn arm(&mut self, tag: u32, time_to_live: Duration) -> Result<(), FlashError>;

    /// Closes the gate. Dark frames are shot with the gate closed.
    fn disarm(&mut self) -> Result<(), FlashError>;

    /// The syncs seen since the last call, waiting up to `patience` for the first.
    fn syncs(&mut self, patience: Duration) -> Result<Vec<FlashShot>, FlashError>;
}
