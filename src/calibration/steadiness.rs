//! How steady the flash is, from many shots of one scene with nothing changed, before and after each is divided by the
//! energy that was measured of it (thesis, section 3.4: 40 shots, standard deviation 0.0029).
//!
//! Colours are combined with weights inverse to their relative variances. The flash's own deviation is the shots' less
//! the sensor's noise, in squares. Intervals are those of a normal sample's variance, (n - 1) s^2 / chi^2.

use super::statistics::chi_square_95;
use serde::{Deserialize, Serialize};

/// Fewer shots say nothing of a deviation: its own error is 1 / sqrt(2 (n - 1)).
pub(crate) const FEWEST_SHOTS: usize = 8;

/// Standard deviation that is as good as the thesis's flash.
const GOOD: f64 = 0.005;

/// One shot of the series.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct SteadyShot {
    /// File name, or number in the series.
    pub label: String,
    /// When its pulse came, UTC seconds since 1970.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub at: Option<f64>,
    /// Mean known light, DN, red green blue.
    pub light_dn: [f64; 3],
    /// Standard error of each by the sensor's noise, DN.
    pub light_dn_standard_error: [f64; 3],
    /// Energy of its pulse in whatever counts it was measured.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub energy_counts: Option<f64>,
    /// What was read, in the same counts, in the dark frame before it: noise.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub dark_energy_counts: Option<f64>,
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
    /// Of the light as it came.
    pub light_deviation: f64,
    /// Of the light divided by measured energy; only if all energies are known.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub light_by_energy_deviation: Option<f64>,
    /// Part of both that is the sensor's noise.
    pub sensor_deviation: f64,
    /// Part of the latter that is the reading of the energy, as dark frames tell; only if all were measured.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub reading_deviation: Option<f64>,
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
    /// The shots.
    pub frames: Vec<SteadyShot>,
}

/// Why a series says nothing.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum SteadyError {
    /// Too few.
    #[error(
        "{0} shots are too few to tell how steady the flash is: {FEWEST_SHOTS} or more are needed, the thesis took 40"
    )]
    TooFew(usize),
    /// No light.
    #[error(
        "{0} shows no flash light (its light or its measured energy is not above 0); leave it out, or check flash, photodiode and exposure"
    )]
    Dark(String),
}

/// Deviations of a series, in the order in which it was shot.
pub fn steadiness(mut frames: Vec<SteadyShot>) -> Result<Steadiness, SteadyError> {
    if frames.len() < FEWEST_SHOTS {
        return Err(SteadyError::TooFew(frames.len()));
    }
    let lit = |s: &SteadyShot| s.light_dn.iter().chain(&s.energy_counts).all(|l| l.is_finite() && *l > 0.0);
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
    let energies: Option<Vec<f64>> = frames.iter().map(|s| s.energy_counts).collect();
    let corrected = energies.as_ref().map(|energies| {
        let by: Vec<f64> = light.iter().zip(energies).map(|(l, e)| l / e).collect();
        let middle = by.iter().sum::<f64>() / n;
        by.into_iter().map(|b| b / middle).collect::<Vec<f64>>()
    });
    let dark: Option<Vec<f64>> = frames.iter().map(|s| Some(s.dark_energy_counts?.powi(2))).collect();
    let reading_deviation = energies.zip(dark).map(|(energies, squares)| {
        (squares.iter().sum::<f64>() / n).sqrt() / (energies.iter().sum::<f64>() / n)
    });
    for (i, frame) in frames.iter_mut().enumerate() {
        frame.relative_light = light[i];
        frame.relative_light_by_energy = corrected.as_ref().map(|c| c[i]);
    }
    let light_deviation = deviation(&light);
    let light_by_energy_deviation = corrected.as_deref().map(deviation);
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
        light_by_energy_deviation,
        sensor_deviation: sensor,
        reading_deviation,
        corrected_deviation: light_by_energy_deviation.map(own),
        corrected_deviation_interval_95: light_by_energy_deviation.map(interval),
        largest_excursion: light.iter().map(|l| (l - 1.0).abs()).fold(0.0, f64::max),
        drift: slope * (n - 1.0),
        frames,
    })
}

impl Steadiness {
    /// Relative deviation of the flash's light from its energy, the noise of sensor and reading taken out.
    pub fn agreement(&self) -> Option<f64> {
        let reading = self.reading_deviation.unwrap_or(0.0);
        Some((self.corrected_deviation?.powi(2) - reading.powi(2)).max(0.0).sqrt())
    }

    /// Standard error of a deviation of the light.
    pub fn standard_error(&self, deviation: f64) -> f64 {
        deviation / (2.0 * (self.frames.len() as f64 - 1.0)).sqrt()
    }

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
    use rand_chacha::ChaCha8Rng;
    use rand_distr::{Distribution, StandardNormal};

    /// Relative standard deviations of what a series is made of.
    #[derive(Clone, Copy, Default)]
    struct Made {
        jitter: f64,
        /// What the light does beside the energy.
        stray: f64,
        sensor: f64,
        reading: f64,
    }

    fn series(random: &mut ChaCha8Rng, n: usize, made: Made) -> Vec<SteadyShot> {
        let mut gauss = |sd: f64| -> f64 { sd * Distribution::<f64>::sample(&StandardNormal, random) };
        (0..n)
            .map(|i| {
                let energy = 1.0 + gauss(made.jitter);
                let given = energy * (1.0 + gauss(made.stray));
                let level = [900.0, 2000.0, 700.0];
                let error = level.map(|l| l * made.sensor * 3f64.sqrt());
                SteadyShot {
                    label: format!("{i}"),
                    light_dn: std::array::from_fn(|c| level[c] * given + gauss(error[c])),
                    light_dn_standard_error: error,
                    energy_counts: Some(1e5 * (energy + gauss(made.reading))),
                    dark_energy_counts: Some(1e5 * gauss(made.reading)),
                    ..SteadyShot::default()
                }
            })
            .collect()
    }

    #[test]
    fn the_jitter_lies_in_its_interval_as_often_as_it_should_and_goes_when_energies_are_known() {
        let mut random = ChaCha8Rng::seed_from_u64(3);
        let mut held = 0;
        for _ in 0..1000 {
            let made = Made { jitter: 0.0029, sensor: 0.0005, ..Made::default() };
            let found = steadiness(series(&mut random, 40, made)).unwrap();
            let [low, high] = found.jitter_deviation_interval_95;
            held += usize::from((low..=high).contains(&0.0029));
            assert!(found.corrected_deviation.unwrap() < 0.0006);
        }
        assert!((930..=970).contains(&held), "{held}");
    }

    #[test]
    fn division_by_the_energy_leaves_what_readings_sensor_and_stray_light_add() {
        let mut random = ChaCha8Rng::seed_from_u64(7);
        let made = Made { jitter: 0.0029, sensor: 0.0002, reading: 0.0004, stray: 0.0 };
        let found = steadiness(series(&mut random, 2000, made)).unwrap();
        assert!((found.light_deviation / 0.0029f64.hypot(0.0002) - 1.0).abs() < 0.05, "{found:?}");
        let by_energy = found.light_by_energy_deviation.unwrap();
        assert!((by_energy / 0.0004f64.hypot(0.0002) - 1.0).abs() < 0.05, "{by_energy}");
        assert!((found.sensor_deviation / 0.0002 - 1.0).abs() < 0.02, "{}", found.sensor_deviation);
        assert!((found.reading_deviation.unwrap() / 0.0004 - 1.0).abs() < 0.06);
        assert!(found.agreement().unwrap() < 0.00015, "{:?}", found.agreement());
        let found = steadiness(series(&mut random, 2000, Made { stray: 0.0006, ..made })).unwrap();
        assert!((found.agreement().unwrap() / 0.0006 - 1.0).abs() < 0.06, "{:?}", found.agreement());
    }

    #[test]
    fn a_reading_that_has_nothing_to_do_with_the_light_makes_it_worse() {
        let mut random = ChaCha8Rng::seed_from_u64(8);
        let made = Made { jitter: 0.0029, sensor: 0.0002, reading: 0.0004, stray: 0.0 };
        let mut shots = series(&mut random, 40, made);
        let energies: Vec<Option<f64>> = shots.iter().map(|s| s.energy_counts).rev().collect();
        shots.iter_mut().zip(energies).for_each(|(s, e)| s.energy_counts = e);
        let found = steadiness(shots).unwrap();
        assert!(found.light_by_energy_deviation.unwrap() > 1.2 * found.light_deviation, "{found:?}");
    }

    #[test]
    fn too_few_or_dark_shots_say_nothing_and_a_drift_is_told() {
        let mut random = ChaCha8Rng::seed_from_u64(4);
        let made = Made { jitter: 0.003, ..Made::default() };
        assert_eq!(steadiness(series(&mut random, 7, made)), Err(SteadyError::TooFew(7)));
        let shots = series(&mut random, 9, made);
        let spoils: [fn(&mut SteadyShot); 3] =
            [|s| s.light_dn[1] = 0.0, |s| s.light_dn[2] = f64::NAN, |s| s.energy_counts = Some(0.0)];
        for spoil in spoils {
            let mut dark = shots.clone();
            spoil(&mut dark[4]);
            assert_eq!(steadiness(dark), Err(SteadyError::Dark("4".into())));
        }
        let made = Made { jitter: 1e-4, sensor: 1e-5, ..Made::default() };
        let mut falling = series(&mut random, 40, made);
        for (i, shot) in falling.iter_mut().enumerate() {
            shot.light_dn = shot.light_dn.map(|l| l * (1.0 - 0.01 * i as f64 / 39.0));
        }
        let found = steadiness(falling).unwrap();
        assert!((found.drift + 0.01).abs() < 2e-4, "{}", found.drift);
    }
}
