//! Light of the levels as far as it is known, and their signals with their errors.

use super::linearity::{self, FROM, LightSource, Linearity, NoLinearity, Reading};
use super::{IsoInput, LightLevel};

/// Part of a step by which a measured step may miss a whole number of steps.
const ODD: f64 = 0.3;

/// Holds the levels' signals against their light.
pub(super) fn linearity(input: &IsoInput) -> Result<Linearity, NoLinearity> {
    let signals = readings(&input.levels, input.range);
    let first = input.levels.first().ok_or(NoLinearity::TooFew)?;
    let one_aperture = input.levels.iter().all(|level| level.aperture == first.aperture);
    let one_time = input.levels.iter().all(|level| level.time == first.time);
    let shared = |(k, level): (usize, &LightLevel)| input.levels[..k].iter().any(|l| l.time == level.time);
    let (lights, missing, source) = match input.stops {
        Some(_) if !(one_aperture && one_time) => return Err(NoLinearity::SettingsVary),
        Some(stops) => {
            let (lights, missing) = ladder(&signals, stops)?;
            (lights, missing, LightSource::Stops)
        }
        None if one_time || !one_aperture => return Err(NoLinearity::LightUntold),
        // Two levels of one time, neighbours or not, were not made by the shutter alone.
        None if input.levels.iter().enumerate().any(shared) => return Err(NoLinearity::LightUntold),
        None => (input.levels.iter().map(|level| level.time).collect(), 0, LightSource::Shutter),
    };
    let known: Vec<(f64, [Option<Reading>; 3])> =
        lights.iter().zip(&signals).filter_map(|(light, signal)| Some(((*light)?, *signal))).collect();
    let mut found = linearity::fit(&known, input.range, input.black_error, source, missing)?;
    let darkest = known.iter().map(|level| level.0).fold(f64::INFINITY, f64::min);
    for step in &mut found.steps {
        let at = lights.iter().position(|light| light.is_some_and(|light| light / darkest == step.light));
        let pairs = at.and_then(|at| input.levels.get(at)).into_iter().flat_map(|level| &level.pairs);
        step.shot_numbers = pairs.flat_map(|pair| pair.shot_numbers.iter().copied()).collect();
    }
    Ok(found)
}

/// Mean of each colour of each level; absent where it clips in one of the level's frames.
fn readings(levels: &[LightLevel], range: [f64; 3]) -> Vec<[Option<Reading>; 3]> {
    let flicker = flicker(levels, range);
    let reading = |level: &LightLevel, c: usize| {
        let own: Option<Vec<_>> = level.pairs.iter().map(|pair| pair.signal[c]).collect();
        let own = own.filter(|own| !own.is_empty())?;
        let n = own.len() as f64;
        let mean = own.iter().map(|s| s.mean).sum::<f64>() / n;
        let noise = own.iter().map(|s| s.noise.powi(2)).sum::<f64>() / (n * n);
        Some(Reading { mean, error: (noise + flicker * mean * mean / n).sqrt() })
    };
    levels.iter().map(|level| [0, 1, 2].map(|c| reading(level, c))).collect()
}

/// Relative variance of a pair's mean that noise does not explain: lamp and shutter do not repeat. One pair tells it
/// with one degree of freedom only, so that all pairs tell it together.
fn flicker(levels: &[LightLevel], range: [f64; 3]) -> f64 {
    let (mut sum, mut count) = (0.0, 0.0f64);
    for pair in levels.iter().flat_map(|level| &level.pairs) {
        for (signal, range) in pair.signal.iter().zip(range) {
            if let Some(signal) = signal.filter(|s| s.mean >= FROM * range) {
                sum += (signal.apart.powi(2) - signal.noise.powi(2)) / signal.mean.powi(2);
                count += 1.0;
            }
        }
    }
    (sum / count.max(1.0)).max(0.0)
}

/// Light of levels that rise by `stops` from one to the next, relative to the first, and how many levels are missing in
/// between; `None` for a level in which every colour clips. `signals` ascend.
fn ladder(signals: &[[Option<Reading>; 3]], stops: f64) -> Result<(Vec<Option<f64>>, usize), NoLinearity> {
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::calibration::noise::{PairTiles, Signal};
    use crate::photometry::LevelSource;

    fn level(mean: f64, part: f64) -> LightLevel {
        let signal = [0.5, 1.0, 0.7].map(|share| {
            let mean = mean * share;
            Some(Signal { mean, noise: 1e-4 * mean, apart: part * mean })
        });
        LightLevel { time: None, aperture: None, pairs: vec![PairTiles { signal, ..PairTiles::default() }] }
    }

    #[test]
    fn a_missing_level_is_told_and_a_wrong_step_refused() {
        let lights = (0..14).filter(|k| *k != 6).map(|k| 20.0 * (0.75 * f64::from(k)).exp2());
        let levels: Vec<_> = lights.map(|light| level(light, 0.0)).collect();
        let signals = readings(&levels, [1e5; 3]);
        let (lights, missing) = ladder(&signals, 0.75).unwrap();
        assert_eq!(missing, 1);
        assert!((lights[6].unwrap() / lights[5].unwrap() - 1.5f64.exp2()).abs() < 1e-12);
        assert!(matches!(ladder(&signals, 1.1), Err(NoLinearity::OddStep { .. })));
        assert!(matches!(ladder(&signals, 0.0), Err(NoLinearity::Stops(_))));
    }

    #[test]
    fn two_levels_of_one_shutter_time_were_not_made_by_the_shutter_wherever_they_stand() {
        let told = |times: [f64; 5]| {
            let levels = times.into_iter().zip([700.0, 1400.0, 2800.0, 4000.0, 5600.0]);
            let levels = levels.map(|(time, mean)| LightLevel { time: Some(time), ..level(mean, 0.0) });
            linearity(&IsoInput {
                iso: crate::units::Iso(100.0),
                levels: levels.collect(),
                dark: vec![],
                range: [13_000.0; 3],
                black: [500.0; 3],
                cut_off_dn: None,
                steps: crate::calibration::Steps::WHOLE,
                saturation_source: LevelSource::Measured,
                black_error: 0.0,
                stops: None,
            })
        };
        assert!(told([1.0, 2.0, 4.0, 5.7, 8.0]).is_ok());
        assert_eq!(told([1.0, 2.0, 4.0, 2.0, 8.0]), Err(NoLinearity::LightUntold));
        assert_eq!(told([1.0, 2.0, 2.0, 5.7, 8.0]), Err(NoLinearity::LightUntold));
    }

    #[test]
    fn a_flicker_that_one_pair_misses_is_told_by_the_others() {
        let levels: Vec<_> = [0.0, 0.01, 0.0, 0.01].into_iter().map(|part| level(5000.0, part)).collect();
        for reading in readings(&levels, [13_000.0; 3]).iter().flatten().flatten() {
            assert!((reading.error / reading.mean - 0.01 * 0.5f64.sqrt()).abs() < 1e-6, "{reading:?}");
        }
    }
}
