//! The flat field of a session: evenly lit frames in, `calibration/flat.json` out.

use super::{RecordError, Series, SeriesError, load as load_record};
use crate::calibration::Record;
use crate::calibration::flat::{FlatCalibration, FlatFitError, fit_flat};
use crate::calibration::statistics::Z95;
use crate::calibration::tiles::{EvenFrame, Tiles, TooSmall};
use crate::export::chart::{Chart, Series as Points};
use crate::progress::Progress;
use crate::session::Session;
use std::path::PathBuf;

/// Name of the calibration among a session's.
const KIND: &str = "flat";

/// Why there is no flat field.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum FlatError {
    /// The frames could not be read or kept.
    #[error(transparent)]
    Series(#[from] SeriesError),
    /// A frame is too small.
    #[error("{}: {source}", path.display())]
    TooSmall {
        /// The frame.
        path: PathBuf,
        /// Its size.
        source: TooSmall,
    },
    /// The frames tell no flat field.
    #[error(transparent)]
    Fit(#[from] FlatFitError),
}

/// Fits the flat field to evenly lit frames and keeps it.
pub fn calibrate(
    session: &Session,
    frames: &[PathBuf],
    progress: &Progress,
) -> Result<Record<FlatCalibration>, FlatError> {
    let mut series = Series::new(session, KIND)?;
    let mut read = vec![];
    for (done, path) in frames.iter().enumerate() {
        progress.check().map_err(SeriesError::from)?;
        progress.report("reading the even frames", done, frames.len());
        let photo = series.read(path)?;
        let small = |source| FlatError::TooSmall { path: path.clone(), source };
        let noise = series.noise(&photo.settings)?;
        let tiles = Tiles::of(&photo.mosaic, noise).map_err(small)?;
        read.push(EvenFrame { settings: photo.settings, tiles });
    }
    let (fit, left_out) = fit_flat(&read)?;
    let verdict = fit.verdict(left_out.len());
    for (frame, why) in left_out {
        series.leave_out(frame, why);
    }
    let figure = figure(&fit);
    Ok(series.keep(fit, verdict, &figure, progress)?)
}

/// The session's flat field; `None` if it was not measured. It is true of one body, lens, focal length and aperture:
/// [`FlatCalibration::fits`].
pub fn load(session: &Session) -> Result<Option<Record<FlatCalibration>>, RecordError> {
    load_record(session, KIND)
}

pub(super) fn figure(fit: &FlatCalibration) -> Chart {
    let named = ["red", "green", "blue"].into_iter().zip(&fit.profile).filter(|(_, rings)| !rings.is_empty());
    let series = named.map(|(name, rings)| Points {
        name: name.into(),
        points: rings.iter().map(|p| (p.radius, p.light, Z95 * p.light_standard_error)).collect(),
    });
    Chart {
        caption: "Light around the frame's centre: vignetting.".into(),
        across: "distance from the centre / half diagonal".into(),
        up: "light / light at the centre".into(),
        series: series.collect(),
    }
}
