//! What the photodiode's figures of a pulse mean, and how well it stands.

use crate::pair::FlashSync;
use serde::Serialize;

/// Time between two samples of the board, us (`firmware/PROTOCOL.md`).
pub(super) const SAMPLE_US: f64 = 13.0;
/// Peaks in which noise and the converter's end are both far away, counts above dark.
const GOOD_PEAK: std::ops::RangeInclusive<f64> = 300.0..=800.0;
/// The converter's end, counts.
const FULL: f64 = 1023.0;
/// Room light beyond this share of the converter leaves the flash too little of it.
const BRIGHT_ROOM: f64 = 0.25;

/// How long the pulse was above the light threshold, ms.
pub fn width_ms(sync: &FlashSync) -> f64 {
    f64::from(sync.lit_samples) * SAMPLE_US * 1e-3
}

/// How well the photodiode stands.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Placement {
    /// No light came.
    Dark,
    /// The converter clipped: the energy is not known.
    Clipped,
    /// Clipping is near.
    High,
    /// As it should be.
    Good,
    /// Noise weighs more than it must.
    Low,
}

/// Judges one pulse.
pub fn placement(pulse: &FlashSync) -> Placement {
    match pulse.peak_counts {
        _ if pulse.light().is_none() => Placement::Dark,
        _ if pulse.clipped_samples > 0 => Placement::Clipped,
        peak if peak > *GOOD_PEAK.end() => Placement::High,
        peak if peak < *GOOD_PEAK.start() => Placement::Low,
        _ => Placement::Good,
    }
}

/// What it means and what to do.
pub fn advice(pulse: &FlashSync) -> String {
    let peak = pulse.peak_counts;
    let sentence = match placement(pulse) {
        Placement::Dark => {
            "No light was seen: is the flash on, charged and connected to the trigger output, and does the photodiode \
             look at it?"
                .into()
        }
        Placement::Clipped => format!(
            "The photodiode clipped in {} samples, so the energy is not known: move it away from the flash, or use a \
             smaller resistor.",
            pulse.clipped_samples
        ),
        Placement::High => format!(
            "The peak of {peak:.0} is close to the end at 1023: move the photodiode a little away from the flash \
             (300 to 800 is ideal)."
        ),
        Placement::Low => format!(
            "The peak of {peak:.0} is low, so noise weighs more than it must: move the photodiode nearer to the flash, \
             or use a larger resistor (300 to 800 is ideal)."
        ),
        Placement::Good => "The photodiode stands well.".into(),
    };
    if pulse.dark_counts > BRIGHT_ROOM * FULL {
        return format!(
            "{sentence} The room alone gives {:.0} of 1023 counts: shield the photodiode from it.",
            pulse.dark_counts
        );
    }
    sentence
}

/// Mean of the measured energies and their standard deviation relative to it; `None` for fewer than three.
pub fn repeatability(pulses: &[FlashSync]) -> Option<(f64, f64)> {
    let energies: Vec<f64> = pulses.iter().filter_map(FlashSync::measured).collect();
    if energies.len() < 3 {
        return None;
    }
    let mean = energies.iter().sum::<f64>() / energies.len() as f64;
    let squares: f64 = energies.iter().map(|e| (e - mean).powi(2)).sum();
    Some((mean, (squares / (energies.len() as f64 - 1.0)).sqrt() / mean))
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use crate::pair::SyncSource;

    pub(crate) fn pulse(peak: f64) -> FlashSync {
        FlashSync {
            number: 1,
            source: SyncSource::Command,
            triggered: true,
            tag: 1,
            at: None,
            energy_counts: 100.0 * peak,
            peak_counts: peak,
            dark_counts: 12.0,
            lit_samples: if peak > 8.0 { 200 } else { 0 },
            clipped_samples: u32::from(peak + 12.0 >= FULL) * 9,
            bounces: 0,
        }
    }

    #[test]
    fn the_peak_says_how_the_photodiode_stands() {
        for (peak, expected) in [
            (2.0, Placement::Dark),
            (60.0, Placement::Low),
            (300.0, Placement::Good),
            (600.0, Placement::Good),
            (900.0, Placement::High),
            (1011.0, Placement::Clipped),
        ] {
            assert_eq!(placement(&pulse(peak)), expected, "{peak}");
        }
        assert!(advice(&pulse(1011.0)).contains("smaller resistor"));
        assert!(
            advice(&FlashSync { dark_counts: 400.0, ..pulse(500.0) }).contains("The room alone gives 400")
        );
    }

    #[test]
    fn repeatability_wants_three_measured_pulses() {
        let pulses = [pulse(500.0), pulse(510.0), pulse(490.0)];
        let (mean, sd) = repeatability(&pulses).unwrap();
        assert!((mean - 50_000.0).abs() < 1e-6 && (sd - 0.02).abs() < 1e-9, "{mean} {sd}");
        assert_eq!(repeatability(&[pulse(500.0), pulse(500.0), pulse(1011.0)]), None);
    }

    #[test]
    fn the_width_is_the_time_above_the_threshold() {
        assert!((width_ms(&pulse(500.0)) - 2.6).abs() < 1e-9);
    }
}
