//! What levels mean, for people.

use super::{BlackSource, IsoLevels, LevelsFit, SiteLevels};
use crate::calibration::Verdict;

/// Standard errors by which black of dark frames and of the masked border may part.
const AGREE_ERRORS: f64 = 3.0;
/// DN by which they may part whatever their errors.
const AGREE_DN: f64 = 0.25;

impl LevelsFit {
    /// What to make of it.
    pub fn verdict(&self) -> Verdict {
        let parted: Vec<String> = self.levels.iter().filter_map(IsoLevels::words_on_masked).collect();
        let sites = || self.levels.iter().flat_map(|levels| &levels.sites);
        let good = sites().any(|site| site.black_dn.is_some() || site.saturation_dn.is_some())
            && !sites().any(SiteLevels::was_lit);
        let mut sentences: Vec<String> = self.levels.iter().map(IsoLevels::words).collect();
        sentences.extend(parted);
        sentences.extend(self.levels.iter().filter_map(IsoLevels::words_on_cut_off));
        sentences.extend(self.levels.iter().filter_map(IsoLevels::words_on_steps));
        sentences.extend(self.levels.iter().filter_map(IsoLevels::words_on_not_reached));
        sentences.extend(self.not_measured.iter().map(|none| none.words("LEVELS ARE MISSING")));
        Verdict { good, sentences }
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
                format!(", read noise below {} DN (rounding hides it)", range(below, 2))
            }
            values => format!(", read noise {} DN", range(values, 2)),
        };
        let saturation = match of(|site| site.saturation_dn) {
            none if none.is_empty() => "saturation was not reached".to_owned(),
            values => format!("saturation is {} DN", range(values, 0)),
        };
        format!("At {} {black}{noise}; {saturation}.", self.iso)
    }

    fn words_on_cut_off(&self) -> Option<String> {
        let share = |site: &SiteLevels| site.cut_off_share.unwrap_or(0.0);
        let most = |a: &&SiteLevels, b: &&SiteLevels| share(a).total_cmp(&share(b));
        let site = self.sites.iter().filter(|site| site.cut_off_dn.is_some()).max_by(most)?;
        let black = match self
            .sites
            .iter()
            .any(|site| site.cut_off_dn.is_some() && site.black_dn_standard_error.is_none())
        {
            true => "black is taken as that value, and it may lie below",
            false => "black is their median",
        };
        Some(format!(
            "At {} the raws are cut off at {:.0} DN, where up to {:.0} % of the dark sites lie: {black}; read noise is not told, for \
             dark frames show but a part of it: `unlit calibrate noise` tells it from lit frames.",
            self.iso,
            site.cut_off_dn?,
            100.0 * site.cut_off_share?
        ))
    }

    fn words_on_steps(&self) -> Option<String> {
        let largest = self.sites.iter().filter_map(|site| site.step_dn).max_by(f64::total_cmp)?;
        Some(format!(
            "At {} the raws have values every {largest:.2} DN only: rounding adds {:.2} DN^2 to variances, which is taken off for \
             read noise.",
            self.iso,
            largest * largest / 12.0
        ))
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
