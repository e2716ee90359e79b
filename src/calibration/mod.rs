//! Fits from calibration shots. Plain inputs, no files.

pub mod exposure;
pub mod flat;
mod flash;
mod linear;
mod record;
pub mod tiles;

pub use flash::{CardResidual, CardShot, FieldFactor, FlashCalibration, FlashFitError, fit_flash};
pub use record::{OtherRig, Record, Rig, SCHEMA, Shot, Verdict};
