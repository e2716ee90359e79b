//! Calibrations from the shots that wait for them, and how each of a session's calibrations stands.

use super::colour::{ChartShot, ColourCalibrationError};
use super::exposure::ExposureError;
use super::flat::FlatError;
use super::levels::LevelsError;
use super::noise::{NoiseError, NoiseFrames};
use super::waiting::{self, WaitingError};
use super::{RecordError, colour, exposure, flat, levels, load, noise};
use crate::calibration::colour::ChartKind;
use crate::calibration::guide::{Kind, Role};
use crate::calibration::{Record, Rig, Shot, Verdict};
use crate::pair::Lighting;
use crate::pipeline::steadiness::{self, SteadinessError, SteadyFile};
use crate::progress::Progress;
use crate::session::Session;
use crate::units::{FNumber, Iso};
use serde::{Deserialize, Serialize};
use serde_json::{Map, Value};

/// What is to be fitted, with all that has to be known beside the shots.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(tag = "kind", rename_all = "snake_case")]
pub enum FitOrder {
    /// Sensor levels.
    Levels,
    /// Noise and linearity.
    Noise {
        /// Stops of light from one level to the next, if the light was changed.
        stops: Option<f64>,
    },
    /// Exposure table.
    Exposure,
    /// Vignetting.
    Flat,
    /// Repeatability of the flash.
    Steadiness,
    /// Colour.
    Colour {
        /// Which chart it is; without it whichever fits best.
        chart: Option<ChartKind>,
        /// Outer corners of the four corner patches, pixels; without them they are found.
        corners_px: Option<[[f64; 2]; 4]>,
    },
}

impl FitOrder {
    /// Of what.
    pub fn kind(&self) -> Kind {
        match self {
            FitOrder::Levels => Kind::Levels,
            FitOrder::Noise { .. } => Kind::Noise,
            FitOrder::Exposure => Kind::Exposure,
            FitOrder::Flat => Kind::Flat,
            FitOrder::Steadiness => Kind::Steadiness,
            FitOrder::Colour { .. } => Kind::Colour,
        }
    }
}

/// Why the shots gave no calibration.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum GuidedError {
    /// The waiting shots.
    #[error(transparent)]
    Waiting(#[from] WaitingError),
    /// Shots of a role are missing, or there are too many.
    #[error("{0}")]
    Shots(&'static str),
    /// Sensor levels.
    #[error(transparent)]
    Levels(#[from] LevelsError),
    /// Noise and linearity.
    #[error(transparent)]
    Noise(#[from] NoiseError),
    /// Exposure table.
    #[error(transparent)]
    Exposure(#[from] ExposureError),
    /// Vignetting.
    #[error(transparent)]
    Flat(#[from] FlatError),
    /// Repeatability of the flash.
    #[error(transparent)]
    Steadiness(#[from] SteadinessError),
    /// Colour.
    #[error(transparent)]
    Colour(#[from] ColourCalibrationError),
    /// The record has no JSON.
    #[error("the record cannot be written down: {0}")]
    Json(#[from] serde_json::Error),
}

/// Fits a calibration to the shots that wait for it and gives its record. If it can be relied on, they do not wait any
/// more.
pub fn fit(session: &Session, order: &FitOrder, progress: &Progress) -> Result<Value, GuidedError> {
    let kind = order.kind();
    let shots = waiting::list(session, kind)?;
    let of = |role| waiting::frames(session, kind, &shots, role);
    let (record, good) = match order {
        FitOrder::Levels => told(levels::calibrate(session, &of(Role::Dark)?, &of(Role::Blown)?, progress)?)?,
        FitOrder::Noise { stops } => {
            let (lit, dark) = (of(Role::Even)?, of(Role::Dark)?);
            let frames = NoiseFrames { lit: &lit, dark: &dark, stops: *stops };
            told(noise::calibrate(session, frames, progress)?)?
        }
        FitOrder::Exposure => told(exposure::calibrate(session, &of(Role::Step)?, progress)?)?,
        FitOrder::Flat => told(flat::calibrate(session, &of(Role::Even)?, progress)?)?,
        FitOrder::Steadiness => {
            let energies = shots.iter().filter(|shot| shot.role == Role::Lit).map(|shot| shot.energy_counts);
            let frames = of(Role::Lit)?.into_iter().zip(energies);
            let files: Vec<SteadyFile> =
                frames.map(|(frame, energy_counts)| SteadyFile { frame, energy_counts }).collect();
            told(steadiness::calibrate(session, &files, progress)?)?
        }
        FitOrder::Colour { chart, corners_px } => {
            let (mut on, mut off) = (of(Role::Chart)?, of(Role::Room)?);
            if on.len() != 1 || off.len() > 1 {
                return Err(GuidedError::Shots(
                    "colour takes one frame of the chart lit by the flash, and one without flash at most; remove the others",
                ));
            }
            let shot = ChartShot { on: on.remove(0), off: off.pop(), chart: *chart, corners: *corners_px };
            told(colour::calibrate(session, &shot, progress)?)?
        }
    };
    if good {
        settle(session, kind, shots.iter().map(|shot| shot.number))?;
    }
    Ok(record)
}

fn told<T: Serialize>(record: Record<T>) -> Result<(Value, bool), serde_json::Error> {
    Ok((serde_json::to_value(&record)?, record.verdict.good))
}

/// These shots do not wait any more: a record has their copies.
pub fn settle(
    session: &Session,
    kind: Kind,
    numbers: impl IntoIterator<Item = u32>,
) -> Result<(), WaitingError> {
    for number in numbers {
        match waiting::remove(session, kind, number) {
            // Somebody removed it meanwhile.
            Ok(()) | Err(WaitingError::None { .. }) => {}
            Err(error) => return Err(error),
        }
    }
    Ok(())
}

/// A session's calibration of this kind, whatever it holds; `None` if it was not made.
pub fn record(session: &Session, kind: Kind) -> Result<Option<Record<Map<String, Value>>>, RecordError> {
    load(session, kind.name())
}

/// Of what a calibration is true. What does not limit it, or is not known, is not there.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Validity {
    /// Body and, where it matters, lens.
    pub rig: Rig,
    /// Apertures of its shots, where they limit it.
    pub apertures: Vec<FNumber>,
    /// Sensitivities of its shots, where they limit it.
    pub isos: Vec<Iso>,
}

impl Validity {
    /// Of a record of this kind.
    pub fn of<T>(kind: Kind, record: &Record<T>) -> Self {
        let used = || record.shots.iter().filter(|shot| shot.left_out.is_none());
        let lens = record.rig.lens.clone().filter(|_| kind.holds_for_lens());
        let lighting = Lighting {
            polariser: record.rig.lighting.polariser.filter(|_| kind.holds_for_polariser()),
            flash_power: record.rig.lighting.flash_power.filter(|_| kind.holds_for_power()),
        };
        Self {
            rig: Rig { lens, lighting, ..record.rig.clone() },
            apertures: distinct(used().filter(|_| kind.holds_for_aperture()), |shot| shot.aperture, |n| n.0),
            isos: distinct(used().filter(|_| kind.holds_for_iso()), |shot| shot.iso, |iso| iso.0),
        }
    }

    /// In one sentence.
    pub fn words(&self) -> String {
        let Rig { make, model, serial, lens, .. } = &self.rig;
        let body = match (make, model) {
            (Some(make), Some(model)) if !model.starts_with(make.as_str()) => format!("{make} {model}"),
            (_, Some(model)) => model.clone(),
            _ => "the body that took the shots".into(),
        };
        let mut parts =
            vec![serial.as_ref().map_or(body.clone(), |serial| format!("{body}, number {serial}"))];
        parts.extend(lens.clone());
        let joined = |values: Vec<String>| values.join(", ");
        if !self.apertures.is_empty() {
            parts.push(joined(self.apertures.iter().map(ToString::to_string).collect()));
        }
        if !self.isos.is_empty() {
            parts.push(joined(self.isos.iter().map(ToString::to_string).collect()));
        }
        let lighting = &self.rig.lighting;
        parts.extend(lighting.polariser.map(|polariser| format!("polariser {polariser}")));
        parts.extend(lighting.flash_power.map(|power| format!("flash power {power}")));
        format!("True of {}.", parts.join("; "))
    }
}

fn distinct<'a, T: Copy>(
    shots: impl Iterator<Item = &'a Shot>,
    of: fn(&Shot) -> Option<T>,
    value: fn(T) -> f64,
) -> Vec<T> {
    let mut found: Vec<T> = shots.filter_map(of).collect();
    found.sort_by(|a, b| value(*a).total_cmp(&value(*b)));
    found.dedup_by(|a, b| value(*a) == value(*b));
    found
}

/// What was measured, in short.
#[derive(Clone, Debug, PartialEq)]
pub struct Measured {
    /// When, UTC.
    pub when: String,
    /// What to make of it.
    pub verdict: Verdict,
    /// Of what it is true.
    pub validity: Validity,
    /// Its files, from the session's folder: the record, the figure and whatever else there is.
    pub files: Vec<String>,
    /// BLAKE3 of its shots.
    pub shots: Vec<String>,
}

/// What was measured of a kind, in short; `None` if nothing was.
pub fn measured(session: &Session, kind: Kind) -> Result<Option<Measured>, RecordError> {
    let Some(record) = record(session, kind)? else { return Ok(None) };
    let name = kind.name();
    let files = ["json", "svg", "png"].map(|extension| format!("calibration/{name}.{extension}"));
    let there = |path: &String| session.path().join(path).is_file();
    let report = Some("calibration/report.html".to_owned());
    Ok(Some(Measured {
        validity: Validity::of(kind, &record),
        when: record.measured,
        verdict: record.verdict,
        files: files.into_iter().chain(report).filter(there).collect(),
        shots: record.shots.into_iter().map(|shot| shot.blake3).collect(),
    }))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::calibration::SCHEMA;
    use crate::pair::{Polariser, Settings};

    #[test]
    fn what_limits_a_calibration_depends_on_its_kind() {
        let text = |t: &str| Some(t.to_owned());
        let settings = Settings {
            make: text("Canon"),
            model: text("Canon EOS 5DS"),
            serial: text("17"),
            lens: text("50 mm"),
            ..Settings::default()
        };
        let shot = |iso: f64, left_out: Option<String>| Shot {
            file: String::new(),
            blake3: String::new(),
            shutter: None,
            aperture: Some(FNumber(8.0)),
            iso: Some(Iso(iso)),
            left_out,
        };
        let record = Record {
            schema: SCHEMA,
            measured: String::new(),
            software: String::new(),
            rig: Rig::of(&settings),
            shots: vec![shot(400.0, None), shot(100.0, None), shot(400.0, None), shot(800.0, text("clips"))],
            verdict: Verdict { good: true, sentences: vec![] },
            fit: (),
        };
        let seen =
            Lighting { polariser: Some(Polariser { angle_degrees: Some(30.0) }), flash_power: Some(0.25) };
        let lit = Record { rig: Rig { lighting: seen, ..record.rig.clone() }, ..record.clone() };
        let words = |kind| Validity::of(kind, &lit).words();
        assert_eq!(words(Kind::Levels), "True of Canon EOS 5DS, number 17; ISO 100, ISO 400.");
        assert_eq!(words(Kind::Colour), "True of Canon EOS 5DS, number 17; polariser at 30 degrees.");
        assert_eq!(
            words(Kind::Steadiness),
            "True of Canon EOS 5DS, number 17; polariser at 30 degrees; flash power 0.25."
        );
        let words = |kind| Validity::of(kind, &record).words();
        assert_eq!(words(Kind::Levels), "True of Canon EOS 5DS, number 17; ISO 100, ISO 400.");
        assert_eq!(words(Kind::Flat), "True of Canon EOS 5DS, number 17; 50 mm; f/8.");
        assert_eq!(words(Kind::Exposure), "True of Canon EOS 5DS, number 17; 50 mm.");
        assert_eq!(words(Kind::Colour), "True of Canon EOS 5DS, number 17.");
    }
}
