//! Sensor levels of a session: dark and blown frames in, `calibration/levels.json` out.

use super::{Series, SeriesError, io};
use crate::calibration::levels::{IsoLevels, IsoSums, LevelsFit, SiteLevels, UnfitFrame};
use crate::calibration::{NotMeasured, Record, Verdict};
use crate::codec::exif;
use crate::codec::raw::Photo;
use crate::export::chart::{self, Chart};
use crate::pipeline::levels::KIND;
use crate::progress::Progress;
use crate::session::Session;
use crate::units::Iso;
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
/// A frame that is not dark, or in which no colour clips, is left out; an ISO of which nothing is left is named with the
/// reason, and it is an error if none is.
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
    let mut isos: Vec<IsoFrames> = vec![];
    for (done, Given { iso, path, is_dark }) in in_order(dark, blown)?.into_iter().enumerate() {
        progress.check().map_err(SeriesError::from)?;
        progress.report("measuring levels", done, total);
        if let Some(iso) = iso {
            isos.iter_mut().filter(|own| own.sums.iso() != iso).for_each(|own| own.sums.let_go());
        }
        let photo = series.read(path)?;
        let own = of_iso(&mut isos, &photo, path)?;
        own.dark_given += usize::from(is_dark);
        let added =
            if is_dark { own.sums.add_dark(&photo.mosaic) } else { own.sums.add_blown(&photo.mosaic) };
        if let Err(source) = added {
            series.leave_out(done, source.to_string());
            let unfit = if is_dark { &mut own.unfit_dark } else { &mut own.unfit_blown };
            *unfit = Some((path.clone(), source));
        }
        if let Some(masked) = &photo.masked {
            own.sums.add_masked(masked);
        }
    }
    progress.report("measuring levels", total, total);
    isos.sort_by(|a, b| a.sums.iso().0.total_cmp(&b.sums.iso().0));
    if isos.iter().all(|own| !own.sums.is_measured())
        && let Some((path, source)) =
            isos.iter().find_map(|own| own.unfit_dark.clone().or(own.unfit_blown.clone()))
    {
        return Err(LevelsError::Unfit { path, source });
    }
    let (isos, none): (Vec<_>, Vec<_>) = isos.into_iter().partition(|own| own.sums.is_measured());
    let levels: Vec<IsoLevels> = isos.iter().map(|own| own.sums.levels()).collect();
    let without_black =
        isos.iter().zip(&levels).filter(|(_, levels)| levels.dark_frames == 0).map(|two| two.0);
    let not_measured = none.iter().chain(without_black).filter_map(IsoFrames::not_measured).collect();
    let fit = LevelsFit { levels, not_measured };
    let verdict = fit.verdict();
    let figure = figure(&isos, &fit, &verdict);
    Ok(series.keep(fit, verdict, &figure, progress)?)
}

/// What the frames of an ISO amount to, and why the last of those that are not fit is not.
struct IsoFrames {
    sums: IsoSums,
    dark_given: usize,
    unfit_dark: Option<(PathBuf, UnfitFrame)>,
    unfit_blown: Option<(PathBuf, UnfitFrame)>,
}

impl IsoFrames {
    /// What its frames were to tell and did not.
    fn not_measured(&self) -> Option<NotMeasured> {
        let why = match (&self.unfit_dark, &self.unfit_blown) {
            (Some((path, why)), _) => {
                format!(
                    "no black, for none of its {} dark frames is fit ({}: {why})",
                    self.dark_given,
                    path.display()
                )
            }
            (None, Some((path, why))) if !self.sums.is_measured() => format!("{}: {why}", path.display()),
            _ => return None,
        };
        Some(NotMeasured { iso: self.sums.iso(), why })
    }
}

/// A frame that is not read yet.
struct Given<'a> {
    /// Its ISO as far as the file tells it without being decoded.
    iso: Option<Iso>,
    path: &'a PathBuf,
    is_dark: bool,
}

/// The frames by ISO, so that those of one alone are held at a time; the dark ones of each first.
fn in_order<'a>(dark: &'a [PathBuf], blown: &'a [PathBuf]) -> Result<Vec<Given<'a>>, SeriesError> {
    let all = dark.iter().map(|path| (path, true)).chain(blown.iter().map(|path| (path, false)));
    let given = |(path, is_dark): (&'a PathBuf, bool)| {
        let iso = exif::settings(&std::fs::read(path).map_err(io(path))?).iso;
        Ok(Given { iso, path, is_dark })
    };
    let mut all = all.map(given).collect::<Result<Vec<_>, SeriesError>>()?;
    let key = |given: &Given| given.iso.map_or(f64::INFINITY, |iso| iso.0);
    all.sort_by(|a, b| key(a).total_cmp(&key(b)));
    Ok(all)
}

/// The sums of a frame's ISO.
fn of_iso<'a>(
    isos: &'a mut Vec<IsoFrames>,
    photo: &Photo,
    path: &Path,
) -> Result<&'a mut IsoFrames, LevelsError> {
    let untold = |setting| LevelsError::Untold { path: path.to_owned(), setting };
    photo.settings.model.as_ref().ok_or_else(|| untold("camera model"))?;
    let iso = photo.settings.iso.ok_or_else(|| untold("ISO"))?;
    let at = isos.iter().position(|own| own.sums.iso() == iso).unwrap_or_else(|| {
        let sums = IsoSums::new(iso, photo.mosaic.cfa);
        isos.push(IsoFrames { sums, dark_given: 0, unfit_dark: None, unfit_blown: None });
        isos.len() - 1
    });
    Ok(&mut isos[at])
}

/// Histograms of the dark frames of the first ISO that has any; else saturation over ISO.
fn figure(isos: &[IsoFrames], fit: &LevelsFit, verdict: &Verdict) -> Chart {
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
    if let Some((own, levels)) = dark {
        let histograms = own.sums.dark_histograms();
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
