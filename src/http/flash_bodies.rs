//! What goes over the wire about a session's flash.

use crate::calibration::Steadiness;
use crate::pair::energy::{AdviceCode, ReferenceSource};
use crate::pipeline::energy::FlashAccount;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// One measured pulse of an accepted pair.
#[derive(Serialize, ToSchema)]
pub(super) struct PulseBody {
    /// Number of the pair.
    pair: u32,
    /// When, UTC seconds since 1970.
    at: Option<f64>,
    /// Seconds since the pulse before.
    rest_s: Option<f64>,
    /// Energy, the controller's counts.
    energy_counts: f64,
    /// Energy against the reference.
    gain: f64,
    /// Standard deviation of `gain`.
    deviation: f64,
}

/// What should be done.
#[derive(Serialize, ToSchema)]
pub(super) struct AdviceBody {
    /// Stable name.
    #[schema(value_type = String, example = "wait_longer")]
    code: AdviceCode,
    /// What was found and what to do.
    sentence: String,
}

/// The energy that has gain 1.
#[derive(Serialize, ToSchema)]
pub(super) struct ReferenceBody {
    /// Counts.
    counts: f64,
    /// `calibration`: mean of the card shots; `session`: median of the session's pairs.
    #[schema(value_type = String, example = "calibration")]
    source: ReferenceSource,
}

/// How steady the known light was over a series of shots with nothing changed.
#[derive(Serialize, ToSchema)]
pub(super) struct RepeatabilityBody {
    /// Shots of the series.
    shots: usize,
    /// Relative standard deviation of the known light as it came.
    spread: f64,
    /// Standard error of `spread`.
    spread_error: f64,
    /// The same, divided by the measured energy; absent unless all energies are known.
    corrected: Option<f64>,
    /// Standard error of `corrected`.
    corrected_error: Option<f64>,
    /// Part of both that is the sensor's noise.
    sensor_noise: f64,
    /// Part of `corrected` that is the photodiode's reading; absent where it was not measured.
    reading_noise: Option<f64>,
}

impl From<Steadiness> for RepeatabilityBody {
    fn from(run: Steadiness) -> Self {
        let corrected = run.light_by_energy_deviation;
        Self {
            shots: run.frames.len(),
            spread: run.light_deviation,
            spread_error: run.standard_error(run.light_deviation),
            corrected,
            corrected_error: corrected.map(|corrected| run.standard_error(corrected)),
            sensor_noise: run.sensor_deviation,
            reading_noise: run.reading_deviation,
        }
    }
}

/// The flash over a session.
#[derive(Serialize, ToSchema)]
pub(super) struct FlashAccountBody {
    /// All of it in one sentence.
    words: String,
    /// What to do; empty when all is well.
    advice: Vec<AdviceBody>,
    /// Pairs that a flash controller watched.
    pairs: usize,
    /// Those whose frames are both proven by its events and its photodiode.
    proven: usize,
    /// Those that were rejected for their lighting.
    misfires: usize,
    /// Against what gains are counted; absent before a pulse was measured.
    reference: Option<ReferenceBody>,
    /// Relative standard deviation of the pulses' energy.
    spread: Option<f64>,
    /// Relative change of energy by rests that were too short; negative is a loss.
    recharge_loss: Option<f64>,
    /// Relative change by heat.
    heat_loss: Option<f64>,
    /// Relative change from the first pulse to the last.
    droop: Option<f64>,
    /// Pulse by pulse.
    pulses: Vec<PulseBody>,
    /// The last repeatability run.
    repeatability: Option<RepeatabilityBody>,
}

impl From<FlashAccount> for FlashAccountBody {
    fn from(account: FlashAccount) -> Self {
        let FlashAccount { scale, trend, repeatability } = account;
        Self {
            words: trend.words(),
            advice: trend
                .advice
                .into_iter()
                .map(|a| AdviceBody { code: a.code, sentence: a.sentence })
                .collect(),
            pairs: trend.pairs,
            proven: trend.proven,
            misfires: trend.misfires,
            reference: scale.reference.map(|r| ReferenceBody { counts: r.counts, source: r.source }),
            spread: trend.spread,
            recharge_loss: trend.recharge_loss,
            heat_loss: trend.heat_loss,
            droop: trend.droop,
            pulses: trend
                .pulses
                .into_iter()
                .map(|p| PulseBody {
                    pair: p.pair,
                    at: p.at,
                    rest_s: p.rest,
                    energy_counts: p.energy_counts,
                    gain: p.gain,
                    deviation: p.deviation,
                })
                .collect(),
            repeatability: repeatability.map(Into::into),
        }
    }
}

/// A repeatability run.
#[derive(Deserialize, Serialize, ToSchema)]
#[serde(default, deny_unknown_fields)]
pub(super) struct RepeatabilityOrder {
    /// How many shots, each a frame without flash and one with it: 8 to 1000.
    pub(super) shots: usize,
}

impl Default for RepeatabilityOrder {
    /// As many as the thesis took.
    fn default() -> Self {
        Self { shots: 40 }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::calibration::{SteadyShot, steadiness};

    #[test]
    fn a_run_without_measured_energies_has_no_corrected_figures() {
        let told = |energy_counts: Option<f64>| {
            let shot = |k: u8| SteadyShot {
                light_dn: [100.0 + f64::from(k); 3],
                energy_counts,
                dark_energy_counts: energy_counts.map(|_| 1.0),
                ..SteadyShot::default()
            };
            RepeatabilityBody::from(steadiness((0..8).map(shot).collect()).unwrap())
        };
        let unknown = told(None);
        assert!(unknown.spread > 0.0);
        assert_eq!((unknown.corrected, unknown.corrected_error, unknown.reading_noise), (None, None, None));
        let known = told(Some(500.0));
        assert!(known.corrected.is_some() && known.corrected_error.is_some());
        assert_eq!(known.reading_noise, Some(1.0 / 500.0));
    }
}
