//! What to make of an exposure table, in words.

use super::{ExposureFit, Setting};
use crate::calibration::Verdict;

/// Shift by 1 DN of black that is worth a word, relative.
const BLACK: f64 = 0.003;
/// Pattern over the frame that is worth a word, relative.
const PATTERN: f64 = 0.005;

/// Whether the table can be relied on (any of its ladders; others are not used), and what is odd about it.
/// `black_known`: whether black is measured, by dark frames or masked pixels, and not taken from a tag or a table.
pub fn verdict(fit: &ExposureFit, black_known: bool) -> Verdict {
    let mut sentences = vec![];
    let good = fit.ladders.iter().any(|ladder| ladder.not_used.is_none());
    for ladder in &fit.ladders {
        let name = ladder.setting.name();
        let worst = ladder.steps.iter().max_by(|a, b| a.deviation.abs().total_cmp(&b.deviation.abs()));
        let Some(worst) = worst else { continue };
        let label = ladder.setting.words(worst.label);
        let deviation = 100.0 * worst.deviation;
        match &ladder.not_used {
            Some(why) => sentences.push(format!("{name}: {why}. THIS LADDER IS NOT USED.")),
            None => sentences.push(format!(
                "{name}: {} steps measured, the worst ({label}) is {deviation:+.2} % off the ideal.",
                ladder.steps.len()
            )),
        }
        let pattern = ladder.steps.iter().map(|step| step.pattern_sd).fold(0.0, f64::max);
        if pattern > PATTERN {
            let why = match ladder.setting {
                Setting::Aperture => "the lens's vignetting moves with the aperture",
                Setting::Iso | Setting::Shutter => "the light moved, or the shutter's curtains run unevenly",
            };
            sentences.push(format!(
                "{name}: the light's pattern over the frame changes by up to {:.1} % between steps ({why}); the factors \
                 are those of the whole frame.",
                100.0 * pattern
            ));
        }
        let hidden = ladder.steps.iter().filter(|step| step.frame_share < 0.999).count();
        if hidden > 0 {
            sentences.push(format!(
                "{name}: {hidden} steps are over-exposed in part and were measured on the rest of the frame."
            ));
        }
    }
    let none = fit.not_measured.iter();
    sentences.extend(
        none.map(|none| format!("{}: A LADDER WAS NOT MEASURED: {}.", none.setting.name(), none.why)),
    );
    let darkest = fit.ladders.iter().map(|ladder| ladder.step_00_dn).fold(f64::INFINITY, f64::min);
    if !black_known && 1.0 / darkest > BLACK {
        sentences.push(format!(
            "Black is not measured, and the darkest step lies but {darkest:.0} DN above it: 1 DN of error would shift \
             deviations by {:.2} %; shoot dark frames first (`unlit calibrate levels`), or take more light.",
            100.0 / darkest
        ));
    }
    if fit.ladders.iter().any(|ladder| ladder.repeat_sd.is_none()) {
        sentences.push(
            "Where no label was shot twice, the intervals tell the sensor's noise alone, not how well shutter, diaphragm \
             and lamp repeat; shoot every step twice to have that too."
                .to_owned(),
        );
    }
    Verdict { good, sentences }
}
