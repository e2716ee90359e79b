//! Pure photometry: what a raw sensor value means, and what of it is the flash's own light.

pub mod apex;
mod demosaic;
mod gain;
pub mod inspect;
mod isolate;
pub mod levels;
mod mosaic;
mod noise;
pub mod preview;
pub mod saturation;

pub use demosaic::{Known, demosaic};
pub use gain::FlashGain;
pub(crate) use isolate::linear;
pub use isolate::{IsolateError, KnownMosaic, RoomLight, isolate, isolate_dark, isolate_mean};
pub use mosaic::{Cfa, LevelSource, Levels, Mosaic};
pub use noise::{NoNoise, NoiseGauge, NoiseModel};
