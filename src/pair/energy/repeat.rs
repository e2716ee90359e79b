//! How steady the known light is: many shots of one scene with nothing changed, before and after each is divided by
//! the energy that the photodiode measured of it (thesis, section 3.4: 40 shots, standard deviation 0.0029).

use super::mean_and_deviation;
use serde::{Deserialize, Serialize};

/// Fewer shots say nothing of a deviation: its own error is 1 / sqrt(2 (n - 1)).
pub(crate) const FEWEST_SHOTS: usize = 8;

/// One shot of the series.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct RepeatShot {
    /// Running number, from 1.
    pub number: u32,
    /// When its pulse came, UTC seconds since 1970.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub at: Option<f64>,
    /// Mean known light of the region, DN, red green blue.
    pub light: [f64; 3],
    /// Standard error of each mean by the sensor's noise, DN.
    pub light_error: [f64; 3],
    /// Energy of the pulse, the controller's counts.
    pub energy_counts: f64,
    /// What was read in the dark frame before it: noise, the controller's counts.
    pub dark_energy_counts: f64,
}

/// What a series says.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Repeatability {
    /// Relative standard deviation of the known light as it came.
    pub spread: f64,
    /// Standard error of `spread`.
    pub spread_error: f64,
    /// Relative standard deviation of the known light divided by the measured energy.
    pub corrected: f64,
    /// Standard error of `corrected`.
    pub corrected_error: f64,
    /// Part of both that is the sensor's noise, not the flash's.
    pub sensor_noise: f64,
    /// Part of `corrected` that is the photodiode's reading, as the dark frames tell.
    pub reading_noise: f64,
    /// Relative standard deviation of the measured energies.
    pub energy_spread: f64,
    /// The shots.
    pub shots: Vec<RepeatShot>,
}

impl Repeatability {
    /// Relative deviation of the flash's light from its energy, the noise of sensor and reading taken out.
    pub fn agreement(&self) -> f64 {
        (self.corrected.powi(2) - self.sensor_noise.powi(2) - self.reading_noise.powi(2)).max(0.0).sqrt()
    }
}

/// Why a series says nothing.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum RepeatError {
    /// Too few shots.
    #[error("{0} shots are too few to tell how steady the flash is: take at least {FEWEST_SHOTS}")]
    TooFew(usize),
    /// No light.
    #[error(
        "shot {0} of the series shows no flash light in the region (known light or measured energy is not above 0); check flash, photodiode and exposure"
    )]
    Dark(u32),
}

/// Deviations of a series. The colours are combined with weights inverse to their relative variances.
pub fn repeatability(shots: &[RepeatShot]) -> Result<Repeatability, RepeatError> {
    if shots.len() < FEWEST_SHOTS {
        return Err(RepeatError::TooFew(shots.len()));
    }
    if let Some(dark) =
        shots.iter().find(|s| !(s.energy_counts > 0.0 && s.light.iter().all(|l| l.is_finite() && *l > 0.0)))
    {
        return Err(RepeatError::Dark(dark.number));
    }
    let n = shots.len() as f64;
    let mean = |of: &dyn Fn(&RepeatShot) -> f64| shots.iter().map(of).sum::<f64>() / n;
    let level: [f64; 3] = std::array::from_fn(|c| mean(&|s| s.light[c]));
    let noise: [f64; 3] =
        std::array::from_fn(|c| mean(&|s| s.light_error[c].powi(2)).sqrt().max(1e-12) / level[c]);
    let weight = noise.map(|n| n.powi(-2));
    let total: f64 = weight.iter().sum();
    let light = |s: &RepeatShot| (0..3).map(|c| weight[c] * s.light[c] / level[c]).sum::<f64>() / total;
    let relative = |values: Vec<f64>| mean_and_deviation(&values).map_or(0.0, |(mean, sd)| sd / mean);
    let spread = relative(shots.iter().map(light).collect());
    let corrected = relative(shots.iter().map(|s| light(s) / s.energy_counts).collect());
    let own_error = (2.0 * (n - 1.0)).sqrt().recip();
    Ok(Repeatability {
        spread,
        spread_error: spread * own_error,
        corrected,
        corrected_error: corrected * own_error,
        sensor_noise: total.sqrt().recip(),
        reading_noise: mean(&|s| s.dark_energy_counts.powi(2)).sqrt() / mean(&|s| s.energy_counts),
        energy_spread: relative(shots.iter().map(|s| s.energy_counts).collect()),
        shots: shots.to_vec(),
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;
    use rand_distr::{Distribution, StandardNormal};

    /// `stray`: what the light does beside the energy.
    fn series(n: u32, jitter: f64, reading: f64, sensor: f64, stray: f64) -> Vec<RepeatShot> {
        let mut random = rand_chacha::ChaCha8Rng::seed_from_u64(7);
        let mut gauss = |sd: f64| -> f64 { sd * Distribution::<f64>::sample(&StandardNormal, &mut random) };
        (1..=n)
            .map(|number| {
                let energy = 1.0 + gauss(jitter);
                let level = [900.0, 2000.0, 700.0];
                let light_error = level.map(|l| l * sensor * 3f64.sqrt());
                let given = energy * (1.0 + gauss(stray));
                let light = std::array::from_fn(|c| level[c] * given + gauss(light_error[c]));
                let energy_counts = 1.2e5 * energy + gauss(1.2e5 * reading);
                let dark_energy_counts = gauss(1.2e5 * reading);
                RepeatShot { number, at: None, light, light_error, energy_counts, dark_energy_counts }
            })
            .collect()
    }

    #[test]
    fn the_flashs_jitter_is_told_and_division_by_the_energy_leaves_only_what_readings_and_sensor_add() {
        let r = repeatability(&series(2000, 0.0029, 0.0004, 0.0002, 0.0)).unwrap();
        assert!((r.spread / 0.0029f64.hypot(0.0002) - 1.0).abs() < 0.05, "{}", r.spread);
        assert!((r.corrected / 0.0004f64.hypot(0.0002) - 1.0).abs() < 0.05, "{}", r.corrected);
        assert!((r.sensor_noise / 0.0002 - 1.0).abs() < 0.02, "{}", r.sensor_noise);
        assert!((r.reading_noise / 0.0004 - 1.0).abs() < 0.06, "{}", r.reading_noise);
        assert!(r.agreement() < 0.00015, "{}", r.agreement());
        let r = repeatability(&series(2000, 0.0029, 0.0004, 0.0002, 0.0006)).unwrap();
        assert!((r.agreement() / 0.0006 - 1.0).abs() < 0.06, "{}", r.agreement());
        assert!((r.energy_spread / 0.0029f64.hypot(0.0004) - 1.0).abs() < 0.05);
    }

    #[test]
    fn a_reading_that_has_nothing_to_do_with_the_light_makes_it_worse() {
        let mut shots = series(40, 0.0029, 0.0004, 0.0002, 0.0);
        let energies: Vec<f64> = shots.iter().map(|s| s.energy_counts).rev().collect();
        shots.iter_mut().zip(energies).for_each(|(s, e)| s.energy_counts = e);
        let r = repeatability(&shots).unwrap();
        assert!(r.corrected > 1.2 * r.spread, "{r:?}");
    }

    #[test]
    fn short_and_dark_series_are_refused() {
        assert_eq!(repeatability(&series(7, 0.003, 0.0, 0.0, 0.0)), Err(RepeatError::TooFew(7)));
        let mut shots = series(8, 0.003, 0.0, 0.0, 0.0);
        shots[4].energy_counts = 0.0;
        assert_eq!(repeatability(&shots), Err(RepeatError::Dark(5)));
        shots[4].energy_counts = 1.0;
        shots[6].light[2] = f64::NAN;
        assert_eq!(repeatability(&shots), Err(RepeatError::Dark(7)));
    }
}
