//! Factors of the steps of every ladder.

use super::ladder::{self, Found, key};
use super::{
    BlackOffset, ExposureCalibration, ExposureFitError, Ladder, LadderShot, Setting, Step, Summary,
};
use crate::calibration::linear::{solve, t_975};
use std::collections::BTreeMap;

/// Largest relative standard error of a step's light that is a measurement.
const DARKEST: f64 = 0.02;
/// Least share of a frame's tiles and colours that must not be over-exposed.
const LEAST_USED: f64 = 0.05;
/// Normal quantile of a 95 % interval.
const NORMAL: f64 = 1.96;
/// Factor from which on a step is bright enough for its colours to be free of a wrong black.
const BRIGHT: f64 = 4.0;

/// Sums over common tiles: light, its variance, sites.
#[derive(Clone, Copy, Debug, Default)]
struct Sum {
    light: f64,
    variance: f64,
    count: f64,
}

/// Measures every ladder among the shots, which come in the order in which they were taken. Gives the figures, and for
/// each shot that is not in them its place and why.
pub fn fit_exposure(
    shots: &[LadderShot],
) -> Result<(ExposureCalibration, Vec<(usize, String)>), ExposureFitError> {
    if let Some(pair) = shots.windows(2).find(|pair| pair[0].tiles.size != pair[1].tiles.size) {
        return Err(ExposureFitError::Sizes(pair[0].tiles.size, pair[1].tiles.size));
    }
    let settings: Vec<_> = shots.iter().map(|s| s.settings.clone()).collect();
    let found = ladder::find(&settings);
    if found.is_empty() {
        let missing: Vec<&str> = Setting::ALL
            .into_iter()
            .filter(|s| !settings.is_empty() && settings.iter().all(|own| s.label(own).is_none()))
            .map(Setting::name)
            .collect();
        let untold = match missing.as_slice() {
            [] => String::new(),
            names => format!("; these files do not tell their {}", names.join(" and ")),
        };
        return Err(ExposureFitError::NoLadder { shots: shots.len(), untold });
    }
    let mut reasons: BTreeMap<usize, String> = BTreeMap::new();
    let ladders: Vec<Ladder> = found.iter().filter_map(|found| measure(shots, found, &mut reasons)).collect();
    if ladders.is_empty() {
        let why: Vec<String> = reasons.into_values().collect();
        return Err(ExposureFitError::Nothing(why.first().cloned().unwrap_or_default()));
    }
    let used = |shot: usize| ladders.iter().flat_map(|l| &l.steps).any(|step| step.shots.contains(&shot));
    let left_out = (0..shots.len()).filter(|&s| !used(s)).map(|s| {
        let alone = || "no other two shots differ from it in one setting alone".to_owned();
        (s, reasons.get(&s).cloned().unwrap_or_else(alone))
    });
    let left_out = left_out.collect();
    Ok((ExposureCalibration { ladders }, left_out))
}

/// Sums of one colour over the tiles that `common` tells, the mean of some shots.
fn sum(shots: &[&LadderShot], colour: usize, common: &[bool]) -> Sum {
    let mut total = Sum::default();
    let n = shots.len() as f64;
    for shot in shots {
        for (tile, _) in shot.tiles.tiles.iter().zip(common).filter(|(_, common)| **common) {
            if let Some(t) = tile[colour] {
                total.light += t.sites * t.mean / n;
                total.variance += t.sites * t.sites * t.variance / (n * n);
                total.count += 1.0 / n;
            }
        }
    }
    total
}

/// Which tiles are whole in a colour in all these shots.
fn common(shots: &[&LadderShot], colour: usize) -> Vec<bool> {
    let tiles = shots.first().map_or(0, |s| s.tiles.tiles.len());
    (0..tiles).map(|i| shots.iter().all(|s| s.tiles.tiles[i][colour].is_some())).collect()
}

/// Light of some shots and of the reference over their common tiles, by colour.
fn against(step: &[&LadderShot], reference: &[&LadderShot]) -> [(Sum, Sum); 3] {
    let all: Vec<&LadderShot> = step.iter().chain(reference).copied().collect();
    std::array::from_fn(|c| {
        let common = common(&all, c);
        (sum(step, c, &common), sum(reference, c, &common))
    })
}

fn pooled(parts: &[(Sum, Sum); 3]) -> (Sum, Sum) {
    parts.iter().fold((Sum::default(), Sum::default()), |(a, b), (c, d)| {
        let add = |a: Sum, b: &Sum| Sum {
            light: a.light + b.light,
            variance: a.variance + b.variance,
            count: a.count + b.count,
        };
        (add(a, c), add(b, d))
    })
}

fn relative(sum: &Sum) -> f64 {
    if sum.light > 0.0 { sum.variance / (sum.light * sum.light) } else { f64::INFINITY }
}

fn measure(shots: &[LadderShot], found: &Found, reasons: &mut BTreeMap<usize, String>) -> Option<Ladder> {
    let setting = found.setting;
    let mut by_label: BTreeMap<i64, Vec<usize>> = BTreeMap::new();
    for &s in &found.shots {
        let label = setting.label(&shots[s].settings)?;
        by_label.entry(key(setting, label)).or_default().push(s);
    }
    // Too dark and too bright ones go first, so that step 00 is the darkest that is a measurement.
    for (_, numbers) in by_label.iter_mut() {
        numbers.retain(|&s| match unfit(&shots[s]) {
            Some(why) => {
                reasons.insert(s, why);
                false
            }
            None => true,
        });
    }
    by_label.retain(|_, numbers| !numbers.is_empty());
    if by_label.len() < 2 {
        for &s in by_label.values().flatten() {
            reasons.insert(s, "the other shots of its ladder cannot be used".into());
        }
        return None;
    }
    let of = |numbers: &[usize]| numbers.iter().map(|&s| &shots[s]).collect::<Vec<_>>();
    let (&zero, first) = by_label.first_key_value()?;
    let reference = of(first);
    let (spread, freedom) = repeats(shots, &by_label);
    let tiles = |parts: &[(Sum, Sum); 3]| parts.iter().map(|p| p.1.count).sum::<f64>();
    let all = tiles(&against(&reference, &reference)).max(1.0);
    let mut steps: Vec<Step> = vec![];
    let mut bright: [Sum; 3] = Default::default();
    for (&at, numbers) in &by_label {
        let step = of(numbers);
        let parts = against(&step, &reference);
        let used = tiles(&parts) / all;
        let (own, base) = pooled(&parts);
        if used < LEAST_USED || base.light <= 0.0 {
            for &s in numbers {
                reasons.insert(s, over_exposed(1.0 - used));
            }
            continue;
        }
        let step_thirds = round(3.0 * (at - zero) as f64 / 1e6);
        let ideal = (step_thirds / 3.0).exp2();
        let factor = own.light / base.light;
        let deviation = factor / ideal - 1.0;
        let noise = relative(&own) + relative(&base);
        let scatter = spread * (1.0 / step.len() as f64 + 1.0 / reference.len() as f64);
        let t = if spread > 0.0 { t_975(freedom) } else { 0.0 };
        let half = match at == zero {
            true => 0.0,
            false => factor / ideal * (NORMAL * NORMAL * noise + t * t * scatter).sqrt(),
        };
        let deviation_rgb = parts.map(|(own, base)| {
            (own.count > 0.0 && base.light > 0.0).then(|| own.light / base.light / ideal - 1.0)
        });
        if factor >= BRIGHT && (used - 1.0).abs() < 1e-9 {
            for (sum, (own, _)) in bright.iter_mut().zip(&parts) {
                sum.light += own.light;
                sum.variance += own.variance;
            }
        }
        let label = setting.label(&step.first()?.settings)?;
        let deviation_95 = [deviation - half, deviation + half];
        let shots = numbers.clone();
        steps.push(Step {
            label,
            step_thirds,
            ideal,
            factor,
            deviation,
            deviation_95,
            deviation_rgb,
            used,
            shots,
        });
    }
    let beyond: Vec<f64> = steps.iter().skip(1).map(|s| s.deviation).collect();
    let base = against(&reference, &reference).map(|(own, _)| own);
    let sites: [f64; 3] = std::array::from_fn(|c| {
        let tiles = reference.first().map(|s| s.tiles.tiles.as_slice()).unwrap_or_default();
        tiles.iter().filter_map(|t| t[c]).map(|t| t.sites).sum()
    });
    Some(Ladder {
        setting,
        steps,
        summary: Summary::of(&beyond),
        light_00_dn: mean_light(&base, &sites),
        repeatability: (freedom > 0).then(|| spread.sqrt()),
        black_offset_dn: black_offset(&base, &bright, &sites),
    })
}

fn mean_light(base: &[Sum; 3], sites: &[f64; 3]) -> Option<f64> {
    let all: f64 = sites.iter().sum();
    (all > 0.0).then(|| base.iter().map(|b| b.light).sum::<f64>() / all)
}

/// Labels in thirds come out whole, those in halves as one and a half.
fn round(thirds: f64) -> f64 {
    let nearest = (thirds * 2.0).round() / 2.0;
    if (nearest - thirds).abs() < 1e-3 { nearest } else { thirds }
}

fn over_exposed(share: f64) -> String {
    format!("over-exposed in {:.0} % of the frame; take less light for the whole ladder", 100.0 * share)
}

/// Why a shot cannot be measured by itself.
fn unfit(shot: &LadderShot) -> Option<String> {
    if shot.tiles.over_exposed > 1.0 - LEAST_USED {
        return Some(over_exposed(shot.tiles.over_exposed));
    }
    let total = (0..3).fold(Sum::default(), |total, c| {
        let part = sum(&[shot], c, &common(&[shot], c));
        Sum {
            light: total.light + part.light,
            variance: total.variance + part.variance,
            count: total.count + part.count,
        }
    });
    let error = relative(&total).sqrt();
    (error > DARKEST).then(|| {
        let error = if error.is_finite() { format!("{:.0} %", 100.0 * error) } else { "all of it".into() };
        format!("too dark to measure (noise is {error} of its light); take more light for the whole ladder")
    })
}

/// Variance between shots of one step beyond noise, relative, pooled over the steps, and its degrees of freedom.
fn repeats(shots: &[LadderShot], by_label: &BTreeMap<i64, Vec<usize>>) -> (f64, usize) {
    let (mut excess, mut freedom) = (0.0, 0);
    for numbers in by_label.values().filter(|n| n.len() > 1) {
        let own: Vec<&LadderShot> = numbers.iter().map(|&s| &shots[s]).collect();
        let sums: Vec<Sum> = own
            .iter()
            .map(|shot| {
                let parts: [(Sum, Sum); 3] = std::array::from_fn(|c| {
                    let part = sum(&[shot], c, &common(&own, c));
                    (part, part)
                });
                pooled(&parts).0
            })
            .collect();
        let n = sums.len() as f64;
        let mean = sums.iter().map(|s| s.light).sum::<f64>() / n;
        if mean > 0.0 {
            let squares: f64 = sums.iter().map(|s| (s.light / mean - 1.0).powi(2)).sum();
            let noise: f64 = sums.iter().map(relative).sum::<f64>() / n;
            excess += squares - (n - 1.0) * noise;
            freedom += sums.len() - 1;
        }
    }
    if freedom == 0 { (0.0, 0) } else { ((excess / freedom as f64).max(0.0), freedom) }
}

/// Straight line through the colours of step 00 against those of the bright steps: its intercept is what every colour
/// of step 00 has too much.
fn black_offset(base: &[Sum; 3], bright: &[Sum; 3], sites: &[f64; 3]) -> Option<BlackOffset> {
    let (mut matrix, mut right) = (vec![vec![0.0; 2]; 2], vec![0.0; 2]);
    let total: f64 = bright.iter().map(|b| b.light).sum();
    for c in (0..3).filter(|&c| sites[c] > 0.0 && bright[c].light > 0.0) {
        // Per site; the bright side's noise is carried over by the slope.
        let (x, y) = (bright[c].light / sites[c], base[c].light / sites[c]);
        let slope = base.iter().map(|b| b.light).sum::<f64>() / total;
        let variance = (base[c].variance + slope * slope * bright[c].variance) / (sites[c] * sites[c]);
        for (i, a) in [1.0, x].into_iter().enumerate() {
            right[i] += a * y / variance;
            for (j, b) in [1.0, x].into_iter().enumerate() {
                matrix[i][j] += a * b / variance;
            }
        }
    }
    let (solution, covariance) = solve(&matrix, &right)?;
    Some(BlackOffset { value: solution[0], standard_error: covariance[0][0].max(0.0).sqrt() })
}
