//! The flash, from shots of a flat card that faces the camera at known distances.
//!
//! Card shots tell, per colour channel, the lamp's radiance in sensor units, and over the field angle the
//! product of lens vignetting and lamp lobe. They cannot tell the two factors apart. Direct
//! light needs only the product as long as lamp and lens share their axis; bounced light is simulated as if all of it
//! were vignetting, which is exact for a lamp without lobe. Model of a pixel on shot s:
//!
//! ```text
//! P_c(x) = k_s R_c g(q) E1(x) rho_t / pi,    g(q) = 1 + a1 q + a2 q^2 + a3 q^3,    mean of k_s = 1
//! ```
//!
//! E1 is the ring's irradiance per unit radiance ([`Ring::irradiance`]), rho_t the card's reflectance, q the
//! squared distance from the principal point over the squared half diagonal, k_s the flash's shot-to-shot
//! energy. Weighted least squares, alternating between (k, R) and a, each of which is linear in the other's
//! absence.

use crate::light::Ring;
use crate::photometry::{KnownMosaic, NoiseModel};
use crate::scene::{Camera, Intrinsics};
use glam::{DAffine3, DMat4, DVec2, DVec3, DVec4, Vec4Swizzles};
use serde::{Deserialize, Serialize};
use std::f64::consts::PI;

/// Sites per edge of the blocks that enter the fit; even, to hold whole filter cells.
const BLOCK: usize = 8;

/// Least share of a shot's blocks that must be unclipped for the shot to count.
const LEAST_USABLE: f64 = 0.05;

/// Model error that is granted to every block beside noise, relative.
const MODEL_ERROR: f64 = 0.002;

/// Largest root mean square residual (relative) of a calibration that may be used.
const MOST_RESIDUAL: f64 = 0.1;

/// One shot of the card with the flash's light isolated.
pub struct CardShot {
    /// File name, for reports.
    pub label: String,
    /// Distance from the lens's centre of projection to the card's plane along the axis, metres.
    pub distance: f64,
    /// Known light on sensor sites, DN.
    pub known: KnownMosaic,
    /// Energy of its pulse in the flash controller's counts, where it was measured.
    pub energy_counts: Option<f64>,
}

/// Product of vignetting and lamp lobe over the field, 1 on the axis.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct FieldFactor {
    /// Coefficients of q, q^2, q^3, where q = (r / half diagonal)^2.
    pub coefficients: [f64; 3],
}

/// What a shot of the series contributed.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct CardResidual {
    /// File name.
    pub label: String,
    /// Given distance, metres.
    pub distance: f64,
    /// Flash energy of this shot relative to the radiance's, as fitted.
    pub gain: f64,
    /// Flash energy of this shot relative to [`FlashCalibration::energy_counts`], as the photodiode measured it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub measured_gain: Option<f64>,
    /// Root mean square of (measured / model - 1) over the blocks.
    pub rms: f64,
    /// Share of blocks that were clipped and left out.
    pub clipped: f64,
    /// Whether the shot entered the fit.
    pub used: bool,
}

/// The flash as processing uses it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct FlashCalibration {
    /// Geometry of the ring (given, not fitted).
    pub ring: Ring,
    /// Radiance per channel in DN: a surface of reflectance rho under irradiance-per-radiance E1 reads
    /// `radiance * g * E1 * rho / pi`.
    pub radiance: [f64; 3],
    /// Standard error of `radiance` from the spread between shots; absent with a single shot.
    pub radiance_error: Option<[f64; 3]>,
    /// Vignetting times lobe.
    pub field: FieldFactor,
    /// Sensor noise, measured on the same shots.
    pub noise: NoiseModel,
    /// Reflectance the card was taken to have.
    pub target_reflectance: f64,
    /// ISO of the shots; known light is proportional to it.
    pub iso: Option<f64>,
    /// f-number of the shots; known light is proportional to its inverse square.
    pub aperture: Option<f64>,
    /// Energy of the flash to which `radiance` belongs, in the flash controller's counts; absent unless the
    /// controller measured every shot that was used.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub energy_counts: Option<f64>,
    /// Every shot with its residuals.
    pub shots: Vec<CardResidual>,
    /// Root mean square of (measured / model - 1) over all blocks used.
    pub rms: f64,
}

/// Why no calibration came out.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum FlashFitError {
    /// Reflectance outside (0, 1].
    #[error(
        "target reflectance {0} is not possible: give the card's diffuse reflectance between 0 and 1, for example 0.94"
    )]
    Reflectance(f64),
    /// A distance that cannot be.
    #[error(
        "{label}: distance {distance} m is not possible: give metres from the lens to the card, greater than 0"
    )]
    Distance {
        /// File.
        label: String,
        /// What was given.
        distance: f64,
    },
    /// Sizes differ.
    #[error(
        "{label} is {got:?} sites but the camera model is {expected:?}: all shots must be full frames of the camera that took the photos"
    )]
    Size {
        /// File.
        label: String,
        /// Width and height of the shot.
        got: (usize, usize),
        /// Width and height of the camera model.
        expected: (usize, usize),
    },
    /// The shots are not of a card at these distances.
    #[error(
        "the card shots are off the model by {0:.0} %: does the card fill the frame and face the camera, and are the distances and ring radii in metres?"
    )]
    Residual(f64),
    /// Nothing usable.
    #[error(
        "no card shot has light to measure: all are over-exposed or dark ({0}); shoot the card farther away, or check that the flash fired"
    )]
    Nothing(String),
}

impl FieldFactor {
    /// Factor at a pixel position.
    pub fn at(&self, intrinsics: &Intrinsics, pixel: DVec2) -> f64 {
        self.at_q(field_q(intrinsics, pixel))
    }

    fn at_q(&self, q: f64) -> f64 {
        let [a, b, c] = self.coefficients;
        1.0 + q * (a + q * (b + q * c))
    }
}

/// (r / half diagonal)^2 of a pixel position.
fn field_q(intrinsics: &Intrinsics, pixel: DVec2) -> f64 {
    let half = DVec2::new(intrinsics.width as f64, intrinsics.height as f64) / 2.0;
    (pixel - intrinsics.principal).length_squared() / half.length_squared()
}

/// A block of sites of one shot and channel.
struct Block {
    shot: usize,
    channel: usize,
    q: f64,
    /// E1 rho_t / pi.
    unit: f64,
    value: f64,
    weight: f64,
}

/// Fits radiance and field factor. `intrinsics` are those of the camera that took the shots; the card stands
/// square to its axis.
pub fn fit_flash(
    shots: &[CardShot],
    intrinsics: &Intrinsics,
    ring: Ring,
    target_reflectance: f64,
    noise: NoiseModel,
) -> Result<FlashCalibration, FlashFitError> {
    if !(target_reflectance > 0.0 && target_reflectance <= 1.0) {
        return Err(FlashFitError::Reflectance(target_reflectance));
    }
    let (mut blocks, mut clipped) = (vec![], vec![]);
    for (index, shot) in shots.iter().enumerate() {
        check(shot, intrinsics)?;
        let (of_shot, share) = blocks_of(index, shot, intrinsics, &ring, target_reflectance);
        if share <= 1.0 - LEAST_USABLE {
            blocks.extend(of_shot);
        }
        clipped.push(share);
    }
    let lit = blocks.iter().map(|b| b.value).sum::<f64>() > 0.0;
    if blocks.is_empty() || !lit {
        let labels: Vec<&str> = shots.iter().map(|s| s.label.as_str()).collect();
        return Err(FlashFitError::Nothing(labels.join(", ")));
    }
    let mut field = FieldFactor { coefficients: [0.0; 3] };
    let mut strength = strengths(&blocks, shots.len(), &field);
    for _ in 0..30 {
        field = fit_field(&blocks, &strength);
        strength = strengths(&blocks, shots.len(), &field);
    }
    let used: Vec<usize> = (0..shots.len()).filter(|&s| strength[s].is_some()).collect();
    // Each shot's own energy, where the controller measured them all, is known better than the cards' distances: it
    // is divided out before the mean is taken.
    let energies: Option<Vec<f64>> =
        used.iter().map(|&s| shots[s].energy_counts.filter(|e| *e > 0.0)).collect();
    let energy_counts = energies.map(|e| e.iter().sum::<f64>() / e.len() as f64);
    let measured_gain = |s: usize| Some(shots[s].energy_counts? / energy_counts?);
    let at = |s: usize, c: usize| strength[s].map_or(0.0, |k| k[c] / measured_gain(s).unwrap_or(1.0));
    let radiance: [f64; 3] =
        std::array::from_fn(|c| used.iter().map(|&s| at(s, c)).sum::<f64>() / used.len() as f64);
    let radiance_error = (used.len() > 1).then(|| {
        std::array::from_fn(|c| {
            let n = used.len() as f64;
            let spread = used.iter().map(|&s| (at(s, c) - radiance[c]).powi(2)).sum::<f64>() / (n - 1.0);
            (spread / n).sqrt()
        })
    });
    let relative =
        |b: &Block| strength[b.shot].map(|k| b.value / (k[b.channel] * field.at_q(b.q) * b.unit) - 1.0);
    let rms = |wanted: Option<usize>| {
        let errors: Vec<f64> =
            blocks.iter().filter(|b| wanted.is_none_or(|s| s == b.shot)).filter_map(relative).collect();
        (errors.iter().map(|e| e * e).sum::<f64>() / errors.len().max(1) as f64).sqrt()
    };
    if let Some(c) = (0..3).find(|&c| radiance[c].is_nan() || radiance[c] <= 0.0) {
        return Err(FlashFitError::Nothing(format!(
            "no light in the {} channel",
            ["red", "green", "blue"][c]
        )));
    }
    if rms(None) > MOST_RESIDUAL {
        return Err(FlashFitError::Residual(100.0 * rms(None)));
    }
    let residuals = shots
        .iter()
        .enumerate()
        .map(|(s, shot)| CardResidual {
            label: shot.label.clone(),
            distance: shot.distance,
            gain: strength[s].map_or(0.0, |k| (0..3).map(|c| k[c] / radiance[c]).sum::<f64>() / 3.0),
            measured_gain: measured_gain(s),
            rms: rms(Some(s)),
            clipped: clipped[s],
            used: strength[s].is_some(),
        })
        .collect();
    Ok(FlashCalibration {
        ring,
        radiance,
        radiance_error,
        field,
        noise,
        target_reflectance,
        iso: None,
        aperture: None,
        energy_counts,
        shots: residuals,
        rms: rms(None),
    })
}

fn check(shot: &CardShot, intrinsics: &Intrinsics) -> Result<(), FlashFitError> {
    if !(shot.distance > 0.0 && shot.distance < 1e3) {
        return Err(FlashFitError::Distance { label: shot.label.clone(), distance: shot.distance });
    }
    let got = (shot.known.value.width(), shot.known.value.height());
    let expected = (intrinsics.width, intrinsics.height);
    if got != expected {
        return Err(FlashFitError::Size { label: shot.label.clone(), got, expected });
    }
    Ok(())
}

/// Means over whole blocks, and the share of blocks that clipping took.
fn blocks_of(
    index: usize,
    shot: &CardShot,
    intrinsics: &Intrinsics,
    ring: &Ring,
    reflectance: f64,
) -> (Vec<Block>, f64) {
    let camera =
        Camera { name: String::new(), intrinsics: *intrinsics, world_from_camera: DAffine3::IDENTITY };
    let known = &shot.known;
    let (mut out, mut all, mut lost) = (vec![], 0, 0);
    for y in (0..(intrinsics.height + 1).saturating_sub(BLOCK)).step_by(BLOCK) {
        for x in (0..(intrinsics.width + 1).saturating_sub(BLOCK)).step_by(BLOCK) {
            let sites = (y..y + BLOCK).flat_map(|y| (x..x + BLOCK).map(move |x| (x, y)));
            let (mut sum, mut variance, mut count) = ([0.0; 3], [0.0; 3], [0.0f64; 3]);
            let mut place = [DVec2::ZERO; 3];
            let mut whole = true;
            for (sx, sy) in sites {
                let c = known.cfa.colour(sx, sy);
                match known.value.at(sx, sy) {
                    Some(v) => sum[c] += f64::from(*v),
                    None => whole = false,
                }
                variance[c] += f64::from(*known.variance.at(sx, sy));
                count[c] += 1.0;
                place[c] += DVec2::new(sx as f64 + 0.5, sy as f64 + 0.5);
            }
            all += 1;
            if !whole {
                lost += 1;
                continue;
            }
            for channel in 0..3 {
                let (n, value) = (count[channel], sum[channel] / count[channel]);
                let pixel = place[channel] / n;
                let unit = ring.irradiance(camera.ray(pixel) * shot.distance, -DVec3::Z) * reflectance / PI;
                let error = variance[channel] / (n * n) + (MODEL_ERROR * value).powi(2);
                if n > 0.0 && unit > 0.0 && error > 0.0 {
                    let q = field_q(intrinsics, pixel);
                    out.push(Block { shot: index, channel, q, unit, value, weight: 1.0 / error });
                }
            }
        }
    }
    (out, if all > 0 { f64::from(lost) / f64::from(all) } else { 1.0 })
}

/// k_s R_c of every shot, given the field factor; `None` for a shot without blocks.
fn strengths(blocks: &[Block], shots: usize, field: &FieldFactor) -> Vec<Option<[f64; 3]>> {
    let mut sums = vec![[[0.0f64; 2]; 3]; shots];
    for b in blocks {
        let model = field.at_q(b.q) * b.unit;
        let sum = &mut sums[b.shot][b.channel];
        sum[0] += b.weight * model * b.value;
        sum[1] += b.weight * model * model;
    }
    let solved = |s: &[[f64; 2]; 3]| s.iter().all(|x| x[1] > 0.0).then(|| s.map(|x| x[0] / x[1]));
    sums.iter().map(solved).collect()
}

/// Coefficients of the field factor, given the strengths: normal equations of four unknowns. The constant is
/// fitted too, or strengths and field would creep towards each other for ever, and then divided out.
fn fit_field(blocks: &[Block], strength: &[Option<[f64; 3]>]) -> FieldFactor {
    let (mut m, mut r) = (DMat4::ZERO, DVec4::ZERO);
    for b in blocks {
        let Some(k) = strength[b.shot] else { continue };
        let row = DVec4::new(1.0, b.q, b.q * b.q, b.q * b.q * b.q) * k[b.channel] * b.unit;
        m += DMat4::from_cols(row * row.x, row * row.y, row * row.z, row * row.w) * b.weight;
        r += row * b.value * b.weight;
    }
    // A ridge far below what the data weigh, for frames too small to bend.
    m += DMat4::from_diagonal(DVec4::splat((1e-9 * m.x_axis.x).max(f64::MIN_POSITIVE)));
    let a = m.inverse() * r;
    let coefficients = a.yzw() / a.x;
    FieldFactor { coefficients: if coefficients.is_finite() { coefficients.to_array() } else { [0.0; 3] } }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::photometry::Cfa;
    use crate::raster::Image;
    use crate::scene::Distortion;

    fn intrinsics() -> Intrinsics {
        Intrinsics {
            width: 240,
            height: 160,
            focal: DVec2::splat(300.0),
            principal: DVec2::new(120.0, 80.0),
            distortion: Distortion::default(),
        }
    }

    fn shot(distance: f64, gain: f64, clip: f64) -> CardShot {
        let (lens, ring) = (intrinsics(), Ring::new(0.035, 0.085).unwrap());
        let camera = Camera { name: String::new(), intrinsics: lens, world_from_camera: DAffine3::IDENTITY };
        let value = Image::from_fn(240, 160, |x, y| {
            let pixel = DVec2::new(x as f64 + 0.5, y as f64 + 0.5);
            let q = field_q(&lens, pixel);
            let e = ring.irradiance(camera.ray(pixel) * distance, -DVec3::Z);
            let r = [2.0e5, 4.0e5, 2.5e5][Cfa::RGGB.colour(x, y)];
            let v = gain * r * (1.0 - 0.11 * q - 0.02 * q * q) * e * 0.94 / PI;
            (v < clip).then_some(v as f32)
        });
        let variance = value.map(|v| v.map_or(0.0, |v| 0.3 * v + 2.0));
        CardShot {
            label: format!("{distance}"),
            distance,
            known: KnownMosaic { value, variance, cfa: Cfa::RGGB },
            energy_counts: None,
        }
    }

    #[test]
    fn radiance_and_field_factor_of_synthetic_cards_come_back() {
        let shots = [shot(0.5, 1.0, 9e3), shot(0.8, 1.003, 9e3), shot(1.2, 0.997, 9e3)];
        let noise = NoiseModel { gain: 0.3, floor: 2.0 };
        let ring = Ring::new(0.035, 0.085).unwrap();
        let fit = fit_flash(&shots, &intrinsics(), ring, 0.94, noise).unwrap();
        for (got, want) in fit.radiance.iter().zip([2.0e5, 4.0e5, 2.5e5]) {
            assert!((got / want - 1.0).abs() < 1e-3, "{:?}", fit.radiance);
        }
        for q in [0.1, 0.5, 0.9] {
            let want = 1.0 - 0.11 * q - 0.02 * q * q;
            assert!((fit.field.at_q(q) - want).abs() < 1e-3, "{:?}", fit.field);
        }
        assert!(fit.rms < 1e-3 && fit.shots[1].gain > fit.shots[2].gain);
    }

    #[test]
    fn measured_energies_take_the_flashs_jitter_out_of_the_radiance() {
        let noise = NoiseModel { gain: 0.3, floor: 2.0 };
        let ring = Ring::new(0.035, 0.085).unwrap();
        let gains = [1.0, 1.02, 0.96];
        let mut shots: Vec<CardShot> =
            [0.5, 0.8, 1.2].into_iter().zip(gains).map(|(d, gain)| shot(d, gain, 9e3)).collect();
        let untold = fit_flash(&shots, &intrinsics(), ring, 0.94, noise).unwrap();
        assert_eq!(untold.energy_counts, None);
        shots.iter_mut().zip(gains).for_each(|(s, g)| s.energy_counts = Some(1e5 * g));
        let told = fit_flash(&shots, &intrinsics(), ring, 0.94, noise).unwrap();
        // The mean energy is 0.9933 of that to which the radiances below belong.
        assert!((told.energy_counts.unwrap() / 0.99333e5 - 1.0).abs() < 1e-4);
        for (got, want) in told.radiance.iter().zip([2.0e5, 4.0e5, 2.5e5]) {
            assert!((got / (0.99333 * want) - 1.0).abs() < 1e-3, "{:?}", told.radiance);
        }
        let error = |fit: &FlashCalibration| fit.radiance_error.unwrap()[1] / fit.radiance[1];
        assert!(error(&untold) > 0.015 && error(&told) < 0.001, "{} {}", error(&untold), error(&told));
        let shot = &told.shots[1];
        assert!((shot.gain / shot.measured_gain.unwrap() - 1.0).abs() < 1e-3, "{shot:?}");
        shots[2].energy_counts = None;
        assert_eq!(fit_flash(&shots, &intrinsics(), ring, 0.94, noise).unwrap().energy_counts, None);
    }

    #[test]
    fn an_overexposed_series_is_refused_with_advice() {
        let noise = NoiseModel { gain: 0.3, floor: 2.0 };
        let ring = Ring::new(0.035, 0.085).unwrap();
        let error = fit_flash(&[shot(0.5, 1.0, 1.0)], &intrinsics(), ring, 0.94, noise).unwrap_err();
        assert!(error.to_string().contains("farther away"), "{error}");
        assert!(matches!(
            fit_flash(&[], &intrinsics(), ring, 1.4, noise),
            Err(FlashFitError::Reflectance(_))
        ));
    }
}
