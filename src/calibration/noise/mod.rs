//! Noise and linearity: photon transfer (EMVA 1288 release 4.0, sections 6.6 and 6.7; J. Janesick, Photon Transfer, 2007).
//!
//! Two frames of the same light differ by noise alone. Half the variance of their difference, in small tiles and each
//! filter position by itself ([`compare`]), is the variance of one frame:
//!
//! ```text
//! variance = g S + f,    f = r^2 + 1/12,    electrons per DN = 1 / g,    read noise in electrons = r / g
//! ```
//!
//! S being the signal above black in DN, g S shot noise (Poisson), r read noise, and 1/12 DN^2 what rounding to whole DN
//! adds; it is taken off for read noise, and stays in the variance of a value. The straight line is fitted over the signals
//! up to 70 % of the range, as EMVA has it, by iterated weighted least squares, pairs of dark frames being points at no
//! signal. Intervals of 95 % come from the fit's covariance: that of 1 / g is the inverse of g's, that of r / g takes the
//! covariance of both along. Full well is the range from black to saturation in electrons. Fixed pattern is what the two
//! frames share beyond a plane in each tile, relative to the signal: the sensor's own (PRNU) with the surface's texture,
//! so that PRNU is that at most. [`Linearity`] says how straight the response is.

mod groups;
mod linearity;
mod tiles;
mod transfer;

pub use groups::{FrameMean, levels};
pub use linearity::{LightSource, Linearity, LinearityStep, NoLinearity};
pub use tiles::{OtherSize, PairTiles, Signal, Tile, compare};

use super::Verdict;
use crate::photometry::{LevelSource, NoiseModel};
use crate::units::Iso;
use serde::{Deserialize, Serialize};
use transfer::{Line, Point, Z95};

/// Colours in the order of their numbers.
const COLOURS: [&str; 3] = ["red", "green", "blue"];
/// Share of the range up to which tiles enter the line.
const FIT_TO: f64 = 0.7;
/// Share of the range from which tiles tell the fixed pattern.
const PATTERN_FROM: f64 = 0.1;
/// Variance of rounding to whole DN, DN^2.
const ROUNDING: f64 = 1.0 / 12.0;
/// Read noise below which rounding no longer adds up as if it were independent, DN.
const COARSE: f64 = 0.4;
/// Largest half width of the gain's interval, relative, of a good calibration.
const SURE: f64 = 0.05;
/// Largest share of left-out tiles, and largest scatter, of a good calibration.
const MOST_REJECTED: f64 = 0.2;
const MOST_SCATTER: f64 = 1.5;

/// Noise of one body.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct NoiseFit {
    /// One entry an ISO, ascending.
    pub noise: Vec<IsoNoise>,
}

/// Noise and linearity at one ISO.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct IsoNoise {
    /// ISO label.
    pub iso: Iso,
    /// Pairs of lit frames used.
    pub pairs: usize,
    /// Pairs of dark frames used.
    pub dark_pairs: usize,
    /// Variance as processing uses it: gain in DN, floor in DN^2 with rounding.
    pub model: NoiseModel,
    /// Electrons per DN, all colours together.
    pub electrons_per_dn: f64,
    /// Its 95 % interval.
    pub electrons_per_dn_interval: [f64; 2],
    /// Read noise in electrons, rounding taken off; absent if the frames have none beyond rounding.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub read_noise_e: Option<f64>,
    /// Its 95 % interval.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub read_noise_e_interval: Option<[f64; 2]>,
    /// Read noise in DN.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub read_noise_dn: Option<f64>,
    /// Fixed pattern relative to the signal, 1 = 100 %: PRNU at most; absent if it is lost in noise.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub fixed_pattern: Option<f64>,
    /// Its 95 % interval.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub fixed_pattern_interval: Option<[f64; 2]>,
    /// Red, green, blue.
    pub colours: Vec<ColourNoise>,
    /// Where the saturation is from that `full_well_e` rests on.
    pub saturation_source: LevelSource,
    /// Every pair of frames against the line.
    pub residuals: Vec<PairResidual>,
    /// Sum of squared residuals in standard deviations, per degree of freedom: 1 if the model holds.
    pub chi_squared: f64,
    /// Share of the tiles that were left out because they lie far from the line.
    pub rejected_share: f64,
    /// Stability of gain between colours: largest difference in standard errors.
    pub colours_apart_in_errors: f64,
    /// How far dark frames lie from the line of the lit ones at no signal, in standard errors; absent without either.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub dark_apart_in_errors: Option<f64>,
    /// How straight the response is.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub linearity: Option<Linearity>,
    /// Why there is no `linearity`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub linearity_not_measured: Option<String>,
}

/// One colour.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ColourNoise {
    /// "red", "green" or "blue".
    pub colour: String,
    /// Electrons per DN; absent if its tiles do not tell it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub electrons_per_dn: Option<f64>,
    /// Its 95 % interval.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub electrons_per_dn_interval: Option<[f64; 2]>,
    /// Electrons from black to saturation; absent where saturation is but a guess.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub full_well_e: Option<f64>,
    /// Its 95 % interval.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub full_well_e_interval: Option<[f64; 2]>,
}

/// One colour of one pair of frames.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct PairResidual {
    /// "red", "green" or "blue".
    pub colour: String,
    /// Mean of its tiles, DN above black.
    pub signal_dn: f64,
    /// Mean variance of its tiles, DN^2.
    pub variance_dn2: f64,
    /// Standard error of that.
    pub variance_error_dn2: f64,
    /// What the line says there.
    pub model_dn2: f64,
}

/// All pairs of one light level; levels ascend.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct LightLevel {
    /// Exposure time relative to a fixed one; absent if it is not told.
    pub time: Option<f64>,
    /// f-number label.
    pub aperture: Option<f64>,
    /// The level's pairs of frames.
    pub pairs: Vec<PairTiles>,
}

/// Everything that one ISO's frames amount to.
#[derive(Clone, Debug, PartialEq)]
pub struct IsoInput {
    /// ISO label.
    pub iso: Iso,
    /// Lit frames, one entry a light level.
    pub levels: Vec<LightLevel>,
    /// Pairs of dark frames.
    pub dark: Vec<PairTiles>,
    /// Saturation less black of each colour, DN.
    pub range: [f64; 3],
    /// Where saturation is from.
    pub saturation_source: LevelSource,
    /// Standard error of black, DN.
    pub black_error: f64,
    /// Stops of light between successive levels, if they were given.
    pub stops: Option<f64>,
}

/// Too little to fit.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error(
    "{0}: the frames do not tell gain and read noise; give two frames each of at least two light levels of an evenly lit surface, neither dark nor clipped"
)]
pub struct NoTransfer(pub Iso);

impl NoiseFit {
    /// Variance model of an ISO, if it was measured.
    pub fn model(&self, iso: Option<Iso>) -> Option<NoiseModel> {
        let iso = iso?;
        self.noise.iter().find(|noise| (noise.iso.0 / iso.0 - 1.0).abs() < 0.01).map(|noise| noise.model)
    }

    /// What to make of it.
    pub fn verdict(&self) -> Verdict {
        let good = !self.noise.is_empty() && self.noise.iter().all(IsoNoise::is_good);
        Verdict { good, sentences: self.noise.iter().flat_map(IsoNoise::words).collect() }
    }
}

/// Fits noise and linearity of one ISO.
pub fn fit(input: &IsoInput) -> Result<IsoNoise, NoTransfer> {
    let lit = || input.levels.iter().flat_map(|level| &level.pairs);
    let usable = |tile: &&Tile| tile.signal <= FIT_TO * input.range[tile.colour];
    let points = |pairs: &[&PairTiles], colour: Option<usize>| -> Vec<Point> {
        let tiles = pairs.iter().flat_map(|pair| &pair.tiles).filter(usable);
        tiles
            .filter(|tile| colour.is_none_or(|c| c == tile.colour))
            .map(|tile| Point { signal: tile.signal, variance: tile.variance, freedom: tile.freedom })
            .collect()
    };
    let lit_pairs: Vec<&PairTiles> = lit().collect();
    let all: Vec<&PairTiles> = lit().chain(&input.dark).collect();
    let line = transfer::fit(&points(&all, None)).ok_or(NoTransfer(input.iso))?;
    let of_colours = [0, 1, 2].map(|c| transfer::fit(&points(&all, Some(c))));
    let electrons = electrons_per_dn(&line);
    let read = read_noise(&line);
    let pattern = fixed_pattern(lit().flat_map(|pair| &pair.tiles).filter(usable), input.range, &line);
    let well_known = input.saturation_source != LevelSource::DecoderMargin
        && input.saturation_source != LevelSource::DecoderTable;
    let colours = (0..3).map(|c| {
        let own = of_colours[c].as_ref().map(electrons_per_dn);
        let well = own.unwrap_or(electrons);
        ColourNoise {
            colour: COLOURS[c].to_owned(),
            electrons_per_dn: own.map(|e| e.0),
            electrons_per_dn_interval: own.map(|e| e.1),
            full_well_e: well_known.then_some(well.0 * input.range[c]),
            full_well_e_interval: well_known.then_some(well.1.map(|e| e * input.range[c])),
        }
    });
    let linearity = linearity_of(input);
    Ok(IsoNoise {
        iso: input.iso,
        pairs: lit_pairs.len(),
        dark_pairs: input.dark.len(),
        model: NoiseModel { gain: line.gain as f32, floor: line.floor.max(ROUNDING) as f32 },
        electrons_per_dn: electrons.0,
        electrons_per_dn_interval: electrons.1,
        read_noise_e: read.map(|r| r.0),
        read_noise_e_interval: read.map(|r| r.1),
        read_noise_dn: read.map(|r| r.0 * line.gain),
        fixed_pattern: pattern.and_then(|p| p.0),
        fixed_pattern_interval: pattern.map(|p| p.1),
        colours: colours.collect(),
        saturation_source: input.saturation_source,
        residuals: all.iter().flat_map(|pair| residuals(pair, &line)).collect(),
        chi_squared: line.chi_squared,
        rejected_share: line.rejected,
        colours_apart_in_errors: colours_apart(&of_colours),
        dark_apart_in_errors: dark_apart(&points(&lit_pairs, None), &input.dark),
        linearity_not_measured: linearity.as_ref().err().map(ToString::to_string),
        linearity: linearity.ok(),
    })
}

/// 1 / gain with its interval.
fn electrons_per_dn(line: &Line) -> (f64, [f64; 2]) {
    let reach = Z95 * line.of_gain.sqrt();
    // A gain that could be none at all leaves no upper bound; a thousandth of it stands for that.
    (1.0 / line.gain, [1.0 / (line.gain + reach), 1.0 / (line.gain - reach).max(1e-3 * line.gain)])
}

/// Read noise in electrons with its interval.
fn read_noise(line: &Line) -> Option<(f64, [f64; 2])> {
    let square = line.floor - ROUNDING;
    if square <= 0.0 {
        return None;
    }
    let noise = square.sqrt() / line.gain;
    let floor_error = line.of_floor.sqrt();
    if square < 3.0 * floor_error {
        let bound = |square: f64| square.max(0.0).sqrt() / line.gain;
        return Some((noise, [bound(square - Z95 * floor_error), bound(square + Z95 * floor_error)]));
    }
    // Variance of ln(sqrt(square) / gain).
    let variance = line.of_floor / (2.0 * square).powi(2) + line.of_gain / line.gain.powi(2)
        - line.covariance / (square * line.gain);
    let reach = (Z95 * variance.max(0.0).sqrt()).exp();
    Some((noise, [noise / reach, noise * reach]))
}

/// Fixed pattern relative to the signal: its value, if it is not lost in noise, and its interval.
fn fixed_pattern<'a>(
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

fn residuals(pair: &PairTiles, line: &Line) -> Vec<PairResidual> {
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
            variance_error_dn2: squares.sqrt() / n,
            model_dn2: line.at(signal / n),
        })
    };
    (0..3).filter_map(of_colour).collect()
}

fn colours_apart(lines: &[Option<Line>; 3]) -> f64 {
    let mut apart: f64 = 0.0;
    for (a, b) in [(0, 1), (1, 2), (0, 2)] {
        if let (Some(a), Some(b)) = (&lines[a], &lines[b]) {
            apart = apart.max((a.gain - b.gain).abs() / (a.of_gain + b.of_gain).sqrt());
        }
    }
    apart
}

/// How far dark frames lie from where the lit ones' line meets no signal.
fn dark_apart(lit: &[Point], dark: &[PairTiles]) -> Option<f64> {
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

/// Light of the levels as far as it is known, held against their signals.
fn linearity_of(input: &IsoInput) -> Result<Linearity, NoLinearity> {
    let mean = |level: &LightLevel| -> [Option<Signal>; 3] {
        [0, 1, 2].map(|c| {
            let own: Option<Vec<Signal>> = level.pairs.iter().map(|pair| pair.signal[c]).collect();
            let own = own.filter(|own| !own.is_empty())?;
            let n = own.len() as f64;
            let error = own.iter().map(|s| s.error.powi(2)).sum::<f64>().sqrt() / n;
            Some(Signal { mean: own.iter().map(|s| s.mean).sum::<f64>() / n, error })
        })
    };
    let signals: Vec<[Option<Signal>; 3]> = input.levels.iter().map(mean).collect();
    let first = input.levels.first().ok_or(NoLinearity::TooFew)?;
    let one_aperture = input.levels.iter().all(|level| level.aperture == first.aperture);
    let one_time = input.levels.iter().all(|level| level.time == first.time);
    let (lights, missing, source) = match input.stops {
        Some(_) if !(one_aperture && one_time) => return Err(NoLinearity::SettingsVary),
        Some(stops) => {
            let (lights, missing) = linearity::ladder(&signals, stops)?;
            (lights, missing, LightSource::Stops)
        }
        None if one_time || !one_aperture => return Err(NoLinearity::LightUntold),
        // Two levels of one time were not made by the shutter alone.
        None if input.levels.windows(2).any(|two| two[0].time == two[1].time) => {
            return Err(NoLinearity::LightUntold);
        }
        None => (input.levels.iter().map(|level| level.time).collect(), 0, LightSource::Shutter),
    };
    let known: Vec<(f64, [Option<Signal>; 3])> =
        lights.iter().zip(&signals).filter_map(|(light, signal)| Some(((*light)?, *signal))).collect();
    linearity::fit(&known, input.range, input.black_error, source, missing)
}

impl IsoNoise {
    fn is_good(&self) -> bool {
        let [low, high] = self.electrons_per_dn_interval;
        high - low <= 2.0 * SURE * self.electrons_per_dn
            && self.chi_squared <= MOST_SCATTER
            && self.rejected_share <= MOST_REJECTED
    }

    fn words(&self) -> Vec<String> {
        let [low, high] = self.electrons_per_dn_interval;
        let read = match (self.read_noise_e, self.read_noise_e_interval) {
            (Some(value), Some([low, high])) => {
                format!("read noise is {value:.2} electrons (95 %: {low:.2} to {high:.2})")
            }
            _ => "read noise is less than what rounding to whole DN makes".to_owned(),
        };
        let mut words = vec![format!(
            "At {} one DN is {:.4} electrons (95 %: {low:.4} to {high:.4}) and {read}; 1/12 DN^2 of rounding is taken off.",
            self.iso, self.electrons_per_dn
        )];
        match (&self.linearity, &self.linearity_not_measured) {
            (Some(linearity), _) => words.push(linearity_words(linearity)),
            (None, Some(why)) => words.push(format!("LINEARITY WAS NOT MEASURED: {why}.")),
            (None, None) => {}
        }
        if !self.is_good() {
            words.push(format!(
                "Do not rely on it: the gain is known to {:.1} %, tiles scatter {:.2} times as they should, {:.0} % of them were left out; shoot more pairs, of an even surface in steady light.",
                50.0 * (high - low) / self.electrons_per_dn,
                self.chi_squared,
                100.0 * self.rejected_share
            ));
        }
        if self.dark_pairs == 0 {
            words.push("Read noise is from the line's intercept: dark frames (--dark) make it surer.".into());
        }
        if self.read_noise_dn.is_some_and(|dn| dn < COARSE) {
            words.push(format!("Read noise is below {COARSE} DN, so that rounding hides part of it."));
        }
        if self.colours_apart_in_errors > 4.0 {
            words.push(
                "The colours differ in gain by more than chance; their mean is used for variances.".into(),
            );
        }
        if self.dark_apart_in_errors.is_some_and(|errors| errors > 4.0) {
            words.push(
                "Dark frames are noisier or quieter than the lit frames' line says at no signal: is it the same ISO and temperature, and the cap tight?".into(),
            );
        }
        words
    }
}

fn linearity_words(linearity: &Linearity) -> String {
    let [from, to] = linearity.range_dn;
    let knee = match linearity.knee_dn {
        Some(dn) => format!("from {dn:.0} DN on it bends by more than 1 %"),
        None => format!("no knee up to {:.0} DN", linearity.checked_to_dn),
    };
    let missing = match linearity.missing_levels {
        0 => String::new(),
        n => format!(" ({n} levels are missing from the ladder)"),
    };
    format!(
        "From {from:.0} to {to:.0} DN above black the linearity error is {:.3} %, the largest deviation {:+.3} %; {knee}{missing}.",
        100.0 * linearity.linearity_error,
        100.0 * linearity.largest_deviation
    )
}

#[cfg(test)]
mod tests;
