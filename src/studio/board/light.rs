//! The simulated flash and the photodiode that watches it.
//!
//! The flash gives its nominal energy times 1 + jitter; before it has recycled it gives nothing. Its light decays
//! exponentially; the diode's RC smooths it, so that the board sees A (exp(-t/T1) - exp(-t/T2)), whose integral is
//! proportional to the energy. With the noise below the board's own figure repeats to about 0.05 %.

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use std::time::Duration;

/// Decay of the flash, seconds.
const FLASH_DECAY: f64 = 1.2e-3;
/// Time constant of the diode's RC, seconds.
const DIODE_RC: f64 = 0.7e-3;
/// Amplitude for a peak of about 600 of 1023 counts at nominal energy.
const AMPLITUDE: f64 = 3060.0;
/// Dark level of the diode in the studio's room light, counts.
const DARK: f64 = 12.3;
/// Noise of one sample, counts.
const NOISE: f64 = 0.5;

/// The flash head.
pub(super) struct Lamp {
    random: ChaCha8Rng,
    jitter_sd: f64,
    recycle_us: u64,
    fired_at: Option<u64>,
    misfires: u32,
}

impl Lamp {
    pub(super) fn new(seed: u64, jitter_sd: f64, recycle: Duration) -> Self {
        Self {
            random: ChaCha8Rng::seed_from_u64(seed),
            jitter_sd,
            recycle_us: recycle.as_micros() as u64,
            fired_at: None,
            misfires: 0,
        }
    }

    /// The next `count` triggers give no light.
    pub(super) fn misfire(&mut self, count: u32) {
        self.misfires = count;
    }

    /// The trigger rises at `now_us`. Returns the energy relative to nominal.
    pub(super) fn trigger(&mut self, now_us: u64) -> f64 {
        if self.misfires > 0 {
            self.misfires -= 1;
            return 0.0;
        }
        if self.fired_at.is_some_and(|at| now_us < at + self.recycle_us) {
            return 0.0;
        }
        self.fired_at = Some(now_us);
        let gauss: f64 = StandardNormal.sample(&mut self.random);
        (1.0 + self.jitter_sd * gauss).max(0.0)
    }
}

/// The photodiode at the board's ADC.
pub(super) struct Diode {
    random: ChaCha8Rng,
    pulse: Option<(u64, f64)>,
}

impl Diode {
    pub(super) fn new(seed: u64) -> Self {
        Self { random: ChaCha8Rng::seed_from_u64(seed), pulse: None }
    }

    /// A pulse of `energy` starts.
    pub(super) fn light(&mut self, at_us: u64, energy: f64) {
        self.pulse = Some((at_us, energy));
    }

    /// What the ADC converts at `now_us`, in counts.
    pub(super) fn sample(&mut self, now_us: u64) -> u16 {
        let light = self.pulse.filter(|(at, _)| now_us >= *at).map_or(0.0, |(at, energy)| {
            let t = (now_us - at) as f64 * 1e-6;
            energy * AMPLITUDE * ((-t / FLASH_DECAY).exp() - (-t / DIODE_RC).exp())
        });
        let gauss: f64 = StandardNormal.sample(&mut self.random);
        (DARK + light + NOISE * gauss).round().clamp(0.0, 1023.0) as u16
    }
}
