//! The fits to one series, and what they tell.

use super::card::{CardShot, SeenShot, Setting, Target};
use super::check::{check, check_target, unfit};
use super::mixed::{ShotSums, Solution, solve};
use super::model::{Cards, Figure, first_guess};
use super::{
    CardResidual, FEWEST_CELLS, FlashCalibration, FlashFacts, FlashFindings, FlashFitError, MOST_MISFIT,
    USUAL_JITTER, Vignetting, misfit,
};
use crate::light::Ring;

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
    let (vignetting, free_radii) = (facts.vignetting, facts.free_radii);
    let fits = Fits { cards: &cards, ring: facts.ring, guess, vignetting, free_radii };
    let (model, solution) = fits.main().ok_or(FlashFitError::Vague)?;
    let flash = model.flash(&solution.theta).ok_or(FlashFitError::Vague)?;

    let shot_rms: Vec<f64> = solution.sums.iter().map(ShotSums::rms).collect();
    let count: f64 = solution.sums.iter().map(|s| s.count).sum();
    let squares: f64 = solution.sums.iter().zip(&shot_rms).map(|(s, rms)| s.count * rms * rms).sum();
    let rms = (squares / count).sqrt();
    let noise: f64 = solution.sums.iter().map(|s| s.noise).sum();
    let misfit_rms = misfit(rms, noise / count);
    if misfit_rms.is_nan() || misfit_rms > MOST_MISFIT {
        return Err(FlashFitError::Residual(100.0 * misfit_rms));
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
            None => sums.as_ref().map(ShotSums::own),
        };
        CardResidual {
            label: shot.label.clone(),
            distance_m: shot.plane.distance(),
            gain: sums.as_ref().map(|sums| energy * (1.0 + sums.own())),
            measured_gain: measured_gain(s),
            residual_rms: sums.as_ref().map(ShotSums::rms),
            clipped_share: shot.clipped,
            used: place.is_some(),
            left_out: match place {
                Some(_) => None,
                None => Some(reasons[s].clone().unwrap_or_else(|| "kept from the fit, to check it".into())),
            },
            prediction_error,
            prediction_error_interval_95: sums.as_ref().filter(|_| place.is_none()).map(|sums| {
                let half = solution.half_prediction(sums);
                [sums.own() - half, sums.own() + half]
            }),
            held_out: shot.held_out,
        }
    });
    let cards_told: Vec<CardResidual> = residuals.collect();
    let findings = fits.findings(&model, &solution, &cards_told, facts.target);
    Ok(FlashCalibration {
        ring: flash.ring,
        radiance_dn: flash.radiance,
        radiance_dn_interval_95: Some(fits.radiance_interval(&solution)),
        radiance_dn_standard_error: Some(std::array::from_fn(|c| flash.radiance[c] * solution.error(c))),
        field: flash.field,
        colour_vignetting: None,
        noise: facts.noise,
        target_reflectance: facts.target.reflectance,
        iso: None,
        aperture: None,
        focal_length_mm: None,
        energy_counts,
        cards: cards_told,
        residual_rms: rms,
        misfit_rms,
        findings,
    })
}

/// The fits to one series.
struct Fits<'a> {
    cards: &'a [SeenShot],
    ring: Ring,
    guess: [f64; 3],
    vignetting: Option<Vignetting>,
    free_radii: bool,
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
        if self.free_radii {
            figures.extend([Figure::Inner, Figure::Outer]);
        }
        loop {
            let Some((model, solution)) = self.with(figures.clone(), &[]) else {
                // Fewer may be told apart.
                figures.pop()?;
                continue;
            };
            let told: Vec<Figure> =
                figures.iter().copied().filter(|f| tells(&model, &solution, *f)).collect();
            if told.len() == figures.len() {
                return Some((model, solution));
            }
            figures = told;
        }
    }

    fn findings(
        &self,
        model: &Cards,
        solution: &Solution,
        cards: &[CardResidual],
        target: &Target,
    ) -> FlashFindings {
        let more = |figures: &[Figure]| self.with([model.figures(), figures].concat(), &solution.theta);
        let exponent = more(&[Figure::Exponent])
            .filter(|(model, fit)| tells(model, fit, Figure::Exponent))
            .and_then(|(model, fit)| interval(&model, &fit, Figure::Exponent, 2.0));
        // A radius that was fitted with the rest stands; else what the shots would say of both.
        let free = [Figure::Inner, Figure::Outer].into_iter().any(|f| model.place(f).is_some());
        let radii = if free { None } else { more(&[Figure::Inner, Figure::Outer]) };
        let radius = |figure, ruler| {
            let (model, fit) = radii.as_ref().map_or((model, solution), |(model, fit)| (model, fit));
            tells(model, fit, figure).then(|| interval(model, fit, figure, ruler)).flatten()
        };
        let mean_size = |wanted: &dyn Fn(&CardResidual) -> bool| {
            let errors: Vec<f64> =
                cards.iter().filter(|c| wanted(c)).filter_map(|c| Some(c.prediction_error?.abs())).collect();
            (!errors.is_empty()).then(|| errors.iter().sum::<f64>() / errors.len() as f64)
        };
        let (offset_m, offset_m_interval_95) =
            interval(model, solution, Figure::Offset, self.ring.offset).unzip();
        let (lobe_exponent, lobe_exponent_interval_95) =
            interval(model, solution, Figure::Lobe, self.ring.lobe).unzip();
        let (inner_radius_m, inner_radius_m_interval_95) = radius(Figure::Inner, self.ring.inner).unzip();
        let (outer_radius_m, outer_radius_m_interval_95) = radius(Figure::Outer, self.ring.outer).unzip();
        let (distance_exponent, distance_exponent_interval_95) = exponent.unzip();
        FlashFindings {
            offset_m,
            offset_m_interval_95,
            lobe_exponent,
            lobe_exponent_interval_95,
            inner_radius_m,
            inner_radius_m_interval_95,
            outer_radius_m,
            outer_radius_m_interval_95,
            distance_exponent,
            distance_exponent_interval_95,
            vignetting_given: self.vignetting.is_some(),
            radii_fitted: free,
            flat_field: None,
            jitter_deviation: solution.variance.sqrt(),
            jitter_assumed: solution.freedom.is_none(),
            dispersion: solution.dispersion,
            left_one_out_error: mean_size(&|c| c.used),
            held_out_error: mean_size(&|c| c.held_out && !c.used),
            second_render_ratio: self.second_render(model, solution),
            target_factor_by_angle_rad: target.curve.clone(),
            correction: None,
            card_tags: vec![],
        }
    }

    /// Ends of the radiances' 95 % intervals, red green blue.
    fn radiance_interval(&self, solution: &Solution) -> [[f64; 2]; 3] {
        std::array::from_fn(|c| {
            let (value, half) = (self.guess[c] * solution.theta[c].exp(), solution.half_interval(c));
            [value * (-half).exp(), value * half.exp()]
        })
    }

    /// Light of all cells over that of a render with the figures found (thesis, table 3.4), by a sum over points of the
    /// ring in place of the closed form.
    fn second_render(&self, model: &Cards, solution: &Solution) -> [f64; 3] {
        let (mut measured, mut rendered) = ([0.0; 3], [0.0; 3]);
        let Some(flash) = model.flash(&solution.theta) else { return [1.0; 3] };
        for (shot, sums) in self.cards.iter().zip(&solution.sums) {
            let own = shot.energy * (1.0 + sums.own());
            for cell in &shot.cells {
                let light = flash.ring.summed_irradiance(cell.point, shot.normal) * cell.target;
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
    Some((place, solution.half_interval(place)))
}

/// Whether the shots tell a figure well enough to be of use.
fn tells(model: &Cards, solution: &Solution, figure: Figure) -> bool {
    half(model, solution, figure).is_some_and(|(_, half)| half <= figure.widest())
}

/// A figure and its 95 % interval.
fn interval(model: &Cards, solution: &Solution, figure: Figure, ruler: f64) -> Option<(f64, [f64; 2])> {
    let (place, half) = half(model, solution, figure)?;
    let value = ruler + solution.theta[place];
    Some((value, [value - half, value + half]))
}
