//! Known patches against the reflectance that was found for them.
//!
//! A patch is compared in camera RGB, white being (1, 1, 1), for there the reflectance was measured, each channel by
//! itself: error = found - known, and the same as a share of the known value. The thesis asks that the error be "no
//! higher then 5% of the ground truth" (section "Reflectance error" of its requirements); we ask 2 %. A patch passes a
//! limit if all three channels do. Whether that is sure is another question, answered by the standard deviation s that the
//! model tells of itself: a pass is sure if |error| + 1.96 s still passes in all channels, a failure if |error| - 1.96 s
//! fails in one. CIEDE2000 (see [`super::colour::delta_e_2000`]) is given where the camera's colours are known.

use super::Verdict;
use super::colour::{Lab, delta_e_2000};
use super::statistics::Z95;
use serde::{Deserialize, Serialize};

/// The thesis's limit, share of the known reflectance.
pub const THESIS: f64 = 0.05;

/// Ours.
pub const OURS: f64 = 0.02;

/// A patch before it is judged.
#[derive(Clone, Debug, PartialEq)]
pub struct PatchReading {
    /// What it reflects, camera RGB; all above 0.
    pub known: [f64; 3],
    /// What was found.
    pub found: [f64; 3],
    /// Standard deviation of that; absent where nothing tells it.
    pub deviation: Option<[f64; 3]>,
    /// CIELAB (D50) of known and found; absent where the camera's colours are not known.
    pub lab: Option<[Lab; 2]>,
}

/// A patch against a limit.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Judgement {
    /// Whether all channels are within it.
    pub passes: bool,
    /// Whether that would stay so with the error 1.96 standard deviations to either side; absent where none is told.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub sure: Option<bool>,
}

/// A patch, judged. Channels are the camera's own R, G, B.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Comparison {
    /// What it reflects.
    pub known_reflectance: [f64; 3],
    /// What was found.
    pub found_reflectance: [f64; 3],
    /// Standard deviation of that; absent where nothing tells it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub found_reflectance_standard_error: Option<[f64; 3]>,
    /// Found - known.
    pub error: [f64; 3],
    /// |found - known|.
    pub absolute_error: [f64; 3],
    /// (found - known) / known.
    pub relative_error: [f64; 3],
    /// CIELAB (D50) of what is known; absent where the camera's colours are not known.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub known_lab: Option<Lab>,
    /// CIELAB (D50) of what was found.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub found_lab: Option<Lab>,
    /// CIEDE2000 between the two.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub delta_e_2000: Option<f64>,
    /// By the thesis's limit.
    pub within_5_percent: Judgement,
    /// By ours.
    pub within_2_percent: Judgement,
}

impl Comparison {
    /// Judges a patch.
    pub fn of(reading: &PatchReading) -> Self {
        let PatchReading { known, found, deviation, lab } = *reading;
        let error: [f64; 3] = std::array::from_fn(|c| found[c] - known[c]);
        let by = |limit: f64| judge(&error, &known, deviation.as_ref(), limit);
        Self {
            known_reflectance: known,
            found_reflectance: found,
            found_reflectance_standard_error: deviation,
            error,
            absolute_error: error.map(f64::abs),
            relative_error: std::array::from_fn(|c| error[c] / known[c]),
            known_lab: lab.map(|[known, _]| known),
            found_lab: lab.map(|[_, found]| found),
            delta_e_2000: lab.map(|[known, found]| delta_e_2000(known, found)),
            within_5_percent: by(THESIS),
            within_2_percent: by(OURS),
        }
    }
}

fn judge(error: &[f64; 3], known: &[f64; 3], deviation: Option<&[f64; 3]>, limit: f64) -> Judgement {
    let within = |slack: &dyn Fn(usize) -> f64| (0..3).all(|c| error[c].abs() + slack(c) <= limit * known[c]);
    let passes = within(&|_| 0.0);
    let sure = deviation.map(|sd| {
        let side = if passes { Z95 } else { -Z95 };
        within(&|c| side * sd[c]) == passes
    });
    Judgement { passes, sure }
}

/// All patches together.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct CertificateSummary {
    /// Patches that were given.
    pub patches: usize,
    /// Those that were seen; the figures are of them alone.
    pub seen: usize,
    /// Mean of found - known, channels pooled, of 1.
    pub mean_error: f64,
    /// Mean of |found - known|, of 1.
    pub mean_absolute_error: f64,
    /// Largest |found - known|, of 1.
    pub max_absolute_error: f64,
    /// Largest |found - known| / known.
    pub max_relative_error: f64,
    /// Mean CIEDE2000; absent where the camera's colours are not known.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub delta_e_2000_mean: Option<f64>,
    /// Largest CIEDE2000.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub delta_e_2000_max: Option<f64>,
    /// Whether every patch that was seen passes the thesis's limit, and at least one was seen.
    pub within_5_percent: bool,
    /// The same by ours.
    pub within_2_percent: bool,
}

impl CertificateSummary {
    /// Of all patches; `None` stands for one that was not seen.
    pub fn of<'a>(patches: impl IntoIterator<Item = Option<&'a Comparison>>) -> Self {
        let all: Vec<Option<&Comparison>> = patches.into_iter().collect();
        let seen: Vec<&Comparison> = all.iter().flatten().copied().collect();
        let errors = || seen.iter().flat_map(|p| p.error);
        let count = (3 * seen.len()).max(1) as f64;
        let largest = |values: &mut dyn Iterator<Item = f64>| values.fold(0.0, |m: f64, v| m.max(v.abs()));
        let colours: Option<Vec<f64>> = seen.iter().map(|p| p.delta_e_2000).collect();
        let colours = colours.filter(|c| !c.is_empty());
        let pass = |by: fn(&Comparison) -> Judgement| !seen.is_empty() && seen.iter().all(|p| by(p).passes);
        Self {
            patches: all.len(),
            seen: seen.len(),
            mean_error: errors().sum::<f64>() / count,
            mean_absolute_error: errors().map(f64::abs).sum::<f64>() / count,
            max_absolute_error: largest(&mut errors()),
            max_relative_error: largest(&mut seen.iter().flat_map(|p| p.relative_error)),
            delta_e_2000_mean: colours.as_ref().map(|c| c.iter().sum::<f64>() / c.len() as f64),
            delta_e_2000_max: colours.map(|c| largest(&mut c.into_iter())),
            within_5_percent: pass(|p| p.within_5_percent),
            within_2_percent: pass(|p| p.within_2_percent),
        }
    }

    /// In words; `unsure` are the patches whose judgement by our limit their standard deviation leaves open, `unseen`
    /// those that were not seen.
    pub fn verdict(&self, unsure: &[&str], unseen: &[&str]) -> Verdict {
        let mut sentences = vec![];
        if self.seen == 0 {
            sentences.push("No patch was seen: nothing is certified.".into());
        } else {
            let by = |passes: bool, whose: &str, limit: f64| {
                let word = if passes { "PASSES" } else { "FAILS" };
                format!("{word} {whose} limit of {:.0} %", 100.0 * limit)
            };
            sentences.push(format!(
                "{} and {}: of {} patches the largest error is {:.1} % of what is known ({:.4} of 1), the mean one {:+.4} of 1.",
                by(self.within_5_percent, "the thesis's", THESIS),
                by(self.within_2_percent, "our", OURS),
                self.seen,
                100.0 * self.max_relative_error,
                self.max_absolute_error,
                self.mean_error,
            ));
            sentences.push(match (self.delta_e_2000_mean, self.delta_e_2000_max) {
                (Some(mean), Some(max)) => {
                    format!("Colours differ by {mean:.2} on average and {max:.2} at most (CIEDE2000).")
                }
                _ => "The camera's colours are not known: no CIEDE2000.".into(),
            });
        }
        if !unsure.is_empty() {
            sentences.push(format!(
                "By the model's own standard deviation the limit of {:.0} % cannot be told for sure for: {}.",
                100.0 * OURS,
                unsure.join(", ")
            ));
        }
        if !unseen.is_empty() {
            sentences.push(format!(
                "{} of {} patches were not seen and prove nothing: {}.",
                unseen.len(),
                self.patches,
                unseen.join(", ")
            ));
        }
        Verdict { good: self.within_5_percent, sentences }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt as _, SeedableRng as _};
    use rand_chacha::ChaCha8Rng;

    fn reading(known: [f64; 3], found: [f64; 3], deviation: Option<[f64; 3]>) -> PatchReading {
        PatchReading { known, found, deviation, lab: None }
    }

    #[test]
    fn limits_are_shares_of_what_is_known_and_the_worst_channel_decides() {
        let judged = |found: [f64; 3]| {
            let c = Comparison::of(&reading([0.5, 0.2, 0.04], found, None));
            (c.within_5_percent.passes, c.within_2_percent.passes)
        };
        assert_eq!(judged([0.5, 0.2, 0.04]), (true, true));
        assert_eq!(judged([0.509, 0.197, 0.0405]), (true, true));
        assert_eq!(judged([0.509, 0.195, 0.04]), (true, false));
        assert_eq!(judged([0.5, 0.2, 0.0421]), (false, false));
        let c = Comparison::of(&reading([0.5, 0.2, 0.04], [0.49, 0.2, 0.05], Some([0.001; 3])));
        assert!((c.relative_error[0] + 0.02).abs() < 1e-12 && (c.relative_error[2] - 0.25).abs() < 1e-12);
        assert_eq!((c.absolute_error[0], c.error[1], c.delta_e_2000), (0.5 - 0.49, 0.0, None));
        assert_eq!(c.within_2_percent, Judgement { passes: false, sure: Some(true) });
    }

    #[test]
    fn a_deviation_as_large_as_the_limit_leaves_it_open() {
        let sure = |found: f64, sd: f64| {
            Comparison::of(&reading([0.5; 3], [found, 0.5, 0.5], Some([sd; 3]))).within_2_percent
        };
        assert_eq!(sure(0.5, 0.004), Judgement { passes: true, sure: Some(true) });
        assert_eq!(sure(0.5, 0.006), Judgement { passes: true, sure: Some(false) });
        assert_eq!(sure(0.515, 0.006), Judgement { passes: false, sure: Some(false) });
        assert_eq!(sure(0.525, 0.006), Judgement { passes: false, sure: Some(true) });
    }

    #[test]
    fn what_is_called_sure_is_wrong_as_seldom_as_it_says() {
        let mut rng = ChaCha8Rng::seed_from_u64(11);
        let mut even = || rng.random::<f64>();
        let (mut sure, mut wrong, mut inside) = (0, 0, 0);
        for _ in 0..4000 {
            let known = [0; 3].map(|_| 0.03 + 0.9 * even());
            let bias = 0.10 * (even() - 0.5);
            let truth = known.map(|k| k * (1.0 + bias));
            let sd = known.map(|k| k * 0.01 * (0.2 + even()));
            // Twelve even ones make a normal one, near enough.
            let found =
                std::array::from_fn(|c| truth[c] + sd[c] * ((0..12).map(|_| even()).sum::<f64>() - 6.0));
            let judged = Comparison::of(&reading(known, found, Some(sd)));
            inside += (0..3).filter(|&c| (found[c] - truth[c]).abs() <= Z95 * sd[c]).count();
            let real = Comparison::of(&reading(known, truth, None)).within_2_percent.passes;
            if judged.within_2_percent.sure == Some(true) {
                sure += 1;
                wrong += usize::from(judged.within_2_percent.passes != real);
            }
        }
        assert!(sure > 500 && (wrong as f64) < 0.05 * f64::from(sure), "{wrong} of {sure}");
        let coverage = inside as f64 / 12_000.0;
        assert!((0.94..=0.96).contains(&coverage), "{coverage}");
    }

    #[test]
    fn patches_that_were_not_seen_never_pass() {
        let none = CertificateSummary::of([None, None]);
        assert!(!none.within_5_percent && !none.within_2_percent && none.patches == 2);
        let verdict = none.verdict(&[], &["a", "b"]);
        assert!(!verdict.good && verdict.sentences[0].contains("nothing is certified"));
        assert!(verdict.sentences[1].contains("prove nothing: a, b"), "{verdict:?}");
        let good = Comparison::of(&PatchReading {
            lab: Some([[50.0, 0.0, 0.0], [51.0, 0.0, 0.0]]),
            ..reading([0.5; 3], [0.505, 0.5, 0.498], None)
        });
        let one = CertificateSummary::of([Some(&good), None]);
        assert!(one.within_2_percent && one.seen == 1 && (one.max_relative_error - 0.01).abs() < 1e-9);
        assert!(
            (one.mean_error - 0.001).abs() < 1e-9 && (one.mean_absolute_error - 0.007 / 3.0).abs() < 1e-9
        );
        assert!(one.delta_e_2000_max.is_some_and(|d| d > 0.9 && d < 1.1), "{one:?}");
        let bad = Comparison::of(&reading([0.5; 3], [0.6; 3], None));
        let both = CertificateSummary::of([Some(&good), Some(&bad)]);
        assert!(!both.within_5_percent && both.delta_e_2000_mean.is_none());
        assert!(both.verdict(&["b"], &[]).sentences[0].starts_with("FAILS the thesis's limit of 5 %"));
    }
}
