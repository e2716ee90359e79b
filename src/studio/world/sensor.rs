//! Lens and sensor: radiance in, the DN of a 14-bit Bayer frame out.
//!
//! The lens blurs by a Gaussian and falls off towards the corners; each site gathers electrons of one colour by a
//! Poisson law, up to its full well; the amplifier adds read noise and multiplies by the sensitivity.

use crate::photometry::{Cfa, LevelSource, Levels, Mosaic};
use crate::raster::{Image, Rgb};
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng;
use rand_distr::{Distribution, Normal, Poisson};

/// DN of no light.
pub(super) const BLACK: f32 = 2048.0;
/// DN at which a site clips.
pub(super) const SATURATION: f32 = 15300.0;
/// Electrons that a site holds; they make [`SATURATION`] at ISO 100.
pub(super) const FULL_WELL: f64 = 45_000.0;
/// Standard deviation of the amplifier's noise, electrons.
pub(super) const READ_NOISE: f64 = 5.0;
/// Sensitivity of the red, green and blue sites relative to green.
pub(super) const GAIN: [f64; 3] = [0.52, 1.0, 0.68];
/// Radiance that fills a green site on the axis at 2^-7 s, f/11 and ISO 100.
pub(super) const FULL_RADIANCE: f64 = 1.08;
/// Standard deviation of the lens blur, pixels.
pub(super) const LENS_SIGMA: f32 = 0.7;
/// Fall-off: 1 - a q - b q^2, q the squared distance from the principal point over the squared half diagonal.
pub(super) const VIGNETTING: [f64; 2] = [0.11, 0.02];
/// Masked columns left of the frame.
const MASKED: usize = 16;
/// Distinguishes the studio's noise from any other user of the generator.
const SEED: u64 = 0x756e_6c69_7400;

/// What the sensor gave.
pub(super) struct Frame {
    /// The active area.
    pub(super) mosaic: Mosaic,
    /// The columns that no light reaches.
    pub(super) masked: Image<u16>,
}

/// Exposes `light`, radiance after the lens blur times the exposure's factors other than sensitivity. `gain` is
/// ISO/100; `shot` seeds the noise.
pub(super) fn expose(light: &Rgb, gain: f64, shot: u64) -> Frame {
    let (width, height) = (light.width(), light.height());
    let mut random = ChaCha8Rng::seed_from_u64(SEED.wrapping_add(shot));
    let electrons_per_dn = FULL_WELL / f64::from(SATURATION - BLACK);
    let read = |electrons: f64, random: &mut ChaCha8Rng| {
        let read_noise = Normal::new(0.0, READ_NOISE).map_or(0.0, |n| n.sample(random));
        let dn = f64::from(BLACK) + (electrons.min(FULL_WELL) + read_noise) * gain / electrons_per_dn;
        dn.round().clamp(0.0, f64::from(SATURATION)) as u16
    };
    let cfa = Cfa::RGGB;
    let dn = Image::from_fn(width, height, |x, y| {
        let colour = cfa.colour(x, y);
        let radiance = f64::from(light.at(x, y)[colour]);
        let mean = radiance * vignetting(width, height, x, y) * GAIN[colour] * FULL_WELL / FULL_RADIANCE;
        // The law refuses a mean of nothing, which gives nothing.
        let electrons = Poisson::new(mean).map_or(0.0, |p| p.sample(&mut random));
        read(electrons, &mut random)
    });
    let masked = Image::from_fn(MASKED, height, |_, _| read(0.0, &mut random));
    let levels = Levels {
        black: [[BLACK; 2]; 2],
        saturation: [[SATURATION; 2]; 2],
        black_source: LevelSource::FileTag,
        saturation_source: LevelSource::FileTag,
    };
    Frame { mosaic: Mosaic { dn, cfa, levels }, masked }
}

/// Share of the light that the lens lets through to a pixel's centre.
fn vignetting(width: usize, height: usize, x: usize, y: usize) -> f64 {
    let (w, h) = (width as f64 / 2.0, height as f64 / 2.0);
    let (dx, dy) = (x as f64 + 0.5 - w, y as f64 + 0.5 - h);
    let q = (dx * dx + dy * dy) / (w * w + h * h);
    1.0 - VIGNETTING[0] * q - VIGNETTING[1] * q * q
}

#[cfg(test)]
mod tests {
    use super::*;

    fn patch(frame: &Frame, colour: (usize, usize)) -> (f64, f64) {
        let (width, height) = (frame.mosaic.dn.width(), frame.mosaic.dn.height());
        let (mut sum, mut square, mut n) = (0.0, 0.0, 0.0);
        for y in (height / 2 - 20..height / 2 + 20).filter(|y| y % 2 == colour.1) {
            for x in (width / 2 - 20..width / 2 + 20).filter(|x| x % 2 == colour.0) {
                let v = f64::from(*frame.mosaic.dn.at(x, y));
                sum += v;
                square += v * v;
                n += 1.0;
            }
        }
        (sum / n, square / n - (sum / n) * (sum / n))
    }

    #[test]
    fn green_at_half_the_full_radiance_is_half_way_up_with_shot_noise() {
        let light = Rgb::filled(200, 200, [FULL_RADIANCE as f32 / 2.0; 3]);
        let (mean, variance) = patch(&expose(&light, 1.0, 1), (1, 0));
        let range = f64::from(SATURATION - BLACK);
        let half = f64::from(BLACK) + range / 2.0;
        assert!((mean - half).abs() < 30.0, "{mean} for {half}");
        let electrons_per_dn = FULL_WELL / range;
        let expected = (FULL_WELL / 2.0 + READ_NOISE.powi(2)) / electrons_per_dn.powi(2);
        assert!((variance / expected - 1.0).abs() < 0.2, "{variance} for {expected}");
        let (red, _) = patch(&expose(&light, 1.0, 1), (0, 0));
        assert!(((red - f64::from(BLACK)) / (mean - f64::from(BLACK)) - 0.52).abs() < 0.005);
    }

    #[test]
    fn too_much_light_clips_and_none_leaves_read_noise_about_black() {
        let bright = expose(&Rgb::filled(64, 64, [9.0; 3]), 1.0, 1);
        assert!(bright.mosaic.dn.pixels().iter().all(|&v| f32::from(v) > SATURATION - 30.0));
        let dark = expose(&Rgb::filled(64, 64, [0.0; 3]), 1.0, 2);
        let (mean, variance) = patch(&dark, (0, 0));
        assert!((mean - f64::from(BLACK)).abs() < 0.5);
        assert!((1.2..3.0).contains(&variance), "{variance}");
    }

    #[test]
    fn noise_is_new_in_every_shot_and_the_same_in_the_same_shot() {
        let light = Rgb::filled(32, 32, [0.3; 3]);
        assert_eq!(expose(&light, 1.0, 5).mosaic, expose(&light, 1.0, 5).mosaic);
        assert_ne!(expose(&light, 1.0, 5).mosaic, expose(&light, 1.0, 6).mosaic);
    }
}
