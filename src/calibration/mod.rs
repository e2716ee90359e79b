//! Fits from calibration shots. Plain inputs, no files.

pub mod colour;
pub mod exposure;
mod flash;
pub mod flat;
mod linear;
mod record;
pub mod tiles;

pub use flash::{CardResidual, CardShot, FieldFactor, FlashCalibration, FlashFitError, fit_flash};
pub use record::{OtherRig, Record, Rig, SCHEMA, Shot, Verdict};
