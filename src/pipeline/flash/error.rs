//! What can go wrong with a flash calibration.

use crate::calibration::{FlashFitError, OtherRig};
use crate::codec::raw::RawError;
use crate::light::RingError;
use crate::photometry::{IsolateError, NoNoise};
use crate::pipeline::calibrate::{RecordError, SeriesError};
use crate::pipeline::card_tags::CardTagError;
use crate::pipeline::develop::DevelopError;
use crate::progress::Cancelled;
use crate::session::SessionError;
use std::path::PathBuf;

/// Why the flash could not be calibrated, or its calibration not be read.
#[derive(Debug, thiserror::Error)]
pub enum FlashError {
    /// None yet.
    #[error("the session {} has no flash calibration; shoot a white card and run `unlit calibrate flash`", .0.display())]
    None(PathBuf),
    /// No shot was given.
    #[error("no card shot was given: --shots takes DISTANCE_IN_METRES=FILE, for example 0.8=card80.cr2")]
    NoShots,
    /// The card's pixels cannot be turned into directions.
    #[error(
        "the lens's focal length is not known: import the scene first (`unlit import scene`), or give --focal-px (focal length in mm times image width in pixels over sensor width in mm)"
    )]
    NoLens,
    /// Nothing says where the card stood.
    #[error("{0}: give its distance (DISTANCE_IN_METRES=FILE), or --tag-size if AprilTags are on the card")]
    NoDistance(String),
    /// The tags do not say it.
    #[error("{label}: {source}; or give the distance: DISTANCE_IN_METRES=FILE")]
    Tags {
        /// File.
        label: String,
        /// What is wrong.
        source: CardTagError,
    },
    /// Settings differ between shots.
    #[error(
        "{label} was shot at other settings ({setting}) than the first shot: all card shots need one ISO, aperture and focal length"
    )]
    Settings {
        /// File.
        label: String,
        /// Which.
        setting: &'static str,
    },
    /// A shot cannot be decoded.
    #[error(transparent)]
    Raw(#[from] RawError),
    /// The frames of a shot do not fit together.
    #[error("{label}: {source}")]
    Isolate {
        /// File.
        label: String,
        /// What is wrong.
        source: IsolateError,
    },
    /// Noise could not be measured.
    #[error(transparent)]
    Noise(#[from] NoNoise),
    /// The ring's radii are impossible.
    #[error(transparent)]
    Ring(#[from] RingError),
    /// The fit failed.
    #[error(transparent)]
    Fit(#[from] FlashFitError),
    /// The file system refused.
    #[error("cannot access {}: {source}", path.display())]
    Io {
        /// File or folder.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// A calibration of the session cannot be read.
    #[error(transparent)]
    Record(#[from] RecordError),
    /// The session refused.
    #[error(transparent)]
    Session(#[from] SessionError),
    /// The shots do not make a series, or `flash.json` is broken.
    #[error(transparent)]
    Series(SeriesError),
    /// A pair, or a shot that is to correct the calibration, of another rig than the calibration's.
    #[error(
        "{name} does not fit the flash calibration: {source}; calibrate the flash with the rig and the settings that took the photographs"
    )]
    OtherRig {
        /// The pair or the shot.
        name: String,
        /// What differs.
        source: OtherRig,
    },
    /// A pair at another power of the flash, whose energy was not measured.
    #[error(
        "{name} was lit by the flash at {found} of its full power, but the flash was calibrated at {expected}, and its energy was not measured in both: shoot a card at {found} and run `unlit calibrate flash --one-shot`, or shoot with a flash controller that measures energies"
    )]
    OtherPower {
        /// The pair.
        name: String,
        /// Part of full power.
        found: f64,
        /// Part of full power.
        expected: f64,
    },
    /// Light cannot be brought from one exposure to another.
    #[error(transparent)]
    Develop(#[from] DevelopError),
    /// The correction takes one shot.
    #[error("{0} card shots were given, but --one-shot takes exactly one")]
    NotOne(usize),
    /// Stopped on request.
    #[error(transparent)]
    Cancelled(#[from] Cancelled),
}

impl From<SeriesError> for FlashError {
    fn from(error: SeriesError) -> Self {
        match error {
            SeriesError::Cancelled(cancelled) => Self::Cancelled(cancelled),
            SeriesError::Raw(raw) => Self::Raw(raw),
            SeriesError::Record(record) => Self::Record(record),
            SeriesError::Session(session) => Self::Session(session),
            other => Self::Series(other),
        }
    }
}
