//! Why a pair was not stored, for people in words and for scripts in codes.

use super::bench::NO_FLASH;
use super::place::PlaceError;
use crate::calibration::SteadyError;
use crate::codec::raw::RawError;
use crate::pair::finding::FindingError;
use crate::photometry::{IsolateError, NoNoise};
use crate::pipeline::calibrate::waiting::WaitingError;
use crate::pipeline::calibrate::{RecordError, SeriesError};
use crate::pipeline::scale::RatioError;
use crate::pipeline::stops::EarlierError;
use crate::progress::Cancelled;
use crate::rig::{CameraError, FlashError};
use crate::session::SessionError;

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
    /// A setting of the camera would spoil every pair, and cannot be set from here.
    #[error("the camera is not ready for pairs: {0}")]
    NotLocked(String),
    /// The camera took a setting and did not obey.
    #[error(
        "the camera was set to {wanted} and says {found}; turn its mode dial to M, and check that no dial or button is held"
    )]
    ExposureNotSet {
        /// What was asked.
        wanted: String,
        /// What it says now.
        found: String,
    },
    /// The camera does not tell its exposure, so that none can be found.
    #[error(
        "the camera does not tell shutter, aperture and sensitivity: turn its mode dial to M and set none of them to automatic"
    )]
    ExposureUntold,
    /// No exposure reaches what was wished.
    #[error(transparent)]
    Finding(#[from] FindingError),
    /// A test shot cannot be decoded.
    #[error("the test shot cannot be used: {0}")]
    TestShot(RawError),
    /// The flash did not do in a test shot what it should.
    #[error(
        "the flash {} in a test shot; check its cable, charge and switch, and that nothing else triggers it",
        if *expected { "did not fire once" } else { "fired although it should not" }
    )]
    TestShotMisfired {
        /// Whether it should have fired.
        expected: bool,
    },
    /// The flash did not light a calibration frame once.
    #[error("the flash did not fire once for this frame; check its cable, charge and switch")]
    FrameMisfired,
    /// A calibration frame could not be kept.
    #[error("the calibration frame could not be kept: {0}")]
    Waiting(WaitingError),
    /// A series that is divided by measured energies, with a flash that nobody measures.
    #[error(
        "how steady the flash is can only be measured with a flash controller, whose photodiode measures every pulse; connect one and leave `--flash manual` out"
    )]
    NeedsController,
    /// A shot of a series that fails however often it is taken.
    #[error("shot {shot} of the series failed {times} times in a row: {why}")]
    SeriesBroken {
        /// Number of the shot.
        shot: u32,
        /// How often it was tried.
        times: u32,
        /// What was the matter last, and what to do.
        why: String,
    },
    /// A series of frames that clip.
    #[error(
        "shot {shot} of the series clips: a colour has no unclipped site in the region, or the light rose by far since the first shot; close the aperture or lower flash power and sensitivity"
    )]
    SeriesClipped {
        /// Number of the shot.
        shot: u32,
    },
    /// The frames of a series show no even surface.
    #[error(transparent)]
    SeriesNoise(#[from] NoNoise),
    /// The frames of a series do not fit together.
    #[error(transparent)]
    SeriesFrames(#[from] IsolateError),
    /// The figures of a series say nothing.
    #[error(transparent)]
    Series(#[from] SteadyError),
    /// A calibration of the session cannot be read.
    #[error(transparent)]
    Levels(RecordError),
    /// The session's exposure table is another body's.
    #[error(transparent)]
    Ratio(#[from] RatioError),
    /// The series is kept, but not the report that tells of it.
    #[error("the series is kept, but the calibration report could not be written: {0}")]
    Report(SeriesError),
    /// The system gave no thread.
    #[error("the frame could not be checked: no thread to be had ({0}); close other programs")]
    NoThread(std::io::Error),
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
            CaptureError::Flash(FlashError::Firmware { .. }) => "flash_firmware",
            CaptureError::Flash(FlashError::Silent { .. }) => "flash_silent",
            CaptureError::Flash(FlashError::Refused { .. }) => "flash_refused",
            CaptureError::Flash(FlashError::NotReady { .. } | FlashError::ReadyLow) => "flash_not_ready",
            CaptureError::Flash(FlashError::Lost { .. }) => "flash_lost",
            CaptureError::NoFlash => "flash_missing",
            CaptureError::NotLocked(_) => "camera_not_locked",
            CaptureError::ExposureNotSet { .. } => "exposure_not_set",
            CaptureError::ExposureUntold => "exposure_untold",
            CaptureError::Finding(_) => "exposure_not_found",
            CaptureError::TestShot(_) => "frame_unreadable",
            CaptureError::TestShotMisfired { .. } | CaptureError::FrameMisfired => "flash_misfired",
            CaptureError::Waiting(WaitingError::Raw(_)) => "frame_unreadable",
            CaptureError::Waiting(_) => "session_not_written",
            CaptureError::NeedsController => "flash_controller_needed",
            CaptureError::SeriesBroken { .. } => "series_broken",
            CaptureError::SeriesClipped { .. } => "series_clipped",
            CaptureError::SeriesNoise(_) => "series_noise_unmeasured",
            CaptureError::SeriesFrames(_) => "series_frames_differ",
            CaptureError::Series(_) => "series_says_nothing",
            CaptureError::Levels(_) => "levels_unreadable",
            CaptureError::Ratio(_) => "exposure_table_of_another_body",
            CaptureError::Report(_) => "report_not_written",
            CaptureError::NoThread(_) => "no_thread",
            CaptureError::Place(PlaceError::Session(SessionError::NoRoom { .. })) => "disk_full",
            CaptureError::Place(PlaceError::Session(SessionError::NoSuchPair { .. })) => "pair_not_found",
            CaptureError::Place(PlaceError::Session(SessionError::PairAccepted { .. })) => "pair_accepted",
            CaptureError::Place(PlaceError::Order(_)) => "order_invalid",
            CaptureError::Place(_) => "session_not_written",
            CaptureError::Cancelled(_) => "cancelled",
        }
    }
}

impl From<SessionError> for CaptureError {
    fn from(error: SessionError) -> Self {
        CaptureError::Place(error.into())
    }
}

impl From<SeriesError> for CaptureError {
    fn from(error: SeriesError) -> Self {
        match error {
            SeriesError::Session(error) => error.into(),
            SeriesError::Cancelled(cancelled) => cancelled.into(),
            other => Self::Report(other),
        }
    }
}

impl From<EarlierError> for CaptureError {
    fn from(error: EarlierError) -> Self {
        match error {
            EarlierError::Session(error) => error.into(),
            EarlierError::Record(error) => CaptureError::Levels(error),
            EarlierError::Cancelled(cancelled) => cancelled.into(),
        }
    }
}
