//! A trial of controller, flash and photodiode: fires some times and tells what came.

use super::pulse::{self, Placement};
use super::settings::BoardSettings;
use super::{ClockState, SerialFlash};
use crate::pair::{FlashSync, SyncSource};
use crate::rig::{Flash, FlashError};
use serde::Serialize;
use std::time::Duration;

/// How long the report of a shot may take: the longest lock time, and the wire.
const REPORT: Duration = Duration::from_secs(2);
/// Readings that make up the dark level.
const READINGS: u32 = 16;

/// Who and how it stands before the first shot.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct BeforeTrial {
    /// Firmware, processor, port.
    pub description: String,
    /// Settings in force.
    pub settings: Option<BoardSettings>,
    /// What the photodiode sees of the room, mean of some readings, counts of 1023.
    pub dark_counts: f64,
    /// How its clock runs.
    pub clock: Option<ClockState>,
}

/// One pulse.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct TrialShot {
    /// The board's figures.
    pub sync: FlashSync,
    /// Time above the light threshold, ms.
    pub width_ms: f64,
    /// How well the photodiode stands.
    pub placement: Placement,
    /// What to do.
    pub advice: String,
}

/// How the energies repeat.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Repeatability {
    /// Mean energy, counts.
    pub mean_counts: f64,
    /// Standard deviation over the mean.
    pub sd_relative: f64,
}

/// Everything that came of a trial.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Trial {
    /// What it was like before.
    pub before: BeforeTrial,
    /// The pulses, in order.
    pub shots: Vec<TrialShot>,
    /// Of three measured pulses or more.
    pub repeatability: Option<Repeatability>,
}

impl Trial {
    /// Whether every shot gave light.
    pub fn saw_light(&self) -> bool {
        !self.shots.is_empty() && self.shots.iter().all(|shot| shot.placement != Placement::Dark)
    }
}

/// Looks at the board; nothing fires.
pub fn before(flash: &mut SerialFlash) -> Result<BeforeTrial, FlashError> {
    let mut sum = 0;
    for _ in 0..READINGS {
        sum += flash.light_level()?;
    }
    Ok(BeforeTrial {
        description: flash.description(),
        settings: flash.settings(),
        dark_counts: f64::from(sum) / f64::from(READINGS),
        clock: flash.clock(),
    })
}

/// Fires `shots` times, each as soon as the flash has recycled; `tell` hears of each pulse.
pub fn run(
    flash: &mut SerialFlash,
    before: BeforeTrial,
    shots: u32,
    mut tell: impl FnMut(&TrialShot),
) -> Result<Trial, FlashError> {
    let mut taken = Vec::new();
    for tag in 1..=shots {
        let sync = fire_once(flash, tag)?;
        let shot = TrialShot {
            sync,
            width_ms: pulse::width_ms(&sync),
            placement: pulse::placement(&sync),
            advice: pulse::advice(&sync),
        };
        tell(&shot);
        taken.push(shot);
    }
    let syncs: Vec<FlashSync> = taken.iter().map(|shot| shot.sync).collect();
    let repeatability = pulse::repeatability(&syncs)
        .map(|(mean_counts, sd_relative)| Repeatability { mean_counts, sd_relative });
    Ok(Trial { before, shots: taken, repeatability })
}

fn fire_once(flash: &mut SerialFlash, tag: u32) -> Result<FlashSync, FlashError> {
    flash.disarm()?;
    flash.syncs(Duration::ZERO)?;
    flash.fire(tag, Duration::ZERO)?;
    let own = |sync: &&FlashSync| sync.source == SyncSource::Command && sync.tag == tag;
    let syncs = flash.syncs(REPORT)?;
    syncs.iter().find(own).copied().ok_or_else(|| FlashError::Silent {
        port: flash.port.clone(),
        request: "fire with a report of the shot".into(),
    })
}
