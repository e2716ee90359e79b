//! A flash calibration in words.

use super::FlashCalibration;
use super::correct::AGREED;
use crate::calibration::{Verdict, holds};

/// Largest standard error of the radiance that is good, relative.
const MOST_ERROR: f64 = 0.005;

/// Largest misfit that is good, relative.
const MOST_MISFIT: f64 = 0.03;

/// Largest mean error of a prediction that is good, relative.
const MOST_PREDICTION: f64 = 0.01;

/// Variance of the residuals over the sensor's above which the model misses something.
const MOST_DISPERSION: f64 = 4.0;

impl FlashCalibration {
    /// What to make of it. `paper`: the card's reflectance was not given but taken for that of office paper.
    pub fn verdict(&self, paper: bool) -> Verdict {
        let found = &self.findings;
        let error = self.radiance_dn_standard_error.map_or(f64::INFINITY, |error| {
            (0..3).map(|c| error[c] / self.radiance_dn[c]).fold(0.0, f64::max)
        });
        let used = self.cards.iter().filter(|c| c.used).count();
        let predicted = found.held_out_error.or(found.left_one_out_error);
        let law = found.distance_exponent.zip(found.distance_exponent_interval_95);
        let second = found.second_render_ratio.iter().map(|r| (r - 1.0).abs()).fold(0.0, f64::max);
        let agreed = used != 1 || second <= AGREED;
        let good = agreed
            && error <= MOST_ERROR
            && self.misfit_rms <= MOST_MISFIT
            && predicted.is_none_or(|p| p <= MOST_PREDICTION)
            && law.is_none_or(|(exponent, interval)| holds(interval, 2.0) || (exponent - 2.0).abs() < 0.02);
        let mut said = vec![match good {
            true => format!(
                "The flash's energy is known to {} from {used} card {}.",
                percent(error),
                plural(used)
            ),
            false => format!(
                "Do not rely on this calibration: energy known to {}, cells off the model by {} beyond the sensor's noise{}.",
                percent(error),
                percent(self.misfit_rms),
                predicted.map_or_else(String::new, |p| format!(", shots predicted within {}", percent(p)))
            ),
        }];
        said.extend(self.corrected());
        for card in self.cards.iter().filter(|c| !c.used && !c.held_out) {
            let why = card.left_out.as_deref().unwrap_or("not used");
            said.push(format!("{} is left out: {why}.", card.label));
        }
        if paper {
            said.push(format!(
                "The card's reflectance of {} is that of office paper and was assumed, not measured; paper is not Lambertian, \
                 so that the energy may be off by a few per cent. Use a card of known reflectance and give it.",
                self.target_reflectance
            ));
        }
        said.push(match law {
            Some(law) if holds(law.1, 2.0) => format!(
                "Light falls with the distance to the power of {}: the inverse-square law holds.",
                told(law, 3)
            ),
            Some(law) => format!(
                "Light falls with the distance to the power of {}, which leaves out 2: check the distances, and that nothing \
                 but the flash lit the card.",
                told(law, 3)
            ),
            None => "The inverse-square law could not be tested: shoot the card at three distances or more.".into(),
        });
        said.push(match found.offset_m.zip(found.offset_m_interval_95) {
            Some((offset, interval)) => {
                let offset = (1e3 * offset, interval.map(|end| 1e3 * end));
                format!("The ring lies {} mm before the lens's centre.", told(offset, 2))
            }
            None => "Where the ring lies along the axis the shots do not tell; it is taken to lie at the lens's centre.".into(),
        });
        said.push(match (found.vignetting_given, found.lobe_exponent.zip(found.lobe_exponent_interval_95)) {
            (true, Some(lobe)) => format!("Its lobe is cos^n with n = {}.", told(lobe, 3)),
            (true, None) => "The shots do not tell the lobe; it is taken to be even.".into(),
            (false, _) => {
                "Without a flat field only the product of vignetting and lobe is known; no separate lobe is told.".into()
            }
        });
        let radius = |name: &str, told_radius: Option<(f64, [f64; 2])>, ruler: f64| {
            if found.radii_fitted {
                return Some(format!(
                    "Its {name} radius is {} m by the shots, not by the ruler.",
                    told(told_radius?, 4)
                ));
            }
            let found = told_radius.filter(|r| !holds(r.1, ruler))?;
            Some(format!(
                "The shots tell another {name} radius than the ruler's {ruler} m: {}; measure it again.",
                told(found, 4)
            ))
        };
        let inner = found.inner_radius_m.zip(found.inner_radius_m_interval_95);
        let outer = found.outer_radius_m.zip(found.outer_radius_m_interval_95);
        said.extend(radius("inner", inner, self.ring.inner));
        said.extend(radius("outer", outer, self.ring.outer));
        if found.inner_radius_m.is_none() || found.outer_radius_m.is_none() {
            said.push("The shots do not tell both radii of the ring; the ruler's values stand.".into());
        }
        if let Some(held) = found.held_out_error {
            said.push(format!("Shots kept from the fit are predicted within {} on average.", percent(held)));
        }
        if used == 1 {
            said.push(format!(
                "From a single shot: a second render is within {:.4} % of it ({:.2} % is asked for); the flash's jitter is taken to be {}.",
                100.0 * second,
                100.0 * AGREED,
                percent(found.jitter_deviation)
            ));
        } else if found.jitter_assumed {
            said.push(format!(
                "The shots are too few to tell the flash's jitter; {} is assumed.",
                percent(found.jitter_deviation)
            ));
        }
        if found.dispersion > MOST_DISPERSION {
            said.push(format!(
                "Residuals within shots have {:.0} times the sensor's variance: the card may be uneven, tilted or creased.",
                found.dispersion
            ));
        }
        Verdict { good, sentences: said }
    }

    /// How it came out of the calibration before.
    fn corrected(&self) -> Option<String> {
        let correction = self.findings.correction.as_ref()?;
        let [r, g, b] = correction.factor;
        let photodiode =
            correction.measured_factor.map_or_else(String::new, |f| format!("; the photodiode tells {f:.4}"));
        Some(format!(
            "The calibration before ({}) was multiplied by {r:.4} {g:.4} {b:.4} (red, green, blue){photodiode}; ring, field and \
             noise are its own.",
            correction.base_file
        ))
    }
}

fn percent(part: f64) -> String {
    format!("{:.2} %", 100.0 * part)
}

fn plural(n: usize) -> &'static str {
    if n == 1 { "shot" } else { "shots" }
}

/// Value and interval.
fn told((value, [low, high]): (f64, [f64; 2]), digits: usize) -> String {
    format!("{value:.digits$} ({low:.digits$} to {high:.digits$})")
}
