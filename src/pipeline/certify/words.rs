//! A certificate as a table for people.

use super::{PatchResult, Source};
use crate::calibration::certificate::{Comparison, Judgement};

/// Headings of [`rows`].
pub const HEAD: [&str; 8] = [
    "Patch",
    "Known (camera R G B)",
    "Found",
    "Standard error",
    "Error, % of known",
    "CIEDE2000",
    "5 % / 2 %",
    "Read from",
];

/// One row a patch, as wide as [`HEAD`].
pub fn rows(patches: &[PatchResult]) -> Vec<Vec<String>> {
    patches.iter().map(row).collect()
}

fn row(result: &PatchResult) -> Vec<String> {
    let name = result.patch.name.clone();
    let Some(comparison) = &result.comparison else {
        let why = result.not_seen.clone().unwrap_or_default();
        let dash = || "-".to_owned();
        return vec![name, dash(), dash(), dash(), dash(), dash(), "not seen".into(), why];
    };
    let Comparison {
        known_reflectance,
        found_reflectance,
        found_reflectance_standard_error,
        relative_error,
        ..
    } = comparison;
    vec![
        name,
        three(known_reflectance),
        three(found_reflectance),
        found_reflectance_standard_error.as_ref().map_or_else(|| "not told".into(), three),
        relative_error.map(|e| format!("{:+.1}", 100.0 * e)).join(" "),
        comparison.delta_e_2000.map_or_else(|| "-".into(), |d| format!("{d:.2}")),
        format!("{} / {}", word(comparison.within_5_percent), word(comparison.within_2_percent)),
        result.read.as_ref().map(place).unwrap_or_default(),
    ]
}

fn three(values: &[f64; 3]) -> String {
    values.map(|v| format!("{v:.4}")).join(" ")
}

fn word(judgement: Judgement) -> String {
    let word = if judgement.passes { "pass" } else { "FAIL" };
    if judgement.sure == Some(false) { format!("{word} (unsure)") } else { word.into() }
}

fn place(source: &Source) -> String {
    match source {
        Source::Texture { texels, seen_share } => {
            format!("the texture: {texels} texels, {:.0} % of it seen", 100.0 * seen_share)
        }
        Source::Views { names, pixels } => {
            format!("beside the model: {pixels} pixels of {} views' own images", names.len())
        }
    }
}
