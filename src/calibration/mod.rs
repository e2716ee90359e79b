//! Fits from calibration shots. Plain inputs, no files.

mod flash;

pub use flash::{CardResidual, CardShot, FieldFactor, FlashCalibration, FlashFitError, fit_flash};
