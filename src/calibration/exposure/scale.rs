//! The measured steps as a look-up table: nothing is put in between.

use super::ladder::key;
use super::{ExposureCalibration, Setting};
use crate::calibration::{OtherRig, Record};
use crate::pair::Settings;
use crate::photometry::apex::{ExposureScale, Nominal};
use crate::units::{FNumber, Iso, Seconds};
use std::collections::BTreeMap;

/// How light scales by a body's measured steps; labels that were not measured mean what they stand for.
///
/// Only ratios of two settings count. What is known of a ladder is one step against another, so that its deviations are
/// taken from their own (geometric) mean: then a ratio of a measured label and one that was not is off the least. Of
/// several ladders of one setting the one with the most steps counts.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct MeasuredScale {
    /// By setting and step: what the label's nominal light is multiplied by.
    factors: BTreeMap<(Setting, i64), f64>,
}

impl MeasuredScale {
    /// The table of a calibration.
    pub fn of(calibration: &ExposureCalibration) -> Self {
        let mut factors = BTreeMap::new();
        for setting in Setting::ALL {
            let ladders = calibration.ladders.iter().filter(|l| l.setting == setting);
            let Some(ladder) = ladders.max_by_key(|l| l.steps.len()) else { continue };
            let sane = |d: f64| d.is_finite() && d > -1.0;
            let steps = || ladder.steps.iter().filter(|s| sane(s.deviation));
            let n = steps().count().max(1) as f64;
            let mean = steps().map(|s| s.deviation.ln_1p()).sum::<f64>() / n;
            factors
                .extend(steps().map(|s| ((setting, key(setting, s.label)), (s.deviation.ln_1p() - mean).exp())));
        }
        Self { factors }
    }

    /// The table for frames with these settings. Refused for another body; through another lens the apertures are left
    /// out, whose steps are the lens's.
    pub fn for_frame(record: &Record<ExposureCalibration>, settings: &Settings) -> Result<Self, OtherRig> {
        record.rig.same_body(settings, "the exposure calibration")?;
        let mut table = Self::of(&record.fit);
        if record.rig.same_lens(settings, "the exposure calibration").is_err() {
            table.factors.retain(|(setting, _), _| *setting != Setting::Aperture);
        }
        Ok(table)
    }

    /// Whether a label was measured.
    pub fn is_measured(&self, setting: Setting, label: f64) -> bool {
        self.factors.contains_key(&(setting, key(setting, label)))
    }

    fn factor(&self, setting: Setting, label: f64) -> f64 {
        self.factors.get(&(setting, key(setting, label))).copied().unwrap_or(1.0)
    }
}

impl ExposureScale for MeasuredScale {
    fn time(&self, shutter: Seconds) -> f64 {
        Nominal.time(shutter) * self.factor(Setting::Shutter, shutter.0)
    }

    fn aperture(&self, aperture: FNumber) -> f64 {
        Nominal.aperture(aperture) * self.factor(Setting::Aperture, aperture.0)
    }

    fn gain(&self, iso: Iso) -> f64 {
        Nominal.gain(iso) * self.factor(Setting::Iso, iso.0)
    }
}
