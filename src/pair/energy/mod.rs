//! How much light the flash gave, pair by pair: what the photodiode's readings are worth, and how they change over a
//! session.
//!
//! A reading `e` is the sum of the samples of one window less the dark level times their number, in counts of the
//! controller's converter. Its error does not depend on the pulse (sampling noise, the dark level's own error, what
//! the room's light does within the window), so that the readings of dark syncs, which are that error and nothing
//! else, measure it: `sigma_e^2 = mean e_dark^2`. The pair's gain is `g = e / e_ref`; the known light of the pair
//! divided by `g` is what a flash of the reference energy would have given.

mod fit;
mod trend;

pub use trend::{Advice, AdviceCode, Trend, TrendPulse, trend};

use super::{FlashRecord, FlashSync};
use crate::photometry::FlashGain;
use serde::{Deserialize, Serialize};

/// Relative deviation granted to a reading before dark syncs have been seen, as the firmware's tests bound it.
const PRIOR_DEVIATION: f64 = 0.0006;
/// Dark syncs that the prior counts as.
const PRIOR_WEIGHT: f64 = 4.0;

/// Where the reference energy comes from.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ReferenceSource {
    /// The pulses of the flash calibration's card shots: gains tie the pairs to the calibration.
    Calibration,
    /// The median of the session's own pairs: gains take the flash's unsteadiness out, but what it gave beside the
    /// calibration is not known.
    Session,
}

/// The energy that has gain 1.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Reference {
    /// Counts.
    pub counts: f64,
    /// Where it comes from.
    pub source: ReferenceSource,
}

/// What one session knows of its flash's energy.
#[derive(Clone, Debug, PartialEq)]
pub struct EnergyScale {
    /// The energy that has gain 1; absent where nothing was measured.
    pub reference: Option<Reference>,
    /// Standard deviation of one reading, counts.
    pub reading_deviation: f64,
    /// Relative deviation of the light from the reading, as a repeatability run measured it.
    pub agreement: Option<f64>,
    /// Mean and standard deviation of the gains measured.
    usual: Option<FlashGain>,
}

/// The median; `None` of nothing.
pub fn median(values: &[f64]) -> Option<f64> {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    sorted.get(sorted.len() / 2).copied()
}

/// Mean and standard deviation (n - 1) of two values or more.
fn mean_and_deviation(values: &[f64]) -> Option<(f64, f64)> {
    let n = values.len() as f64;
    let mean = values.iter().sum::<f64>() / n;
    let variance = values.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / (n - 1.0);
    (values.len() > 1).then(|| (mean, variance.sqrt()))
}

/// Standard deviation of one reading in counts, from the dark syncs among `syncs`, all of them without light and
/// therefore of true energy 0. `typical` (counts) gives the prior its size.
pub fn reading_deviation<'a>(syncs: impl IntoIterator<Item = &'a FlashSync>, typical: f64) -> f64 {
    let (mut sum, mut weight) = (PRIOR_WEIGHT * (PRIOR_DEVIATION * typical).powi(2), PRIOR_WEIGHT);
    for sync in syncs.into_iter().filter(|sync| !sync.triggered && sync.light().is_none()) {
        sum += sync.energy_counts.powi(2);
        weight += 1.0;
    }
    (sum / weight).sqrt()
}

impl EnergyScale {
    /// From the controller's account of the session's accepted pairs; `calibration`: the mean energy of the flash
    /// calibration's shots in counts, where they were measured; `agreement`: see [`EnergyScale::agreement`].
    pub fn new<'a>(
        records: impl IntoIterator<Item = &'a FlashRecord> + Clone,
        calibration: Option<f64>,
        agreement: Option<f64>,
    ) -> Self {
        let energies: Vec<f64> = records.clone().into_iter().filter_map(FlashRecord::energy_counts).collect();
        let of = |source| move |counts| Reference { counts, source };
        let of_session = median(&energies).map(of(ReferenceSource::Session));
        let reference = calibration.map(of(ReferenceSource::Calibration)).or(of_session);
        let dark = records.into_iter().flat_map(|record| &record.off);
        let typical = of_session.or(reference).map_or(0.0, |r| r.counts);
        let reading_deviation = reading_deviation(dark, typical);
        let usual = reference.and_then(|reference| {
            let gains: Vec<f64> = energies.iter().map(|e| e / reference.counts).collect();
            let (value, deviation) = mean_and_deviation(&gains)?;
            Some(FlashGain { value, deviation })
        });
        Self { reference, reading_deviation, agreement, usual }
    }

    /// The gain that was measured of a pulse of `energy` counts.
    pub fn measured(&self, energy: f64) -> Option<FlashGain> {
        let reference = self.reference?;
        let value = energy / reference.counts;
        let reading = self.reading_deviation / reference.counts;
        let deviation = reading.hypot(self.agreement.unwrap_or(0.0) * value);
        Some(FlashGain { value, deviation })
    }

    /// The gain of a pair: as measured; where its pulse was not, the session's mean with the flash's own spread; where
    /// those are too few, 1 with the spread that strobes have.
    pub fn gain(&self, record: Option<&FlashRecord>) -> FlashGain {
        let energy = record.and_then(FlashRecord::energy_counts);
        energy.and_then(|e| self.measured(e)).or(self.usual).unwrap_or(FlashGain::UNMEASURED)
    }
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use crate::pair::SyncSource;

    pub(in crate::pair) fn sync(triggered: bool, energy: f64) -> FlashSync {
        FlashSync {
            number: 1,
            source: SyncSource::Contact,
            triggered,
            tag: u32::from(triggered),
            at: None,
            energy_counts: energy,
            peak_counts: 0.0,
            dark_counts: 12.0,
            lit_samples: if triggered { 200 } else { 0 },
            clipped_samples: 0,
            bounces: 0,
        }
    }

    fn pair(dark: f64, energy: f64) -> FlashRecord {
        FlashRecord { off: vec![sync(false, dark)], on: vec![sync(true, energy)] }
    }

    #[test]
    fn dark_syncs_measure_what_a_reading_is_worth() {
        let darks: Vec<FlashSync> =
            (0..400).map(|i| sync(false, if i % 2 == 0 { 40.0 } else { -40.0 })).collect();
        assert!((reading_deviation(&darks, 1e5) - 40.0).abs() < 1.0);
        assert!((reading_deviation([], 1e5) - 60.0).abs() < 1e-9, "the prior alone");
        let lit = sync(true, 1e5);
        assert!((reading_deviation([&lit], 1e5) - 60.0).abs() < 1e-9, "light is no noise");
    }

    #[test]
    fn gains_refer_to_the_calibration_where_its_pulses_were_measured() {
        let pairs = [pair(0.0, 1.02e5), pair(0.0, 1.0e5), pair(0.0, 0.98e5)];
        let own = EnergyScale::new(&pairs, None, None);
        assert_eq!(own.reference.unwrap().source, ReferenceSource::Session);
        assert!((own.gain(Some(&pairs[0])).value - 1.02).abs() < 1e-9);
        let tied = EnergyScale::new(&pairs, Some(2.0e5), Some(0.0004));
        let gain = tied.gain(Some(&pairs[1]));
        assert!((gain.value - 0.5).abs() < 1e-9);
        let reading = tied.reading_deviation / 2.0e5;
        assert!((gain.deviation - reading.hypot(0.0002)).abs() < 1e-9);
    }

    #[test]
    fn a_pair_without_a_reading_has_the_usual_gain_with_the_flashs_own_spread() {
        let mut pairs = vec![pair(0.0, 1.02e5), pair(0.0, 1.0e5), pair(0.0, 0.98e5)];
        let mut clipped = pair(0.0, 0.9e5);
        clipped.on[0].clipped_samples = 3;
        pairs.push(clipped);
        let scale = EnergyScale::new(&pairs, None, None);
        for record in [Some(&pairs[3]), None] {
            let gain = scale.gain(record);
            assert!((gain.value - 1.0).abs() < 1e-9 && (gain.deviation - 0.02).abs() < 1e-9, "{gain:?}");
        }
        assert_eq!(EnergyScale::new(&[], None, None).gain(None), FlashGain::UNMEASURED);
        let alone = EnergyScale::new(&pairs[..1], None, None);
        assert_eq!(alone.gain(None), FlashGain::UNMEASURED);
    }
}
