//! The exposure table: what every step of a setting really does to the sensor's values, against the APEX ideal.
//!
//! A ladder is a series in steady light in which one setting moves and the other two stay (thesis 3.2, table 3.1). The
//! factor of a step against the ladder's darkest one (step 00) is a ratio of sums above black,
//!
//! ```text
//! F_k = mean over its shots of sum_T y / mean over the shots of step 00 of sum_T y,
//! deviation_k = F_k / 2^(stops_k - stops_0) - 1           (2^(k/3) in thirds: eq. 3.6 with Delta EV = k/3)
//! ```
//!
//! T are the tiles and colours of the whole frame that are not over-exposed in any shot of the two steps: the same ones
//! in numerator and denominator, so vignetting and the colour of the light cancel, and a step that clips in green at the
//! centre is still measured on the rest. For shot noise a ratio of sums is the maximum likelihood. Its relative
//! variance is, to first order,
//!
//! ```text
//! var(ln F) = var(Y_k) / Y_k^2 + var(Y_0) / Y_0^2 + s^2 (1 / n_k + 1 / n_0)
//! ```
//!
//! with the tiles' own variances. s is the scatter of shots of one setting beyond noise (shutter, diaphragm, lamp), by
//! moments over all steps that were shot more than once; without such steps it is not known and not in the interval,
//! and the verdict says so.

mod ladder;
mod table;
#[cfg(test)]
mod tests;
mod words;

pub use ladder::Setting;
pub use table::{ExposureTable, ScaleSource};
pub use words::verdict;

use super::statistics::{Z95, t_975};
use super::tiles::{EvenFrame, Tiles};
use crate::pair::Settings;
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, BTreeSet};

/// Share of the frame that must not be over-exposed for a shot to count.
const LEAST_FRAME: f64 = 0.02;
/// Largest relative standard error of a shot's light for it to count.
const MOST_ERROR: f64 = 0.01;
/// A deviation beyond half a third of a stop is no tolerance of a camera.
const HALF_STEP: f64 = 0.122;

/// The thesis's table 3.2: its camera against the ideal. Mean, max, min, SD by setting, in the order of
/// [`Setting::ALL`]. Its max and min are magnitudes (its means lie below its minima).
pub const THESIS: [Summary; 3] = [
    Summary { mean: 0.0045, max: 0.0451, min: 0.0016, sd: 0.0245 },
    Summary { mean: 0.0028, max: 0.0915, min: 0.0314, sd: 0.0593 },
    Summary { mean: -0.0056, max: 0.0236, min: 0.0016, sd: 0.0115 },
];

/// Deviations of one setting, unit-free, as the thesis's table 3.2 has them.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Summary {
    /// Mean, with sign.
    pub mean: f64,
    /// Largest magnitude.
    pub max: f64,
    /// Least magnitude.
    pub min: f64,
    /// Standard deviation (n - 1).
    pub sd: f64,
}

/// One step of a ladder.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Step {
    /// Label: ISO, seconds or f-number.
    pub label: f64,
    /// Thirds of a stop above step 00, as the labels have it.
    pub step_thirds: f64,
    /// Measured light relative to step 00.
    pub factor: f64,
    /// Measured factor over the ideal one, less 1. Exactly 0 at step 00.
    pub deviation: f64,
    /// 95 % interval of the deviation.
    pub deviation_interval_95: [f64; 2],
    /// Shots that it is the mean of.
    pub shots: usize,
    /// Which they are: places in the order given, from 0.
    #[serde(default)]
    pub shot_numbers: Vec<usize>,
    /// Share of tiles and colours that were compared with step 00, 0 to 1.
    pub frame_share: f64,
    /// How much the pattern of light over the frame differs from step 00's, beyond noise; relative, one standard
    /// deviation. A lens's vignetting moves so with the aperture.
    pub pattern_sd: f64,
}

/// One ladder.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Ladder {
    /// What moves.
    pub setting: Setting,
    /// The two labels that stay: ISO, seconds or f-number.
    pub shared: BTreeMap<Setting, f64>,
    /// From the darkest up.
    pub steps: Vec<Step>,
    /// Mean light of step 00 above black, DN.
    pub step_00_dn: f64,
    /// Scatter of shots of one label beyond noise, relative; absent if none was shot twice.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub repeat_sd: Option<f64>,
    /// Why its factors are not used: absent if they are.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub not_used: Option<String>,
    /// Of the deviations, step 00 not among them.
    pub summary: Summary,
    /// Of the deviations of each step from the one before it, as the thesis compares them.
    pub between_steps: Summary,
}

/// All ladders.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ExposureFit {
    /// By setting.
    pub ladders: Vec<Ladder>,
    /// Ladders whose shots told nothing.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub not_measured: Vec<LadderNotMeasured>,
}

/// A ladder whose shots told nothing.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct LadderNotMeasured {
    /// What moves.
    pub setting: Setting,
    /// Why, in words.
    pub why: String,
}

/// Why no table came out.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum ExposureFitError {
    /// No ladder in the shots.
    #[error(
        "no ladder is among the {shots} usable shots of {given}: three labels or more of one setting are needed that share the other two (ISO, shutter, aperture) and are neither over-exposed nor dark{first}"
    )]
    NoLadder {
        /// Shots that can be used.
        shots: usize,
        /// Shots given.
        given: usize,
        /// The first reason why one could not, to be appended.
        first: String,
    },
}

/// A table, and by shot why it was left out.
pub type Fitted = (ExposureFit, Vec<Option<String>>);

/// Finds the ladders and measures them. `shots` in the order in which they were taken; those of another size than most do
/// not count. A ladder that cannot be measured or used is named with the reason, and the others stand.
pub fn fit_exposure(shots: &[EvenFrame]) -> Result<Fitted, ExposureFitError> {
    let mut sizes: BTreeMap<(usize, usize), usize> = BTreeMap::new();
    shots.iter().for_each(|shot| *sizes.entry(shot.tiles.size).or_default() += 1);
    let common = sizes.into_iter().max_by_key(|(_, shots)| *shots).map_or((0, 0), |(size, _)| size);
    let mut left_out: Vec<Option<String>> = shots.iter().map(|shot| unfit(&shot.tiles, common)).collect();
    let usable: Vec<usize> = (0..shots.len()).filter(|&s| left_out[s].is_none()).collect();
    let settings: Vec<Settings> = usable.iter().map(|&s| shots[s].settings.clone()).collect();
    let mut found = ladder::find(&settings);
    for shot in found.iter_mut().flat_map(|ladder| &mut ladder.shots) {
        *shot = usable[*shot];
    }
    let (mut ladders, mut not_measured, mut used) = (vec![], vec![], BTreeSet::<usize>::new());
    for found in &found {
        let Some(mut ladder) = measure(found, shots) else {
            let why =
                "no two of its steps have a part of the frame in common that is over-exposed in neither";
            not_measured.push(LadderNotMeasured { setting: found.setting, why: why.into() });
            continue;
        };
        ladder.not_used = beyond_tolerance(&ladder);
        let step = |label: f64| ladder::key(found.setting, label);
        let measured: BTreeSet<i64> = ladder.steps.iter().map(|s| step(s.label)).collect();
        let label = |s: usize| found.setting.label(&shots[s].settings);
        used.extend(found.shots.iter().filter(|&&s| label(s).is_some_and(|l| measured.contains(&step(l)))));
        ladders.push(ladder);
    }
    if ladders.is_empty() {
        let first = left_out.iter().flatten().next().map_or(String::new(), |why| format!("; a shot {why}"));
        return Err(ExposureFitError::NoLadder { shots: usable.len(), given: shots.len(), first });
    }
    for shot in usable.into_iter().filter(|s| !used.contains(s)) {
        let why = match found.iter().any(|ladder| ladder.shots.contains(&shot)) {
            true => "is over-exposed wherever the darkest step of its ladder is not",
            false => "belongs to no ladder: too few shots share two of its three settings",
        };
        left_out[shot] = Some(why.to_owned());
    }
    Ok((ExposureFit { ladders, not_measured }, left_out))
}

/// Why a ladder's factors cannot be a camera's.
fn beyond_tolerance(ladder: &Ladder) -> Option<String> {
    let worst = ladder.steps.iter().max_by(|a, b| a.deviation.abs().total_cmp(&b.deviation.abs()))?;
    (worst.deviation.abs() > HALF_STEP).then(|| {
        format!(
            "{} is {:+.1} % off its label, more than half a step; either the light changed, or a frame's labels are wrong: shoot the \
             ladder again in steady light with everything on manual",
            ladder.setting.words(worst.label),
            100.0 * worst.deviation
        )
    })
}

/// Why a shot cannot be measured; `size` is that of most.
fn unfit(tiles: &Tiles, size: (usize, usize)) -> Option<String> {
    if tiles.size != size {
        let ((width, height), (most, high)) = (tiles.size, size);
        return Some(format!(
            "is of {width} x {height} pixels, the others of {most} x {high}; give full frames of one camera"
        ));
    }
    if tiles.over_exposed > 1.0 - LEAST_FRAME {
        return Some(format!("is over-exposed over {:.0} % of the frame", 100.0 * tiles.over_exposed));
    }
    if tiles.cut_off + tiles.over_exposed > 1.0 - LEAST_FRAME {
        return Some(format!("is too dark: {:.0} % of the frame is cut off at 0 DN", 100.0 * tiles.cut_off));
    }
    let (mut light, mut variance, mut sites) = (0.0, 0.0, 0.0);
    for tile in tiles.tiles.iter().flatten().flatten() {
        light += tile.sites * tile.mean;
        variance += tile.sites * tile.sites * tile.variance;
        sites += tile.sites;
    }
    let error: f64 = variance.sqrt();
    (light.is_nan() || error > MOST_ERROR * light).then(|| {
        let (mean, error) = (light / sites.max(1.0), error / sites.max(1.0));
        format!("is too dark: its light is {mean:.2} +- {error:.2} DN above black")
    })
}

/// Light of one shot over some tiles, and its variance relative to its square.
#[derive(Clone, Copy)]
struct Light {
    sum: f64,
    relative: f64,
}

/// Tiles and colours that all these shots have, as (tile, colour, weight).
fn shared_tiles(shots: &[&EvenFrame]) -> Vec<(usize, usize, f64)> {
    let Some(first) = shots.first() else { return vec![] };
    let all = (0..first.tiles.tiles.len()).flat_map(|tile| (0..3).map(move |colour| (tile, colour)));
    all.filter_map(|(tile, colour)| {
        let of = |shot: &&EvenFrame| shot.tiles.tiles.get(tile).and_then(|tile| tile[colour]);
        let weight = of(first)?.sites;
        shots.iter().all(|shot| of(shot).is_some()).then_some((tile, colour, weight))
    })
    .collect()
}

fn light(shot: &EvenFrame, over: &[(usize, usize, f64)]) -> Light {
    let (mut sum, mut variance) = (0.0, 0.0);
    for &(tile, colour, weight) in over {
        if let Some(tile) = shot.tiles.tiles[tile][colour] {
            sum += weight * tile.mean;
            variance += weight * weight * tile.variance;
        }
    }
    Light { sum, relative: variance / (sum * sum) }
}

/// A step before it has an interval.
struct Raw {
    label: f64,
    stops: f64,
    factor: f64,
    /// Relative variance by noise alone.
    noise: f64,
    shots: Vec<usize>,
    frame_share: f64,
    pattern_sd: f64,
}

fn measure(found: &ladder::Found, shots: &[EvenFrame]) -> Option<Ladder> {
    let setting = found.setting;
    let label = |s: usize| setting.label(&shots[s].settings);
    let mut steps: BTreeMap<i64, Vec<usize>> = BTreeMap::new();
    for &shot in &found.shots {
        steps.entry(ladder::key(setting, label(shot)?)).or_default().push(shot);
    }
    let base: Vec<&EvenFrame> = steps.values().next()?.iter().map(|&s| &shots[s]).collect();
    let (mut raw, mut scatter, mut freedom) = (vec![], 0.0, 0usize);
    for (number, numbers) in steps.values().enumerate() {
        let label = label(*numbers.first()?)?;
        let own: Vec<&EvenFrame> = numbers.iter().map(|&s| &shots[s]).collect();
        let over = shared_tiles(&[base.clone(), own.clone()].concat());
        let all = own.first()?.tiles.tiles.len() as f64 * 3.0;
        let lights: Vec<Light> = own.iter().map(|shot| light(shot, &over)).collect();
        let dark: Vec<Light> = base.iter().map(|shot| light(shot, &over)).collect();
        let mean = |lights: &[Light]| lights.iter().map(|l| l.sum).sum::<f64>() / lights.len() as f64;
        let noise = |lights: &[Light]| {
            lights.iter().map(|l| l.relative).sum::<f64>() / (lights.len() * lights.len()) as f64
        };
        let (bright, dark_mean) = (mean(&lights), mean(&dark));
        if over.is_empty() || bright <= 0.0 || dark_mean <= 0.0 {
            continue;
        }
        if lights.len() > 1 {
            let squares: f64 = lights.iter().map(|l| (l.sum / bright - 1.0).powi(2)).sum();
            let expected: f64 = lights.iter().map(|l| l.relative).sum::<f64>() / lights.len() as f64;
            scatter += squares - (lights.len() - 1) as f64 * expected;
            freedom += lights.len() - 1;
        }
        let first = number == 0;
        raw.push(Raw {
            label,
            stops: setting.stops(label),
            factor: if first { 1.0 } else { bright / dark_mean },
            noise: if first { 0.0 } else { noise(&lights) + noise(&dark) },
            shots: numbers.clone(),
            frame_share: over.len() as f64 / all,
            pattern_sd: if first { 0.0 } else { pattern(&own, &base, &over, bright / dark_mean) },
        });
    }
    if raw.len() < 2 {
        return None;
    }
    let own = shared_tiles(&base);
    let sites: f64 = own.iter().map(|(_, _, weight)| weight).sum();
    let step_00 = base.iter().map(|shot| light(shot, &own).sum).sum::<f64>() / base.len() as f64;
    let scatter = (freedom > 0).then(|| (scatter / freedom as f64).max(0.0));
    let steps = steps_of(&raw, scatter, freedom);
    let thirds = |a: &Raw, b: &Raw| b.factor / a.factor / (b.stops - a.stops).exp2() - 1.0;
    let between: Vec<f64> = raw.windows(2).map(|pair| thirds(&pair[0], &pair[1])).collect();
    let others = Setting::ALL.into_iter().filter(|other| *other != setting);
    let shared = others.filter_map(|other| Some((other, other.label(&base.first()?.settings)?))).collect();
    Some(Ladder {
        setting,
        shared,
        step_00_dn: step_00 / sites,
        repeat_sd: scatter.map(f64::sqrt),
        not_used: None,
        summary: summary(&steps.iter().skip(1).map(|step| step.deviation).collect::<Vec<_>>()),
        between_steps: summary(&between),
        steps,
    })
}

fn steps_of(raw: &[Raw], scatter: Option<f64>, freedom: usize) -> Vec<Step> {
    let Some(base) = raw.first() else { return vec![] };
    let t = t_975(freedom.max(1) as f64);
    let step = |own: &Raw| {
        let stops = own.stops - base.stops;
        let ratio = own.factor / stops.exp2();
        let count = 1.0 / own.shots.len() as f64 + 1.0 / base.shots.len() as f64;
        let first = stops == 0.0;
        let repeat = if first { 0.0 } else { scatter.unwrap_or(0.0) * count };
        let half = ratio * (Z95 * Z95 * own.noise + t * t * repeat).sqrt();
        Step {
            label: own.label,
            step_thirds: (3e6 * stops).round() / 1e6,
            factor: own.factor,
            deviation: ratio - 1.0,
            deviation_interval_95: [ratio - 1.0 - half, ratio - 1.0 + half],
            shots: own.shots.len(),
            shot_numbers: own.shots.clone(),
            frame_share: own.frame_share,
            pattern_sd: own.pattern_sd,
        }
    };
    raw.iter().map(step).collect()
}

/// Standard deviation over the tiles of (light / (factor * light of step 00) - 1) beyond noise; 0 if noise explains it.
fn pattern(own: &[&EvenFrame], base: &[&EvenFrame], over: &[(usize, usize, f64)], factor: f64) -> f64 {
    let (mut squares, mut weights, mut n) = (0.0, 0.0, 0.0);
    for &(tile, colour, _) in over {
        let mean = |shots: &[&EvenFrame]| {
            let tiles: Vec<_> = shots.iter().filter_map(|shot| shot.tiles.tiles[tile][colour]).collect();
            let n = tiles.len().max(1) as f64;
            let variance = tiles.iter().map(|t| t.variance).sum::<f64>() / (n * n);
            (tiles.iter().map(|t| t.mean).sum::<f64>() / n, variance)
        };
        let ((bright, bright_variance), (dark, dark_variance)) = (mean(own), mean(base));
        if dark <= 0.0 || bright <= 0.0 {
            continue;
        }
        let variance = bright_variance / (bright * bright) + dark_variance / (dark * dark);
        squares += (bright / (factor * dark) - 1.0).powi(2) / variance;
        weights += 1.0 / variance;
        n += 1.0;
    }
    let excess: f64 = squares - n;
    if excess > 4.0 * (2.0 * n).sqrt() { (excess / weights).sqrt() } else { 0.0 }
}

fn summary(deviations: &[f64]) -> Summary {
    let n = deviations.len().max(1) as f64;
    let mean = deviations.iter().sum::<f64>() / n;
    let squares: f64 = deviations.iter().map(|d| (d - mean).powi(2)).sum();
    let sizes = || deviations.iter().map(|d| d.abs());
    Summary {
        mean,
        max: sizes().fold(0.0, f64::max),
        min: sizes().reduce(f64::min).unwrap_or(0.0),
        sd: if n > 1.0 { (squares / (n - 1.0)).sqrt() } else { 0.0 },
    }
}
