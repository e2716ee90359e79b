//! What capture asks of a camera and of a flash, whatever stands behind them.

use crate::pair::{Dial, FlashSync, Offered, Settings};
use crate::units::Seconds;
use serde::{Deserialize, Serialize};
use std::sync::Arc;
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

/// How long a shot took, part by part.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct ShotTimes {
    /// From the request to the camera's word that a file waits: exposure and the camera's own work.
    pub exposing: Duration,
    /// Download of all files of the shot.
    pub transfer: Duration,
    /// From the last byte to the camera's word that it is ready.
    pub until_ready: Duration,
    /// From the call to its return, everything included.
    pub total: Duration,
}

/// One release of the shutter: everything that the camera made of it.
#[derive(Clone, Debug, PartialEq)]
pub struct Shot {
    /// The raw file.
    pub raw: ShotFile,
    /// The JPEG of a body that writes RAW+JPEG.
    pub jpeg: Option<ShotFile>,
    /// Where the time went.
    pub times: ShotTimes,
}

/// How one setting of the exposure lock stands.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum LockState {
    /// As it must be.
    Locked,
    /// It was otherwise; it was set, and reads as it must be.
    Corrected,
    /// It is otherwise and cannot be set from here: pairs would be spoilt.
    Wrong,
    /// The camera does not tell it: the operator is asked.
    Unreadable,
    /// Pairs can be shot, but there is something to know (a wide aperture, a shutter faster than X-sync).
    Warning,
}

/// One setting of the exposure lock.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct LockItem {
    /// Stable name (`mode`, `focus`, `drive`, `white_balance`, `file_format`, ...).
    pub name: String,
    /// How it stands.
    pub state: LockState,
    /// What the camera says; empty when it does not tell.
    pub value: String,
    /// What it means, and what to do or to check.
    pub sentence: String,
}

/// The exposure lock, item by item.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct LockReport {
    /// In the order of the maker's table.
    pub items: Vec<LockItem>,
    /// Fastest shutter at which the whole frame sees the flash, where the body is known.
    pub x_sync: Option<Seconds>,
}

impl LockReport {
    /// Sentences of the items in `state`.
    pub fn sentences(&self, state: LockState) -> Vec<&str> {
        self.items.iter().filter(|i| i.state == state).map(|i| i.sentence.as_str()).collect()
    }
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
    #[error(
        "camera {port} is held by another program (often gvfs: `systemctl --user stop \
         gvfs-gphoto2-volume-monitor` and `gio mount -s gphoto2` free it; `unlit doctor` names it)"
    )]
    Claimed {
        /// The port.
        port: String,
    },
    /// The camera says it is busy; trying again is worth it.
    #[error("camera is busy: {0}")]
    Busy(String),
    /// The deadline passed; the camera host was killed and will be started anew.
    #[error(
        "camera did not finish {operation} within {deadline:.1?}; its driver was stopped and is started again at the next try"
    )]
    Deadline {
        /// What was asked.
        operation: String,
        /// How long it had.
        deadline: Duration,
    },
    /// The link broke, or the library no longer knows where it stands.
    #[error(
        "the link to the camera was lost while it was to {operation}: {reason}; it is opened anew at the next try"
    )]
    Lost {
        /// What was asked.
        operation: String,
        /// What the driver said.
        reason: String,
    },
    /// The camera has left the bus.
    #[error(
        "camera {port} has left the USB bus: plug it in again, switch it on or wake it, and set its auto power off to never"
    )]
    Unplugged {
        /// Where it was.
        port: String,
    },
    /// The camera refused.
    #[error("camera refused to {operation}: {reason}")]
    Refused {
        /// What was asked.
        operation: String,
        /// What the driver said.
        reason: String,
    },
    /// It did not release because it found no focus.
    #[error("camera did not release because it found no focus: switch the lens to manual focus (MF) ({0})")]
    NoFocus(String),
    /// No room for the frame.
    #[error(
        "camera has no room for the frame: empty or change its card, or let it send frames to the computer ({0})"
    )]
    CardFull(String),
    /// The battery is too low to release.
    #[error("camera's battery is too low: charge or change it, best use a mains adapter ({0})")]
    BatteryLow(String),
    /// A frame came with fewer bytes than announced.
    #[error(
        "{name} came with {got} of {announced} bytes, and the camera no longer has it: take the frame again"
    )]
    Incomplete {
        /// The camera's name for the file.
        name: String,
        /// Bytes that came.
        got: u64,
        /// Bytes that the camera announced.
        announced: u64,
    },
    /// Frames came that cannot be told apart from those of an earlier release.
    #[error("the frame that came cannot be trusted to be the one just taken: {0}; take it again")]
    Untrusted(String),
    /// Everything that can be done from here was done; hands are needed.
    #[error("the camera does not come back ({reason}). {advice}")]
    Stuck {
        /// The last error.
        reason: String,
        /// What the operator should do, in order.
        advice: String,
    },
    /// The camera host process could not be run or spoken to.
    #[error("camera host process failed: {0}")]
    Host(String),
}

impl CameraError {
    /// Stable name for scripts.
    pub fn code(&self) -> &'static str {
        match self {
            CameraError::NotFound { .. } => "camera_not_found",
            CameraError::Claimed { .. } => "camera_claimed",
            CameraError::Busy(_) => "camera_busy",
            CameraError::Deadline { .. } => "camera_deadline",
            CameraError::Lost { .. } => "camera_lost",
            CameraError::Unplugged { .. } => "camera_unplugged",
            CameraError::Refused { .. } => "camera_refused",
            CameraError::NoFocus(_) => "camera_no_focus",
            CameraError::CardFull(_) => "camera_card_full",
            CameraError::BatteryLow(_) => "camera_battery_low",
            CameraError::Incomplete { .. } => "camera_frame_incomplete",
            CameraError::Untrusted(_) => "camera_frame_untrusted",
            CameraError::Stuck { .. } => "camera_stuck",
            CameraError::Host(_) => "camera_host_failed",
        }
    }

    /// Whether [`Camera::recover`] and another try may help without the operator's hands.
    pub fn may_pass(&self) -> bool {
        matches!(
            self,
            CameraError::Busy(_)
                | CameraError::Deadline { .. }
                | CameraError::Lost { .. }
                | CameraError::Unplugged { .. }
                | CameraError::Incomplete { .. }
                | CameraError::Untrusted(_)
                | CameraError::Host(_)
        )
    }
}

/// A tethered camera. All calls block up to their deadline.
pub trait Camera: Send {
    /// Who it is.
    fn info(&mut self) -> Result<CameraInfo, CameraError>;

    /// Settings as the camera reports them now.
    fn settings(&mut self) -> Result<Settings, CameraError>;

    /// What the dials offer now.
    fn offered(&mut self) -> Result<Offered, CameraError>;

    /// Turns one dial to a value that it offers. Whether the camera obeyed is proved by the next file's EXIF.
    fn set(&mut self, dial: Dial) -> Result<(), CameraError>;

    /// Goes through everything that must stand still while pairs are shot, sets what can be set, and says how
    /// each item stands.
    fn lock(&mut self) -> Result<LockReport, CameraError>;

    /// A live picture (JPEG).
    fn preview(&mut self) -> Result<Vec<u8>, CameraError>;

    /// Ends live view: the mirror comes down, and the camera saves its battery.
    fn end_preview(&mut self) -> Result<(), CameraError> {
        Ok(())
    }

    /// Brings a camera back after a call that failed, from the gentlest step to the roughest, and tells the steps
    /// taken in words. An error says what the operator must do.
    fn recover(&mut self) -> Result<Vec<String>, CameraError> {
        self.info().map(|_| Vec::new())
    }

    /// Releases the shutter once and brings its files; returns only when the camera is ready for the next.
    fn shoot(&mut self) -> Result<Shot, CameraError>;
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

/// What went wrong at the flash, and what the operator can do.
#[derive(Debug, thiserror::Error)]
pub enum FlashError {
    /// The port could not be opened.
    #[error("flash controller port {port} cannot be opened ({reason}): {advice}")]
    Open {
        /// The device path.
        port: String,
        /// What the system said.
        reason: String,
        /// What to do.
        advice: String,
    },
    /// Something answers, but not in this program's protocol.
    #[error(
        "what is on {port} is no flash controller that this program can speak to: {reason}. If it is your controller, \
         program it with `unlit flash upload {port}`; else choose another port (`unlit flash ports`)"
    )]
    Firmware {
        /// The device path.
        port: String,
        /// What is wrong with its answers.
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
    #[error("flash controller refused {request}: {word} (error {code}); {}", remedy(*code))]
    Refused {
        /// The request.
        request: String,
        /// The board's error code.
        code: u32,
        /// The board's word for it.
        word: String,
    },
    /// The flash has not recycled.
    #[error(
        "flash is still recycling: wait {:.1} s, or set a shorter recycle time (`--recycle`) if the flash needs less",
        Duration::from_millis(*wait_ms).as_secs_f64()
    )]
    NotReady {
        /// How long to wait.
        wait_ms: u64,
    },
    /// The flash's ready output is low; no one can tell for how long.
    #[error(
        "flash is not charged, says its ready output, which stays low: wait, switch the flash on, or see whether the \
         output's wire is loose; where none is wired, start without `--ready-output`"
    )]
    ReadyLow,
    /// The link broke, or the board cannot vouch for the frame under way.
    #[error(
        "flash controller on {port} failed: {reason}. If it was unplugged, plug it in again; if not, take the frame \
         again, and look at its cable and power if this happens often"
    )]
    Lost {
        /// The device path.
        port: String,
        /// What the system said, or what became of the frame.
        reason: String,
    },
}

/// What to do about an error of the board; `firmware/PROTOCOL.md` has the numbers.
fn remedy(code: u32) -> &'static str {
    match code {
        1..=3 | 6 => {
            "what it is told arrives damaged: use another USB cable or socket, and keep the cable away from the flash's"
        }
        4 => "its firmware does not know this: bring it up to date with `unlit flash upload`",
        5 => "the value is out of the range that its firmware takes (firmware/PROTOCOL.md): choose another",
        7 => {
            "it restarted and knows nobody: try again, and look at its cable and power if this happens often"
        }
        10 => {
            "the flash recycles, or its ready output is low: wait a moment, and see whether the flash is on"
        }
        11 => {
            "the camera's sync contact is closed, or a measurement runs. If it stays so, take the sync cable off the \
             camera: if the contact opens then, the camera or another flash on it holds it; if not, the cable is shorted"
        }
        12 => "the last pulse was a moment ago: wait, and try again",
        13 => "it no longer remembers that shot: take the frame again",
        _ => {
            "its firmware may be newer than this program: `unlit flash upload` gives it the one that belongs to it"
        }
    }
}

/// How long whoever shoots waits for a flash to recycle.
pub const RECYCLE_PATIENCE: Duration = Duration::from_secs(30);

/// Closes a controller's gate from any thread, past whoever has the controller.
pub type Closer = Arc<dyn Fn() -> Result<(), FlashError> + Send + Sync>;

/// A flash controller between the camera's sync contact and the flash.
pub trait Flash: Send {
    /// How it stands.
    fn status(&mut self) -> FlashStatus;

    /// Lets exactly the next sync through, once, if it comes within `time_to_live`. Of a flash that recycles it waits
    /// for the last second only; what takes longer is [`FlashError::NotReady`] or [`FlashError::ReadyLow`], and the
    /// caller's to wait for, up to [`RECYCLE_PATIENCE`].
    fn arm(&mut self, tag: u32, time_to_live: Duration) -> Result<(), FlashError>;

    /// Closes the gate. Dark frames are shot with the gate closed.
    fn disarm(&mut self) -> Result<(), FlashError>;

    /// What closes the gate while somebody else has the controller; `None` where nothing can.
    fn closer(&self) -> Option<Closer> {
        None
    }

    /// The syncs seen since the last call, waiting up to `patience` for the first.
    fn syncs(&mut self, patience: Duration) -> Result<Vec<FlashSync>, FlashError>;
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_refusal_says_what_to_do_about_it() {
        let words = |code| {
            let (request, word) = ("arm tag=1 ttl=15000".to_owned(), "busy".to_owned());
            FlashError::Refused { request, code, word }.to_string()
        };
        assert!(
            words(11).contains("refused arm tag=1 ttl=15000: busy (error 11); the camera's sync contact")
        );
        assert!(words(11).contains("take the sync cable off"));
        for (code, part) in
            [(1, "cable"), (4, "unlit flash upload"), (5, "range"), (7, "restarted"), (10, "wait")]
        {
            assert!(words(code).contains(part), "{}", words(code));
        }
    }
}
