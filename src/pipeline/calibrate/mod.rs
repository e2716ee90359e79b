//! Calibrations from raw files: the shots are read one by one, the fit is kept with all that it comes from.
//!
//! A calibration of the kind `levels` is `calibration/levels.json` (a [`Record`]), `calibration/levels.svg` (its
//! figure) and `calibration/levels/` (its shots, copied unless they lie in the session already). Shots that are taken
//! or sent in one by one wait in `calibration/waiting/` ([`waiting`]) until [`guided`] fits them. Whenever a record is kept,
//! `calibration/report.html` is written anew ([`report`]).

pub mod colour;
mod error;
pub mod exposure;
pub mod flat;
pub mod guided;
pub mod levels;
pub mod noise;
pub mod report;
pub mod take;
pub mod waiting;

pub use error::{RecordError, SeriesError};

use super::levels as sensor_levels;
use crate::calibration::{OtherRig, Record, Rig, SCHEMA, Shot, Verdict};
use crate::codec::raw::Photo;
use crate::export::chart::{self, Chart};
use crate::pair::{Lighting, PairRecord, Settings};
use crate::photometry::NoiseModel;
use crate::photometry::levels::MeasuredLevels;
use crate::progress::Progress;
use crate::session::{Session, store as disk, utc_now};
use serde::Serialize;
use serde::de::DeserializeOwned;
use std::io::ErrorKind;
use std::path::{Path, PathBuf};

/// A series of shots as they are read.
pub(super) struct Series<'a> {
    session: &'a Session,
    kind: &'static str,
    measured: MeasuredLevels,
    rig: Rig,
    /// Polariser and power are as somebody said, whatever was noted with the shots.
    lighting_said: bool,
    shots: Vec<Shot>,
    /// Where each shot was read from.
    paths: Vec<PathBuf>,
    /// What the file of each tells.
    settings: Vec<Settings>,
    /// What people must be told beside the fit's verdict.
    remarks: Vec<String>,
    /// A small picture of each, for the report; absent where there is nothing to see.
    pictures: Vec<Option<Vec<u8>>>,
    /// Figures beside the chart, by what their files' names end in.
    figures: Vec<(&'static str, Vec<u8>)>,
    /// Files beside the record, by name.
    beside: Vec<(String, Vec<u8>)>,
}

impl<'a> Series<'a> {
    /// A series without shots yet, to be kept as a calibration of this kind.
    pub(super) fn new(session: &'a Session, kind: &'static str) -> Result<Self, SeriesError> {
        // Levels are measured on the frames as they are, whatever an earlier measurement said.
        let measured = if kind == sensor_levels::KIND {
            MeasuredLevels::default()
        } else {
            sensor_levels::load(session)?
        };
        let rig = Rig { lighting: session.manifest().lighting, ..Rig::default() };
        Ok(Self {
            session,
            kind,
            measured,
            rig,
            lighting_said: false,
            shots: vec![],
            paths: vec![],
            settings: vec![],
            remarks: vec![],
            pictures: vec![],
            figures: vec![],
            beside: vec![],
        })
    }

    /// Says how the shots were lit and seen, where that is not what was noted with them, or what the session says.
    pub(super) fn lit(&mut self, lighting: Lighting) {
        self.rig.lighting = lighting;
        self.lighting_said = true;
    }

    /// The polariser and the power that were noted with a shot are those of the first. Sensor levels and noise know neither.
    fn same_lighting(&mut self, path: &Path) -> Result<(), OtherRig> {
        let sensor = [sensor_levels::KIND, noise::KIND].contains(&self.kind);
        let Some(noted) = waiting::lighting_beside(path).filter(|_| !(sensor || self.lighting_said)) else {
            return Ok(());
        };
        if self.shots.is_empty() {
            self.rig.lighting = noted;
            return Ok(());
        }
        self.rig.same_polariser(&noted, "the first shot")?;
        self.rig.same_power(&noted, "the first shot")
    }

    /// The rig as far as the shots told it.
    pub(super) fn rig(&self) -> &Rig {
        &self.rig
    }

    /// Reads the next shot; it must be of the same body and lens as those before. Its number in the series is the
    /// count of those.
    pub(super) fn read(&mut self, path: &Path) -> Result<Photo, SeriesError> {
        let bytes = std::fs::read(path).map_err(io(path))?;
        let photo = sensor_levels::decode(&bytes, &path.display().to_string(), &self.measured)?;
        let settings = &photo.settings;
        let other = |source| SeriesError::OtherRig { path: path.to_owned(), source };
        self.rig.same_lens(settings, "the first shot").map_err(other)?;
        self.same_lighting(path).map_err(other)?;
        let blake3 = disk::digest(&bytes);
        if let Some(at) = self.shots.iter().position(|shot| shot.blake3 == blake3) {
            return Err(SeriesError::Twice { path: path.to_owned(), other: self.paths[at].clone() });
        }
        let told = Rig::of(settings);
        let Rig { make, model, serial, lens, lighting } = std::mem::take(&mut self.rig);
        self.rig = Rig {
            make: make.or(told.make),
            model: model.or(told.model),
            serial: serial.or(told.serial),
            lens: lens.or(told.lens),
            lighting,
        };
        let (shutter, aperture, iso) = (settings.shutter, settings.aperture, settings.iso);
        let file = self.place(path, &blake3);
        self.shots.push(Shot { file, blake3, shutter, aperture, iso, left_out: None });
        self.paths.push(path.to_owned());
        self.pictures.push(report::shots::picture(&photo.mosaic).ok());
        self.settings.push(photo.settings.clone());
        Ok(photo)
    }

    /// Where a shot lies in the session: where it is, unless it waits there, or where its copy will be.
    fn place(&self, path: &Path, blake3: &str) -> String {
        let (root, own) = (self.session.path().canonicalize(), path.canonicalize());
        if let (Ok(root), Ok(own)) = (root, own)
            && let Ok(inside) = own.strip_prefix(root)
            && !waiting::is_waiting(inside)
        {
            return inside.to_string_lossy().into_owned();
        }
        copy_name(self.kind, &path.to_string_lossy(), blake3)
    }

    /// The shots read so far.
    pub(super) fn shots(&self) -> &[Shot] {
        &self.shots
    }

    /// Tells people of something beside the fit's verdict; once, however often it is said.
    pub(super) fn remark(&mut self, remark: String) {
        if !self.remarks.contains(&remark) {
            self.remarks.push(remark);
        }
    }

    /// The session's noise, where it was measured at the ISO of these settings and can be relied on.
    pub(super) fn noise(&mut self, settings: &Settings) -> Result<Option<NoiseModel>, SeriesError> {
        let noise::SessionNoise { model, remark, scaled } = noise::of(self.session, settings)?;
        // A frame's own noise is nearer to the truth than an upper bound.
        if scaled {
            return Ok(None);
        }
        remark.into_iter().for_each(|remark| self.remark(remark));
        Ok(model)
    }

    /// A figure to be kept beside the chart, in a file whose name ends in `ending`.
    pub(super) fn figure(&mut self, ending: &'static str, bytes: Vec<u8>) {
        self.figures.push((ending, bytes));
    }

    /// A file to be kept in `calibration/` with the record.
    pub(super) fn beside(&mut self, name: String, bytes: Vec<u8>) {
        self.beside.push((name, bytes));
    }

    /// Says why a shot is not used.
    pub(super) fn leave_out(&mut self, shot: usize, why: String) {
        self.shots[shot].left_out = Some(why);
    }

    /// The same of a shot of which nothing worse is known.
    pub(super) fn leave_out_too(&mut self, shot: usize, why: &str) {
        self.shots[shot].left_out.get_or_insert_with(|| why.to_owned());
    }

    /// Copies the shots into the session, keeps the fit and its figure, and writes the report; on the disk when this
    /// returns. It can be cancelled until the record is written, and then comes to its end.
    pub(super) fn keep<T: Serialize>(
        self,
        fit: T,
        mut verdict: Verdict,
        figure: &Chart,
        progress: &Progress,
    ) -> Result<Record<T>, SeriesError> {
        let Self {
            session,
            kind,
            measured: levels,
            rig,
            shots,
            paths,
            settings,
            remarks,
            pictures,
            mut figures,
            beside,
            ..
        } = self;
        verdict.sentences.extend(sensor_levels::remarks(&levels, &settings));
        verdict.sentences.extend(remarks);
        if !rig.tells_body() {
            verdict.sentences.push(UNTOLD.into());
        }
        let count = paths.len();
        for (done, (shot, path)) in shots.iter().zip(&paths).enumerate() {
            progress.check()?;
            progress.report("copying the shots", done, count);
            let copy = session.path().join(&shot.file);
            if path.canonicalize().ok() == copy.canonicalize().ok() && copy.is_file() {
                continue;
            }
            let bytes = std::fs::read(path).map_err(io(path))?;
            if disk::digest(&bytes) != shot.blake3 {
                return Err(SeriesError::Changed(path.clone()));
            }
            session.keep(&copy, &bytes)?;
        }
        let measured = utc_now();
        let software = concat!("unlit ", env!("CARGO_PKG_VERSION")).to_owned();
        let record = Record { schema: SCHEMA, measured, software, rig, shots, verdict, fit };
        figures.push(("svg", chart::picture(figure).into_bytes()));
        progress.check()?;
        let progress = &progress.unstoppable();
        for (name, bytes) in beside {
            session.keep(&session.calibration_dir().join(name), &bytes)?;
        }
        store(session, kind, &record, &figures)?;
        progress.report("copying the shots", count, count);
        for (shot, picture) in record.shots.iter().zip(pictures) {
            if let Some(picture) = picture {
                report::shots::keep(session, &shot.blake3, &picture)?;
            }
        }
        report::write(session, progress)?;
        Ok(record)
    }
}

/// Where the copy of a shot lies from the session's folder: told apart by content, called as it was.
fn copy_name(kind: &str, file: &str, blake3: &str) -> String {
    let mark = format!("{}_", blake3.get(..8).unwrap_or(blake3));
    let name = file.rsplit('/').next().unwrap_or(file);
    format!("calibration/{kind}/{mark}{}", name.strip_prefix(&mark).unwrap_or(name))
}

/// Makes a record the session's calibration of this kind, with its figures, each by what its file's name ends in. What the
/// session had of this kind goes to `calibration/former/`, under the date of its measurement, even if it cannot be read
/// any more: what was processed by it stays traceable. The record comes last: while it is the old one, all is as before.
fn store<T: Serialize>(
    session: &Session,
    kind: &str,
    record: &Record<T>,
    figures: &[(&str, Vec<u8>)],
) -> Result<(), SeriesError> {
    #[derive(Default, serde::Deserialize)]
    struct Dated {
        #[serde(default)]
        measured: String,
    }
    let path = file(session, kind);
    let bytes = serde_json::to_vec_pretty(record)
        .map_err(|e| RecordError::Damaged { path: path.clone(), reason: e.to_string() })?;
    let folder = session.calibration_dir();
    let there = |path: &Path| match std::fs::read(path) {
        Err(error) if error.kind() == ErrorKind::NotFound => Ok(None),
        other => other.map(Some).map_err(io(path)),
    };
    if let Some(former) = there(&path)?.filter(|former| *former != bytes) {
        let Dated { measured } = serde_json::from_slice(&former).unwrap_or_default();
        let date: String = measured.chars().filter(|c| c.is_ascii_alphanumeric() || *c == '-').collect();
        let name = format!("former/{kind}_{date}_{}", &disk::digest(&former)[..8]);
        for ending in ["svg", "png"] {
            if let Some(figure) = there(&folder.join(format!("{kind}.{ending}")))? {
                session.keep(&folder.join(format!("{name}.{ending}")), &figure)?;
            }
        }
        session.keep(&folder.join(format!("{name}.json")), &former)?;
    }
    for (ending, figure) in figures {
        session.keep(&folder.join(format!("{kind}.{ending}")), figure)?;
    }
    Ok(session.keep(&path, &bytes)?)
}

/// What is said of shots that do not tell their camera.
const UNTOLD: &str = "The shots do not tell which camera took them: nothing can keep this from being used for another body. \
                      Give raw files as the camera wrote them.";

/// Which calibrations were used for these pairs though nobody knows whether they are of the body that took them, a sentence
/// each. (Levels and noise that cannot be compared are not used; noise says so itself where it is the pair that does not
/// tell.)
pub(super) fn unchecked(session: &Session, pairs: &[&PairRecord]) -> Result<Vec<String>, RecordError> {
    let mut sentences = vec![];
    let silent: Vec<&str> =
        pairs.iter().filter(|pair| pair.on.settings.model.is_none()).map(|pair| pair.name.as_str()).collect();
    for kind in ["levels", "noise", "exposure", "flash"] {
        let Some(record) = load::<serde::de::IgnoredAny>(session, kind)? else { continue };
        let file = format!("calibration/{kind}.json");
        if !record.rig.tells_body() && kind == sensor_levels::KIND {
            sentences.push(format!("{file} IS NOT USED: its shots do not tell which camera took them."));
        } else if !record.rig.tells_body() {
            sentences.push(format!(
                "NOBODY CHECKED OF WHICH BODY {file} IS: its shots do not tell which camera took them, and it is taken to \
                 be the one that took the photos."
            ));
        } else if !silent.is_empty() && ["exposure", "flash"].contains(&kind) {
            sentences.push(format!(
                "NOBODY CHECKED WHETHER {file} IS OF THE BODY THAT TOOK {}: these photos do not tell their camera.",
                silent.join(", ")
            ));
        }
    }
    Ok(sentences)
}

/// A session's calibration of this kind; `None` if it was not made.
pub(super) fn load<T: DeserializeOwned>(
    session: &Session,
    kind: &str,
) -> Result<Option<Record<T>>, RecordError> {
    #[derive(serde::Deserialize)]
    struct Form {
        schema: Option<u32>,
    }
    let path = file(session, kind);
    let bytes = match std::fs::read(&path) {
        Err(error) if error.kind() == ErrorKind::NotFound => return Ok(None),
        other => other.map_err(|source| RecordError::Io { path: path.clone(), source })?,
    };
    let damaged = |e: serde_json::Error| RecordError::Damaged { path: path.clone(), reason: e.to_string() };
    let Form { schema } = serde_json::from_slice(&bytes).map_err(damaged)?;
    match schema {
        Some(SCHEMA) => {}
        Some(found) if found > SCHEMA => return Err(RecordError::TooNew { path, found }),
        _ => return Err(RecordError::Older(path)),
    }
    serde_json::from_slice(&bytes).map(Some).map_err(damaged)
}

pub(super) fn file(session: &Session, kind: &str) -> PathBuf {
    session.calibration_dir().join(format!("{kind}.json"))
}

fn io(path: &Path) -> impl FnOnce(std::io::Error) -> SeriesError + '_ {
    move |source| SeriesError::Io { path: path.to_owned(), source }
}

#[cfg(test)]
mod tests;
