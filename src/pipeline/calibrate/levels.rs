//! Sensor levels of a session: dark and blown frames in, `calibration/levels.json` out.

use super::{Series, SeriesError};
use crate::calibration::levels::{IsoLevels, IsoSums, LevelsFit, SiteLevels, UnfitFrame};
use crate::calibration::{Record, Verdict};
use crate::codec::raw::Photo;
use crate::export::chart::{self, Chart};
use crate::pipeline::levels::KIND;
use crate::progress::Progress;
use crate::session::Session;
use std::path::{Path, PathBuf};

/// Why levels could not be measured.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum LevelsError {
    /// The shots could not be read, or the result not be kept.
    #[error(transparent)]
    Series(#[from] SeriesError),
    /// No frame was given.
    #[error("no frame was given: --dark takes frames shot with the lens cap on, --blown over-exposed ones")]
    NoFrames,
    /// A frame does not tell whose levels it shows.
    #[error("{} does not tell its {setting}; give a raw file as the camera wrote it", path.display())]
    Untold {
        /// The frame.
        path: PathBuf,
        /// What is missing.
        setting: &'static str,
    },
    /// A frame is not what it should be.
    #[error("{}: {source}", path.display())]
    Unfit {
        /// The frame.
        path: PathBuf,
        /// What is wrong with it.
        source: UnfitFrame,
    },
}

/// Measures the levels of every ISO that occurs and keeps them in the session, in place of what was measured before.
/// A frame that is not dark is an error, one in which no colour clips is left out, and an error if nothing else is there.
pub fn calibrate(
    session: &Session,
    dark: &[PathBuf],
    blown: &[PathBuf],
    progress: &Progress,
) -> Result<Record<LevelsFit>, LevelsError> {
    let total = dark.len() + blown.len();
    if total == 0 {
        return Err(LevelsError::NoFrames);
    }
    let mut series = Series::new(session, KIND)?;
    let mut isos: Vec<IsoSums> = vec![];
    let mut last_unfit = None;
    let all = dark.iter().map(|path| (path, true)).chain(blown.iter().map(|path| (path, false)));
    for (done, (path, is_dark)) in all.enumerate() {
        progress.check().map_err(SeriesError::from)?;
        progress.report("measuring levels", done, total);
        let photo = series.read(path)?;
        let sums = of_iso(&mut isos, &photo, path)?;
        let unfit = |source| LevelsError::Unfit { path: path.clone(), source };
        if is_dark {
            sums.add_dark(&photo.mosaic).map_err(unfit)?;
        } else if let Err(source) = sums.add_blown(&photo.mosaic) {
            series.leave_out(done, source.to_string());
            last_unfit = Some(unfit(source));
        }
        if let Some(masked) = &photo.masked {
            sums.add_masked(masked);
        }
    }
    progress.report("measuring levels", total, total);
    isos.sort_by(|a, b| a.iso().0.total_cmp(&b.iso().0));
    let fit = LevelsFit { levels: isos.iter().map(IsoSums::levels).collect() };
    if let Some(unfit) = last_unfit
        && dark.is_empty()
        && fit.levels.iter().all(|levels| levels.blown_frames == 0)
    {
        return Err(unfit);
    }
    let verdict = fit.verdict();
    let figure = figure(&isos, &fit, &verdict);
    Ok(series.keep(fit, verdict, &figure, progress)?)
}

/// The sums of a frame's ISO.
fn of_iso<'a>(
    isos: &'a mut Vec<IsoSums>,
    photo: &Photo,
    path: &Path,
) -> Result<&'a mut IsoSums, LevelsError> {
    let untold = |setting| LevelsError::Untold { path: path.to_owned(), setting };
    photo.settings.model.as_ref().ok_or_else(|| untold("camera model"))?;
    let iso = photo.settings.iso.ok_or_else(|| untold("ISO"))?;
    let at = isos.iter().position(|sums| sums.iso() == iso).unwrap_or_else(|| {
        isos.push(IsoSums::new(iso, photo.mosaic.cfa));
        isos.len() - 1
    });
    Ok(&mut isos[at])
}

/// Histograms of the dark frames of the first ISO that has any; else saturation over ISO.
fn figure(isos: &[IsoSums], fit: &LevelsFit, verdict: &Verdict) -> Chart {
    let caption = verdict.sentences.join(" ");
    // One position a colour: the second green hides the first.
    let shown = |sites: &[SiteLevels]| {
        let mut shown: Vec<usize> = vec![];
        for (at, site) in sites.iter().enumerate() {
            if shown.iter().all(|&other| sites[other].colour != site.colour) {
                shown.push(at);
            }
        }
        shown
    };
    let dark = isos.iter().zip(&fit.levels).find(|(_, levels)| levels.dark_frames > 0);
    if let Some((sums, levels)) = dark {
        let histograms = sums.dark_histograms();
        let series = shown(&levels.sites).into_iter().map(|at| chart::Series {
            name: levels.sites[at].colour.clone(),
            points: histograms[at].iter().map(|&(dn, share)| (dn, share, 0.0)).collect(),
        });
        let across = format!("dark frames at {}, DN", levels.iso);
        return Chart { caption, across, up: "share of sites, %".into(), series: series.collect() };
    }
    let order = fit.levels.first().map(|levels| shown(&levels.sites)).unwrap_or_default();
    let series = order.into_iter().map(|at| {
        let point = |levels: &IsoLevels| Some((levels.iso.0.log2(), levels.sites[at].saturation_dn?, 0.0));
        chart::Series {
            name: fit.levels[0].sites[at].colour.clone(),
            points: fit.levels.iter().filter_map(point).collect(),
        }
    });
    Chart { caption, across: "log2 of ISO".into(), up: "saturation, DN".into(), series: series.collect() }
}
