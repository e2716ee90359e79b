//! The measured steps as a look-up table for whoever scales light from one setting to another.

use super::ladder::key;
use super::{ExposureFit, Setting};
use crate::calibration::{OtherRig, Record};
use crate::pair::Settings;
use crate::photometry::apex::{ExposureScale, Nominal};
use crate::units::{FNumber, Iso, Seconds};
use std::collections::BTreeMap;

/// What a body's labels really do, label by label, nothing interpolated. A label that was not measured keeps its
/// nominal meaning.
///
/// Ratios of two measured labels are those measured. A ladder tells no label's absolute meaning, so each ladder stands
/// such that its mean deviation (in stops) is 0: a ratio of a measured to an unmeasured label then errs by the latter's
/// own deviation alone.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ExposureTable {
    /// Measured over nominal light, by setting and step.
    corrections: BTreeMap<(Setting, i64), f64>,
}

/// Where a ratio of two exposures comes from.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum ScaleSource {
    /// The labels are the same, or none is told: there is nothing to scale.
    Same,
    /// Every label that differs was measured.
    Measured,
    /// At least one that differs was not: its nominal meaning stands in.
    Nominal,
}

impl ExposureTable {
    /// The table of a fit; of several ladders of one setting that can be used, the longest counts. `same_lens`: whether the photographs
    /// that it is for were taken through the lens of the fit; if not, its apertures are not used.
    pub fn of(fit: &ExposureFit, same_lens: bool) -> Self {
        let mut corrections = BTreeMap::new();
        for setting in Setting::ALL {
            if setting == Setting::Aperture && !same_lens {
                continue;
            }
            let own = fit.ladders.iter().filter(|l| l.setting == setting && l.not_used.is_none());
            let Some(ladder) = own.max_by_key(|ladder| ladder.steps.len()) else { continue };
            let logs: Vec<f64> = ladder.steps.iter().map(|step| step.deviation.ln_1p()).collect();
            let mean = logs.iter().sum::<f64>() / logs.len().max(1) as f64;
            for (step, log) in ladder.steps.iter().zip(logs) {
                corrections.insert((setting, key(setting, step.label)), (log - mean).exp());
            }
        }
        Self { corrections }
    }

    /// The table for frames with these settings. Refused for another body; through another lens the apertures are left
    /// out, whose steps are the lens's.
    pub fn for_frame(record: &Record<ExposureFit>, settings: &Settings) -> Result<Self, OtherRig> {
        let of = "the exposure calibration";
        record.rig.same_body(settings, of)?;
        Ok(Self::of(&record.fit, record.rig.same_lens(settings, of).is_ok()))
    }

    /// Where the ratio of these two exposures comes from.
    pub fn source(&self, one: &Settings, other: &Settings) -> ScaleSource {
        let mut source = ScaleSource::Same;
        for setting in Setting::ALL {
            let labels = (setting.label(one), setting.label(other));
            let (Some(a), Some(b)) = (labels.0.map(|l| key(setting, l)), labels.1.map(|l| key(setting, l)))
            else {
                continue;
            };
            if a == b {
                continue;
            }
            if [a, b].iter().any(|step| !self.corrections.contains_key(&(setting, *step))) {
                return ScaleSource::Nominal;
            }
            source = ScaleSource::Measured;
        }
        source
    }

    fn correction(&self, setting: Setting, label: f64) -> f64 {
        self.corrections.get(&(setting, key(setting, label))).copied().unwrap_or(1.0)
    }
}

impl ExposureScale for ExposureTable {
    fn time(&self, shutter: Seconds) -> f64 {
        Nominal.time(shutter) * self.correction(Setting::Shutter, shutter.0)
    }

    fn aperture(&self, aperture: FNumber) -> f64 {
        Nominal.aperture(aperture) * self.correction(Setting::Aperture, aperture.0)
    }

    fn gain(&self, iso: Iso) -> f64 {
        Nominal.gain(iso) * self.correction(Setting::Iso, iso.0)
    }
}
