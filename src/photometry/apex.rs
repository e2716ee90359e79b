//! What exposure labels stand for, and how light scales with them (APEX; ISO 2720).
//!
//! Dials and EXIF carry rounded labels; shutters, diaphragms and amplifiers move in powers of two: 1/60 s is
//! 2^-6 s, f/11 is 2^(7/2), ISO 1000 is 100 * 2^(10/3). Takes labels, gives true values; whoever has measured
//! a body's own steps implements [`ExposureScale`] with them.

use crate::units::{FNumber, Iso, Seconds};
use serde::Serialize;

/// Largest distance in stops between a label and the step it stands for: 1/60 (0.093) is the worst in use.
const ROUNDING: f64 = 0.1;
/// Labels of half stops that lie as near to a third: no dial in thirds has them.
const HALF_STOPS: [f64; 2] = [1.5, 3.0];

/// How light becomes sensor values at given settings. The labels' nominal meaning unless a body was measured.
pub trait ExposureScale: std::fmt::Debug {
    /// Exposure time in seconds.
    fn time(&self, shutter: Seconds) -> f64;
    /// Light that the aperture lets through, 1 / N^2.
    fn aperture(&self, aperture: FNumber) -> f64;
    /// Amplification, proportional to ISO.
    fn gain(&self, iso: Iso) -> f64;

    /// S = t ISO / N^2: what steady light is scaled by.
    fn room(&self, shutter: Seconds, aperture: FNumber, iso: Iso) -> f64 {
        self.time(shutter) * self.flash(aperture, iso)
    }

    /// ISO / N^2: what a flash is scaled by, which is over before the shutter closes.
    fn flash(&self, aperture: FNumber, iso: Iso) -> f64 {
        self.gain(iso) * self.aperture(aperture)
    }
}

/// Third-stop (else half-stop) steps as the labels name them.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Nominal;

impl ExposureScale for Nominal {
    fn time(&self, shutter: Seconds) -> f64 {
        step(shutter.0.log2(), HALF_STOPS.contains(&shutter.0)).exp2()
    }

    fn aperture(&self, aperture: FNumber) -> f64 {
        (-step(2.0 * aperture.0.log2(), false)).exp2()
    }

    fn gain(&self, iso: Iso) -> f64 {
        100.0 * step((iso.0 / 100.0).log2(), false).exp2()
    }
}

/// The step in stops that a label of `stops` stands for: the third, else the half within rounding, else the
/// label itself.
fn step(stops: f64, half: bool) -> f64 {
    let nearest = |per_stop: f64| Some((stops * per_stop).round() / per_stop);
    let within = |step: &f64| (step - stops).abs() <= ROUNDING;
    let third = if half { None } else { nearest(3.0).filter(within) };
    third.or_else(|| nearest(2.0).filter(within)).unwrap_or(stops)
}

/// Reflected-light meter constant K in cd s / (m^2 ISO) of most makers (ISO 2720 allows 10.6 to 13.4).
pub const METER_CONSTANT: f64 = 12.5;

/// The additive system's values of one exposure, in stops (thesis eq. 3.1 to 3.5; Kerr 2016; ANSI PH2.5-1960). Figures
/// are taken as they are written, not as the steps that labels stand for.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Apex {
    /// Av = log2(N^2).
    pub aperture_value: f64,
    /// Tv = log2(1 / t), t in seconds.
    pub time_value: f64,
    /// Sv = log2(2^(-7/4) ISO).
    pub speed_value: f64,
    /// EV = Av + Tv.
    pub exposure_value: f64,
    /// Bv = EV - Sv: of the luminance that a meter would have exposed so.
    pub brightness_value: f64,
    /// That luminance B = 2^Bv N K with N = 2^(-7/4), cd/m^2.
    pub luminance_cd_m2: f64,
}

impl Apex {
    /// The values of an exposure; `meter_constant` is K, see [`METER_CONSTANT`].
    pub fn of(shutter: Seconds, aperture: FNumber, iso: Iso, meter_constant: f64) -> Self {
        let speed_constant = (-1.75f64).exp2();
        let aperture_value = 2.0 * aperture.0.log2();
        let time_value = -shutter.0.log2();
        let speed_value = (speed_constant * iso.0).log2();
        let exposure_value = aperture_value + time_value;
        let brightness_value = exposure_value - speed_value;
        let luminance_cd_m2 = brightness_value.exp2() * speed_constant * meter_constant;
        Self { aperture_value, time_value, speed_value, exposure_value, brightness_value, luminance_cd_m2 }
    }

    /// What sensor values at this exposure are multiplied by to be those at another, in steady light:
    /// 2^(Bv - Bv of the other) (thesis eq. 3.6), which is the ratio of t ISO / N^2.
    pub fn factor_to(&self, other: &Self) -> f64 {
        (self.brightness_value - other.brightness_value).exp2()
    }

    /// The same for a flash, which is over before the shutter closes: the ratio of ISO / N^2.
    pub fn flash_factor_to(&self, other: &Self) -> f64 {
        (self.aperture_value - other.aperture_value + other.speed_value - self.speed_value).exp2()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Labels of one dial, dearest light first, and the true value of the first in stops.
    fn rises_by(labels: &[f64], first: f64, by: f64, stops: impl Fn(f64) -> f64) {
        for (i, label) in labels.iter().enumerate() {
            let expected = first + by * i as f64;
            assert!((stops(*label) - expected).abs() < 1e-9, "{label}: {} not {expected}", stops(*label));
        }
    }

    #[test]
    fn every_label_of_a_third_stop_dial_is_its_power_of_two() {
        let time = |t: f64| Nominal.time(Seconds(t)).log2();
        let fast = [
            8000.0, 6400.0, 5000.0, 4000.0, 3200.0, 2500.0, 2000.0, 1600.0, 1250.0, 1000.0, 800.0, 640.0,
            500.0, 400.0, 320.0, 250.0, 200.0, 160.0, 125.0, 100.0, 80.0, 60.0, 50.0, 40.0, 30.0, 25.0, 20.0,
            15.0, 13.0, 10.0, 8.0, 6.0, 5.0, 4.0,
        ];
        rises_by(&fast.map(|t| 1.0 / t), -13.0, 1.0 / 3.0, time);
        let slow = [
            0.3, 0.4, 0.5, 0.6, 0.8, 1.0, 1.3, 1.6, 2.0, 2.5, 3.2, 4.0, 5.0, 6.0, 8.0, 10.0, 13.0, 15.0,
            20.0, 25.0, 30.0,
        ];
        rises_by(&slow, -5.0 / 3.0, 1.0 / 3.0, time);
        let apertures = [
            1.4, 1.6, 1.8, 2.0, 2.2, 2.5, 2.8, 3.2, 3.5, 4.0, 4.5, 5.0, 5.6, 6.3, 7.1, 8.0, 9.0, 10.0, 11.0,
            13.0, 14.0, 16.0, 18.0, 20.0, 22.0, 25.0, 29.0, 32.0,
        ];
        rises_by(&apertures, -1.0, -1.0 / 3.0, |n| Nominal.aperture(FNumber(n)).log2());
        let isos = [
            100.0, 125.0, 160.0, 200.0, 250.0, 320.0, 400.0, 500.0, 640.0, 800.0, 1000.0, 1250.0, 1600.0,
            2000.0, 2500.0, 3200.0, 4000.0, 5000.0, 6400.0, 8000.0, 10000.0, 12800.0,
        ];
        rises_by(&isos, 100f64.log2(), 1.0 / 3.0, |iso| Nominal.gain(Iso(iso)).log2());
    }

    #[test]
    fn half_stop_labels_and_free_values_keep_their_meaning() {
        let halves = [6000.0, 3000.0, 1500.0, 750.0, 350.0, 180.0, 90.0, 45.0].map(|t| 1.0 / t);
        rises_by(&halves, -12.5, 1.0, |t| Nominal.time(Seconds(t)).log2());
        rises_by(&[0.7, 1.5, 3.0], -0.5, 1.0, |t| Nominal.time(Seconds(t)).log2());
        rises_by(&[1.2, 1.7, 2.4, 3.3, 4.8, 6.7, 9.5], -0.5, -1.0, |n| Nominal.aperture(FNumber(n)).log2());
        // Between all steps: a free-running shutter.
        assert!((Nominal.time(Seconds(2f64.powf(-6.18))) - 2f64.powf(-6.18)).abs() < 1e-9);
    }

    #[test]
    fn room_light_knows_the_shutter_and_flash_does_not() {
        let (f8, iso) = (FNumber(8.0), Iso(200.0));
        let ratio = Nominal.room(Seconds(1.0 / 60.0), f8, iso) / Nominal.room(Seconds(1.0 / 125.0), f8, iso);
        assert!((ratio - 2.0).abs() < 1e-9);
        let ratio = Nominal.flash(FNumber(11.0), Iso(100.0)) / Nominal.flash(f8, iso);
        assert!((ratio - 0.25).abs() < 1e-9);
    }

    fn apex(shutter: f64, aperture: f64, iso: f64) -> Apex {
        Apex::of(Seconds(shutter), FNumber(aperture), Iso(iso), METER_CONSTANT)
    }

    #[test]
    fn the_thesiss_worked_example_is_twelve() {
        // Eq. 3.7 to 3.9; its 11.9995 is 2^3.5849, rounded on the way.
        let (a, b) = (apex(1.0 / 150.0, 8.0, 100.0), apex(1.0 / 100.0, 8.0, 800.0));
        assert!((a.time_value - 7.2288).abs() < 5e-5 && (b.time_value - 6.6439).abs() < 5e-5);
        assert!((a.speed_value - 4.8939).abs() < 5e-5 && (b.speed_value - 7.8939).abs() < 5e-5);
        assert!((a.speed_value - a.time_value + 2.3349).abs() < 1e-4);
        assert!((b.speed_value - b.time_value - 1.2500).abs() < 1e-4);
        assert!((a.factor_to(&b) - 12.0).abs() < 1e-9);
        assert!((b.factor_to(&a) - 1.0 / 12.0).abs() < 1e-9);
        assert!((a.flash_factor_to(&b) - 8.0).abs() < 1e-9, "a flash knows no shutter");
    }

    #[test]
    fn an_exposure_of_nothing_but_ones_is_the_metered_luminance_of_k_over_iso() {
        let one = apex(1.0, 1.0, 100.0);
        assert_eq!((one.aperture_value, one.time_value, one.exposure_value), (0.0, 0.0, 0.0));
        assert!((one.luminance_cd_m2 - 0.125).abs() < 1e-12, "{one:?}");
        let sunny = apex(1.0 / 125.0, 16.0, 100.0);
        assert!((sunny.exposure_value - (125f64.log2() + 8.0)).abs() < 1e-12);
        assert!((sunny.exposure_value - sunny.brightness_value - sunny.speed_value).abs() < 1e-12);
        assert!((sunny.luminance_cd_m2 - 12.5 * 256.0 * 125.0 / 100.0).abs() < 1e-6);
    }
}
