//! Sensor levels: black, read noise and saturation of every filter position, an ISO at a time.
//!
//! Black is the mean of dark frames (lens cap) of the same ISO, else of the masked border. Sites further than five
//! standard deviations from the position's median do not count, so that hot sites do not lift it. Its 95 % interval holds
//! that sites scatter (`sd / sqrt(n)`) and, by Student's quantile, what whole frames scatter beyond that. Read noise comes from pairs of dark frames: the difference of two frames has no fixed pattern, and
//! twice the variance of one (EMVA 1288 release 4.0, section 6.6). Values are whole DN, which adds 1/12 DN^2 (the
//! variance of rounding, uniform over one DN); it is taken off. Below 0.24 DN^2 a variance is mostly rounding, and only a
//! bound of the read noise is told, as EMVA has it. A site that is more than eight standard deviations above
//! its position's median in every dark frame is hot.
//!
//! Saturation is where clipped sites pile up in a blown frame ([`crate::photometry::saturation`]). A colour that is not
//! blown in any frame is told as not reached.

mod dark;
mod histogram;
mod sums;
#[cfg(test)]
mod tests;

pub use sums::{IsoSums, UnfitFrame};

use super::{Rig, Verdict};
use crate::photometry::levels::{LevelsAt, MeasuredLevels};
use crate::units::Iso;
use serde::{Deserialize, Serialize};

/// Standard errors by which black of dark frames and of the masked border may part.
const AGREE_ERRORS: f64 = 3.0;
/// DN by which they may part whatever their errors.
const AGREE_DN: f64 = 0.25;
/// Dark frames that read so many DN more than the masked border beside them were not dark.
const LIT_DN: f64 = 4.0;

/// Levels of one body.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct LevelsFit {
    /// One entry an ISO, ascending.
    pub levels: Vec<IsoLevels>,
}

/// Where black was measured.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum BlackSource {
    /// In frames taken with the lens capped.
    DarkFrames,
    /// In the border that no light reaches, of whatever frames were given.
    MaskedPixels,
}

/// Levels of one ISO.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct IsoLevels {
    /// ISO label.
    pub iso: Iso,
    /// Dark frames used.
    pub dark_frames: usize,
    /// Blown frames used.
    pub blown_frames: usize,
    /// Where `black_dn` is from; absent if nothing told it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub black_source: Option<BlackSource>,
    /// Sites that are hot in all dark frames; absent without dark frames.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub hot_sites: Option<u64>,
    /// The four filter positions, row by row from the active area's first site.
    pub sites: Vec<SiteLevels>,
}

/// Levels of one filter position.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SiteLevels {
    /// Row in the filter array, 0 or 1.
    pub row: usize,
    /// Column in the filter array, 0 or 1.
    pub column: usize,
    /// "red", "green" or "blue".
    pub colour: String,
    /// DN of no light.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub black_dn: Option<f64>,
    /// Standard error of `black_dn`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub black_dn_standard_error: Option<f64>,
    /// Its 95 % interval.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub black_dn_interval_95: Option<[f64; 2]>,
    /// Mean of the masked border, DN; absent if the files have none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub masked_black_dn: Option<f64>,
    /// Its standard error.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub masked_black_dn_standard_error: Option<f64>,
    /// Read noise of one frame, DN, rounding taken off; absent without two dark frames, and where rounding hides it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub read_noise_dn: Option<f64>,
    /// Its standard error.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub read_noise_dn_standard_error: Option<f64>,
    /// Its 95 % interval.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub read_noise_dn_interval_95: Option<[f64; 2]>,
    /// Upper bound of the read noise, DN, where rounding hides it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub read_noise_below_dn: Option<f64>,
    /// DN at which clipped sites pile up; absent if no frame reached it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub saturation_dn: Option<f64>,
    /// DN from which processing takes a site for clipped: the foot of that pile less its noise.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub clipped_from_dn: Option<f64>,
    /// Why there is no `saturation_dn`, where blown frames were given.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub not_reached: Option<String>,
}

impl LevelsFit {
    /// The levels as frames are read with.
    pub fn measured(&self, rig: &Rig) -> MeasuredLevels {
        let isos = self.levels.iter().map(|levels| {
            let mut at = LevelsAt { iso: levels.iso, black: [[None; 2]; 2], saturation: [[None; 2]; 2] };
            for site in levels.sites.iter().filter(|site| site.row < 2 && site.column < 2) {
                // A photograph's own masked border is nearer to it than that of frames shot bright.
                let own = site.black_dn.filter(|_| levels.black_source == Some(BlackSource::DarkFrames));
                at.black[site.row][site.column] = own.filter(|_| !site.was_lit()).map(|dn| dn as f32);
                at.saturation[site.row][site.column] = site.clipped_from_dn.map(|dn| dn as f32);
            }
            at
        });
        MeasuredLevels { model: rig.model.clone(), serial: rig.serial.clone(), isos: isos.collect() }
    }

    /// What to make of it.
    pub fn verdict(&self) -> Verdict {
        let parted: Vec<String> = self.levels.iter().filter_map(IsoLevels::words_on_masked).collect();
        let sites = || self.levels.iter().flat_map(|levels| &levels.sites);
        let good = sites().any(|site| site.black_dn.is_some() || site.saturation_dn.is_some())
            && !sites().any(SiteLevels::was_lit);
        let mut sentences: Vec<String> = self.levels.iter().map(IsoLevels::words).collect();
        sentences.extend(parted);
        sentences.extend(self.levels.iter().filter_map(IsoLevels::words_on_not_reached));
        Verdict { good, sentences }
    }
}

impl SiteLevels {
    /// Whether the dark frames saw light: far more above the masked border than borders and sites differ by.
    fn was_lit(&self) -> bool {
        matches!((self.black_dn, self.masked_black_dn), (Some(own), Some(masked)) if own - masked > LIT_DN)
    }
}

impl IsoLevels {
    fn words(&self) -> String {
        let range = |values: Vec<f64>, digits: usize| {
            let low = values.iter().copied().fold(f64::INFINITY, f64::min);
            let high = values.iter().copied().fold(f64::NEG_INFINITY, f64::max);
            let (low, high) = (format!("{low:.digits$}"), format!("{high:.digits$}"));
            if low == high { low } else { format!("{low} to {high}") }
        };
        let of = |value: fn(&SiteLevels) -> Option<f64>| -> Vec<f64> {
            self.sites.iter().filter_map(value).collect()
        };
        let source = match self.black_source {
            Some(BlackSource::DarkFrames) => format!("{} dark frames", self.dark_frames),
            Some(BlackSource::MaskedPixels) => "the masked border".into(),
            None => String::new(),
        };
        let black = match of(|site| site.black_dn) {
            none if none.is_empty() => "black was not measured".to_owned(),
            values => format!("black is {} DN (from {source})", range(values, 2)),
        };
        let below = of(|site| site.read_noise_below_dn);
        let noise = match of(|site| site.read_noise_dn) {
            none if none.is_empty() && below.is_empty() => String::new(),
            none if none.is_empty() => {
                format!(", read noise below {} DN (rounding to whole DN hides it)", range(below, 2))
            }
            values => format!(", read noise {} DN", range(values, 2)),
        };
        let saturation = match of(|site| site.saturation_dn) {
            none if none.is_empty() => "saturation was not reached".to_owned(),
            values => format!("saturation is {} DN", range(values, 0)),
        };
        format!("At {} {black}{noise}; {saturation}.", self.iso)
    }

    fn words_on_masked(&self) -> Option<String> {
        let apart = |site: &SiteLevels| {
            let (own, masked) = (site.black_dn?, site.masked_black_dn?);
            let error = site.black_dn_standard_error?.hypot(site.masked_black_dn_standard_error?);
            let part = masked - own;
            (part.abs() > AGREE_DN.max(AGREE_ERRORS * error)).then_some(part)
        };
        let parts: Vec<f64> = self.sites.iter().filter_map(apart).collect();
        let worst = parts.into_iter().max_by(|a, b| a.abs().total_cmp(&b.abs()))?;
        Some(format!(
            "At {} the masked border reads up to {worst:+.2} DN from the dark frames, which {}; were the frames really dark, and is the lens cap tight?",
            self.iso,
            if self.sites.iter().any(SiteLevels::was_lit) { "DO NOT COUNT" } else { "count" }
        ))
    }

    fn words_on_not_reached(&self) -> Option<String> {
        let mut colours: Vec<&str> = vec![];
        for site in self.sites.iter().filter(|site| site.not_reached.is_some()) {
            if !colours.contains(&site.colour.as_str()) {
                colours.push(&site.colour);
            }
        }
        (!colours.is_empty()).then(|| {
            format!(
                "At {} {} {} in the blown frames: not reached, the next best source stays; shoot brighter, or with light of another colour.",
                self.iso,
                colours.join(" and "),
                if colours.len() == 1 { "never clips" } else { "never clip" }
            )
        })
    }
}
