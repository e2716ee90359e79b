//! The exposure plan: at which settings both frames of every pair of a session are shot, and what a camera
//! offers to choose from.

use crate::photometry::inspect::Region;
use crate::units::{FNumber, Iso, Seconds};
use serde::{Deserialize, Serialize};
use std::fmt;

/// The three settings that scale light into sensor values, as the camera labels them.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Exposure {
    /// Exposure time label.
    pub shutter: Seconds,
    /// Aperture label.
    pub aperture: FNumber,
    /// Sensitivity label.
    pub iso: Iso,
}

impl fmt::Display for Exposure {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}, {}, {}", self.shutter, self.aperture, self.iso)
    }
}

/// Exposures of a session's frames. Equal for both frames unless the operator wished otherwise; then the unlit
/// frame is scaled before it is subtracted.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Plan {
    /// Of the frames without flash.
    pub off: Exposure,
    /// Of the frames with flash.
    pub on: Exposure,
}

impl Plan {
    /// Both exposures in words, once if they are equal.
    pub fn words(&self) -> String {
        if self.off == self.on {
            self.on.to_string()
        } else {
            format!("without flash {}; with flash {}", self.off, self.on)
        }
    }
}

/// X-sync time of bodies whose own is not known.
const USUAL_X_SYNC: Seconds = Seconds(1.0 / 200.0);
/// F-number below which bodies were seen to scale their raw values.
const WIDE: FNumber = FNumber(4.0);

impl Plan {
    /// What the operator should know of these exposures; `x_sync` is the body's, where it is known.
    pub fn warnings(&self, x_sync: Option<Seconds>) -> Vec<String> {
        let mut warnings = Vec::new();
        let fastest = x_sync.unwrap_or(USUAL_X_SYNC);
        // Labels are rounded.
        if self.on.shutter.0 < 0.97 * fastest.0 {
            warnings.push(format!(
                "The shutter at {} is faster than the X-sync time of {fastest}: the flash may light a stripe of the frame only.",
                self.on.shutter
            ));
        }
        let widest = self.on.aperture.0.min(self.off.aperture.0);
        if widest < 0.97 * WIDE.0 {
            warnings.push(format!(
                "The aperture of {} is wider than {WIDE}: some bodies (Canon) then multiply raw values by a factor that they do not tell.",
                FNumber(widest)
            ));
        }
        warnings
    }
}

/// One dial and where it should stand.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Dial {
    /// Exposure time.
    Shutter(Seconds),
    /// Relative aperture.
    Aperture(FNumber),
    /// Sensitivity.
    Iso(Iso),
}

/// The values that the camera's dials offer now, as labelled.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Offered {
    /// Exposure times (bulb and automatic left out).
    pub shutters: Vec<Seconds>,
    /// F-numbers of the mounted lens.
    pub apertures: Vec<FNumber>,
    /// Sensitivities (automatic left out).
    pub isos: Vec<Iso>,
}

/// The region of interest as shares of the frame, so that it can be drawn on a live picture of any size.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Window {
    /// Left edge, 0 to 1 of the frame's width.
    pub x: f64,
    /// Top edge, 0 to 1 of the frame's height.
    pub y: f64,
    /// Width, above 0 to 1 of the frame's.
    pub width: f64,
    /// Height, above 0 to 1 of the frame's.
    pub height: f64,
}

/// A window that does not lie in the frame.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[error(
    "the region {},{} of size {} x {} is not inside the frame; give shares of the frame from 0 to 1, width and height above 0",
    .0.x, .0.y, .0.width, .0.height
)]
pub struct WindowOutside(pub Window);

impl Window {
    /// The window itself, if it lies inside the frame.
    pub fn checked(self) -> Result<Self, WindowOutside> {
        // Drawn by hand on a page, edges may overshoot by a rounding error.
        let fits = |from: f64, size: f64| from >= -1e-6 && size > 0.0 && from + size <= 1.0 + 1e-6;
        if fits(self.x, self.width) && fits(self.y, self.height) {
            Ok(self)
        } else {
            Err(WindowOutside(self))
        }
    }

    /// The sites of a frame of `width` x `height` that it covers, at least two cells of the filter array each way.
    pub fn sites(&self, width: usize, height: usize) -> Region {
        let span = |from: f64, size: f64, whole: usize| {
            let least = 4.min(whole);
            let start = ((from.max(0.0) * whole as f64).floor() as usize).min(whole - least);
            let end = (((from + size) * whole as f64).ceil() as usize).clamp(start + least, whole);
            (start, end - start)
        };
        let ((x, width), (y, height)) = (span(self.x, self.width, width), span(self.y, self.height, height));
        Region { x, y, width, height }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_window_covers_its_share_of_any_frame_and_never_leaves_it() {
        let half = Window { x: 0.25, y: 0.5, width: 0.5, height: 0.5 };
        assert_eq!(half.sites(600, 400), Region { x: 150, y: 200, width: 300, height: 200 });
        let sliver = Window { x: 1.0 - 1e-9, y: 0.0, width: 1e-9, height: 1e-9 };
        assert_eq!(sliver.checked(), Ok(sliver));
        assert_eq!(sliver.sites(600, 400), Region { x: 596, y: 0, width: 4, height: 4 });
    }

    #[test]
    fn a_window_outside_the_frame_is_refused() {
        for (x, y, width, height) in
            [(0.5, 0.0, 0.6, 1.0), (-0.1, 0.0, 0.5, 0.5), (0.0, 0.0, 0.0, 1.0), (f64::NAN, 0.0, 1.0, 1.0)]
        {
            assert!(Window { x, y, width, height }.checked().is_err());
        }
    }
}
