//! The flash, from shots of a flat card at known places (thesis, section 3.4).
//!
//! Card shots tell, per colour channel, the lamp's radiance in sensor units, where the ring lies along the lens's axis,
//! and over the field the product of lens vignetting and lamp lobe. They cannot tell the two factors apart: a lobe is
//! fitted only where a flat field gives the vignetting. Direct light needs only the product as long as lamp and lens
//! share their axis; bounced light is simulated as if all of it were vignetting, which is exact for a lamp without
//! lobe. Model of a colour's mean over a cell of shot s:
//!
//! ```text
//! P_c(x) = k_s R_c g(q) E1(x) rho_t / pi,    g(q) = 1 + a1 q + a2 q^2 + a3 q^3,    mean of k_s = 1
//! ```
//!
//! E1 is the ring's irradiance per unit radiance ([`Ring::irradiance`], with its offset and lobe), rho_t the card's
//! reflectance factor, q the squared distance from the principal point over the squared half diagonal, k_s the flash's
//! energy, which is the shot's and not the pixel's. The fit is by Levenberg-Marquardt with the jitter of k_s as a
//! variance component (module `mixed`). Energy is per shot: the shutter's time is nowhere in it.
//!
//! A flat field is known with an error of its own: where it gives the vignetting, its coefficients stay free within that
//! (module `vignetting`), so that the lobe's interval holds the flat field's. The law of distance is tested by a fit with
//! E1 times
//! (d / d0)^(2 - p), which leaves p = 2 to the inverse square; the ring's radii by a fit in which they may leave the ruler's
//! values. By request they may do so in the fit that counts.

mod card;
mod check;
mod correct;
mod error;
mod fit;
mod mixed;
mod model;
mod variance;
mod verdict;
mod vignetting;

pub use card::{CardShot, Cell, Plane, Target};
pub use correct::{Correction, correct_flash};
pub use error::FlashFitError;
pub use fit::fit_flash;
pub use vignetting::Vignetting;

use super::flat::FlatField;
use super::tags::CardSight;
use crate::light::Ring;
use crate::photometry::NoiseModel;
use crate::scene::Intrinsics;
use serde::{Deserialize, Serialize};

/// Largest share of a shot's cells that clipping may take.
const MOST_CLIPPED: f64 = 0.25;

/// Fewest cells of a shot that counts.
const FEWEST_CELLS: usize = 8;

/// The flash's jitter where the shots are too few to tell it: the thesis's 0.0029.
const USUAL_JITTER: f64 = 0.0029;

/// Largest misfit (relative) of a calibration that may be used.
const MOST_MISFIT: f64 = 0.1;

/// Root mean square of what the sensor's noise does not account for: of the residuals, less the mean of the sensor's own
/// relative variance. Both unweighted, so that bright cells do not speak for dim ones.
fn misfit(residual_rms: f64, noise: f64) -> f64 {
    (residual_rms * residual_rms - noise).max(0.0).sqrt()
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
    pub distance_m: f64,
    /// Flash energy of this shot relative to the radiance's, as fitted; absent where the shot cannot be measured.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub gain: Option<f64>,
    /// Flash energy of this shot relative to [`FlashCalibration::energy_counts`], as the photodiode measured it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub measured_gain: Option<f64>,
    /// Root mean square of (measured / model - 1) over the cells, the shot's own energy taken out; absent where the shot
    /// cannot be measured.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub residual_rms: Option<f64>,
    /// Share of cells that were clipped and left out.
    pub clipped_share: f64,
    /// Whether the shot entered the fit.
    pub used: bool,
    /// Why it did not, in words.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub left_out: Option<String>,
    /// Its light over what a fit without it predicts, less 1; absent if no such fit can be made.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub prediction_error: Option<f64>,
    /// Its 95 % interval, which should hold 0; of shots outside of the fit.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub prediction_error_interval_95: Option<[f64; 2]>,
    /// Kept from the fit on purpose, to check it.
    #[serde(default)]
    pub held_out: bool,
}

/// What the fit says beside the figures that processing uses. What is absent the shots cannot tell.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct FlashFindings {
    /// Where the ring's plane lies along the axis, towards the scene positive.
    pub offset_m: Option<f64>,
    /// Its 95 % interval.
    pub offset_m_interval_95: Option<[f64; 2]>,
    /// Exponent n of the lobe cos^n; only where the vignetting was given.
    pub lobe_exponent: Option<f64>,
    /// Its 95 % interval.
    pub lobe_exponent_interval_95: Option<[f64; 2]>,
    /// The ring's radii as the shots tell them; the calibration keeps the ruler's unless `radii_fitted`.
    pub inner_radius_m: Option<f64>,
    /// Its 95 % interval.
    pub inner_radius_m_interval_95: Option<[f64; 2]>,
    /// Outer.
    pub outer_radius_m: Option<f64>,
    /// Its 95 % interval.
    pub outer_radius_m_interval_95: Option<[f64; 2]>,
    /// p of a law 1 / d^p for a small lamp.
    pub distance_exponent: Option<f64>,
    /// Its 95 % interval.
    pub distance_exponent_interval_95: Option<[f64; 2]>,
    /// Whether `field` is the lens's vignetting alone; otherwise it is vignetting times lobe.
    pub vignetting_given: bool,
    /// Whether `ring` has the radii that the shots tell and not the ruler's.
    #[serde(default)]
    pub radii_fitted: bool,
    /// The flat field that gave the vignetting, where it was the session's.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub flat_field: Option<FlatSource>,
    /// Relative standard deviation of the energy between shots; what of it the controller measured is taken out.
    pub jitter_deviation: f64,
    /// Whether that is the usual value because the shots are too few to tell.
    pub jitter_assumed: bool,
    /// Variance of the residuals within shots over the sensor's.
    pub dispersion: f64,
    /// Mean size of the relative error by which fits without a shot predict it, over the shots used.
    pub left_one_out_error: Option<f64>,
    /// Mean size of the relative error of prediction, over the shots that were held out.
    pub held_out_error: Option<f64>,
    /// Light of all cells used over that of a second render with the figures found, red green blue.
    pub second_render_ratio: [f64; 3],
    /// The card's factor over the angle, as given: angle from the normal in radians, factor.
    pub target_factor_by_angle_rad: Vec<[f64; 2]>,
    /// By which single shot an earlier calibration was brought to this energy; absent for a fit of its own.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub correction: Option<Correction>,
    /// Where AprilTags say the cards stood, of shots that show any.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub card_tags: Vec<CardSight>,
}

/// The calibration that another one rests on.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct FlatSource {
    /// When it was measured, UTC.
    pub measured: String,
    /// BLAKE3 of its record, hexadecimal.
    pub blake3: String,
}

/// The flash as processing uses it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct FlashCalibration {
    /// Geometry of the ring: radii as given, offset and lobe as fitted.
    pub ring: Ring,
    /// Radiance per channel in DN: a surface of reflectance rho under irradiance-per-radiance E1 reads
    /// `radiance * g * E1 * rho / pi`.
    pub radiance_dn: [f64; 3],
    /// Ends of its 95 % interval; absent if it did not come from a fit.
    pub radiance_dn_interval_95: Option<[[f64; 2]; 3]>,
    /// Its standard error, the flash's jitter included; absent if it did not come from a fit.
    pub radiance_dn_standard_error: Option<[f64; 3]>,
    /// Vignetting times lobe; vignetting alone where that was given.
    pub field: FieldFactor,
    /// Vignetting by colour, where a flat field tells that the colours differ: `field` holds for light from which their
    /// differences were taken out ([`CardShot::even_colours`]).
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub colour_vignetting: Option<FlatField>,
    /// Sensor noise, measured on the same shots.
    pub noise: NoiseModel,
    /// Reflectance the card was taken to have.
    pub target_reflectance: f64,
    /// ISO of the shots; known light is proportional to it.
    pub iso: Option<f64>,
    /// f-number of the shots; known light is proportional to its inverse square.
    pub aperture: Option<f64>,
    /// Focal length of the shots, mm; `field` is of no other.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub focal_length_mm: Option<f64>,
    /// Energy of the flash to which `radiance_dn` belongs, in the flash controller's counts; absent unless the
    /// controller measured every shot that was used.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub energy_counts: Option<f64>,
    /// Every shot with its residuals.
    pub cards: Vec<CardResidual>,
    /// Root mean square of (measured / model - 1) over all cells used, each shot's own energy taken out.
    pub residual_rms: f64,
    /// What of it the sensor's noise does not account for: the root of `residual_rms^2` less the mean relative variance of
    /// the cells by the sensor's noise.
    pub misfit_rms: f64,
    /// Intervals and tests.
    #[serde(default)]
    pub findings: FlashFindings,
}

/// What the fit is told beside the shots.
#[derive(Clone, Debug)]
pub struct FlashFacts<'a> {
    /// Of the camera that took the shots.
    pub intrinsics: &'a Intrinsics,
    /// The ring by the ruler.
    pub ring: Ring,
    /// The card.
    pub target: &'a Target,
    /// The sensor.
    pub noise: NoiseModel,
    /// The lens's vignetting, where a flat field tells it.
    pub vignetting: Option<Vignetting>,
    /// Lets the shots tell the ring's radii where they can, in place of the ruler.
    pub free_radii: bool,
}

#[cfg(test)]
mod misfit_tests;
#[cfg(test)]
#[path = "tests.rs"]
mod tests;
