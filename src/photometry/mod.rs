//! Pure photometry: what a raw sensor value means, and what of it is the flash's own light.

mod demosaic;
mod isolate;
pub mod inspect;
mod mosaic;
mod noise;

pub use demosaic::{Known, demosaic};
pub use isolate::{IsolateError, KnownMosaic, isolate, isolate_dark};
pub use mosaic::{Cfa, LevelSource, Levels, Mosaic};
pub use noise::NoiseModel;
