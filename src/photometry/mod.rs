//! Pure photometry: what a raw sensor value means, and what of it is the flash's own light.

pub mod inspect;
mod mosaic;

pub use mosaic::{Cfa, LevelSource, Levels, Mosaic};
