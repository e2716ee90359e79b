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
//! adds; it is taken off for read noise, and stays in the variance of a value; where the raws have steps of s DN
//! it is s^2/12 ([`SensorValues::steps`]). The straight line is fitted over the signals
//! up to 70 % of the range, as EMVA has it, by iterated weighted least squares, pairs of dark frames being points at no
//! signal. Tiles whose mean lies within six standard deviations of clipping or of 0 DN do not count, by the line's own
//! variance: those in which nothing clips would be the quiet ones among them. Dark frames of raws that are cut off at black have half of
//! their noise, and do not count ([`SensorValues::cut_off`]); read noise is then the lit frames' intercept. Intervals of 95 % come from the fit's covariance: that of 1 / g is the inverse of g's, that of r / g takes the
//! covariance of both along. Full well is the range from black to saturation in electrons. Fixed pattern is what the two
//! frames share beyond a plane in each tile, relative to the signal: the sensor's own (PRNU) with the surface's texture,
//! so that PRNU is that at most. [`Linearity`] says how straight the response is.

mod figures;
mod groups;
mod light;
mod linearity;
mod tiles;
mod transfer;
mod values;
mod words;

pub use groups::{FrameMean, levels};
pub use linearity::{LightSource, Linearity, LinearityStep, NoLinearity};
pub use tiles::{OtherSize, PairTiles, Signal, Tile, compare};
pub use values::{DarkCut, SensorValues};

use super::{NotMeasured, Steps, rounding};
use crate::photometry::{LevelSource, NoiseModel};
use crate::units::Iso;
use figures::ReadNoise;
use serde::{Deserialize, Serialize};
use transfer::Point;

/// Colours in the order of their numbers.
const COLOURS: [&str; 3] = ["red", "green", "blue"];
/// Share of the range up to which tiles enter the line.
const FIT_TO: f64 = 0.7;
/// Standard deviations of a site that a tile's mean keeps from clipping and from 0 DN.
const CLEAR: f64 = 6.0;
/// Largest relative difference between two ISO labels that mean the same.
const SAME_ISO: f64 = 0.01;

/// Noise of one body.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct NoiseFit {
    /// One entry an ISO, ascending.
    pub noise: Vec<IsoNoise>,
    /// ISOs whose frames told nothing.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub not_measured: Vec<NotMeasured>,
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
    pub electrons_per_dn_interval_95: [f64; 2],
    /// Read noise in electrons, rounding taken off; absent where rounding hides it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub read_noise_e: Option<f64>,
    /// Its 95 % interval.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub read_noise_e_interval_95: Option<[f64; 2]>,
    /// Upper bound of read noise in electrons, where rounding hides it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub read_noise_below_e: Option<f64>,
    /// Read noise in DN.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub read_noise_dn: Option<f64>,
    /// Fixed pattern relative to the signal, 1 = 100 %: PRNU at most; absent if it is lost in noise.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub fixed_pattern: Option<f64>,
    /// Its 95 % interval.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub fixed_pattern_interval_95: Option<[f64; 2]>,
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
    /// The difference of gains that is largest, relative, 1 = 100 %; absent if it may be chance.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub colours_apart: Option<f64>,
    /// Value at which dark frames are cut off, DN: they do not count; absent if their noise is whole.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub cut_off_dn: Option<f64>,
    /// Distance between values that occur, DN, where signals are low; absent if it is 1.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub step_dn: Option<f64>,
    /// The same where signals are high, if it grows with the signal.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub companded_step_dn: Option<f64>,
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
    pub electrons_per_dn_interval_95: Option<[f64; 2]>,
    /// Electrons from black to saturation; absent where saturation is but a guess.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub full_well_e: Option<f64>,
    /// Its 95 % interval.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub full_well_e_interval_95: Option<[f64; 2]>,
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
    pub variance_dn2_standard_error: f64,
    /// What the line says there.
    pub model_dn2: f64,
    /// The pair's frames: places in the order given, from 0.
    #[serde(default)]
    pub shot_numbers: Vec<usize>,
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
    /// Black of each colour, DN above the lowest value that there is.
    pub black: [f64; 3],
    /// Value at which dark frames are cut off, if they are.
    pub cut_off_dn: Option<f64>,
    /// Distances between values that occur.
    pub steps: Steps,
    /// Where saturation is from.
    pub saturation_source: LevelSource,
    /// Standard error of black, DN.
    pub black_error: f64,
    /// Stops of light between successive levels, if they were given.
    pub stops: Option<f64>,
}

/// Too little to fit.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error(
    "the frames do not tell gain and read noise; give two frames each of at least two light levels of an evenly lit surface, neither dark nor clipped"
)]
pub struct NoTransfer;

/// Noise at an ISO, and where it is from.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct NoiseAt {
    /// Variance of a site's value.
    pub model: NoiseModel,
    /// The ISO that it was measured at.
    pub measured_at: Iso,
    /// Whether that is another ISO, from which the model was scaled.
    pub scaled: bool,
}

impl NoiseFit {
    /// Noise at an ISO: as measured there, else scaled from the nearest ISO by [`NoiseModel::at_iso`]; `None` if nothing
    /// was measured that can be relied on.
    pub fn at(&self, iso: Iso) -> Option<NoiseAt> {
        let stops = |noise: &&IsoNoise| (noise.iso.0 / iso.0).log2().abs();
        let nearest =
            self.noise.iter().filter(|noise| noise.is_good()).min_by(|a, b| stops(a).total_cmp(&stops(b)))?;
        let scaled = (nearest.iso.0 / iso.0 - 1.0).abs() >= SAME_ISO;
        let model = if scaled { nearest.model.at_iso(nearest.iso, iso) } else { nearest.model };
        Some(NoiseAt { model, measured_at: nearest.iso, scaled })
    }
}

/// Fits noise and linearity of one ISO.
pub fn fit(input: &IsoInput) -> Result<IsoNoise, NoTransfer> {
    let lit = || input.levels.iter().flat_map(|level| &level.pairs);
    let usable = |tile: &&Tile| tile.signal <= FIT_TO * input.range[tile.colour];
    let points = |pairs: &[&PairTiles], counts: &dyn Fn(&Tile) -> bool| -> Vec<Point> {
        let tiles = pairs.iter().flat_map(|pair| &pair.tiles).filter(usable);
        tiles
            .filter(|tile| counts(tile))
            .map(|tile| Point { signal: tile.signal, variance: tile.variance, freedom: tile.freedom })
            .collect()
    };
    let lit_pairs: Vec<&PairTiles> = lit().collect();
    // Noise that is cut off is none to go by.
    let dark = if input.cut_off_dn.is_some() { &[][..] } else { &input.dark };
    let all: Vec<&PairTiles> = lit().chain(dark).collect();
    let first = transfer::fit(&points(&all, &|_| true)).ok_or(NoTransfer)?;
    let clear = |tile: &Tile| {
        let reach = CLEAR * first.at(tile.signal).sqrt();
        tile.signal + reach <= input.range[tile.colour] && tile.signal + input.black[tile.colour] >= reach
    };
    let line = transfer::fit(&points(&all, &clear)).ok_or(NoTransfer)?;
    let of_colours = [0, 1, 2].map(|c| transfer::fit(&points(&all, &|tile| tile.colour == c && clear(tile))));
    let electrons = figures::electrons_per_dn(&line);
    let (read, below) = match figures::read_noise(&line, input.steps.low) {
        ReadNoise::Told(value, interval) => (Some((value, interval)), None),
        ReadNoise::Below(bound) => (None, Some(bound)),
    };
    let pattern =
        figures::fixed_pattern(lit().flat_map(|pair| &pair.tiles).filter(usable), input.range, &line);
    let well_known = input.saturation_source != LevelSource::DecoderMargin
        && input.saturation_source != LevelSource::DecoderTable;
    let colours = (0..3).map(|c| {
        let own = of_colours[c].as_ref().map(figures::electrons_per_dn);
        let well = own.unwrap_or(electrons);
        ColourNoise {
            colour: COLOURS[c].to_owned(),
            electrons_per_dn: own.map(|e| e.0),
            electrons_per_dn_interval_95: own.map(|e| e.1),
            full_well_e: well_known.then_some(well.0 * input.range[c]),
            full_well_e_interval_95: well_known.then_some(well.1.map(|e| e * input.range[c])),
        }
    });
    let linearity = light::linearity(input);
    let (colours_apart_in_errors, colours_apart) = figures::colours_apart(&of_colours);
    let least = rounding::VARIANCE * input.steps.low.powi(2);
    Ok(IsoNoise {
        iso: input.iso,
        pairs: lit_pairs.len(),
        dark_pairs: dark.len(),
        model: NoiseModel { gain: line.gain as f32, floor: line.floor.max(least) as f32 },
        electrons_per_dn: electrons.0,
        electrons_per_dn_interval_95: electrons.1,
        read_noise_e: read.map(|r| r.0),
        read_noise_e_interval_95: read.map(|r| r.1),
        read_noise_below_e: below,
        read_noise_dn: read.map(|r| r.0 * line.gain),
        fixed_pattern: pattern.and_then(|p| p.0),
        fixed_pattern_interval_95: pattern.map(|p| p.1),
        colours: colours.collect(),
        saturation_source: input.saturation_source,
        residuals: all.iter().flat_map(|pair| figures::residuals(pair, &line)).collect(),
        chi_squared: line.chi_squared,
        rejected_share: line.rejected,
        colours_apart_in_errors,
        colours_apart,
        cut_off_dn: input.cut_off_dn,
        step_dn: (input.steps.low > 1.0).then_some(input.steps.low),
        companded_step_dn: input.steps.companded().then_some(input.steps.high),
        dark_apart_in_errors: figures::dark_apart(&points(&lit_pairs, &clear), dark),
        linearity_not_measured: linearity.as_ref().err().map(ToString::to_string),
        linearity: linearity.ok(),
    })
}

#[cfg(test)]
mod tests;
