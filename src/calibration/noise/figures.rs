//! Figures of a fitted line with their intervals.

use super::tiles::{PairTiles, Tile};
use super::transfer::{self, Line, Point};
use super::{COLOURS, PairResidual};
use crate::calibration::rounding;
use crate::calibration::statistics::Z95;

/// Share of the range from which tiles tell the fixed pattern.
const PATTERN_FROM: f64 = 0.1;

/// Standard errors from which a difference is more than chance.
pub(super) const APART: f64 = 4.0;

/// Read noise of one frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum ReadNoise {
    /// Electrons, with the 95 % interval.
    Told(f64, [f64; 2]),
    /// No more than this many electrons: rounding to whole DN hides it.
    Below(f64),
}

/// 1 / gain with its interval.
pub(super) fn electrons_per_dn(line: &Line) -> (f64, [f64; 2]) {
    let reach = Z95 * line.of_gain.sqrt();
    // A gain that could be none at all leaves no upper bound; a thousandth of it stands for that.
    (1.0 / line.gain, [1.0 / (line.gain + reach), 1.0 / (line.gain - reach).max(1e-3 * line.gain)])
}

/// Read noise in electrons; values stand every `step` DN. A floor below 0.24 steps^2 is mostly rounding, and no more than an
/// upper bound is told (EMVA 1288): 0.4 steps, or what the floor's own interval reaches, if that is more.
pub(super) fn read_noise(line: &Line, step: f64) -> ReadNoise {
    let square = line.floor - rounding::VARIANCE * step * step;
    let floor_error = line.of_floor.sqrt();
    let electrons = |square: f64| square.max(0.0).sqrt() / line.gain;
    if line.floor < rounding::LEAST_FLOOR * step * step {
        let hidden = (rounding::HIDDEN * step).powi(2);
        return ReadNoise::Below(electrons((square + Z95 * floor_error).max(hidden)));
    }
    let noise = electrons(square);
    let departure = rounding::departure(square.sqrt() / step) * step * step;
    if square < 3.0 * floor_error {
        let reach = Z95 * floor_error + departure;
        return ReadNoise::Told(noise, [electrons(square - reach), electrons(square + reach)]);
    }
    // Variance of ln(sqrt(square) / gain).
    let variance = line.of_floor / (2.0 * square).powi(2) + line.of_gain / line.gain.powi(2)
        - line.covariance / (square * line.gain);
    let reach = (Z95 * variance.max(0.0).sqrt() + departure / (2.0 * square)).exp();
    ReadNoise::Told(noise, [noise / reach, noise * reach])
}

/// Fixed pattern relative to the signal: its value, if it is not lost in noise, and its interval.
pub(super) fn fixed_pattern<'a>(
    tiles: impl Iterator<Item = &'a Tile>,
    range: [f64; 3],
    line: &Line,
) -> Option<(Option<f64>, [f64; 2])> {
    // Covariance over squared signal; it spreads by the noise's variance over the root of the degrees of freedom.
    let parts: Vec<(f64, f64)> = tiles
        .filter(|tile| tile.signal >= PATTERN_FROM * range[tile.colour])
        .map(|tile| {
            let square = tile.signal.powi(2);
            (tile.shared / square, tile.freedom * (square / line.at(tile.signal)).powi(2))
        })
        .collect();
    if parts.len() < 8 {
        return None;
    }
    let weight: f64 = parts.iter().map(|p| p.1).sum();
    let mean = parts.iter().map(|(part, w)| part * w).sum::<f64>() / weight;
    let spread = parts.iter().map(|(part, w)| (w * (part - mean)).powi(2)).sum::<f64>().sqrt() / weight;
    let bound = |square: f64| square.max(0.0).sqrt();
    let interval = [bound(mean - Z95 * spread), bound(mean + Z95 * spread)];
    Some(((interval[0] > 0.0).then(|| bound(mean)), interval))
}

pub(super) fn residuals(pair: &PairTiles, line: &Line) -> Vec<PairResidual> {
    let of_colour = |c: usize| {
        let (mut n, mut signal, mut variance, mut squares) = (0.0, 0.0, 0.0, 0.0);
        for tile in pair.tiles.iter().filter(|tile| tile.colour == c) {
            n += 1.0;
            signal += tile.signal;
            variance += tile.variance;
            squares += 2.0 * tile.variance.powi(2) / tile.freedom;
        }
        (n > 0.0).then(|| PairResidual {
            colour: COLOURS[c].to_owned(),
            signal_dn: signal / n,
            variance_dn2: variance / n,
            variance_dn2_standard_error: squares.sqrt() / n,
            model_dn2: line.at(signal / n),
            shot_numbers: pair.shot_numbers.clone(),
        })
    };
    (0..3).filter_map(of_colour).collect()
}

/// The largest difference of gains between two colours in standard errors; and that which is largest relative to their mean,
/// of those beyond chance.
pub(super) fn colours_apart(lines: &[Option<Line>; 3]) -> (f64, Option<f64>) {
    let (mut in_errors, mut relative) = (0.0f64, None::<f64>);
    for (a, b) in [(0, 1), (1, 2), (0, 2)] {
        if let (Some(a), Some(b)) = (&lines[a], &lines[b]) {
            let difference = (a.gain - b.gain).abs();
            let errors = difference / (a.of_gain + b.of_gain).sqrt();
            in_errors = in_errors.max(errors);
            if errors > APART {
                relative = Some(relative.unwrap_or(0.0).max(2.0 * difference / (a.gain + b.gain)));
            }
        }
    }
    (in_errors, relative)
}

/// How far dark frames lie from where the lit ones' line meets no signal.
pub(super) fn dark_apart(lit: &[Point], dark: &[PairTiles]) -> Option<f64> {
    let line = transfer::fit(lit)?;
    let (mut weight, mut sum, mut signal) = (0.0, 0.0, 0.0);
    for tile in dark.iter().flat_map(|pair| &pair.tiles) {
        weight += tile.freedom;
        sum += tile.freedom * tile.variance;
        signal += tile.freedom * tile.signal;
    }
    if weight == 0.0 {
        return None;
    }
    let (variance, signal) = (sum / weight, signal / weight);
    let own = 2.0 * variance.powi(2) / weight;
    Some((variance - line.gain * signal - line.floor).abs() / (own + line.of_floor).sqrt())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn colours_part_by_more_than_chance_or_not_at_all() {
        let line = |gain: f64, error: f64| {
            Some(Line {
                gain,
                floor: 2.0,
                of_gain: error * error,
                of_floor: 0.01,
                covariance: 0.0,
                chi_squared: 1.0,
                rejected: 0.0,
            })
        };
        // Red is surely 3 % higher; blue is further off, but nobody knows.
        let (errors, apart) = colours_apart(&[line(1.03, 1e-3), line(1.0, 1e-3), line(1.2, 0.1)]);
        assert!((errors - 0.03 / 2e-6f64.sqrt()).abs() < 1e-9, "{errors}");
        assert!((apart.unwrap() - 0.03 / 1.015).abs() < 1e-12, "{apart:?}");
        let (errors, apart) = colours_apart(&[line(1.03, 0.01), line(1.0, 0.01), None]);
        assert!(errors > 2.0 && apart.is_none(), "{errors}, {apart:?}");
    }
}
