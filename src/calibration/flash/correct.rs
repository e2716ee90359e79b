//! One-shot mode (thesis, section 3.4): a calibration that is there is brought to a flash of another energy by a single
//! shot of the card.
//!
//! First render: the light that the calibration predicts for the shot. The factor of each channel is the measured over
//! that light, by least squares with the sensor's weights, `f = sum w y m / sum w m^2`; radiances are multiplied by it.
//! Second render: the light that the radiances so found give, by another way (a sum over points of the ring in place of the
//! closed form) and as plain sums over the cells; the shot's light over it should be 1 within [`AGREED`]. Geometry, field
//! and noise stay as they were calibrated.

use super::card::{CardShot, SeenShot, Setting, Target};
use super::check::{check, check_target, unfit};
use super::{CardResidual, FEWEST_CELLS, FlashCalibration, FlashFitError, MOST_MISFIT, USUAL_JITTER, misfit};
use crate::calibration::statistics::Z95;
use crate::light::Ring;
use crate::scene::Intrinsics;
use serde::{Deserialize, Serialize};

/// How far the second render may be off the shot: the thesis's 0.02 %.
pub(super) const AGREED: f64 = 2e-4;

/// How a calibration came out of an earlier one by a single shot.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Correction {
    /// Light of the shot over that of a render by the earlier calibration, red green blue: what the radiances were
    /// multiplied by.
    pub factor: [f64; 3],
    /// The factor that the flash controller's energies tell, where both were measured.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub measured_factor: Option<f64>,
    /// Copy of the earlier calibration, from the session's folder.
    pub base_file: String,
    /// Its BLAKE3, hexadecimal.
    pub base_blake3: String,
}

/// Corrects a calibration by a shot of the card; its place in the session is the caller's to fill in. `light_ratio`:
/// known light at the shot's settings over that at the calibration's, ISO / N^2.
pub fn correct_flash(
    base: &FlashCalibration,
    shot: &CardShot,
    (intrinsics, target): (&Intrinsics, &Target),
    light_ratio: f64,
) -> Result<FlashCalibration, FlashFitError> {
    check_target(target)?;
    check(shot, intrinsics)?;
    let nothing = |why: String| FlashFitError::Nothing(format!("{}: {why}", shot.label));
    if let Some(why) = unfit(shot) {
        return Err(nothing(why));
    }
    let setting = Setting { intrinsics, ring: base.ring, target, noise: base.noise };
    let seen = setting.see(shot, 1.0);
    if seen.cells.len() < FEWEST_CELLS {
        return Err(nothing("too little of it lies on the card".into()));
    }
    let first = base.radiance_dn.map(|r| r * light_ratio);
    let render = |radiance: [f64; 3], light: &dyn Fn(&Ring, &SeenShot, usize) -> f64| -> Vec<[f64; 3]> {
        let of = |(i, cell): (usize, &super::card::Seen)| {
            let unit = light(&base.ring, &seen, i) * cell.target * base.field.at_q(cell.q);
            radiance.map(|r| r * unit)
        };
        seen.cells.iter().enumerate().map(of).collect()
    };
    let rendered = render(first, &|ring, seen, i| ring.irradiance(seen.cells[i].point, seen.normal));
    let (mut factor, mut noise) = ([0.0; 3], [0.0; 3]);
    for c in 0..3 {
        let (mut along, mut square) = (0.0, 0.0);
        for (cell, model) in seen.cells.iter().zip(&rendered) {
            along += cell.value[c] * model[c] / cell.variance[c];
            square += model[c] * model[c] / cell.variance[c];
        }
        factor[c] = along / square;
        noise[c] = square.sqrt().recip() / factor[c];
    }
    if !factor.iter().all(|f| f.is_finite() && *f > 0.0) {
        return Err(nothing("the calibration predicts no light for it".into()));
    }
    let radiance: [f64; 3] = std::array::from_fn(|c| first[c] * factor[c]);
    let again = render(radiance, &|ring, seen, i| ring.summed_irradiance(seen.cells[i].point, seen.normal));
    let total = |lights: &mut dyn Iterator<Item = [f64; 3]>| {
        lights.fold([0.0; 3], |sum, light| std::array::from_fn(|c| sum[c] + light[c]))
    };
    let (measured, second) =
        (total(&mut seen.cells.iter().map(|cell| cell.value)), total(&mut again.iter().copied()));
    let off = seen
        .cells
        .iter()
        .zip(&again)
        .flat_map(|(cell, m)| (0..3).map(|c| (cell.value[c] / m[c] - 1.0).powi(2)));
    let readings = (3 * seen.cells.len()) as f64;
    let rms = (off.sum::<f64>() / readings).sqrt();
    let squares = seen
        .cells
        .iter()
        .zip(&again)
        .flat_map(|(cell, m)| (0..3).map(|c| (cell.value[c] - m[c]).powi(2) / cell.variance[c]));
    let dispersion = (squares.sum::<f64>() / (readings - 3.0)).max(1.0);
    let variances =
        seen.cells.iter().zip(&again).flat_map(|(cell, m)| (0..3).map(|c| cell.variance[c] / (m[c] * m[c])));
    let misfit_rms = misfit(rms, variances.sum::<f64>() / readings);
    if misfit_rms.is_nan() || misfit_rms > MOST_MISFIT {
        return Err(FlashFitError::Residual(100.0 * misfit_rms));
    }
    // The shot's own jitter stays in the factor unless its pulse was measured.
    let energy_counts = shot.energy_counts.filter(|e| *e > 0.0);
    let told = base.findings.jitter_deviation;
    let jitter = match energy_counts {
        Some(_) => 0.0,
        None if told > 0.0 => told,
        None => USUAL_JITTER,
    };
    let error: [f64; 3] = std::array::from_fn(|c| {
        let before = base.radiance_dn_standard_error.map_or(0.0, |error| error[c] / base.radiance_dn[c]);
        (before * before + jitter * jitter + noise[c] * noise[c]).sqrt()
    });
    let mut findings = base.findings.clone();
    findings.dispersion = dispersion;
    findings.second_render_ratio = std::array::from_fn(|c| measured[c] / second[c]);
    findings.target_factor_by_angle_rad.clone_from(&target.curve);
    (findings.left_one_out_error, findings.held_out_error) = (None, None);
    let measured_factor = energy_counts.zip(base.energy_counts).map(|(now, then)| now / then);
    findings.correction =
        Some(Correction { factor, measured_factor, base_file: String::new(), base_blake3: String::new() });
    let card = CardResidual {
        label: shot.label.clone(),
        distance_m: shot.plane.distance(),
        gain: Some(1.0),
        measured_gain: None,
        residual_rms: Some(rms),
        clipped_share: shot.clipped,
        used: true,
        left_out: None,
        prediction_error: None,
        prediction_error_interval_95: None,
        held_out: false,
    };
    Ok(FlashCalibration {
        radiance_dn: radiance,
        radiance_dn_interval_95: Some(std::array::from_fn(|c| {
            [-Z95, Z95].map(|reach| radiance[c] * (reach * error[c]).exp())
        })),
        radiance_dn_standard_error: Some(std::array::from_fn(|c| radiance[c] * error[c])),
        target_reflectance: target.reflectance,
        energy_counts,
        cards: vec![card],
        residual_rms: rms,
        misfit_rms,
        findings,
        ..base.clone()
    })
}
