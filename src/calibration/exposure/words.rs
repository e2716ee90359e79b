//! What to make of a measured table, in words.

use super::{ExposureCalibration, Ladder};
use crate::calibration::Verdict;

/// Widest half of a 95 % interval of a table that processing should use.
const WIDEST: f64 = 0.02;
/// Share of step 00's light from which on a wrong black is told of.
const BLACK: f64 = 0.001;
/// Standard errors from which on it is told of.
const SURE: f64 = 3.0;

impl ExposureCalibration {
    /// Whether the table can be relied on; `left_out` is the number of shots that are not in it.
    pub fn verdict(&self, left_out: usize) -> Verdict {
        let (mut sentences, mut doubts) = (vec![], vec![]);
        let widest = self.ladders.iter().map(half_width).fold(0.0, f64::max);
        let mut good = widest <= WIDEST;
        for ladder in &self.ladders {
            let name = ladder.setting.name();
            let worst = ladder.steps.iter().max_by(|a, b| a.deviation.abs().total_cmp(&b.deviation.abs()));
            let Some(worst) = worst else { continue };
            sentences.push(format!(
                "The {} measured {name} steps are off the ideal by {:.2} % at most ({}: {:+.2} %), known to \u{b1}{:.2} %.",
                ladder.steps.len(),
                100.0 * worst.deviation.abs(),
                ladder.setting.words(worst.label),
                100.0 * worst.deviation,
                100.0 * half_width(ladder),
            ));
            if let (Some(black), Some(light)) = (ladder.black_offset_dn, ladder.light_00_dn) {
                let share = black.value.abs() / light;
                if share > BLACK && black.value.abs() > SURE * black.standard_error {
                    good = false;
                    doubts.push(format!(
                        "The black level seems to be {:.2} DN off in the {name} ladder, {:.1} % of the light of its darkest step: its deviations are wrong by as much. Take more light, or a body whose black the file tells.",
                        black.value,
                        100.0 * share,
                    ));
                }
            }
            if let Some(part) = ladder.steps.iter().map(|s| s.used).min_by(f64::total_cmp).filter(|u| *u < 1.0) {
                doubts.push(format!(
                    "Part of the frame is over-exposed in the {name} ladder's bright steps; {:.0} % of it was measured at least.",
                    100.0 * part
                ));
            }
        }
        if widest > WIDEST {
            doubts.push(format!(
                "The steps are known to \u{b1}{:.1} % only: too little light. Shoot with the brightest step just below over-exposure.",
                100.0 * widest
            ));
        }
        if left_out > 0 {
            doubts.push(format!("{left_out} shots were left out; each says why."));
        }
        if self.ladders.iter().all(|l| l.repeatability.is_none()) {
            doubts.push(
                "Every step was shot once: what shutter, diaphragm and lamp vary from shot to shot is not in the intervals."
                    .into(),
            );
        }
        sentences.extend(doubts);
        Verdict { good, sentences }
    }
}

fn half_width(ladder: &Ladder) -> f64 {
    ladder.steps.iter().map(|s| (s.deviation_95[1] - s.deviation_95[0]) / 2.0).fold(0.0, f64::max)
}
