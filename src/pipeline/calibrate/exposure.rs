//! The exposure table of a session: ladders of shots in, `calibration/exposure.json` out.

use super::{RecordError, Series, SeriesError, load as load_record};
use crate::calibration::exposure::{
    ExposureFit, ExposureFitError, ExposureTable, ScaleSource, fit_exposure, verdict,
};
use crate::calibration::tiles::{EvenFrame, Tiles, TooSmall};
use crate::calibration::{OtherRig, Record};
use crate::export::chart::{Chart, Series as Points};
use crate::pair::Settings;
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
    let mut read = vec![];
    for (done, path) in shots.iter().enumerate() {
        progress.check().map_err(SeriesError::from)?;
        progress.report("reading the ladders", done, shots.len());
        let photo = series.read(path)?;
        let small = |source| ExposureError::TooSmall { path: path.clone(), source };
        let tiles = Tiles::of(&photo.mosaic).map_err(small)?;
        read.push(EvenFrame { settings: photo.settings, tiles });
    }
    let (fit, left_out) = fit_exposure(&read)?;
    let verdict = verdict(&fit);
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

/// How light scales with settings for a session's photographs.
#[derive(Clone, Debug, Default)]
pub struct SessionScale {
    record: Option<Record<ExposureFit>>,
}

impl SessionScale {
    /// By the session's table if it has one.
    pub fn load(session: &Session) -> Result<Self, RecordError> {
        Ok(Self { record: load(session)?.filter(|record| record.verdict.good) })
    }

    /// The scale between two exposures of one body, of which `settings` are a frame's own: what the labels stand for,
    /// without a table or if nothing differs; else an error if the table is of another body.
    pub fn between(&self, settings: &Settings, other: &Settings) -> Result<ExposureTable, OtherRig> {
        let differ = ExposureTable::default().source(settings, other) != ScaleSource::Same;
        match &self.record {
            Some(record) if differ => ExposureTable::for_frame(record, settings),
            _ => Ok(ExposureTable::default()),
        }
    }

    /// Everything of the table that figures depend on; absent without a table.
    pub(in crate::pipeline) fn told(&self) -> Option<String> {
        self.record.as_ref().map(|record| format!("{:?} {:?}", record.rig, record.fit))
    }
}

pub(super) fn figure(fit: &ExposureFit) -> Chart {
    let series = fit.ladders.iter().map(|ladder| {
        let points = ladder.steps.iter().map(|step| {
            let half = (step.deviation_95[1] - step.deviation_95[0]) / 2.0;
            (step.step_thirds, 100.0 * step.deviation, 100.0 * half)
        });
        Points { name: ladder.setting.name().into(), points: points.collect() }
    });
    Chart {
        caption: "Measured factor of each step against the ideal 2^(k/3), with its 95 % interval.".into(),
        across: "thirds of a stop above the darkest step".into(),
        up: "deviation, %".into(),
        series: series.collect(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::calibration::exposure::{Ladder, Setting, Step, Summary};
    use crate::calibration::{Rig, SCHEMA, Verdict};
    use crate::photometry::apex::ExposureScale;
    use crate::units::Iso;

    fn at(model: &str, iso: f64) -> Settings {
        Settings { model: Some(model.into()), iso: Some(Iso(iso)), ..Settings::default() }
    }

    fn record(good: bool) -> Record<ExposureFit> {
        let step = |(label, deviation): (f64, f64)| Step {
            label,
            step_thirds: 0.0,
            factor: 1.0,
            deviation,
            deviation_95: [deviation; 2],
            shots: 1,
            shot_numbers: vec![],
            frame_share: 1.0,
            pattern_sd: 0.0,
        };
        let none = Summary { mean: 0.0, max: 0.0, min: 0.0, sd: 0.0 };
        let ladder = Ladder {
            setting: Setting::Iso,
            shared: Default::default(),
            steps: [(100.0, 0.0), (125.0, 0.01), (200.0, 0.02)].map(step).to_vec(),
            repeat_sd: None,
            summary: none,
            between_steps: none,
        };
        Record {
            schema: SCHEMA,
            measured: String::new(),
            software: String::new(),
            rig: Rig::of(&at("A", 100.0)),
            shots: vec![],
            verdict: Verdict { good, sentences: vec![] },
            fit: ExposureFit { ladders: vec![ladder] },
        }
    }

    #[test]
    fn a_sessions_table_counts_for_its_body_where_settings_differ_and_if_it_is_good() {
        let folder = tempfile::tempdir().unwrap();
        let session = Session::create(&folder.path().join("s"), "s").unwrap();
        let ratio = |model: &str, from: f64, to: f64| {
            let scale = SessionScale::load(&session).unwrap();
            scale.between(&at(model, from), &at(model, to)).map(|t| t.gain(Iso(to)) / t.gain(Iso(from)))
        };
        let near = |found: Result<f64, OtherRig>, wanted: f64| (found.unwrap() - wanted).abs() < 1e-12;
        assert!(near(ratio("A", 100.0, 200.0), 2.0), "without a table");
        let keep = |good: bool| {
            let bytes = serde_json::to_vec(&record(good)).unwrap();
            session.keep(&session.calibration_dir().join("exposure.json"), &bytes).unwrap();
        };
        keep(false);
        assert!(near(ratio("A", 100.0, 200.0), 2.0), "a bad one");
        keep(true);
        assert!(near(ratio("A", 100.0, 200.0), 2.0 * 1.02));
        assert!(ratio("B", 100.0, 200.0).unwrap_err().to_string().contains("camera model"));
        assert!(near(ratio("B", 200.0, 200.0), 1.0), "nothing differs");
        assert!(SessionScale::load(&session).unwrap().told().is_some());
    }
}
