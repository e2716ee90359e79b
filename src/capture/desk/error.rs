//! Why a wish was not taken, and how a job's errors become the queue's.

use super::NAME_LIMIT;
use crate::capture::error::CaptureError;
use crate::capture::place::PlaceError;
use crate::capture::thumbnail::ThumbnailError;
use crate::jobs::{JobsError, WorkError};
use crate::pair::WindowOutside;
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
    /// Something to process is missing.
    #[error("session {session:?} cannot be processed yet: it has no {missing}")]
    NotReady {
        /// The session.
        session: String,
        /// What is missing, in words.
        missing: String,
    },
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
    /// The queue.
    #[error(transparent)]
    Jobs(#[from] JobsError),
    /// A thumbnail could not be made.
    #[error(transparent)]
    Thumbnail(#[from] ThumbnailError),
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
