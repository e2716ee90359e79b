//! The exposure plan: at which settings both frames of every pair of a session are shot, and what a camera
//! offers to choose from.

use crate::units::{FNumber, Iso, Seconds};
use serde::{Deserialize, Serialize};
use std::fmt;

/// The three settings that scale light into sensor values, as the camera labels them.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Exposure {
    /// Exposure time label.
    pub shutter: Seconds,
    /// Aperture label.
    pub aperture: FNumber,
    /// Sensitivity label.
    pub iso: Iso,
}

impl fmt::Display for Exposure {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}, {}, {}", self.shutter, self.aperture, self.iso)
    }
}

/// Exposures of a session's frames. Equal for both frames unless the operator wished otherwise; then the unlit
/// frame is scaled before it is subtracted.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Plan {
    /// Of the frames without flash.
    pub off: Exposure,
    /// Of the frames with flash.
    pub on: Exposure,
}

/// One dial and where it should stand.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Dial {
    /// Exposure time.
    Shutter(Seconds),
    /// Relative aperture.
    Aperture(FNumber),
    /// Sensitivity.
    Iso(Iso),
}

/// The values that the camera's dials offer now, as labelled.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Offered {
    /// Exposure times (bulb and automatic left out).
    pub shutters: Vec<Seconds>,
    /// F-numbers of the mounted lens.
    pub apertures: Vec<FNumber>,
    /// Sensitivities (automatic left out).
    pub isos: Vec<Iso>,
}
