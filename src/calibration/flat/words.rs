//! What to make of a flat field, in words.

use super::FlatCalibration;
use crate::calibration::{Verdict, holds};

/// Slope of the light from the centre to an edge from which on it was not even.
const UNEVEN: f64 = 0.01;
/// Relative residual of a part of the frame from which on it is told of, and the standard errors that it must have.
const SPOT: (f64, f64) = (0.003, 5.0);
/// Widest half of the corner's 95 % interval of a flat field that processing should use.
const WIDEST: f64 = 0.01;
/// Largest residual of any part of the frame for that.
const WORST: f64 = 0.02;

impl FlatCalibration {
    /// Whether the flat field can be relied on; `left_out` is the number of frames that are not in it.
    pub fn verdict(&self, left_out: usize) -> Verdict {
        let [_, green, _] = self.corner;
        let widest = self.corner_interval_95.into_iter().map(half).fold(0.0, f64::max);
        let curves =
            if self.per_channel { "each colour has its own curve" } else { "one curve for all colours" };
        let mut good = widest <= WIDEST;
        let mut sentences = vec![format!(
            "The corner has {:.2} % of the centre's light, known to \u{b1}{:.2} % ({} frames, {curves}).",
            100.0 * green,
            100.0 * half(self.corner_interval_95[1]),
            self.frames,
        )];
        if widest > WIDEST {
            sentences.push("That is too little to rely on: give more or brighter frames.".into());
        }
        let slopes = self.light_gradient.into_iter().zip(self.light_gradient_interval_95);
        for ((slope, interval), [less, more]) in slopes.zip([["left", "right"], ["top", "bottom"]]) {
            if !holds(interval, 0.0) && slope.abs() > UNEVEN {
                good = false;
                let side = if slope > 0.0 { more } else { less };
                sentences.push(format!(
                    "The light was not even: it grows by {:.1} % from the centre to the {side}. The slope was taken out, but what is bent of it was not; light the surface from farther away, or turn the camera by 180 degrees between frames.",
                    100.0 * slope.abs()
                ));
            }
        }
        if let Some((row, column, worst)) = self.worst() {
            if worst.abs() > SPOT.0 && worst.abs() > SPOT.1 * self.residual_map_standard_error {
                let (rows, columns) =
                    (self.residual_map.len(), self.residual_map.first().map_or(0, Vec::len));
                sentences.push(format!(
                    "Part {} of {columns} from the left, {} of {rows} from the top is off the curve by {:+.2} %: dust, uneven light, or a surface that is not plain.",
                    column + 1,
                    row + 1,
                    100.0 * worst
                ));
            }
            good &= worst.abs() <= WORST.max(SPOT.1 * self.residual_map_standard_error);
        }
        if self.aperture.is_none() || self.focal_length_mm.is_none() {
            sentences.push(
                "The files do not tell aperture and focal length both: see to it that the photographs have those of these frames."
                    .into(),
            );
        }
        if left_out > 0 {
            sentences.push(format!("{left_out} frames were left out; each says why."));
        }
        Verdict { good, sentences }
    }

    /// Row, column and value of the part of the frame that is farthest off.
    fn worst(&self) -> Option<(usize, usize, f64)> {
        let parts = self.residual_map.iter().enumerate();
        let parts =
            parts.flat_map(|(r, row)| row.iter().enumerate().filter_map(move |(c, v)| Some((r, c, (*v)?))));
        parts.max_by(|a, b| a.2.abs().total_cmp(&b.2.abs()))
    }
}

fn half([low, high]: [f64; 2]) -> f64 {
    (high - low) / 2.0
}
