//! Fits from calibration shots. Plain inputs, no files.

pub mod colour;
mod flash;
mod record;

pub use flash::{CardResidual, CardShot, FieldFactor, FlashCalibration, FlashFitError, fit_flash};
pub use record::{OtherRig, Record, Rig, SCHEMA, Shot, Verdict};
