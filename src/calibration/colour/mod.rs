//! Colour, from a frame of a chart with published values: camera RGB to CIE XYZ.
//!
//! [`ChartFrame`] gives the picture, [`find`] or [`between`] the chart in it, [`ChartFrame::readings`] what its patches
//! read and [`fit_colour`] the matrix with all that tells how good it is: every patch's difference, those of patches that
//! did not take part (each by itself, and each half by the other), and how even the light was.

mod charts;
mod cielab;
mod find;
mod fit;
mod lattice;
mod overlay;
mod plane;
mod regions;
mod sites;
mod standards;
mod summary;

pub use charts::{COLUMNS, ChartKind, PATCHES, ROWS, UnknownChart};
pub use cielab::{Lab, delta_e_2000, delta_e_2000_plain, lab, xyz};
pub use find::{Found, between, find};
pub use overlay::overlay;
pub use plane::{image_from_corners, measured_corners};
pub use sites::{ChartFrame, FramesDiffer, Reading};
pub use standards::Standards;
pub use summary::Differences;

use super::Verdict;
use fit::{LEAST_PATCHES, Sample, Solution, solve, white};
use glam::{DMat3, DVec2, DVec3};
use serde::{Deserialize, Serialize};
use summary::summary;

/// Standard errors that a gradient must have to be told from none.
const TOLD: f64 = 3.0;

/// Standard error of a gradient above which nothing is said of the light.
const UNTOLD: f64 = 0.05;

/// Gradient below which light counts as even.
const EVEN: f64 = 0.02;

/// Leave-one-out mean up to which a calibration should be used.
const GOOD: f64 = 5.0;

/// Why there is no colour calibration.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum ColourError {
    /// No chart.
    #[error(
        "no colour chart is seen in {0}: it must lie flat and whole in the frame, evenly lit, patches free; or give the outer corners of its patches with --corners"
    )]
    NoChart(String),
    /// Corners that hold no chart.
    #[error(
        "no known chart lies between the corners given in {0}: give the outer corners of the four corner patches, in pixels from the frame's top left corner"
    )]
    NotBetween(String),
    /// Too few patches.
    #[error(
        "only {usable} patches can be used, and a matrix that can be checked needs more than {LEAST_PATCHES}: {why}"
    )]
    TooFew {
        /// Patches without fault.
        usable: usize,
        /// The first fault.
        why: String,
    },
    /// No matrix.
    #[error("the patches' colours give no matrix: they must differ in all three channels; check the frame")]
    NoMatrix,
}

/// One patch's share in a fit.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Patch {
    /// Its name on the chart.
    pub name: String,
    /// Mean over its middle, R, G, B, DN above black.
    pub rgb_dn: [f64; 3],
    /// Standard error of that, DN.
    pub rgb_dn_standard_error: [f64; 3],
    /// Share of clipped sites, 0 to 1.
    pub clipped_share: f64,
    /// Published L*, a*, b* under D50.
    pub reference_lab: Lab,
    /// L*, a*, b* as fitted.
    pub lab: Lab,
    /// CIEDE2000 between the two.
    pub delta_e_2000: f64,
    /// CIEDE2000 under a matrix fitted without this patch; absent where the patch was left out anyway.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub leave_one_out_delta_e_2000: Option<f64>,
    /// Why it was left out of the fit; absent if it was used.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub left_out: Option<String>,
}

/// How the light changes over the chart.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Evenness {
    /// Relative change from the chart's middle to its last column; the first column's is the negative.
    pub across: f64,
    /// Standard error of that.
    pub across_standard_error: f64,
    /// Relative change from the chart's middle to its last row.
    pub down: f64,
    /// Standard error of that.
    pub down_standard_error: f64,
    /// Whether the matrix was fitted with the gradient taken out: it was told, and patches left out were predicted
    /// better with it.
    pub taken_out: bool,
    /// Mean leave-one-out CIEDE2000 without a gradient.
    pub leave_one_out_mean_even: f64,
    /// Mean leave-one-out CIEDE2000 with it.
    pub leave_one_out_mean_uneven: f64,
}

/// A colour calibration. Matrices are row-major, their columns are R, G, B.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ColourFit {
    /// The chart.
    pub chart: ChartKind,
    /// Whose values it was compared with.
    pub chart_source: String,
    /// CIE XYZ under D50, white Y = 1, of camera RGB in which a perfect white is (1, 1, 1).
    pub xyz_d50_from_camera: [[f64; 3]; 3],
    /// What a perfect white under the chart's light reads, R, G, B, DN above black, at this shot's exposure.
    pub white_dn: [f64; 3],
    /// CIEDE2000 of the patches that were fitted.
    pub fit: Differences,
    /// The same for each patch under a matrix fitted without it.
    pub leave_one_out: Differences,
    /// The same for each half of the patches, every other one as on a chessboard, under a matrix fitted to the other.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub half_held_out: Option<Differences>,
    /// CIEDE2000 by a matrix without the gradient taken out; equal to `fit` if none was.
    pub fit_even: Differences,
    /// The light over the chart.
    pub evenness: Evenness,
    /// ISO 19264-1 and FADGI.
    pub standards: Standards,
    /// All patches, row by row.
    pub patches: Vec<Patch>,
    /// Corners of the measured part of each patch in the frame, pixels.
    pub patch_corners_px: Vec<[[f64; 2]; 4]>,
}

/// Fits the matrix to a chart of this kind; `image_from_chart` maps to sites.
pub fn fit_colour(
    kind: ChartKind,
    readings: &[Reading],
    image_from_chart: &DMat3,
) -> Result<ColourFit, ColourError> {
    let middle = DVec2::new((COLUMNS - 1) as f64, (ROWS - 1) as f64) / 2.0;
    let all: Vec<Sample> = readings
        .iter()
        .zip(kind.patches())
        .enumerate()
        .map(|(k, (reading, (_, reference)))| Sample {
            rgb: DVec3::from_array(reading.rgb_dn),
            reference: *reference,
            place: (plane::patch_centre(k) - middle) / middle,
        })
        .collect();
    let used: Vec<usize> = (0..all.len()).filter(|&k| readings[k].left_out.is_none()).collect();
    // One more, so that each can be held against a fit without it.
    if used.len() <= LEAST_PATCHES {
        let why = readings.iter().find_map(|r| r.left_out.clone()).unwrap_or_default();
        return Err(ColourError::TooFew { usable: used.len(), why });
    }
    let samples: Vec<Sample> = used.iter().map(|&k| all[k]).collect();
    let pairs = |solution: &Solution| -> Vec<(Lab, Lab)> {
        samples.iter().map(|s| (s.reference, solution.lab(s))).collect()
    };
    let even = solve(&samples, false).ok_or(ColourError::NoMatrix)?;
    let uneven = solve(&samples, true).ok_or(ColourError::NoMatrix)?;
    let without = |uneven: bool| held_out(&samples, uneven, |k, other| k == other, samples.len());
    let (out_even, out_uneven) = (without(false), without(true));
    let [even_mean, uneven_mean] = [&out_even, &out_uneven].map(|out| summary(&flat(out)).mean);
    let ratio = uneven.gradient.abs() / uneven.gradient_error;
    let taken_out = ratio.max_element() > TOLD && uneven_mean < even_mean;
    let (solution, out) = if taken_out { (uneven, out_uneven) } else { (even, out_even) };
    if out.iter().any(Option::is_none) {
        return Err(ColourError::NoMatrix);
    }
    let colour = |k: usize| (used[k] % COLUMNS + used[k] / COLUMNS) % 2;
    let halves = held_out(&samples, taken_out, |k, half| colour(k) == half, 2);
    let white_dn = white(&solution).ok_or(ColourError::NoMatrix)?;
    let patches = readings
        .iter()
        .enumerate()
        .map(|(k, reading)| {
            let measured = solution.lab(&all[k]);
            let place = used.iter().position(|&u| u == k);
            Patch {
                name: kind.patches()[k].0.to_owned(),
                rgb_dn: reading.rgb_dn,
                rgb_dn_standard_error: reading.error_dn,
                clipped_share: reading.clipped_share,
                reference_lab: all[k].reference,
                lab: measured,
                delta_e_2000: delta_e_2000(all[k].reference, measured),
                leave_one_out_delta_e_2000: place.and_then(|p| out[p]).map(|(a, b)| delta_e_2000(a, b)),
                left_out: reading.left_out.clone(),
            }
        })
        .collect();
    let xyz_d50_from_camera = solution.xyz_from_rgb * DMat3::from_diagonal(white_dn);
    let leave_one_out = summary(&flat(&out));
    Ok(ColourFit {
        chart: kind,
        chart_source: kind.source().to_owned(),
        xyz_d50_from_camera: rows(&xyz_d50_from_camera),
        white_dn: white_dn.to_array(),
        fit: summary(&pairs(&solution)),
        leave_one_out,
        half_held_out: halves.iter().all(Option::is_some).then(|| summary(&flat(&halves))),
        fit_even: summary(&pairs(&even)),
        evenness: Evenness {
            across: uneven.gradient.x,
            across_standard_error: uneven.gradient_error.x,
            down: uneven.gradient.y,
            down_standard_error: uneven.gradient_error.y,
            taken_out,
            leave_one_out_mean_even: even_mean,
            leave_one_out_mean_uneven: uneven_mean,
        },
        standards: standards::judge(&leave_one_out),
        patches,
        patch_corners_px: (0..PATCHES)
            .map(|k| measured_corners(image_from_chart, k).map(|p| p.to_array()))
            .collect(),
    })
}

/// Reference and value of every sample under a fit to those outside its group; `None` where that gives no matrix.
fn held_out(
    samples: &[Sample],
    uneven: bool,
    in_group: impl Fn(usize, usize) -> bool,
    groups: usize,
) -> Vec<Option<(Lab, Lab)>> {
    let mut out = vec![None; samples.len()];
    for group in 0..groups {
        let rest: Vec<Sample> =
            samples.iter().enumerate().filter(|(k, _)| !in_group(*k, group)).map(|(_, s)| *s).collect();
        let Some(solution) = solve(&rest, uneven) else { continue };
        for (k, s) in samples.iter().enumerate().filter(|(k, _)| in_group(*k, group)) {
            out[k] = Some((s.reference, solution.lab(s)));
        }
    }
    out
}

fn flat(pairs: &[Option<(Lab, Lab)>]) -> Vec<(Lab, Lab)> {
    pairs.iter().flatten().copied().collect()
}

/// Rows of a matrix.
pub fn rows(matrix: &DMat3) -> [[f64; 3]; 3] {
    let turned = matrix.transpose();
    [turned.x_axis, turned.y_axis, turned.z_axis].map(|v| v.to_array())
}

/// A matrix of rows.
pub fn matrix(rows: &[[f64; 3]; 3]) -> DMat3 {
    let [a, b, c] = rows.map(DVec3::from_array);
    DMat3::from_cols(a, b, c).transpose()
}

impl ColourFit {
    /// What to make of it, in words.
    pub fn verdict(&self) -> Verdict {
        let (fit, out) = (&self.fit, &self.leave_one_out);
        let good = out.mean <= GOOD;
        let mut sentences = vec![format!(
            "Colours differ by {:.2} on average and {:.2} at most (CIEDE2000, {} patches); patches that were not fitted by {:.2} and {:.2}: {}.",
            fit.mean,
            fit.max,
            fit.patches,
            out.mean,
            out.max,
            if good {
                "good enough to use"
            } else {
                "too much; shoot the chart evenly lit, in focus, without reflections"
            }
        )];
        let iso = match &self.standards.iso_19264_1_level {
            Some(level) => format!("meet level {level} of ISO 19264-1"),
            None => "meet no level of ISO 19264-1".into(),
        };
        sentences.push(format!(
            "Patches that were not fitted {iso} and have {} of 4 stars by FADGI 2023 (colour alone).",
            self.standards.fadgi_2023_stars
        ));
        sentences.push(self.evenness.words());
        let left_out = self.patches.iter().filter(|p| p.left_out.is_some()).count();
        if left_out > 0 {
            sentences.push(format!("{left_out} patches were left out; each says why."));
        }
        Verdict { good, sentences }
    }
}

impl Evenness {
    fn words(&self) -> String {
        let percent = |v: f64, e: f64| format!("{:+.1} % (standard error {:.1} %)", 100.0 * v, 100.0 * e);
        let (across, down) =
            (percent(self.across, self.across_standard_error), percent(self.down, self.down_standard_error));
        if self.across_standard_error.max(self.down_standard_error) > UNTOLD {
            return format!(
                "How even the light was cannot be told: from the middle to the edges it may change by {across} across and {down} down; shoot an even grey card in the chart's place to know."
            );
        }
        let worst = self.across.abs().max(self.down.abs());
        match (self.taken_out, worst > EVEN) {
            (true, _) => format!(
                "The light was uneven, {across} across and {down} down from the chart's middle; this was taken out."
            ),
            (false, true) => format!(
                "The light may have been uneven, {across} across and {down} down from the chart's middle; taking it out would not predict patches better, so it was left."
            ),
            (false, false) => {
                format!("The light was even: {across} across and {down} down from the chart's middle.")
            }
        }
    }
}

#[cfg(test)]
mod tests;
