//! How steady the flash is, from lit frames of one scene with nothing changed (thesis, section 3.4: 40 shots, standard
//! deviation 0.0029).
//!
//! Colours are combined with weights inverse to their relative variances. The flash's own deviation is the frames' less
//! the sensor's noise, in squares. Intervals are those of a normal sample's variance, (n - 1) s^2 / chi^2.

use super::statistics::chi_square_95;
use serde::{Deserialize, Serialize};

/// Fewer shots say nothing of a deviation: its own error is 1 / sqrt(2 (n - 1)).
const FEWEST: usize = 8;

/// Standard deviation that is as good as the thesis's flash.
const GOOD: f64 = 0.005;

/// One lit frame.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SteadyShot {
    /// File name.
    pub label: String,
    /// Mean known light, DN, red green blue.
    pub light_dn: [f64; 3],
    /// Standard error of each by the sensor's noise, DN.
    pub light_dn_standard_error: [f64; 3],
    /// Energy of its pulse in whatever counts it was measured.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub energy_counts: Option<f64>,
    /// Its light over the mean of all; filled in by [`steadiness`].
    #[serde(default)]
    pub relative_light: f64,
    /// The same divided by its energy over the mean of all.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub relative_light_by_energy: Option<f64>,
}

/// What a series says. Deviations are relative standard deviations.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Steadiness {
    /// Of the flash's energy between shots, the sensor's noise taken out.
    pub jitter_deviation: f64,
    /// 95 % interval of it.
    pub jitter_deviation_interval_95: [f64; 2],
    /// Of the frames as they came.
    pub light_deviation: f64,
    /// Part of it that is the sensor's noise.
    pub sensor_deviation: f64,
    /// Of what is left when light is divided by measured energy, the sensor's noise taken out; only if all energies are
    /// known.
    pub corrected_deviation: Option<f64>,
    /// 95 % interval of it.
    pub corrected_deviation_interval_95: Option<[f64; 2]>,
    /// Largest excursion of a shot from the mean.
    pub largest_excursion: f64,
    /// Change from the first to the last shot by a straight line through all: a flash that warms up or a battery that
    /// runs down.
    pub drift: f64,
    /// The frames.
    pub frames: Vec<SteadyShot>,
}

/// Why a series says nothing.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum SteadyError {
    /// Too few.
    #[error(
        "{0} frames are too few to tell how steady the flash is: give at least {FEWEST}, the thesis took 40"
    )]
    TooFew(usize),
    /// No light.
    #[error("{0} shows no flash light; leave it out, or check that the flash fired")]
    Dark(String),
}

/// Deviations of a series of frames, in the order in which they were shot.
pub fn steadiness(mut frames: Vec<SteadyShot>) -> Result<Steadiness, SteadyError> {
    if frames.len() < FEWEST {
        return Err(SteadyError::TooFew(frames.len()));
    }
    let lit = |s: &SteadyShot| s.light_dn.iter().all(|l| l.is_finite() && *l > 0.0);
    if let Some(dark) = frames.iter().find(|s| !lit(s)) {
        return Err(SteadyError::Dark(dark.label.clone()));
    }
    let n = frames.len() as f64;
    let mean = |of: &dyn Fn(&SteadyShot) -> f64| frames.iter().map(of).sum::<f64>() / n;
    let level: [f64; 3] = std::array::from_fn(|c| mean(&|s| s.light_dn[c]));
    let noise: [f64; 3] =
        std::array::from_fn(|c| mean(&|s| s.light_dn_standard_error[c].powi(2)).sqrt().max(1e-12) / level[c]);
    let weight = noise.map(|n| n.powi(-2));
    let total: f64 = weight.iter().sum();
    let sensor = total.sqrt().recip();
    let light: Vec<f64> = frames
        .iter()
        .map(|s| (0..3).map(|c| weight[c] * s.light_dn[c] / level[c]).sum::<f64>() / total)
        .collect();
    let energies: Option<Vec<f64>> =
        frames.iter().map(|s| s.energy_counts.filter(|e| e.is_finite() && *e > 0.0)).collect();
    let corrected = energies.map(|energies| {
        let by: Vec<f64> = light.iter().zip(&energies).map(|(l, e)| l / e).collect();
        let middle = by.iter().sum::<f64>() / n;
        by.into_iter().map(|b| b / middle).collect::<Vec<f64>>()
    });
    for (i, frame) in frames.iter_mut().enumerate() {
        frame.relative_light = light[i];
        frame.relative_light_by_energy = corrected.as_ref().map(|c| c[i]);
    }
    let light_deviation = deviation(&light);
    let own = |whole: f64| (whole * whole - sensor * sensor).max(0.0).sqrt();
    let interval = |whole: f64| {
        let [low, high] = chi_square_95(n - 1.0);
        [own(whole * ((n - 1.0) / high).sqrt()), own(whole * ((n - 1.0) / low).sqrt())]
    };
    let centre = (n - 1.0) / 2.0;
    let slope = light.iter().enumerate().map(|(i, l)| (i as f64 - centre) * l).sum::<f64>()
        / (n * (n * n - 1.0) / 12.0);
    Ok(Steadiness {
        jitter_deviation: own(light_deviation),
        jitter_deviation_interval_95: interval(light_deviation),
        light_deviation,
        sensor_deviation: sensor,
        corrected_deviation: corrected.as_deref().map(|c| own(deviation(c))),
        corrected_deviation_interval_95: corrected.as_deref().map(|c| interval(deviation(c))),
        largest_excursion: light.iter().map(|l| (l - 1.0).abs()).fold(0.0, f64::max),
        drift: slope * (n - 1.0),
        frames,
    })
}

impl Steadiness {
    /// What to make of it.
    pub fn verdict(&self) -> super::Verdict {
        let percent = |part: f64| format!("{:.3} %", 100.0 * part);
        let good = self.corrected_deviation.unwrap_or(self.jitter_deviation) <= GOOD;
        let [low, high] = self.jitter_deviation_interval_95;
        let mut sentences = vec![format!(
            "The flash's energy has a standard deviation of {} between shots (95 %: {} to {}; {} frames).",
            percent(self.jitter_deviation),
            percent(low),
            percent(high),
            self.frames.len()
        )];
        if let Some(corrected) = self.corrected_deviation {
            sentences.push(format!("Divided by the measured energies {} is left.", percent(corrected)));
        }
        if self.drift.abs() > 2.0 * self.jitter_deviation && self.drift.abs() > 0.002 {
            sentences.push(format!(
                "Over the series the energy went by {}: let the flash warm up, or change its battery.",
                percent(self.drift)
            ));
        }
        if !good {
            sentences.push("That is more than a repeatable flash shows; give it longer to recycle.".into());
        }
        super::Verdict { good, sentences }
    }
}

/// Relative standard deviation.
fn deviation(values: &[f64]) -> f64 {
    let n = values.len() as f64;
    let mean = values.iter().sum::<f64>() / n;
    (values.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / (n - 1.0)).sqrt() / mean
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;
    use rand_distr::{Distribution, StandardNormal};

    fn series(random: &mut rand_chacha::ChaCha8Rng, n: usize, jitter: f64, sensor: f64) -> Vec<SteadyShot> {
        let mut gauss = || -> f64 { StandardNormal.sample(random) };
        (0..n)
            .map(|i| {
                let energy = 1.0 + jitter * gauss();
                let level = [900.0, 2000.0, 700.0];
                let light_dn_standard_error = level.map(|l| l * sensor * 3f64.sqrt());
                SteadyShot {
                    label: format!("{i}"),
                    light_dn: std::array::from_fn(|c| {
                        level[c] * energy + light_dn_standard_error[c] * gauss()
                    }),
                    light_dn_standard_error,
                    energy_counts: Some(1e5 * energy),
                    relative_light: 0.0,
                    relative_light_by_energy: None,
                }
            })
            .collect()
    }

    #[test]
    fn the_jitter_lies_in_its_interval_as_often_as_it_should_and_goes_when_energies_are_known() {
        let mut random = rand_chacha::ChaCha8Rng::seed_from_u64(3);
        let mut held = 0;
        for _ in 0..1000 {
            let found = steadiness(series(&mut random, 40, 0.0029, 0.0005)).unwrap();
            let [low, high] = found.jitter_deviation_interval_95;
            held += usize::from((low..=high).contains(&0.0029));
            assert!(found.corrected_deviation.unwrap() < 0.0006);
        }
        assert!((930..=970).contains(&held), "{held}");
    }

    #[test]
    fn too_few_or_dark_frames_say_nothing_and_a_drift_is_told() {
        let mut random = rand_chacha::ChaCha8Rng::seed_from_u64(4);
        assert_eq!(steadiness(series(&mut random, 7, 0.003, 0.0)), Err(SteadyError::TooFew(7)));
        let mut dark = series(&mut random, 9, 0.003, 0.0);
        dark[4].light_dn[1] = 0.0;
        assert_eq!(steadiness(dark), Err(SteadyError::Dark("4".into())));
        let mut falling = series(&mut random, 40, 1e-4, 1e-5);
        for (i, shot) in falling.iter_mut().enumerate() {
            shot.light_dn = shot.light_dn.map(|l| l * (1.0 - 0.01 * i as f64 / 39.0));
        }
        let found = steadiness(falling).unwrap();
        assert!((found.drift + 0.01).abs() < 2e-4, "{}", found.drift);
    }
}
