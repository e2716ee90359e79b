//! Fits from calibration shots. Plain inputs, no files.

mod flash;
pub mod levels;
pub mod noise;
mod record;

pub use flash::{CardResidual, CardShot, FieldFactor, FlashCalibration, FlashFitError, fit_flash};
pub use levels::LevelsFit;
pub use noise::NoiseFit;
pub use record::{OtherRig, Record, Rig, SCHEMA, Shot, Verdict};
