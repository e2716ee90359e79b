//! Fits from calibration shots. Plain inputs, no files.

mod flash;
mod record;
mod steadiness;

pub use flash::{
    CardResidual, CardShot, Cell, FieldFactor, FlashCalibration, FlashFacts, FlashFindings, FlashFitError,
    Interval, Plane, Target, fit_flash,
};
pub use record::{OtherRig, Record, Rig, SCHEMA, Shot, Verdict};
pub use steadiness::{Steadiness, SteadyError, SteadyShot, steadiness};
