//! Linearity: signal over known light, and where it leaves the straight line.
//!
//! A colour's line goes through black: that is what subtracting and scaling frames takes for granted (EMVA 1288 release
//! 4.0, section 6.7, fits an offset too). Its slope is the mean of signal over light of the levels from 5 to 70 % of the
//! range and below the knee, each with the same relative weight, as EMVA has it. The deviation of a level is
//! signal / (slope * light) - 1, and the linearity error the mean of the deviations' absolute values over 5 to 95 % of the
//! range, up to the knee.
//!
//! A colour's knee is where it leaves the line for good: its brightest levels, all from there on, deviate by more than one
//! percent (and more than three standard errors). Where between two levels it passes one percent is interpolated. Since
//! bent levels would tilt the line, the first slope is the median of signal over light, and slope and knee are sought in
//! turn until they stand.
//!
//! Where the shutter makes the levels, its labels are the reference, and shutters keep to them to some 2 % only. How far the
//! levels scatter about the line (1 % at least) then enters the errors, so that a shutter's error is not told as a knee.

use super::{COLOURS, FIT_TO};
use serde::{Deserialize, Serialize};

/// Share of the range from which levels count.
pub(super) const FROM: f64 = 0.05;
/// Share of the range up to which levels count for the linearity error.
const TO: f64 = 0.95;
/// Levels that a colour needs between [`FROM`] and [`FIT_TO`].
const FEWEST: usize = 3;
/// Deviation from which the knee is reached.
const KNEE: f64 = 0.01;
/// Standard errors that a bent level must deviate by.
pub(super) const SURE: f64 = 3.0;
/// Part by which a shutter's time usually misses its label: half of it is one standard error.
pub(super) const LABEL: f64 = 0.02;
/// Standard deviation of normal noise over its median absolute deviation.
const OF_MEDIAN: f64 = 1.4826;
/// Rounds of seeking slope and knee in turn.
const ROUNDS: usize = 10;

/// Mean of a colour at a level of light.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Reading {
    /// DN above black.
    pub(super) mean: f64,
    /// Standard error, DN.
    pub(super) error: f64,
}

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
    /// Standard error of the light by the shutter's labels, 1 = 100 %, the largest of the colours; absent without labels.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub label_standard_error: Option<f64>,
    /// Mean absolute deviation from the line, 1 = 100 %.
    pub linearity_error: f64,
    /// The deviation that is largest in absolute value, among those that count, 1 = 100 %.
    pub largest_deviation: f64,
    /// Least and largest signal that counts, DN above black.
    pub range_dn: [f64; 2],
    /// Signal from which the response of a colour leaves the line by more than 1 %, DN above black, the lowest of the
    /// colours; absent if none does.
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
    /// Standard error of `deviation`: noise, black, how far two frames of one light part, and how far the shutter's labels
    /// may be off where they tell the light.
    pub deviation_standard_error: f64,
    /// Whether it counts for `linearity_error`.
    #[serde(default)]
    pub counts: bool,
    /// Frames of the level: places in the order given, from 0.
    #[serde(default)]
    pub shot_numbers: Vec<usize>,
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
        "no colour has {FEWEST} levels on a straight line between 5 and 70 % of the range; shoot more levels of light, up to clipping"
    )]
    TooFew,
}

/// One colour against its line.
struct Response {
    /// Deviation and its standard error of every level.
    deviations: Vec<(f64, f64)>,
    /// Levels before the knee.
    straight: usize,
    /// Signal at the knee, DN.
    knee: Option<f64>,
    /// Standard error of the light by labels.
    label: f64,
}

/// Line and knee of one colour; `own` has light and reading of its levels, ascending. `None` if fewer than [`FEWEST`]
/// levels stand on a line.
fn response(own: &[(f64, Reading)], range: f64, black_error: f64, source: LightSource) -> Option<Response> {
    let inside = |until: usize| -> Vec<&(f64, Reading)> {
        own[..until].iter().filter(|(_, s)| (FROM..=FIT_TO).contains(&(s.mean / range))).collect()
    };
    let mut ratios: Vec<f64> = inside(own.len()).iter().map(|(light, s)| s.mean / light).collect();
    if ratios.len() < FEWEST {
        return None;
    }
    ratios.sort_by(f64::total_cmp);
    let (mut slope, mut of_slope) = (ratios[(ratios.len() - 1) / 2], 0.0);
    let label = match source {
        LightSource::Stops => 0.0,
        LightSource::Shutter => {
            let mut off: Vec<f64> = ratios.iter().map(|ratio| (ratio / slope - 1.0).abs()).collect();
            off.sort_by(f64::total_cmp);
            (OF_MEDIAN * off[off.len() / 2]).max(0.5 * LABEL)
        }
    };
    let error = |s: &Reading| (s.error.hypot(black_error) / s.mean).hypot(label);
    let mut straight = own.len();
    let mut deviations = vec![];
    for round in 0..ROUNDS {
        let deviation =
            |(light, s): &(f64, Reading)| (s.mean / (slope * light) - 1.0, error(s).hypot(of_slope));
        deviations = own.iter().map(deviation).collect();
        let bent = |(deviation, error): &(f64, f64)| deviation.abs() > KNEE.max(SURE * error);
        let found = deviations.iter().rposition(|d| !bent(d)).map_or(0, |last| last + 1);
        if round > 0 && found == straight {
            break;
        }
        straight = found;
        let levels = inside(straight);
        if levels.len() < FEWEST {
            return None;
        }
        let n = levels.len() as f64;
        slope = levels.iter().map(|(light, s)| s.mean / light).sum::<f64>() / n;
        of_slope = levels.iter().map(|(_, s)| error(s).powi(2)).sum::<f64>().sqrt() / n;
    }
    let knee = own.get(straight).map(|(_, bent)| {
        let ((before, _), (beyond, _)) = (deviations[straight - 1], deviations[straight]);
        let (before, beyond) = (before * beyond.signum(), beyond.abs());
        let last = own[straight - 1].1.mean;
        last + (bent.mean - last) * ((KNEE - before) / (beyond - before)).clamp(0.0, 1.0)
    });
    Some(Response { deviations, straight, knee, label })
}

/// Holds readings against light; levels ascend. `range` is saturation less black of each colour, DN; `black_error` that of
/// black.
pub(super) fn fit(
    levels: &[(f64, [Option<Reading>; 3])],
    range: [f64; 3],
    black_error: f64,
    light_source: LightSource,
    missing_levels: usize,
) -> Result<Linearity, NoLinearity> {
    let darkest = levels.iter().map(|level| level.0).fold(f64::INFINITY, f64::min);
    let (mut steps, mut label_error, mut knee_dn) = (vec![], 0.0f64, None::<f64>);
    for c in 0..3 {
        let own = levels.iter().filter_map(|(light, readings)| Some((light / darkest, readings[c]?)));
        let own: Vec<(f64, Reading)> = own.filter(|(_, s)| s.mean > 0.0).collect();
        let Some(found) = response(&own, range[c], black_error, light_source) else { continue };
        label_error = label_error.max(found.label);
        knee_dn = match (knee_dn, found.knee) {
            (Some(lowest), Some(own)) => Some(lowest.min(own)),
            (either, other) => either.or(other),
        };
        for (at, ((light, s), (deviation, deviation_standard_error))) in
            own.iter().zip(found.deviations).enumerate()
        {
            steps.push(LinearityStep {
                light: *light,
                colour: COLOURS[c].to_owned(),
                signal_dn: s.mean,
                deviation,
                deviation_standard_error,
                counts: at < found.straight && (FROM..=TO).contains(&(s.mean / range[c])),
                shot_numbers: vec![],
            });
        }
    }
    steps.sort_by(|a, b| a.signal_dn.total_cmp(&b.signal_dn));
    let counting: Vec<&LinearityStep> = steps.iter().filter(|step| step.counts).collect();
    let (Some(first), Some(last), Some(top)) = (counting.first(), counting.last(), steps.last()) else {
        return Err(NoLinearity::TooFew);
    };
    let larger = |a: f64, b: f64| if b.abs() > a.abs() { b } else { a };
    Ok(Linearity {
        light_source,
        label_standard_error: (label_error > 0.0).then_some(label_error),
        linearity_error: counting.iter().map(|step| step.deviation.abs()).sum::<f64>()
            / counting.len() as f64,
        largest_deviation: counting.iter().map(|step| step.deviation).fold(0.0, larger),
        range_dn: [first.signal_dn, last.signal_dn],
        knee_dn,
        checked_to_dn: top.signal_dn,
        missing_levels,
        steps,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;
    use rand_distr::{Distribution, StandardNormal};

    const RANGE: [f64; 3] = [13_000.0; 3];

    fn level(light: f64, response: impl Fn(f64) -> f64) -> [Option<Reading>; 3] {
        [0.5, 1.0, 0.7].map(|gain| {
            let mean = response(gain * light);
            (mean < RANGE[0]).then_some(Reading { mean, error: 1e-4 * mean })
        })
    }

    #[test]
    fn a_straight_sensor_has_no_error() {
        let lights = (0..14).map(|k| 20.0 * (0.75 * f64::from(k)).exp2());
        let levels: Vec<_> = lights.map(|light| (light, level(light, |x| x))).collect();
        let fit = fit(&levels, RANGE, 0.0, LightSource::Stops, 1).unwrap();
        assert!(fit.linearity_error < 1e-12 && fit.knee_dn.is_none(), "{fit:?}");
        assert_eq!(fit.missing_levels, 1);
    }

    #[test]
    fn the_knee_of_a_bent_sensor_is_found_and_the_error_counts_below_it() {
        // Beyond 5000 DN half the further light is lost: one percent at 0.5 * 5000 / 0.49 of light.
        let bend = |x: f64| if x < 5000.0 { x } else { 5000.0 + 0.5 * (x - 5000.0) };
        let levels: Vec<_> = (0..60)
            .map(|k| 100.0 * (f64::from(k) / 6.0).exp2())
            .filter(|light| *light < 22_000.0)
            .map(|light| (light, level(light, bend)))
            .collect();
        let fit = fit(&levels, RANGE, 0.0, LightSource::Shutter, 0).unwrap();
        let knee = fit.knee_dn.unwrap();
        assert!((4900.0..5300.0).contains(&knee), "{knee}");
        assert!(fit.linearity_error < 0.002, "{}", fit.linearity_error);
        assert!(fit.checked_to_dn > 12_000.0);
    }

    #[test]
    fn one_colours_knee_is_not_hidden_by_another_that_stays_straight() {
        let levels: Vec<_> = (0..40)
            .map(|k| 100.0 * (f64::from(k) / 4.0).exp2())
            .map(|light| {
                let mut readings = level(light, |x| x);
                readings[1] = readings[1].map(|s| Reading { mean: s.mean.min(8000.0), ..s });
                (light, readings)
            })
            .collect();
        let knee = fit(&levels, RANGE, 0.0, LightSource::Shutter, 0).unwrap().knee_dn.unwrap();
        assert!((6500.0..8100.0).contains(&knee), "{knee}");
    }

    #[test]
    fn knees_of_a_thousand_random_sensors_are_found_and_straight_ones_have_none() {
        let mut random = ChaCha8Rng::seed_from_u64(23);
        let (mut invented, mut missed, mut off, mut inside, mut all) = (0, 0, 0, 0.0, 0.0);
        for number in 0..1000 {
            let step: f64 = 0.2 + 0.5 * random.random::<f64>();
            // Levels scatter by up to 0.5 % of themselves.
            let part = 5e-3 * random.random::<f64>().powi(2);
            let (from, rest) = (4000.0 + 5000.0 * random.random::<f64>(), 0.2 + 0.5 * random.random::<f64>());
            let bent = number % 2 == 0;
            let bend = |x: f64| if bent && x > from { from + rest * (x - from) } else { x };
            let mut levels = vec![];
            for k in 0..60 {
                let light = 60.0 * (step * f64::from(k)).exp2();
                // What a lamp does to one colour it does to all.
                let lamp: f64 = StandardNormal.sample(&mut random);
                let readings = level(light * (1.0 + part * lamp), bend);
                let readings = readings.map(|r| r.map(|r| Reading { error: part.max(1e-4) * r.mean, ..r }));
                if readings[1].is_none() {
                    break;
                }
                levels.push((light, readings));
            }
            let fit = fit(&levels, RANGE, 0.0, LightSource::Stops, 0).unwrap();
            // One percent below the line.
            let wanted = 0.99 * (1.0 - rest) * from / (0.99 - rest);
            match (bent && wanted < 0.6 * fit.checked_to_dn, fit.knee_dn) {
                (true, None) => missed += 1,
                (true, Some(found)) => {
                    let reach = step.exp2() * (1.0 + 6.0 * part);
                    off += usize::from(!(wanted / reach..wanted * reach).contains(&found));
                }
                (false, Some(_)) if !bent => invented += 1,
                _ => {}
            }
            if !bent {
                for s in fit.steps.iter().filter(|s| s.signal_dn > FROM * RANGE[0]) {
                    all += 1.0;
                    inside += f64::from(u8::from(s.deviation.abs() < 1.96 * s.deviation_standard_error));
                }
            }
        }
        let covered: f64 = inside / all;
        println!("invented {invented}, missed {missed}, off {off}, deviations {covered} of {all}");
        assert!(invented <= 10 && missed <= 5 && off <= 25, "{invented} {missed} {off}");
        assert!((0.90..=0.98).contains(&covered), "{covered}");
    }

    #[test]
    fn shutters_that_miss_their_labels_by_two_percent_bend_no_sensor() {
        let mut random = ChaCha8Rng::seed_from_u64(29);
        let (mut invented, mut by_stops, mut inside, mut all) = (0, 0, 0.0, 0.0);
        for _ in 0..500 {
            let mut levels = vec![];
            for k in 0..20 {
                let light = 150.0 * (f64::from(k) / 3.0).exp2();
                let off = LABEL * (2.0 * random.random::<f64>() - 1.0);
                levels.push((light, level(light * (1.0 + off), |x| x)));
            }
            let of = |source| fit(&levels, RANGE, 0.0, source, 0).unwrap();
            by_stops += usize::from(of(LightSource::Stops).knee_dn.is_some());
            let fit = of(LightSource::Shutter);
            invented += usize::from(fit.knee_dn.is_some());
            for s in fit.steps.iter().filter(|s| s.signal_dn > FROM * RANGE[0]) {
                all += 1.0;
                inside += f64::from(u8::from(s.deviation.abs() < 1.96 * s.deviation_standard_error));
            }
        }
        let covered: f64 = inside / all;
        println!("knees by shutter {invented}, by stops {by_stops} of 500; deviations {covered} of {all}");
        assert!(invented <= 5 && by_stops > 100, "{invented}, {by_stops}");
        assert!(covered > 0.93, "{covered}");
    }

    #[test]
    fn two_levels_tell_nothing() {
        let levels: Vec<_> = [3000.0, 6000.0].map(|light| (light, level(light, |x| x))).to_vec();
        assert_eq!(fit(&levels, RANGE, 0.0, LightSource::Stops, 0), Err(NoLinearity::TooFew));
    }
}
