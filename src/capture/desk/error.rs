//! Why a wish was not taken, and how a job's errors become the queue's.

use super::sessions::NAME_LIMIT;
use crate::calibration::guide::Kind;
use crate::capture::error::CaptureError;
use crate::capture::place::PlaceError;
use crate::capture::sequence::SequenceError;
use crate::capture::thumbnail::ThumbnailError;
use crate::jobs::{JobsError, WorkError};
use crate::pair::WindowOutside;
use crate::pair::order::Slot;
use crate::pipeline::calibrate::RecordError;
use crate::pipeline::calibrate::waiting::WaitingError;
use crate::pipeline::energy::EnergyError;
use crate::progress::Cancelled;
use crate::session::SessionError;

/// Why a wish was not taken.
#[derive(Debug, thiserror::Error)]
pub enum DeskError {
    /// The name cannot be a folder's.
    #[error(
        "{0:?} cannot name a session: use 1 to {NAME_LIMIT} characters, no / or \\, not beginning with a dot"
    )]
    BadName(String),
    /// No such session.
    #[error("there is no session {0:?}; make it first")]
    NoSuchSession(String),
    /// No such pair.
    #[error("session {session:?} has no pair {number}")]
    NoSuchPair {
        /// The session.
        session: String,
        /// The pair.
        number: u32,
    },
    /// No such file.
    #[error("session {session:?} has no file {id:?}; its files are listed at /api/v1/sessions/NAME/files")]
    NoSuchFile {
        /// The session.
        session: String,
        /// What was asked for.
        id: String,
    },
    /// No such frame.
    #[error("pair {number} has no frame {slot}; its order has no place for it")]
    NoSuchFrame {
        /// The pair.
        number: u32,
        /// The frame.
        slot: Slot,
    },
    /// Something to process is missing.
    #[error("session {session:?} cannot be processed yet: it has no {missing}")]
    NotReady {
        /// The session.
        session: String,
        /// What is missing, in words.
        missing: String,
    },
    /// Nothing was measured.
    #[error("session {session:?} has no calibration of {}; shoot and fit it first", kind.name())]
    NotMeasured {
        /// The session.
        session: String,
        /// What was asked for.
        kind: Kind,
    },
    /// A shot that a record comes from.
    #[error(
        "the calibration comes from shot {0}, which is kept; calibrate again without it (held_out) if it is wrong"
    )]
    ShotInRecord(String),
    /// Shots that wait for their calibration.
    #[error(transparent)]
    Waiting(#[from] WaitingError),
    /// A calibration's record.
    #[error(transparent)]
    Record(#[from] RecordError),
    /// A region outside the frame.
    #[error(transparent)]
    Window(#[from] WindowOutside),
    /// The camera or the flash.
    #[error(transparent)]
    Capture(#[from] CaptureError),
    /// A value out of its range.
    #[error("{0}")]
    BadValue(String),
    /// The session folder.
    #[error(transparent)]
    Session(#[from] SessionError),
    /// The disk.
    #[error(transparent)]
    Place(#[from] PlaceError),
    /// The session's flash.
    #[error(transparent)]
    Energy(#[from] EnergyError),
    /// The sequence.
    #[error(transparent)]
    Sequence(SequenceError),
    /// The queue.
    #[error(transparent)]
    Jobs(#[from] JobsError),
    /// A thumbnail could not be made.
    #[error(transparent)]
    Thumbnail(#[from] ThumbnailError),
}

impl From<SequenceError> for DeskError {
    fn from(error: SequenceError) -> Self {
        match error {
            SequenceError::Session(error) => DeskError::Session(error),
            other => DeskError::Sequence(other),
        }
    }
}

/// Brings the domains' errors under the queue's.
pub(super) struct JobError(pub(super) WorkError);

impl From<WorkError> for JobError {
    fn from(error: WorkError) -> Self {
        JobError(error)
    }
}

impl From<CaptureError> for JobError {
    fn from(error: CaptureError) -> Self {
        JobError(match error {
            CaptureError::Cancelled(Cancelled) => WorkError::Cancelled,
            other => WorkError::failed(other.code(), other),
        })
    }
}
