//! Fits from calibration shots. Plain inputs, no files.

pub mod certificate;
pub mod colour;
pub mod exposure;
mod flash;
pub mod flat;
pub mod guide;
mod histogram;
pub mod levels;
mod linear;
pub mod noise;
mod record;
mod rounding;
mod steadiness;
pub mod tags;
pub mod tiles;

pub use flash::{
    CardResidual, CardShot, Cell, Correction, FieldFactor, FlashCalibration, FlashFacts, FlashFindings,
    FlashFitError, FlatSource, Interval, Plane, Target, Vignetting, correct_flash, fit_flash,
};
pub use histogram::Steps;
pub use levels::LevelsFit;
pub use noise::NoiseFit;
pub use record::{NotMeasured, OtherRig, Record, Rig, SCHEMA, Shot, Verdict};
pub use steadiness::{Steadiness, SteadyError, SteadyShot, steadiness};
