//! What the figures mean, for people.

use super::figures::APART;
use super::linearity::{self, LABEL, LightSource, Linearity};
use super::{IsoNoise, NoiseFit};
use crate::calibration::Verdict;
use crate::calibration::rounding::COARSE;

/// Largest half width of the gain's interval, relative, of a good calibration.
const SURE: f64 = 0.05;
/// Largest share of left-out tiles, and largest scatter, of a good calibration.
const MOST_REJECTED: f64 = 0.2;
const MOST_SCATTER: f64 = 1.5;
/// Difference of gains between colours that matters, relative: sensors keep to one line to no more.
const COLOURS: f64 = 0.02;

impl NoiseFit {
    /// What to make of it: good if there is an ISO that can be relied on. Those that cannot are not used.
    pub fn verdict(&self) -> Verdict {
        let good = self.noise.iter().any(IsoNoise::is_good);
        let none = self.not_measured.iter().map(|none| none.words("NOISE WAS NOT MEASURED"));
        Verdict { good, sentences: self.noise.iter().flat_map(IsoNoise::words).chain(none).collect() }
    }
}

impl IsoNoise {
    /// Whether to rely on it.
    pub fn is_good(&self) -> bool {
        let [low, high] = self.electrons_per_dn_interval_95;
        high - low <= 2.0 * SURE * self.electrons_per_dn
            && self.chi_squared <= MOST_SCATTER
            && self.rejected_share <= MOST_REJECTED
    }

    fn words(&self) -> Vec<String> {
        let [low, high] = self.electrons_per_dn_interval_95;
        let whole = self.step_dn.map_or("whole DN".to_owned(), |step| format!("steps of {step:.2} DN"));
        let rounding = self.step_dn.map_or("1/12".to_owned(), |step| format!("{:.2}", step * step / 12.0));
        let read = match (self.read_noise_e, self.read_noise_e_interval_95) {
            (Some(value), Some([low, high])) => {
                format!("read noise is {value:.2} electrons (95 %: {low:.2} to {high:.2})")
            }
            _ => match self.read_noise_below_e {
                Some(bound) => {
                    format!("read noise is below {bound:.2} electrons: rounding to {whole} hides it")
                }
                None => "read noise was not told".to_owned(),
            },
        };
        let mut words = vec![format!(
            "At {} one DN is {:.4} electrons (95 %: {low:.4} to {high:.4}) and {read}; {rounding} DN^2 of rounding to {whole} is taken off.",
            self.iso, self.electrons_per_dn
        )];
        match (&self.linearity, &self.linearity_not_measured) {
            (Some(linearity), _) => words.push(linearity_words(linearity)),
            (None, Some(why)) => words.push(format!("LINEARITY WAS NOT MEASURED: {why}.")),
            (None, None) => {}
        }
        if !self.is_good() {
            words.push(format!(
                "Do not rely on it, it is not used: the gain is known to {:.1} %, tiles scatter {:.2} times as they should, {:.0} % of them were left out; shoot more pairs, of an even surface in steady light.",
                50.0 * (high - low) / self.electrons_per_dn,
                self.chi_squared,
                100.0 * self.rejected_share
            ));
        }
        if let Some(dn) = self.cut_off_dn {
            words.push(format!(
                "The raws are cut off at {dn:.0} DN, so that dark frames show but a part of their noise and do not count; read noise \
                 is from the line's intercept."
            ));
        } else if self.dark_pairs == 0 {
            words.push("Read noise is from the line's intercept: dark frames (--dark) make it surer.".into());
        }
        let coarse = COARSE * self.step_dn.unwrap_or(1.0);
        if self.read_noise_dn.is_some_and(|dn| dn < coarse) {
            words.push(format!(
                "Read noise is below {coarse:.2} DN, so that rounding to {whole} may shift it; its interval holds that."
            ));
        }
        if let Some(step) = self.companded_step_dn {
            words.push(format!(
                "The raws are companded: their steps grow to {step:.1} DN with the signal, so that noise at high signals holds up to \
                 {:.1} DN^2 of rounding; shoot raws without lossy compression.",
                step * step / 12.0
            ));
        }
        if let Some(apart) = self.colours_apart.filter(|apart| *apart > COLOURS) {
            words.push(format!(
                "The colours differ in gain by up to {:.1} %, more than chance; one gain is used for the variances of all, which are \
                 off by {}.",
                100.0 * apart,
                self.colours_off()
            ));
        }
        if self.dark_apart_in_errors.is_some_and(|errors| errors > APART) {
            words.push(
                "Dark frames are noisier or quieter than the lit frames' line says at no signal: is it the same ISO and temperature, and the cap tight?".into(),
            );
        }
        words
    }
}

impl IsoNoise {
    /// By how much shot noise of each colour is told wrong by the one gain of all, in words.
    fn colours_off(&self) -> String {
        let off = self.colours.iter().filter_map(|own| {
            let percent = 100.0 * (own.electrons_per_dn? / self.electrons_per_dn - 1.0);
            Some(format!("{percent:+.1} % for {}", own.colour))
        });
        off.collect::<Vec<_>>().join(", ")
    }
}

/// The least bend that is told where labels tell the light; older records do not have the labels' error.
fn least_bend(linearity: &Linearity) -> f64 {
    linearity::SURE * linearity.label_standard_error.unwrap_or(0.5 * LABEL)
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
    let light = match linearity.light_source {
        LightSource::Stops => "The light's steps are those given (--stops)".to_owned(),
        LightSource::Shutter => format!(
            "The light's steps are the shutter's labels, whose own errors ({:.0} % and more are usual) are in these figures, so that no \
             bend of less than {:.1} % is told",
            100.0 * LABEL,
            100.0 * least_bend(linearity)
        ),
    };
    format!(
        "From {from:.0} to {to:.0} DN above black the linearity error is {:.3} %, the largest deviation {:+.3} %; {knee}{missing}. {light}.",
        100.0 * linearity.linearity_error,
        100.0 * linearity.largest_deviation
    )
}

#[cfg(test)]
mod tests {
    use super::linearity::{Reading, fit};
    use super::*;

    #[test]
    fn the_least_bend_that_is_told_grows_with_the_labels_errors() {
        for (scatter, least) in [(0.0f64, 0.01), (0.04, 0.02)] {
            // Levels by thirds of a stop, off by this much, half of it, or not at all.
            let levels = (0..12).map(|k| {
                let light = 800.0 * (f64::from(k) / 3.0).exp2();
                let off = scatter * [0.0, 1.0, -1.0, 0.5, -0.5][k as usize % 5];
                let mean = light * (1.0 + off);
                (light, [Some(Reading { mean, error: 1e-4 * mean }); 3])
            });
            let levels: Vec<_> = levels.collect();
            let found = fit(&levels, [13_000.0; 3], 0.0, LightSource::Shutter, 0).unwrap();
            let error = found.label_standard_error.unwrap();
            assert!(error >= least, "{found:?}");
            let told = format!("no bend of less than {:.1} % is told", 300.0 * error);
            assert!(linearity_words(&found).contains(&told), "{}", linearity_words(&found));
            let by_stops = fit(&levels, [13_000.0; 3], 0.0, LightSource::Stops, 0);
            assert!(by_stops.is_ok_and(|found| found.label_standard_error.is_none()));
        }
    }
}
