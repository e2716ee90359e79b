//! What can go wrong with a calibration's shots and records.

use crate::calibration::{OtherRig, SCHEMA};
use crate::codec::raw::RawError;
use crate::progress::Cancelled;
use crate::session::{SessionError, advice};
use std::path::PathBuf;

/// Why a calibration's shots could not be read, or the calibration not be kept or read again.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum SeriesError {
    /// The disk refused.
    #[error("{}: {source}; {}", path.display(), advice(source))]
    Io {
        /// File or folder.
        path: PathBuf,
        /// The system's own word.
        source: std::io::Error,
    },
    /// A shot cannot be decoded.
    #[error(transparent)]
    Raw(#[from] RawError),
    /// A shot of another rig.
    #[error("{} is not of the same rig as the others: {source}; calibrate each rig by itself", path.display())]
    OtherRig {
        /// The shot.
        path: PathBuf,
        /// What differs.
        source: OtherRig,
    },
    /// A shot was given twice.
    #[error("{} and {} are the same photograph; give each once", path.display(), other.display())]
    Twice {
        /// The shot.
        path: PathBuf,
        /// The one given before.
        other: PathBuf,
    },
    /// A shot changed while it was used.
    #[error("{} changed while it was read; try again when nothing writes it any more", .0.display())]
    Changed(PathBuf),
    /// A calibration's record cannot be read or written.
    #[error(transparent)]
    Record(#[from] RecordError),
    /// The session refused.
    #[error(transparent)]
    Session(#[from] SessionError),
    /// Stopped on request.
    #[error(transparent)]
    Cancelled(#[from] Cancelled),
}

/// Why a calibration that was made could not be read.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum RecordError {
    /// The disk refused.
    #[error("{}: {source}; {}", path.display(), advice(source))]
    Io {
        /// The file.
        path: PathBuf,
        /// The system's own word.
        source: std::io::Error,
    },
    /// A calibration's file is broken.
    #[error("{} is damaged ({reason}); calibrate again", path.display())]
    Damaged {
        /// The file.
        path: PathBuf,
        /// What is wrong with it.
        reason: String,
    },
    /// A calibration of another rig than the photographs.
    #[error("{} is not of the camera that took the photos: {source}; calibrate again with that camera, or begin another session for it", path.display())]
    OtherRig {
        /// The file.
        path: PathBuf,
        /// What differs.
        source: OtherRig,
    },
    /// A calibration of an earlier program.
    #[error("{} was written by an earlier version of unlit, in a form that is not read any more; calibrate again (the file is kept)", .0.display())]
    Older(PathBuf),
    /// A calibration of a later program.
    #[error("{} was written by a later version of unlit (form {found}, this program knows {SCHEMA}); update unlit", path.display())]
    TooNew {
        /// The file.
        path: PathBuf,
        /// Its form.
        found: u32,
    },
}
