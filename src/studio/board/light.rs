//! The simulated flash and the photodiode that watches it.
//!
//! The flash gives its nominal energy times 1 + jitter; before it has recycled it gives nothing. With [`LampOptions`]
//! it also behaves like a real one: pulse number n (from 0), at power p = 2^-stops, gives
//!
//! `E = p (1 + jitter) (1 - a p' exp(-dt / tau)) (1 - k h) max(0, 1 - b n)`
//!
//! with dt the rest since the pulse before and p' that pulse's power (its capacitor charges exponentially and lacks a
//! share a p' right after a pulse), h the heat (each pulse adds its p, and it falls by exp(-dt / T)), b the battery's
//! droop a shot. Where h exceeds a limit the flash protects itself and does not fire. The lamp's clock may run faster
//! than the room's, so that a test need not wait for minutes of cooling; recycling keeps the room's time, as the board
//! does.
//!
//! Its light decays exponentially; the diode's RC smooths it, so that the board sees A (exp(-t/T1) - exp(-t/T2)), whose
//! integral is proportional to the energy. With the noise below the board's own figure repeats to about 0.05 %.

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

/// A capacitor that is not full again at once.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Recharge {
    /// Share of the energy that lacks right after a full pulse, 0 to 1.
    pub lacking: f64,
    /// Time constant of charging.
    pub tau: Duration,
}

/// A tube that warms up.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Heat {
    /// Time constant of cooling.
    pub cooling: Duration,
    /// Relative loss of energy per unit of heat, the heat of one full pulse.
    pub loss: f64,
    /// Heat above which the flash does not fire.
    pub limit: f64,
}

/// What makes one pulse of the simulated flash differ from the next, beside its jitter. The default is nothing.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LampOptions {
    /// The capacitor.
    pub recharge: Option<Recharge>,
    /// The tube.
    pub heat: Option<Heat>,
    /// The battery: relative loss of energy a shot.
    pub droop: f64,
    /// How many times faster the lamp's clock runs than the room's.
    pub clock: f64,
}

impl Default for LampOptions {
    fn default() -> Self {
        Self { recharge: None, heat: None, droop: 0.0, clock: 1.0 }
    }
}

impl LampOptions {
    /// What is wrong with them, in words.
    pub(super) fn check(&self) -> Result<(), &'static str> {
        let recharges =
            self.recharge.is_none_or(|r| (0.0..=1.0).contains(&r.lacking) && r.tau > Duration::ZERO);
        let cools = self.heat.is_none_or(|h| h.cooling > Duration::ZERO && h.loss >= 0.0 && h.limit > 0.0);
        if !recharges {
            return Err("recharge of the simulated flash: a share in 0..=1 and a time constant above 0");
        }
        if !cools {
            return Err("heat of the simulated flash: time constant and limit above 0, loss not below 0");
        }
        if !((0.0..1.0).contains(&self.droop) && self.clock > 0.0 && self.clock.is_finite()) {
            return Err("droop of the simulated flash: a share in 0..1; its clock's factor: above 0");
        }
        Ok(())
    }
}

/// The flash head.
pub(super) struct Lamp {
    random: ChaCha8Rng,
    jitter_sd: f64,
    recycle_us: u64,
    options: LampOptions,
    /// Energy of a pulse at the power set, relative to full power.
    power: f64,
    fired_at: Option<u64>,
    /// Power of the pulse at `fired_at`.
    fired_with: f64,
    /// Heat right after that pulse, in full pulses.
    heat: f64,
    shots: u32,
    misfires: u32,
}

impl Lamp {
    pub(super) fn new(seed: u64, jitter_sd: f64, recycle: Duration, options: LampOptions) -> Self {
        Self {
            random: ChaCha8Rng::seed_from_u64(seed),
            jitter_sd,
            recycle_us: recycle.as_micros() as u64,
            options,
            power: 1.0,
            fired_at: None,
            fired_with: 0.0,
            heat: 0.0,
            shots: 0,
            misfires: 0,
        }
    }

    /// The operator sets the power to so many stops below full.
    pub(super) fn set_power(&mut self, stops: f64) {
        self.power = (-stops).exp2().min(1.0);
    }

    /// Time since the last pulse by the lamp's own clock, seconds; infinite before the first.
    fn rest(&self, now_us: u64) -> f64 {
        self.fired_at.map_or(f64::INFINITY, |at| now_us.saturating_sub(at) as f64 * 1e-6 * self.options.clock)
    }

    /// Share of its energy that a pulse now has for what came before it.
    fn condition(&self, rest: f64, heat: f64) -> f64 {
        let charge = self.options.recharge.map_or(1.0, |recharge| {
            1.0 - recharge.lacking * self.fired_with * (-rest / recharge.tau.as_secs_f64()).exp()
        });
        let coolness = self.options.heat.map_or(1.0, |option| (1.0 - option.loss * heat).max(0.0));
        let battery = (1.0 - self.options.droop * f64::from(self.shots)).max(0.0);
        charge * coolness * battery
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
        let rest = self.rest(now_us);
        let heat = self.options.heat.map_or(0.0, |h| self.heat * (-rest / h.cooling.as_secs_f64()).exp());
        if self.options.heat.is_some_and(|option| heat > option.limit) {
            return 0.0;
        }
        let condition = self.power * self.condition(rest, heat);
        self.fired_at = Some(now_us);
        self.fired_with = self.power;
        self.heat = heat + self.power;
        self.shots += 1;
        let gauss: f64 = StandardNormal.sample(&mut self.random);
        (1.0 + self.jitter_sd * gauss).max(0.0) * condition
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

#[cfg(test)]
mod tests {
    use super::*;

    /// A lamp without jitter, and its energies at the given times in seconds.
    fn energies(options: LampOptions, at: &[f64]) -> Vec<f64> {
        let mut lamp = Lamp::new(1, 0.0, Duration::from_millis(100), options);
        at.iter().map(|t| lamp.trigger((t * 1e6) as u64)).collect()
    }

    fn close(found: &[f64], expected: &[f64]) {
        assert_eq!(found.len(), expected.len());
        assert!(found.iter().zip(expected).all(|(f, e)| (f - e).abs() < 1e-9), "{found:?} for {expected:?}");
    }

    #[test]
    fn a_capacitor_lacks_less_the_longer_it_rests() {
        let recharge = Recharge { lacking: 0.2, tau: Duration::from_secs(2) };
        let options = LampOptions { recharge: Some(recharge), ..LampOptions::default() };
        let lacks = |rest: f64| 1.0 - 0.2 * (-rest / 2.0_f64).exp();
        close(&energies(options, &[0.0, 1.0, 4.0]), &[1.0, lacks(1.0), lacks(3.0)]);
        let fast = LampOptions { clock: 10.0, ..options };
        close(&energies(fast, &[0.0, 1.0]), &[1.0, lacks(10.0)]);
    }

    #[test]
    fn a_hot_tube_gives_less_refuses_in_the_end_and_cools() {
        let heat = Heat { cooling: Duration::from_secs(60), loss: 0.01, limit: 2.5 };
        let options = LampOptions { heat: Some(heat), ..LampOptions::default() };
        let cooled = |h: f64, rest: f64| h * (-rest / 60.0_f64).exp();
        let second = cooled(1.0, 1.0);
        let third = cooled(1.0 + second, 1.0);
        let given = energies(options, &[0.0, 1.0, 2.0, 3.0, 4.0, 63.0]);
        close(&given[..3], &[1.0, 1.0 - 0.01 * second, 1.0 - 0.01 * third]);
        close(&given[3..], &[0.0, 0.0, 1.0 - 0.01 * cooled(1.0 + third, 61.0)]);
    }

    #[test]
    fn a_battery_droops_shot_by_shot_and_power_steps_halve() {
        let options = LampOptions { droop: 0.001, ..LampOptions::default() };
        close(&energies(options, &[0.0, 1.0, 2.0]), &[1.0, 0.999, 0.998]);
        let recharge = Recharge { lacking: 0.2, tau: Duration::from_secs(1) };
        let options = LampOptions { recharge: Some(recharge), ..LampOptions::default() };
        let mut lamp = Lamp::new(1, 0.0, Duration::from_millis(100), options);
        lamp.set_power(2.0);
        let lacks = 0.25 * (1.0 - 0.2 * 0.25 * (-1.0_f64).exp());
        close(&[lamp.trigger(0), lamp.trigger(1_000_000)], &[0.25, lacks]);
    }

    #[test]
    fn options_that_no_flash_has_are_refused() {
        let wrong = [
            LampOptions { clock: 0.0, ..LampOptions::default() },
            LampOptions { droop: -0.1, ..LampOptions::default() },
            LampOptions {
                recharge: Some(Recharge { lacking: 1.5, tau: Duration::from_secs(1) }),
                ..LampOptions::default()
            },
        ];
        assert!(
            LampOptions::default().check().is_ok() && wrong.iter().all(|options| options.check().is_err())
        );
    }
}
