//! Linearity: signal over known light, and where it leaves the straight line.
//!
//! A colour's line goes through black: that is what subtracting and scaling frames takes for granted (EMVA 1288 release
//! 4.0, section 6.7, fits an offset too). Its slope is the mean of signal over light of the levels from 5 to 70 % of the
//! range, each with the same relative weight, as EMVA has it. The deviation of a level is signal / (slope * light) - 1,
//! and the linearity error the mean of the deviations' absolute values over 5 to 95 % of the range, up to the knee. The
//! knee is the lowest signal that deviates by more than one percent (and more than two standard errors), all brighter
//! ones doing so too.

use super::tiles::Signal;
use super::{COLOURS, FIT_TO};
use serde::{Deserialize, Serialize};

/// Share of the range from which levels count.
const FROM: f64 = 0.05;
/// Share of the range up to which levels count for the linearity error.
const TO: f64 = 0.95;
/// Levels that a colour needs between [`FROM`] and [`FIT_TO`].
const FEWEST: usize = 3;
/// Deviation from which the knee is reached.
const KNEE: f64 = 0.01;
/// Part of a step by which a measured step may miss a whole number of steps.
const ODD: f64 = 0.3;

/// Where the ratio of light between levels is known from.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum LightSource {
    /// The step in stops that was given.
    Stops,
    /// Shutter times, by what their labels stand for.
    Shutter,
}

/// How straight the sensor's response is.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Linearity {
    /// Where the light is known from.
    pub light_source: LightSource,
    /// Mean absolute deviation from the line, 1 = 100 %.
    pub linearity_error: f64,
    /// The deviation that is largest in absolute value, among those that count, 1 = 100 %.
    pub largest_deviation: f64,
    /// Least and largest signal that counts, DN above black.
    pub range_dn: [f64; 2],
    /// Signal from which the response leaves the line by more than 1 %, DN above black; absent if no level does.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub knee_dn: Option<f64>,
    /// Largest unclipped signal that was held against the line, DN above black.
    pub checked_to_dn: f64,
    /// Levels that are missing from an even ladder of light.
    pub missing_levels: usize,
    /// Every level and colour that does not clip.
    pub steps: Vec<LinearityStep>,
}

/// One colour of one level.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct LinearityStep {
    /// Light relative to the dimmest level.
    pub light: f64,
    /// "red", "green" or "blue".
    pub colour: String,
    /// Mean over the frame, DN above black.
    pub signal_dn: f64,
    /// Signal over what the line says, less 1.
    pub deviation: f64,
    /// Standard error of `deviation`: noise, black, and how far the level's two frames part.
    pub deviation_error: f64,
}

/// Why linearity could not be measured.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum NoLinearity {
    /// Nothing tells how much brighter a level is than another.
    #[error(
        "the light's steps are not known: give --stops if the light was raised by one step between levels, or vary the shutter time at one light"
    )]
    LightUntold,
    /// The step given is impossible.
    #[error(
        "steps of {0} stops are not possible: give the stops between successive levels, for example 0.75"
    )]
    Stops(f64),
    /// Shutter or aperture vary beside the light.
    #[error(
        "shutter time or aperture vary between the frames, but --stops says that the light alone does; give frames of one setting, or leave --stops out"
    )]
    SettingsVary,
    /// Levels that do not stand on the ladder.
    #[error(
        "the levels at {from:.0} and {to:.0} DN lie {measured:.2} stops apart, which is no whole number of steps of {stops} stops; check --stops, and that nothing but the light changed"
    )]
    OddStep {
        /// Signal of the dimmer level, DN above black.
        from: f64,
        /// Of the brighter one.
        to: f64,
        /// Their distance, stops.
        measured: f64,
        /// The step given.
        stops: f64,
    },
    /// Too few.
    #[error(
        "no colour has {FEWEST} levels between 5 and 70 % of the range; shoot more levels of light, up to clipping"
    )]
    TooFew,
}

/// Light of levels that rise by `stops` from one to the next, relative to the first, and how many levels are missing in
/// between; `None` for a level in which every colour clips. `signals` ascend.
pub(super) fn ladder(
    signals: &[[Option<Signal>; 3]],
    stops: f64,
) -> Result<(Vec<Option<f64>>, usize), NoLinearity> {
    if !(stops > 0.0 && stops <= 8.0) {
        return Err(NoLinearity::Stops(stops));
    }
    let (mut lights, mut missing, mut at) = (vec![], 0, 0usize);
    for (index, now) in signals.iter().enumerate() {
        if index > 0 {
            let before = &signals[index - 1];
            let both = (0..3).filter_map(|c| Some((before[c]?.mean, now[c]?.mean)));
            let brightest = both.filter(|(a, b)| *a > 0.0 && *b > 0.0).max_by(|a, b| a.1.total_cmp(&b.1));
            let Some((from, to)) = brightest else {
                lights.resize(signals.len(), None);
                return Ok((lights, missing));
            };
            let measured = (to / from).log2();
            let steps = (measured / stops).round();
            if steps < 1.0 || (measured / stops - steps).abs() > ODD {
                return Err(NoLinearity::OddStep { from, to, measured, stops });
            }
            missing += steps as usize - 1;
            at += steps as usize;
        }
        lights.push(Some((stops * at as f64).exp2()));
    }
    Ok((lights, missing))
}

/// Holds signals against light. `range` is saturation less black of each colour, DN; `black_error` that of black.
pub(super) fn fit(
    levels: &[(f64, [Option<Signal>; 3])],
    range: [f64; 3],
    black_error: f64,
    light_source: LightSource,
    missing_levels: usize,
) -> Result<Linearity, NoLinearity> {
    let darkest = levels.iter().map(|level| level.0).fold(f64::INFINITY, f64::min);
    // Step and its share of the colour's range.
    let mut steps: Vec<(LinearityStep, f64)> = vec![];
    for c in 0..3 {
        let own: Vec<(f64, Signal)> =
            levels.iter().filter_map(|(light, signal)| Some((light / darkest, signal[c]?))).collect();
        let inside: Vec<&(f64, Signal)> =
            own.iter().filter(|(_, s)| (FROM..=FIT_TO).contains(&(s.mean / range[c]))).collect();
        if inside.len() < FEWEST {
            continue;
        }
        let n = inside.len() as f64;
        let slope = inside.iter().map(|(light, s)| s.mean / light).sum::<f64>() / n;
        let error = |s: &Signal| s.error.hypot(black_error) / s.mean;
        let of_slope = inside.iter().map(|(_, s)| error(s).powi(2)).sum::<f64>().sqrt() / n;
        for (light, s) in own.iter().filter(|(_, s)| s.mean > 0.0) {
            let step = LinearityStep {
                light: *light,
                colour: COLOURS[c].to_owned(),
                signal_dn: s.mean,
                deviation: s.mean / (slope * light) - 1.0,
                deviation_error: error(s).hypot(of_slope),
            };
            steps.push((step, s.mean / range[c]));
        }
    }
    steps.sort_by(|a, b| a.0.signal_dn.total_cmp(&b.0.signal_dn));
    let bent = |step: &LinearityStep| step.deviation.abs() > KNEE.max(2.0 * step.deviation_error);
    let straight = steps.iter().rposition(|(step, _)| !bent(step)).map_or(0, |last| last + 1);
    let knee_dn = steps.get(straight).map(|(step, _)| step.signal_dn);
    let counting: Vec<&LinearityStep> = steps[..straight]
        .iter()
        .filter(|(_, share)| (FROM..=TO).contains(share))
        .map(|(step, _)| step)
        .collect();
    let (Some(first), Some(last), Some(top)) = (counting.first(), counting.last(), steps.last()) else {
        return Err(NoLinearity::TooFew);
    };
    let largest =
        counting.iter().map(|s| s.deviation).fold(0.0, |a: f64, b| if b.abs() > a.abs() { b } else { a });
    Ok(Linearity {
        light_source,
        linearity_error: counting.iter().map(|s| s.deviation.abs()).sum::<f64>() / counting.len() as f64,
        largest_deviation: largest,
        range_dn: [first.signal_dn, last.signal_dn],
        knee_dn,
        checked_to_dn: top.0.signal_dn,
        missing_levels,
        steps: steps.into_iter().map(|(step, _)| step).collect(),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    const RANGE: [f64; 3] = [13_000.0; 3];

    fn level(light: f64, response: impl Fn(f64) -> f64) -> [Option<Signal>; 3] {
        [0.5, 1.0, 0.7].map(|gain| {
            let mean = response(gain * light);
            (mean < RANGE[0]).then_some(Signal { mean, error: 1e-4 * mean })
        })
    }

    #[test]
    fn a_straight_sensor_has_no_error_and_a_missing_level_is_told() {
        let lights: Vec<f64> =
            (0..14).filter(|k| *k != 6).map(|k| 20.0 * (0.75 * f64::from(k)).exp2()).collect();
        let signals: Vec<_> = lights.iter().map(|&light| level(light, |x| x)).collect();
        let (found, missing) = ladder(&signals, 0.75).unwrap();
        assert_eq!(missing, 1);
        let levels: Vec<_> = found.iter().zip(&signals).map(|(light, s)| (light.unwrap(), *s)).collect();
        let fit = fit(&levels, RANGE, 0.0, LightSource::Stops, missing).unwrap();
        assert!(fit.linearity_error < 1e-12 && fit.knee_dn.is_none(), "{fit:?}");
        assert!(matches!(ladder(&signals, 1.1), Err(NoLinearity::OddStep { .. })));
        assert!(matches!(ladder(&signals, 0.0), Err(NoLinearity::Stops(_))));
    }

    #[test]
    fn the_knee_of_a_bent_sensor_is_found_and_the_error_counts_below_it() {
        // Beyond 9000 DN half the further light is lost.
        let bend = |x: f64| if x < 9000.0 { x } else { 9000.0 + 0.5 * (x - 9000.0) };
        let levels: Vec<_> = (0..60)
            .map(|k| 100.0 * (f64::from(k) / 6.0).exp2())
            .filter(|light| *light < 24_000.0)
            .map(|light| (light, level(light, bend)))
            .collect();
        let fit = fit(&levels, RANGE, 0.0, LightSource::Shutter, 0).unwrap();
        let knee = fit.knee_dn.unwrap();
        assert!((9000.0..10_500.0).contains(&knee), "{knee}");
        assert!(fit.linearity_error < 0.003, "{}", fit.linearity_error);
        assert!(fit.checked_to_dn > 12_000.0);
    }

    #[test]
    fn two_levels_tell_nothing() {
        let levels: Vec<_> = [3000.0, 6000.0].map(|light| (light, level(light, |x| x))).to_vec();
        assert_eq!(fit(&levels, RANGE, 0.0, LightSource::Stops, 0), Err(NoLinearity::TooFew));
    }
}
