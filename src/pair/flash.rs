//! What the flash controller saw of a pair: every closing of the sync contact, lit or dark, with the light that
//! its photodiode measured. `firmware/PROTOCOL.md` says how the board comes by each figure.

use serde::{Deserialize, Serialize};

/// Least samples above the threshold that a pulse has: a quarter of a millisecond, half the shortest time constant of
/// the photodiode's circuit. Fewer are a spark of interference.
const LEAST_LIT_SAMPLES: u32 = 20;
/// Least mean light of those samples, counts, all other light of the window counted in. A pulse's are 8 counts (the
/// board's threshold) above dark each, and the rest of its window is dark; the flicker of a lamp is as often below its
/// mean as above.
const LEAST_MEAN_COUNTS: f64 = 6.0;

/// What set a shot of the controller off.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum SyncSource {
    /// The camera's sync contact closed.
    Contact,
    /// The host told the controller to fire.
    Command,
}

/// One closing of the camera's sync contact (or one fire on command), as the controller saw it.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct FlashSync {
    /// Running number on the board since its boot, from 1.
    pub number: u32,
    /// What set it off.
    pub source: SyncSource,
    /// Whether the board let it through to the flash.
    pub triggered: bool,
    /// Tag given when arming; 0 for a sync that found the gate closed.
    pub tag: u32,
    /// When, UTC seconds since 1970, by the fit of the board's clock to the host's; absent before there is one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub at: Option<f64>,
    /// Light above the dark level, counts summed over the window. Of a dark sync it is noise of either sign.
    pub energy_counts: f64,
    /// Highest sample above the dark level, counts.
    pub peak_counts: f64,
    /// Dark level before the sync, counts.
    pub dark_counts: f64,
    /// Samples above the light threshold. Interference and the room's flicker give some, too: see
    /// [`FlashSync::light`].
    pub lit_samples: u32,
    /// Samples at the converter's end, whose light is not known: the energy is too low then.
    pub clipped_samples: u32,
    /// Further edges that were swallowed as bounce of the contact.
    pub bounces: u32,
}

impl FlashSync {
    /// Energy of the pulse in counts; `None` when what was seen, if anything, was no pulse.
    pub fn light(&self) -> Option<f64> {
        let pulse = self.lit_samples >= LEAST_LIT_SAMPLES
            && self.energy_counts >= LEAST_MEAN_COUNTS * f64::from(self.lit_samples);
        pulse.then_some(self.energy_counts)
    }

    /// [`FlashSync::light`] if it can be measured with: the converter did not clip.
    pub fn measured(&self) -> Option<f64> {
        self.light().filter(|_| self.clipped_samples == 0)
    }
}

/// What the flash controller saw of a pair.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct FlashRecord {
    /// Syncs of the unlit frame; one that was not let through.
    pub off: Vec<FlashSync>,
    /// Syncs of the lit frame; one that was.
    pub on: Vec<FlashSync>,
}

impl FlashRecord {
    /// How often the flash was triggered for the unlit frame; must be 0.
    pub fn pulses_off(&self) -> usize {
        self.off.iter().filter(|sync| sync.triggered).count()
    }

    /// How often the flash was triggered for the lit frame; must be 1.
    pub fn pulses_on(&self) -> usize {
        self.on.iter().filter(|sync| sync.triggered).count()
    }

    /// The pulse that lit the lit frame, if there was exactly one.
    pub fn pulse(&self) -> Option<&FlashSync> {
        let mut triggered = self.on.iter().filter(|sync| sync.triggered);
        triggered.next().filter(|_| triggered.next().is_none())
    }

    /// Whether the photodiode saw the pulse of the lit frame, measured or not.
    pub fn saw_light(&self) -> bool {
        self.pulse().is_some_and(|pulse| pulse.light().is_some())
    }

    /// What the account proves, in one sentence.
    pub fn words(&self) -> String {
        let dark = match (self.off.len(), self.off.iter().any(|s| s.triggered || s.light().is_some())) {
            (0, _) => "nothing proves the frame without flash dark",
            (_, true) => "light fell on the frame without flash",
            (_, false) => "the frame without flash is proven dark",
        };
        let lit = match (self.pulses_on(), self.pulse()) {
            (1, Some(pulse)) => match (pulse.light(), pulse.clipped_samples) {
                (Some(energy), 0) => format!("one pulse of {energy:.0} counts lit the other"),
                (Some(_), _) => "one pulse lit the other, too bright for the photodiode to measure".into(),
                (None, _) => "one trigger for the other, whose light the photodiode did not see".into(),
            },
            (0, _) => "no trigger came for the other".into(),
            (n, _) => format!("{n} triggers came for the other"),
        };
        format!("Controller: {dark}; {lit}.")
    }

    /// Energy of that pulse in the board's counts, where it was measured.
    pub fn energy_counts(&self) -> Option<f64> {
        self.pulse().and_then(FlashSync::measured)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// What the board would report of light that varies like this over the samples of a window.
    fn seen(light: impl Fn(f64) -> f64) -> FlashSync {
        let samples: Vec<f64> = (0..1538).map(|i| light(f64::from(i) * 13e-6)).collect();
        FlashSync {
            number: 1,
            source: SyncSource::Contact,
            triggered: false,
            tag: 0,
            at: None,
            energy_counts: samples.iter().sum(),
            peak_counts: samples.iter().copied().fold(0.0, f64::max),
            dark_counts: 20.0,
            lit_samples: samples.iter().filter(|v| **v > 8.0).count() as u32,
            clipped_samples: 0,
            bounces: 0,
        }
    }

    #[test]
    fn a_pulse_is_light_and_flicker_and_sparks_are_not() {
        let pulse = |peak: f64| move |t: f64| 5.1 * peak * ((-t / 1.2e-3).exp() - (-t / 0.7e-3).exp());
        for peak in [12.0, 40.0, 600.0] {
            assert!(seen(pulse(peak)).light().is_some(), "peak {peak}: {:?}", seen(pulse(peak)));
        }
        assert_eq!(seen(|t| if t < 30e-6 { 900.0 } else { 0.0 }).light(), None, "a spark");
        for hertz in [100.0, 120.0] {
            for start in 0..8 {
                let phase = f64::from(start) * std::f64::consts::FRAC_PI_4;
                let flicker = |t: f64| 15.0 * (2.0 * std::f64::consts::PI * hertz * t + phase).sin();
                assert!(seen(flicker).lit_samples > 300);
                assert_eq!(seen(flicker).light(), None, "{hertz} Hz, {start}");
            }
        }
    }
}
