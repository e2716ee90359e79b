//! What the figures mean, for people.

use super::linearity::Linearity;
use super::{IsoNoise, NoiseFit};
use crate::calibration::Verdict;
use crate::calibration::rounding::COARSE;

/// Largest half width of the gain's interval, relative, of a good calibration.
const SURE: f64 = 0.05;
/// Largest share of left-out tiles, and largest scatter, of a good calibration.
const MOST_REJECTED: f64 = 0.2;
const MOST_SCATTER: f64 = 1.5;
/// Standard errors from which a difference between colours, or to the dark frames, is told.
const APART: f64 = 4.0;

impl NoiseFit {
    /// What to make of it.
    pub fn verdict(&self) -> Verdict {
        let good = !self.noise.is_empty() && self.noise.iter().all(IsoNoise::is_good);
        Verdict { good, sentences: self.noise.iter().flat_map(IsoNoise::words).collect() }
    }
}

impl IsoNoise {
    fn is_good(&self) -> bool {
        let [low, high] = self.electrons_per_dn_interval_95;
        high - low <= 2.0 * SURE * self.electrons_per_dn
            && self.chi_squared <= MOST_SCATTER
            && self.rejected_share <= MOST_REJECTED
    }

    fn words(&self) -> Vec<String> {
        let [low, high] = self.electrons_per_dn_interval_95;
        let read = match (self.read_noise_e, self.read_noise_e_interval_95) {
            (Some(value), Some([low, high])) => {
                format!("read noise is {value:.2} electrons (95 %: {low:.2} to {high:.2})")
            }
            _ => match self.read_noise_below_e {
                Some(bound) => {
                    format!("read noise is below {bound:.2} electrons: rounding to whole DN hides it")
                }
                None => "read noise was not told".to_owned(),
            },
        };
        let mut words = vec![format!(
            "At {} one DN is {:.4} electrons (95 %: {low:.4} to {high:.4}) and {read}; 1/12 DN^2 of rounding is taken off.",
            self.iso, self.electrons_per_dn
        )];
        match (&self.linearity, &self.linearity_not_measured) {
            (Some(linearity), _) => words.push(linearity_words(linearity)),
            (None, Some(why)) => words.push(format!("LINEARITY WAS NOT MEASURED: {why}.")),
            (None, None) => {}
        }
        if !self.is_good() {
            words.push(format!(
                "Do not rely on it: the gain is known to {:.1} %, tiles scatter {:.2} times as they should, {:.0} % of them were left out; shoot more pairs, of an even surface in steady light.",
                50.0 * (high - low) / self.electrons_per_dn,
                self.chi_squared,
                100.0 * self.rejected_share
            ));
        }
        if self.dark_pairs == 0 {
            words.push("Read noise is from the line's intercept: dark frames (--dark) make it surer.".into());
        }
        if self.read_noise_dn.is_some_and(|dn| dn < COARSE) {
            words.push(format!(
                "Read noise is below {COARSE} DN, so that rounding to whole DN may shift it; its interval holds that."
            ));
        }
        if self.colours_apart_in_errors > APART {
            words.push(
                "The colours differ in gain by more than chance; their mean is used for variances.".into(),
            );
        }
        if self.dark_apart_in_errors.is_some_and(|errors| errors > APART) {
            words.push(
                "Dark frames are noisier or quieter than the lit frames' line says at no signal: is it the same ISO and temperature, and the cap tight?".into(),
            );
        }
        words
    }
}

fn linearity_words(linearity: &Linearity) -> String {
    let [from, to] = linearity.range_dn;
    let knee = match linearity.knee_dn {
        Some(dn) => format!("from {dn:.0} DN on it bends by more than 1 %"),
        None => format!("no knee up to {:.0} DN", linearity.checked_to_dn),
    };
    let missing = match linearity.missing_levels {
        0 => String::new(),
        n => format!(" ({n} levels are missing from the ladder)"),
    };
    format!(
        "From {from:.0} to {to:.0} DN above black the linearity error is {:.3} %, the largest deviation {:+.3} %; {knee}{missing}.",
        100.0 * linearity.linearity_error,
        100.0 * linearity.largest_deviation
    )
}
