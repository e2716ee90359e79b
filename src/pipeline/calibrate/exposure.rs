//! The exposure table of a session: ladders of shots in, `calibration/exposure.json` out.

use super::{RecordError, Series, SeriesError, load as load_record};
use crate::calibration::Record;
use crate::calibration::exposure::{ExposureFit, ExposureFitError, fit_exposure, verdict};
use crate::calibration::tiles::{EvenFrame, Tiles, TooSmall};
use crate::export::chart::{Chart, Series as Points};
use crate::photometry::LevelSource;
use crate::progress::Progress;
use crate::session::Session;
use std::path::PathBuf;

/// Name of the calibration among a session's.
const KIND: &str = "exposure";

/// Why there is no exposure table.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ExposureError {
    /// The shots could not be read or kept.
    #[error(transparent)]
    Series(#[from] SeriesError),
    /// A shot is too small.
    #[error("{}: {source}", path.display())]
    TooSmall {
        /// The shot.
        path: PathBuf,
        /// Its size.
        source: TooSmall,
    },
    /// The shots make no table.
    #[error(transparent)]
    Fit(#[from] ExposureFitError),
}

/// Measures the steps of all ladders among the shots, given in the order in which they were taken, and keeps them.
pub fn calibrate(
    session: &Session,
    shots: &[PathBuf],
    progress: &Progress,
) -> Result<Record<ExposureFit>, ExposureError> {
    let mut series = Series::new(session, KIND)?;
    let (mut read, mut black_known) = (vec![], true);
    for (done, path) in shots.iter().enumerate() {
        progress.check().map_err(SeriesError::from)?;
        progress.report("reading the ladders", done, shots.len());
        let photo = series.read(path)?;
        let black = photo.mosaic.levels.black_source;
        black_known &= matches!(black, LevelSource::Measured | LevelSource::MaskedPixels);
        let small = |source| ExposureError::TooSmall { path: path.clone(), source };
        let noise = series.noise(&photo.settings)?;
        let tiles = Tiles::of(&photo.mosaic, noise).map_err(small)?;
        read.push(EvenFrame { settings: photo.settings, tiles });
    }
    let (fit, left_out) = fit_exposure(&read)?;
    let verdict = verdict(&fit, black_known);
    for (shot, why) in left_out.into_iter().enumerate() {
        if let Some(why) = why {
            series.leave_out(shot, why);
        }
    }
    let figure = figure(&fit);
    Ok(series.keep(fit, verdict, &figure, progress)?)
}

/// The session's table; `None` if it was not measured.
pub fn load(session: &Session) -> Result<Option<Record<ExposureFit>>, RecordError> {
    load_record(session, KIND)
}

pub(super) fn figure(fit: &ExposureFit) -> Chart {
    let series = fit.ladders.iter().map(|ladder| {
        let points = ladder.steps.iter().map(|step| {
            let half = (step.deviation_interval_95[1] - step.deviation_interval_95[0]) / 2.0;
            (step.step_thirds, 100.0 * step.deviation, 100.0 * half)
        });
        Points { name: ladder.setting.name().into(), points: points.collect() }
    });
    Chart {
        caption: "Measured factor of each step against the ideal 2^(k/3).".into(),
        across: "thirds of a stop above the darkest step".into(),
        up: "deviation, %".into(),
        series: series.collect(),
    }
}
