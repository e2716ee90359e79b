//! The checks' parts one by one, so that a benchmark can tell what each costs. Nothing else needs them.

use super::motion;
use super::stop::Stop;
use super::survey::{self, Survey};
use crate::photometry::Mosaic;
use crate::photometry::inspect::Region;

/// What one walk over both frames found.
pub struct Surveyed {
    survey: Survey,
    black: [f32; 2],
}

/// Walks over both frames, which must be of one size.
pub fn survey(off: &Mosaic, on: &Mosaic) -> Surveyed {
    let whole = Region { x: 0, y: 0, width: off.dn.width(), height: off.dn.height() };
    let black = [off, on].map(|m| m.levels.black.concat().into_iter().sum::<f32>() / 4.0);
    Surveyed { survey: survey::survey(off, on, 1.0, whole), black }
}

impl Surveyed {
    /// Displacement of the lit frame in sites (right, down), where it can be told.
    pub fn movement(&self) -> Option<(f64, f64)> {
        let [off, on] = &self.survey.cells;
        motion::shift(off, on)
    }

    /// The stop's signature.
    pub fn stop(&self) -> Option<Stop> {
        Stop::new(&self.survey.cells, self.black, 1.0, None)
    }
}
