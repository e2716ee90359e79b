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
pub(crate) mod statistics;
mod steadiness;
pub mod tags;
pub mod tiles;

pub use flash::{
    CardResidual, CardShot, Cell, Correction, FieldFactor, FlashCalibration, FlashFacts, FlashFindings,
    FlashFitError, FlatSource, Plane, Target, Vignetting, correct_flash, fit_flash,
};
pub use histogram::Steps;
pub use levels::LevelsFit;
pub use noise::NoiseFit;
pub use record::{NotMeasured, OtherRig, Record, Rig, SCHEMA, Shot, Verdict};
pub(crate) use steadiness::FEWEST_SHOTS;
pub use steadiness::{Steadiness, SteadyError, SteadyShot, steadiness};

/// Whether a value lies in an interval, given by its ends.
pub fn holds([low, high]: [f64; 2], value: f64) -> bool {
    (low..=high).contains(&value)
}
