//! How light goes with the settings of a session's photographs: by its measured exposure table
//! (`calibration/exposure.json`) where it has one, else by what labels stand for.
//!
//! Everything that scales one exposure to another asks here, so that a table is either used by all or by none, and
//! [`Ratios`] says by which of the two a run went.

use super::calibrate::{RecordError, exposure};
use crate::calibration::exposure::{ExposureFit, ExposureTable, ScaleSource};
use crate::calibration::{FlashCalibration, OtherRig, Record, Rig};
use crate::pair::{PairRecord, Settings};
use crate::photometry::apex::ExposureScale;
use crate::session::Session;
use crate::units::{FNumber, Iso};
use serde::{Deserialize, Serialize};

/// A session's exposure table, or none.
#[derive(Clone, Debug, Default)]
pub struct SessionScale {
    record: Option<Record<ExposureFit>>,
}

/// Why two exposures cannot be scaled to each other.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum RatioError {
    /// A setting that one of two frames lacks.
    #[error(
        "only one of its two frames tells the {0}, so that the room's light cannot be taken out; shoot it again with one setting for both"
    )]
    Lacking(&'static str),
    /// The table is another body's.
    #[error(
        "settings differ, but the session's exposure table does not hold: {0}; run `unlit calibrate exposure` with the body that took the photos, or remove calibration/exposure.json to go by labels"
    )]
    OtherBody(#[from] OtherRig),
}

impl SessionScale {
    /// By the session's table if it has one.
    pub fn load(session: &Session) -> Result<Self, RecordError> {
        Ok(Self { record: exposure::load(session)? })
    }

    /// The table, unless its verdict is bad.
    fn good(&self) -> Option<&Record<ExposureFit>> {
        self.record.as_ref().filter(|record| record.verdict.good)
    }

    /// The scale of the body that took a frame of these settings; an error if the table is another body's.
    pub fn of(&self, settings: &Settings) -> Result<ExposureTable, OtherRig> {
        self.good().map_or_else(|| Ok(ExposureTable::default()), |r| ExposureTable::for_frame(r, settings))
    }

    /// The scale between two exposures of one body, of which `settings` are a frame's own. The table of another body is
    /// an error if any label differs; if none does, it is not needed.
    pub fn between(&self, settings: &Settings, other: &Settings) -> Result<ExposureTable, OtherRig> {
        match self.of(settings) {
            Err(_) if ExposureTable::default().source(settings, other) == ScaleSource::Same => {
                Ok(ExposureTable::default())
            }
            found => found,
        }
    }

    /// S_on / S_off with S = t ISO / N^2, by which the room's light in the unlit frame is taken to that in the lit one.
    /// What neither frame tells counts as equal.
    pub fn room_ratio(&self, on: &Settings, off: &Settings) -> Result<f64, RatioError> {
        let scale = self.between(on, off)?;
        let ratio = |on: Option<f64>, off: Option<f64>, setting| match (on, off) {
            (Some(on), Some(off)) => Ok(on / off),
            (None, None) => Ok(1.0),
            _ => Err(RatioError::Lacking(setting)),
        };
        let time = |s: &Settings| s.shutter.map(|v| scale.time(v));
        let iso = |s: &Settings| s.iso.map(|v| scale.gain(v));
        let aperture = |s: &Settings| s.aperture.map(|v| scale.aperture(v));
        Ok(ratio(time(on), time(off), "shutter")?
            * ratio(iso(on), iso(off), "ISO")?
            * ratio(aperture(on), aperture(off), "aperture")?)
    }

    /// Everything of the table that figures and words on them depend on; absent without one.
    pub fn told(&self) -> Option<String> {
        let record = self.record.as_ref()?;
        Some(format!("{} {:?} {:?} {:?}", record.measured, record.verdict.good, record.rig, record.fit))
    }

    /// By what the pairs' ratios go: of the lit to the unlit frame, and of the lit frame to the flash calibration.
    pub(super) fn ratios<'a>(
        &self,
        pairs: impl Iterator<Item = &'a PairRecord>,
        calibration: &FlashCalibration,
    ) -> Ratios {
        let mut ratios = Ratios {
            table: self.record.as_ref().map(|record| TableOrigin {
                measured: record.measured.clone(),
                rig: record.rig.clone(),
                good: record.verdict.good,
            }),
            ..Ratios::default()
        };
        for pair in pairs {
            let (on, off) = (&pair.on.settings, &pair.off.settings);
            let other = |table: &Record<ExposureFit>| !table.rig.lighting.same_polariser(&pair.lighting);
            if self.good().is_some_and(other) {
                ratios.other_polariser.push(pair.name.clone());
            }
            let then = of_calibration(calibration, on);
            // Developing refuses the table of another body where anything differs.
            let table = self.of(on).unwrap_or_default();
            match table.source(on, off).max(table.source(on, &then)) {
                ScaleSource::Same => {}
                ScaleSource::Measured => ratios.measured.push(pair.name.clone()),
                ScaleSource::Nominal => ratios.by_labels.push(pair.name.clone()),
            }
        }
        ratios
    }
}

/// The settings of a flash calibration's shots as far as a flash's light goes with them; the shutter is the frame's.
pub(super) fn of_calibration(calibration: &FlashCalibration, frame: &Settings) -> Settings {
    let (iso, aperture) = (calibration.iso.map(Iso), calibration.aperture.map(FNumber));
    Settings { iso, aperture, shutter: frame.shutter, ..Settings::default() }
}

/// By what the exposures of a run were scaled.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Ratios {
    /// Pairs that were scaled by measured steps alone.
    pub measured: Vec<String>,
    /// Pairs that were scaled by what at least one label stands for.
    pub by_labels: Vec<String>,
    /// Pairs that were seen through another polariser than the table's shots.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub other_polariser: Vec<String>,
    /// The session's exposure table; absent if it has none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub table: Option<TableOrigin>,
}

/// Which exposure table.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct TableOrigin {
    /// When it was measured, UTC.
    pub measured: String,
    /// Of which body and lens.
    pub rig: Rig,
    /// Whether its verdict is good; a table that is not is not used.
    pub good: bool,
}

impl Ratios {
    /// In words, for the report.
    pub fn words(&self) -> String {
        let mut parts = vec![];
        if self.measured.is_empty() && self.by_labels.is_empty() {
            parts.push(
                "none was needed: both frames of each pair and the flash calibration have the same settings"
                    .into(),
            );
        }
        if !self.measured.is_empty() {
            parts.push(format!("by the measured exposure table: {}", self.measured.join(", ")));
        }
        if !self.by_labels.is_empty() {
            parts.push(format!("by what labels stand for: {}", self.by_labels.join(", ")));
        }
        parts.push(match &self.table {
            None => "no exposure table was measured".into(),
            Some(table) => {
                let Rig { model, serial, lens, .. } = &table.rig;
                let body: Vec<&str> =
                    [model, serial, lens].into_iter().flatten().map(String::as_str).collect();
                let use_of = if table.good { "" } else { ", not used since its verdict is bad" };
                format!("calibration/exposure.json of {} ({}){use_of}", table.measured, body.join(", "))
            }
        });
        if let (false, Some(table)) = (self.other_polariser.is_empty(), &self.table) {
            parts.push(format!(
                "ITS SHOTS WERE SEEN THROUGH ANOTHER POLARISER ({}) than {}: a step of a dial is taken to be the same \
                 through both",
                table.rig.lighting.polariser_words(),
                self.other_polariser.join(", ")
            ));
        }
        parts.join("; ")
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::calibration::SCHEMA;
    use crate::units::Seconds;
    use serde_json::json;

    fn at(model: &str, iso: f64) -> Settings {
        Settings { model: Some(model.into()), iso: Some(Iso(iso)), ..Settings::default() }
    }

    /// A table of ISO 100 to 200 and f/11 to f/9.
    fn record(good: bool) -> Record<ExposureFit> {
        let none = json!({ "mean": 0.0, "max": 0.0, "min": 0.0, "sd": 0.0 });
        let ladder = |setting: &str, steps: [(f64, f64); 3]| {
            let step = |(label, deviation): (f64, f64)| {
                json!({
                    "label": label, "step_thirds": 0.0, "factor": 1.0, "deviation": deviation,
                    "deviation_interval_95": [deviation, deviation], "shots": 1, "frame_share": 1.0, "pattern_sd": 0.0,
                })
            };
            json!({
                "setting": setting, "shared": {}, "steps": steps.map(step), "step_00_dn": 400.0,
                "summary": none, "between_steps": none,
            })
        };
        serde_json::from_value(json!({
            "schema": SCHEMA, "measured": "2026-11-23T10:00:00Z", "software": "", "shots": [],
            "rig": { "model": "A", "lens": "50 mm" }, "verdict": { "good": good, "sentences": [] },
            "ladders": [
                ladder("iso", [(100.0, 0.0), (125.0, 0.01), (200.0, 0.02)]),
                ladder("aperture", [(11.0, 0.0), (10.0, 0.01), (9.0, 0.04)]),
            ],
        }))
        .unwrap()
    }

    fn near(found: Result<f64, RatioError>, wanted: f64) {
        let found = found.unwrap();
        assert!((found - wanted).abs() < 1e-12, "{found}, not {wanted}");
    }

    #[test]
    fn a_sessions_table_counts_for_its_body_where_settings_differ_and_if_it_is_good() {
        let folder = tempfile::tempdir().unwrap();
        let session = Session::create(&folder.path().join("s"), "s").unwrap();
        let ratio = |model: &str, off: f64, on: f64| {
            SessionScale::load(&session).unwrap().room_ratio(&at(model, on), &at(model, off))
        };
        near(ratio("A", 100.0, 200.0), 2.0);
        let keep = |good: bool| {
            let bytes = serde_json::to_vec(&record(good)).unwrap();
            session.keep(&session.calibration_dir().join("exposure.json"), &bytes).unwrap();
        };
        keep(false);
        near(ratio("A", 100.0, 200.0), 2.0);
        keep(true);
        near(ratio("A", 100.0, 200.0), 2.0 * 1.02);
        let refused = ratio("B", 100.0, 200.0).unwrap_err().to_string();
        assert!(
            refused.contains("camera model is \"B\"") && refused.contains("calibrate exposure"),
            "{refused}"
        );
        near(ratio("B", 200.0, 200.0), 1.0);
        assert!(SessionScale::load(&session).unwrap().told().is_some());
    }

    #[test]
    fn the_rooms_light_scales_with_time_iso_and_aperture_and_not_with_what_nobody_told() {
        let on = Settings {
            shutter: Some(Seconds(1.0 / 60.0)),
            aperture: Some(FNumber(8.0)),
            iso: Some(Iso(200.0)),
            ..Settings::default()
        };
        let ratio = |off: &Settings| SessionScale::default().room_ratio(&on, off);
        // 1/60 and 1/125 are 2^-6 and 2^-7 s, f/8 and f/9 a third of a stop apart.
        let off = Settings { shutter: Some(Seconds(1.0 / 125.0)), iso: Some(Iso(100.0)), ..on.clone() };
        assert!((ratio(&off).unwrap() - 4.0).abs() < 1e-9);
        let closed = Settings { aperture: Some(FNumber(9.0)), ..off };
        assert!((ratio(&closed).unwrap() - 4.0 * 2f64.cbrt()).abs() < 1e-9);
        let untold = Settings::default();
        assert_eq!(SessionScale::default().room_ratio(&untold, &untold), Ok(1.0));
        assert_eq!(ratio(&Settings { shutter: None, ..on.clone() }), Err(RatioError::Lacking("shutter")));
    }

    #[test]
    fn another_lens_has_other_apertures_and_the_same_body() {
        let scale = SessionScale { record: Some(record(true)) };
        let through = |lens: &str, aperture: f64| Settings {
            lens: Some(lens.into()),
            aperture: Some(FNumber(aperture)),
            ..at("A", 100.0)
        };
        let ratio = |lens| scale.room_ratio(&through(lens, 9.0), &through(lens, 11.0));
        let nominal = 2f64.powf(2.0 / 3.0);
        near(ratio("50 mm"), nominal * 1.04);
        near(ratio("85 mm"), nominal);
        let table = scale.of(&through("85 mm", 9.0)).unwrap();
        let source = table.source(&through("85 mm", 9.0), &through("85 mm", 11.0));
        assert_eq!(source, ScaleSource::Nominal, "and it is told");
    }

    #[test]
    fn pairs_are_counted_by_where_their_ratios_come_from() {
        let frame = |iso: f64| {
            let settings = serde_json::to_value(at("A", iso)).unwrap();
            json!({ "file": "f", "original_name": "f", "bytes": 1, "blake3": "00", "settings": settings })
        };
        let pair = |name: &str, off: f64, on: f64| -> PairRecord {
            let (off, on) = (frame(off), frame(on));
            let told = json!({
                "number": 1, "name": name, "verdict": "accepted", "reasons": [], "off": off, "on": on,
            });
            serde_json::from_value(told).unwrap()
        };
        let calibration: FlashCalibration = serde_json::from_value(json!({
            "ring": { "inner_radius_m": 0.035, "outer_radius_m": 0.085 }, "radiance_dn": [1.0, 1.0, 1.0],
            "field": { "coefficients": [0.0, 0.0, 0.0] }, "noise": { "gain_dn": 0.3, "floor_dn2": 10.0 },
            "target_reflectance": 0.94, "iso": 100.0, "aperture": null, "cards": [], "residual_rms": 0.0, "misfit_rms": 0.0,
        }))
        .unwrap();
        // Alike; two steps; unlike the flash calibration; a label that was not measured.
        let pairs = [("a", 100.0, 100.0), ("b", 200.0, 100.0), ("c", 200.0, 200.0), ("d", 400.0, 100.0)];
        let pairs = pairs.map(|(name, off, on)| pair(name, off, on));
        let of = |scale: SessionScale| scale.ratios(pairs.iter(), &calibration);
        let ratios = of(SessionScale { record: Some(record(true)) });
        assert_eq!(
            (ratios.measured, ratios.by_labels),
            (vec!["b".into(), "c".into()], vec!["d".to_string()])
        );
        assert!(ratios.table.unwrap().good);
        assert_eq!(ratios.other_polariser, [""; 0]);
        let mut seen = record(true);
        seen.rig.lighting.polariser = Some(crate::pair::Polariser { angle_degrees: Some(30.0) });
        let ratios = of(SessionScale { record: Some(seen) });
        assert_eq!(ratios.other_polariser, ["a", "b", "c", "d"]);
        assert!(
            ratios.words().contains("ANOTHER POLARISER (at 30 degrees) than a, b, c, d"),
            "{}",
            ratios.words()
        );
        let ratios = of(SessionScale { record: Some(record(false)) });
        assert_eq!((ratios.measured.len(), ratios.by_labels.len()), (0, 3));
        assert!(!ratios.table.unwrap().good);
        assert_eq!(of(SessionScale::default()).table, None);
    }

    #[test]
    fn a_run_says_by_what_its_exposures_were_scaled() {
        let none = Ratios::default().words();
        assert!(none.contains("none was needed") && none.contains("no exposure table"), "{none}");
        let Record { measured, rig, .. } = record(true);
        let table = TableOrigin { measured, rig, good: true };
        let ratios = Ratios {
            measured: vec!["0001".into()],
            by_labels: vec!["0002".into()],
            table: Some(table),
            ..Ratios::default()
        };
        assert_eq!(
            ratios.words(),
            "by the measured exposure table: 0001; by what labels stand for: 0002; \
             calibration/exposure.json of 2026-11-23T10:00:00Z (A, 50 mm)"
        );
        let mut bad = ratios;
        bad.table.as_mut().unwrap().good = false;
        assert!(bad.words().contains("not used since its verdict is bad"));
    }
}
