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
//! The law of distance is tested by a fit with E1 times (d / d0)^(2 - p), which leaves p = 2 to the inverse square; the
//! ring's radii by a fit in which they may leave the ruler's values.

mod card;
mod linear;
mod mixed;
mod model;
mod verdict;

pub use card::{CardShot, Cell, Plane, Target};

use crate::light::Ring;
use crate::photometry::NoiseModel;
use crate::scene::Intrinsics;
use card::{SeenShot, Setting};
use mixed::{Solution, solve};
use model::{Cards, Figure, first_guess};
use serde::{Deserialize, Serialize};

/// Largest share of a shot's cells that clipping may take.
const MOST_CLIPPED: f64 = 0.25;

/// Fewest cells of a shot that counts.
const FEWEST_CELLS: usize = 8;

/// The flash's jitter where the shots are too few to tell it: the thesis's 0.0029.
const USUAL_JITTER: f64 = 0.0029;

/// Largest root mean square residual (relative) of a calibration that may be used.
const MOST_RESIDUAL: f64 = 0.1;

/// Product of vignetting and lamp lobe over the field, 1 on the axis.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct FieldFactor {
    /// Coefficients of q, q^2, q^3, where q = (r / half diagonal)^2.
    pub coefficients: [f64; 3],
}

/// A figure with its 95 % interval.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Interval {
    /// Best value.
    pub value: f64,
    /// Lower end.
    pub low: f64,
    /// Upper end.
    pub high: f64,
}

impl Interval {
    fn around(value: f64, half: f64) -> Self {
        Self { value, low: value - half, high: value + half }
    }

    /// Whether a value lies inside.
    pub fn holds(&self, value: f64) -> bool {
        (self.low..=self.high).contains(&value)
    }
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
    /// Root mean square of (measured / model - 1) over the cells, the shot's own energy taken out.
    pub rms: f64,
    /// Share of cells that were clipped and left out.
    pub clipped: f64,
    /// Whether the shot entered the fit.
    pub used: bool,
    /// Why it did not, in words.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub left_out: Option<String>,
    /// Its light over what a fit without it predicts, less 1; absent if no such fit can be made.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub prediction_error: Option<f64>,
    /// Kept from the fit on purpose, to check it.
    #[serde(default)]
    pub held_out: bool,
}

/// What the fit says beside the figures that processing uses. What is absent the shots cannot tell.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct FlashFindings {
    /// Radiance per channel, DN.
    pub radiance_dn: Option<[Interval; 3]>,
    /// Where the ring's plane lies along the axis, towards the scene positive.
    pub offset_m: Option<Interval>,
    /// Exponent n of the lobe cos^n; only where the vignetting was given.
    pub lobe_exponent: Option<Interval>,
    /// The ring's radii as the shots tell them; the calibration keeps the ruler's.
    pub inner_radius_m: Option<Interval>,
    /// Outer.
    pub outer_radius_m: Option<Interval>,
    /// p of a law 1 / d^p for a small lamp.
    pub distance_exponent: Option<Interval>,
    /// Whether `field` is the lens's vignetting alone; otherwise it is vignetting times lobe.
    pub vignetting_given: bool,
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
    /// The card's factor over the angle (radians), as given.
    pub target_curve: Vec<[f64; 2]>,
}

/// The flash as processing uses it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct FlashCalibration {
    /// Geometry of the ring: radii as given, offset and lobe as fitted.
    pub ring: Ring,
    /// Radiance per channel in DN: a surface of reflectance rho under irradiance-per-radiance E1 reads
    /// `radiance * g * E1 * rho / pi`.
    pub radiance: [f64; 3],
    /// Standard error of `radiance`, the flash's jitter included; absent if it did not come from a fit.
    pub radiance_error: Option<[f64; 3]>,
    /// Vignetting times lobe; vignetting alone where that was given.
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
    pub cards: Vec<CardResidual>,
    /// Root mean square of (measured / model - 1) over all cells used, each shot's own energy taken out.
    pub rms: f64,
    /// Intervals and tests.
    #[serde(default)]
    pub findings: FlashFindings,
}

/// Why no calibration came out.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum FlashFitError {
    /// Reflectance outside (0, 1].
    #[error(
        "target reflectance {0} is not possible: give the card's diffuse reflectance between 0 and 1, for example 0.94"
    )]
    Reflectance(f64),
    /// A curve that is none.
    #[error(
        "the target's curve is not possible: give angles in radians, rising, from 0 to below pi / 2, each with a factor above 0"
    )]
    Curve,
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
    /// A plane that cannot be.
    #[error(
        "{label}: the card does not face the camera: give a unit normal that points from the card to the camera, at most 80 degrees off the axis"
    )]
    Plane {
        /// File.
        label: String,
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
    /// The search found no end.
    #[error(
        "no ring flash of these radii explains the card shots: check distances and radii (metres), and shoot the card at two distances or more"
    )]
    Vague,
    /// Nothing usable.
    #[error(
        "no card shot has light to measure ({0}); shoot the card farther away if it is over-exposed, or check that the flash fired"
    )]
    Nothing(String),
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
    pub vignetting: Option<FieldFactor>,
}

/// Fits radiance, field and place of the ring to card shots. ISO and aperture are the caller's to fill in.
pub fn fit_flash(shots: &[CardShot], facts: &FlashFacts) -> Result<FlashCalibration, FlashFitError> {
    check_target(facts.target)?;
    shots.iter().try_for_each(|shot| check(shot, facts.intrinsics))?;
    let reasons: Vec<Option<String>> = shots.iter().map(unfit).collect();
    let used: Vec<usize> = (0..shots.len()).filter(|&s| reasons[s].is_none() && !shots[s].held_out).collect();
    let nothing = || {
        let told: Vec<String> = shots
            .iter()
            .zip(&reasons)
            .map(|(s, why)| format!("{}: {}", s.label, why.as_deref().unwrap_or("kept from the fit")))
            .collect();
        FlashFitError::Nothing(told.join("; "))
    };
    // Each shot's own energy, where the controller measured them all, is known better than the fit could tell it.
    let energies: Option<Vec<f64>> =
        used.iter().map(|&s| shots[s].energy_counts.filter(|e| *e > 0.0)).collect();
    let energy_counts = energies.filter(|e| !e.is_empty()).map(|e| e.iter().sum::<f64>() / e.len() as f64);
    let measured_gain = |s: usize| Some(shots[s].energy_counts.filter(|e| *e > 0.0)? / energy_counts?);
    let setting =
        Setting { intrinsics: facts.intrinsics, ring: facts.ring, target: facts.target, noise: facts.noise };
    let seen: Vec<SeenShot> =
        (0..shots.len()).map(|s| setting.see(&shots[s], measured_gain(s).unwrap_or(1.0))).collect();
    let (used, cards): (Vec<usize>, Vec<SeenShot>) =
        used.into_iter().map(|s| (s, seen[s].clone())).filter(|(_, c)| c.cells.len() >= FEWEST_CELLS).unzip();
    if used.is_empty() {
        return Err(nothing());
    }
    let guess = first_guess(&cards, facts.ring, facts.vignetting).ok_or_else(nothing)?;
    let fits = Fits { cards: &cards, ring: facts.ring, guess, vignetting: facts.vignetting };
    let (model, solution) = fits.main().ok_or(FlashFitError::Vague)?;
    let flash = model.flash(&solution.theta).ok_or(FlashFitError::Vague)?;

    let shot_rms: Vec<f64> = solution.sums.iter().map(mixed::ShotSums::rms).collect();
    let count: f64 = solution.sums.iter().map(|s| s.count).sum();
    let squares: f64 = solution.sums.iter().zip(&shot_rms).map(|(s, rms)| s.count * rms * rms).sum();
    let rms = (squares / count).sqrt();
    if rms.is_nan() || rms > MOST_RESIDUAL {
        return Err(FlashFitError::Residual(100.0 * rms));
    }
    let single = used.len() == 1;
    let residuals = shots.iter().enumerate().map(|(s, shot)| {
        let energy = measured_gain(s).unwrap_or(1.0);
        let place = used.iter().position(|u| *u == s);
        let sums = match (place, &reasons[s]) {
            (Some(place), _) => Some(solution.sums[place].clone()),
            (None, None) => model.sums_of(&seen[s], &flash).filter(|s| s.w > 0.0),
            (None, Some(_)) => None,
        };
        let prediction_error = match place {
            Some(_) if single => None,
            Some(place) => solution.left_out(place),
            None => sums.as_ref().map(mixed::ShotSums::own),
        };
        CardResidual {
            label: shot.label.clone(),
            distance: shot.plane.distance(),
            gain: sums.as_ref().map_or(0.0, |sums| energy * (1.0 + sums.own())),
            measured_gain: measured_gain(s),
            rms: sums.as_ref().map_or(0.0, mixed::ShotSums::rms),
            clipped: shot.clipped,
            used: place.is_some(),
            left_out: match place {
                Some(_) => None,
                None => Some(reasons[s].clone().unwrap_or_else(|| "kept from the fit, to check it".into())),
            },
            prediction_error,
            held_out: shot.held_out,
        }
    });
    let cards_told: Vec<CardResidual> = residuals.collect();
    let findings = fits.findings(&model, &solution, &cards_told, facts.target);
    let unit = |i: usize| (0..solution.theta.len()).map(|j| f64::from(u8::from(i == j))).collect::<Vec<_>>();
    Ok(FlashCalibration {
        ring: flash.ring,
        radiance: flash.radiance,
        radiance_error: Some(std::array::from_fn(|c| flash.radiance[c] * solution.error(&unit(c)))),
        field: flash.field,
        noise: facts.noise,
        target_reflectance: facts.target.reflectance,
        iso: None,
        aperture: None,
        energy_counts,
        cards: cards_told,
        rms,
        findings,
    })
}

/// The fits to one series.
struct Fits<'a> {
    cards: &'a [SeenShot],
    ring: Ring,
    guess: [f64; 3],
    vignetting: Option<FieldFactor>,
}

impl<'a> Fits<'a> {
    /// Begins where `near` is, an earlier fit whose figures come first among these.
    fn with(&self, figures: Vec<Figure>, near: &[f64]) -> Option<(Cards<'a>, Solution)> {
        let model = Cards::new(self.cards, self.ring, self.guess, self.vignetting, figures);
        let mut start = model.start();
        start.iter_mut().zip(near).for_each(|(to, from)| *to = *from);
        let solution = solve(&model, start, USUAL_JITTER)?;
        Some((model, solution))
    }

    /// The fit that counts: what the shots cannot tell stays at the ruler's value.
    fn main(&self) -> Option<(Cards<'a>, Solution)> {
        let mut figures = vec![Figure::Offset];
        figures.extend(self.vignetting.map(|_| Figure::Lobe));
        let (model, solution) = match self.with(figures.clone(), &[]) {
            Some(fit) => fit,
            None => return self.with(vec![], &[]),
        };
        let told: Vec<Figure> = figures.iter().copied().filter(|f| tells(&model, &solution, *f)).collect();
        if told.len() == figures.len() { Some((model, solution)) } else { self.with(told, &[]) }
    }

    fn findings(
        &self,
        model: &Cards,
        solution: &Solution,
        cards: &[CardResidual],
        target: &Target,
    ) -> FlashFindings {
        let settled: Vec<Figure> =
            [Figure::Offset, Figure::Lobe].into_iter().filter(|f| model.place(*f).is_some()).collect();
        let more = |figures: &[Figure]| self.with([settled.as_slice(), figures].concat(), &solution.theta);
        let exponent = more(&[Figure::Exponent])
            .filter(|(model, fit)| tells(model, fit, Figure::Exponent))
            .and_then(|(model, fit)| interval(&model, &fit, Figure::Exponent, 2.0));
        let radii = more(&[Figure::Inner, Figure::Outer]);
        let radius = |figure, ruler| {
            let (model, fit) = radii.as_ref()?;
            tells(model, fit, figure).then(|| interval(model, fit, figure, ruler)).flatten()
        };
        let mean_size = |wanted: &dyn Fn(&CardResidual) -> bool| {
            let errors: Vec<f64> =
                cards.iter().filter(|c| wanted(c)).filter_map(|c| Some(c.prediction_error?.abs())).collect();
            (!errors.is_empty()).then(|| errors.iter().sum::<f64>() / errors.len() as f64)
        };
        let radiance_dn = std::array::from_fn(|c| {
            let mut form = vec![0.0; solution.theta.len()];
            form[c] = 1.0;
            let (value, half) = (self.guess[c] * solution.theta[c].exp(), solution.half_interval(&form));
            Interval { value, low: value * (-half).exp(), high: value * half.exp() }
        });
        FlashFindings {
            radiance_dn: Some(radiance_dn),
            offset_m: interval(model, solution, Figure::Offset, self.ring.offset),
            lobe_exponent: interval(model, solution, Figure::Lobe, self.ring.lobe),
            inner_radius_m: radius(Figure::Inner, self.ring.inner),
            outer_radius_m: radius(Figure::Outer, self.ring.outer),
            distance_exponent: exponent,
            vignetting_given: self.vignetting.is_some(),
            jitter_deviation: solution.variance.sqrt(),
            jitter_assumed: solution.freedom.is_none(),
            dispersion: solution.dispersion,
            left_one_out_error: mean_size(&|c| c.used),
            held_out_error: mean_size(&|c| c.held_out && !c.used),
            second_render_ratio: self.second_render(model, solution),
            target_curve: target.curve.clone(),
        }
    }

    /// Light of all cells over that of a render with the figures found (thesis, table 3.4).
    fn second_render(&self, model: &Cards, solution: &Solution) -> [f64; 3] {
        let (mut measured, mut rendered) = ([0.0; 3], [0.0; 3]);
        let Some(flash) = model.flash(&solution.theta) else { return [1.0; 3] };
        for (shot, sums) in self.cards.iter().zip(&solution.sums) {
            let own = shot.energy * (1.0 + sums.own());
            for cell in &shot.cells {
                let light = flash.ring.irradiance(cell.point, shot.normal) * cell.target;
                let unit = light * flash.field.at_q(cell.q) * own;
                for c in 0..3 {
                    measured[c] += cell.value[c];
                    rendered[c] += flash.radiance[c] * unit;
                }
            }
        }
        std::array::from_fn(|c| measured[c] / rendered[c])
    }
}

/// Half of a figure's 95 % interval.
fn half(model: &Cards, solution: &Solution, figure: Figure) -> Option<(usize, f64)> {
    let place = model.place(figure)?;
    let mut form = vec![0.0; solution.theta.len()];
    form[place] = 1.0;
    Some((place, solution.half_interval(&form)))
}

/// Whether the shots tell a figure well enough to be of use.
fn tells(model: &Cards, solution: &Solution, figure: Figure) -> bool {
    half(model, solution, figure).is_some_and(|(_, half)| half <= figure.widest())
}

fn interval(model: &Cards, solution: &Solution, figure: Figure, ruler: f64) -> Option<Interval> {
    let (place, half) = half(model, solution, figure)?;
    Some(Interval::around(ruler + solution.theta[place], half))
}

fn check_target(target: &Target) -> Result<(), FlashFitError> {
    if !(target.reflectance > 0.0 && target.reflectance <= 1.0) {
        return Err(FlashFitError::Reflectance(target.reflectance));
    }
    let rising = target.curve.windows(2).all(|w| w[0][0] < w[1][0]);
    let sound = |[angle, factor]: &[f64; 2]| (0.0..1.57).contains(angle) && *factor > 0.0 && *factor < 10.0;
    if rising && target.curve.iter().all(sound) { Ok(()) } else { Err(FlashFitError::Curve) }
}

fn check(shot: &CardShot, intrinsics: &Intrinsics) -> Result<(), FlashFitError> {
    let label = || shot.label.clone();
    let normal = shot.plane.normal;
    if !((normal.length() - 1.0).abs() < 1e-6 && normal.z < -0.17 && shot.plane.point.is_finite()) {
        return Err(FlashFitError::Plane { label: label() });
    }
    let distance = shot.plane.distance();
    if !(distance > 0.0 && distance < 1e3) {
        return Err(FlashFitError::Distance { label: label(), distance });
    }
    let expected = (intrinsics.width, intrinsics.height);
    if shot.size != expected {
        return Err(FlashFitError::Size { label: label(), got: shot.size, expected });
    }
    Ok(())
}

/// Why a shot cannot be measured, in words.
fn unfit(shot: &CardShot) -> Option<String> {
    if shot.clipped > MOST_CLIPPED {
        return Some(format!(
            "over-exposed: clipped sites in {:.0} % of the frame; put the card farther away, close the aperture or turn the flash down",
            100.0 * shot.clipped
        ));
    }
    if shot.cells.len() < FEWEST_CELLS {
        return Some("its frame is too small to measure".into());
    }
    let n = shot.cells.len() as f64;
    let mean = |c: usize| shot.cells.iter().map(|cell| cell.value[c]).sum::<f64>() / n;
    let dark = (0..3).any(|c| mean(c).is_nan() || mean(c) <= 1.0);
    dark.then(|| "dark: the flash did not fire, or its light did not reach the card".into())
}

#[cfg(test)]
#[path = "tests.rs"]
mod tests;
