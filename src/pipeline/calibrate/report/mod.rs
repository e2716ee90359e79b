//! `calibration/report.html`: every calibration of a session on one page, each figure with the shots it comes from.
//!
//! The page is made anew whenever a calibration is kept. A record that cannot be read does not keep the page from being
//! written: it is told in its place. Small pictures of the shots are made once (`shots`).

mod certificate;
mod colour;
mod exposure;
mod flash;
mod flat;
mod levels;
mod noise;
pub(super) mod shots;
mod steadiness;

use super::{RecordError, SeriesError, load};
use crate::calibration::{Record, Rig};
use crate::export::calibration_report::{CalibrationReport, Line, Mark, Part, Piece, Row, Table, html};
use crate::export::report::Block;
use crate::pipeline::report::{fact, moment, or_untold};
use crate::progress::Progress;
use crate::session::{Session, utc_now};
use serde::de::DeserializeOwned;
use std::path::PathBuf;

/// A calibration that there can be.
struct Kind {
    /// As its files are named, and the part in links.
    id: &'static str,
    /// Of its shots' labels.
    letter: char,
    /// For people.
    name: &'static str,
    /// What is used where it was not made.
    instead: &'static str,
}

/// What one calibration has to say beyond what all records have.
#[derive(Default)]
struct Told {
    /// Of what it is true, beside the body.
    valid_for: Vec<String>,
    /// Names and values.
    facts: Vec<(String, String)>,
    /// Figures and tables.
    pieces: Vec<Piece>,
    /// What each shot was for; shorter if no more is known.
    roles: Vec<String>,
}

const LEVELS: Kind = Kind {
    id: "levels",
    letter: 'L',
    name: "Sensor levels",
    instead: "the masked border of each frame, the file's tags, or what is published of the body",
};
const NOISE: Kind = Kind {
    id: "noise",
    letter: 'N',
    name: "Noise and linearity",
    instead: "the noise that the flash's card shots show; the sensor is taken to be linear",
};
const EXPOSURE: Kind = Kind {
    id: "exposure",
    letter: 'E',
    name: "Exposure table",
    instead: "what the labels of ISO, shutter and aperture stand for, 2^(k/3)",
};
const FLAT: Kind = Kind {
    id: "flat",
    letter: 'V',
    name: "Flat field",
    instead: "the product of vignetting and the flash's lobe, as the card shots tell it",
};
const FLASH: Kind = Kind {
    id: "flash",
    letter: 'F',
    name: "Flash",
    instead: "nothing: pairs cannot be processed without it",
};
const STEADINESS: Kind = Kind {
    id: "steadiness",
    letter: 'R',
    name: "Repeatability of the flash",
    instead: "the scatter of the card shots, or the usual 0.29 %",
};
const COLOUR: Kind = Kind {
    id: "colour",
    letter: 'C',
    name: "Colour",
    instead: "the maker's matrix of the body, where one is known; else colours stay the camera's own",
};
const CERTIFICATE: Kind = Kind {
    id: "certificate",
    letter: 'K',
    name: "Certificate of the model",
    instead: "nothing: the reflectance was not compared with known patches",
};

/// Where the report is kept.
pub fn file(session: &Session) -> PathBuf {
    session.calibration_dir().join("report.html")
}

/// Writes the report of all calibrations that the session has; on the disk when this returns.
pub fn write(session: &Session, progress: &Progress) -> Result<PathBuf, SeriesError> {
    let mut page = Page { session, progress, summary: vec![], parts: vec![], rigs: vec![] };
    page.add(&LEVELS, levels::tell)?;
    page.add(&NOISE, noise::tell)?;
    page.add(&EXPOSURE, exposure::tell)?;
    page.add(&FLAT, flat::tell)?;
    page.add(&FLASH, flash::tell)?;
    page.add(&STEADINESS, steadiness::tell)?;
    page.add_controllers_series();
    page.add(&COLOUR, colour::tell)?;
    page.add_certificate();
    let path = file(session);
    session.keep(&path, html(&page.report()).as_bytes())?;
    Ok(path)
}

struct Page<'a> {
    session: &'a Session,
    progress: &'a Progress,
    summary: Vec<Line>,
    parts: Vec<Part>,
    rigs: Vec<Rig>,
}

impl Page<'_> {
    fn add<T: DeserializeOwned>(
        &mut self,
        kind: &Kind,
        tell: fn(&Session, &Record<T>) -> Told,
    ) -> Result<(), SeriesError> {
        match load::<T>(self.session, kind.id) {
            Ok(Some(record)) => self.measured(kind, &record, tell(self.session, &record)),
            Ok(None) => {
                self.missing(kind);
                Ok(())
            }
            Err(error) => {
                self.unreadable(kind, &error);
                Ok(())
            }
        }
    }

    fn measured<T>(&mut self, kind: &Kind, record: &Record<T>, told: Told) -> Result<(), SeriesError> {
        let mark = if record.verdict.good { Mark::Good } else { Mark::Bad };
        let mut valid = vec![body(&record.rig)];
        valid.extend(told.valid_for);
        let lighting = &record.rig.lighting;
        valid.extend(lighting.polariser.map(|polariser| format!("polariser {polariser}")));
        valid.extend(lighting.flash_power.map(|power| format!("flash power {power}")));
        let mut facts = vec![
            fact("True of", valid.join(", ")),
            fact("Measured", format!("{} UTC, {}", moment(&record.measured), record.software)),
        ];
        facts.extend(told.facts);
        let shots = shots::rows(self.session, kind.name, &record.shots, &told.roles, self.progress)?;
        self.summary.push(Line {
            name: kind.name,
            part: Some(kind.id),
            mark,
            words: record.verdict.sentences.first().cloned().unwrap_or_default(),
            valid_for: valid.join(", "),
            measured: moment(&record.measured),
        });
        self.parts.push(Part {
            id: kind.id,
            letter: kind.letter,
            heading: kind.name,
            mark,
            sentences: record.verdict.sentences.clone(),
            facts,
            pieces: told.pieces,
            shots,
        });
        if !self.rigs.contains(&record.rig) {
            self.rigs.push(record.rig.clone());
        }
        Ok(())
    }

    fn missing(&mut self, kind: &Kind) {
        let words = format!("in its place: {}.", kind.instead);
        self.summary.push(line(kind, Mark::Missing, words));
    }

    fn unreadable(&mut self, kind: &Kind, error: &RecordError) {
        self.summary.push(line(kind, Mark::Bad, error.to_string()));
    }

    fn report(self) -> CalibrationReport {
        let manifest = self.session.manifest();
        let software = concat!("unlit ", env!("CARGO_PKG_VERSION"));
        let rigs: Vec<String> = self
            .rigs
            .iter()
            .map(|rig| match &rig.lens {
                Some(lens) => format!("{}, {lens}", body(rig)),
                None => format!("{}, lens not told", body(rig)),
            })
            .collect();
        CalibrationReport {
            title: format!("Calibration of {}", manifest.name),
            subtitle: format!(
                "Written {} UTC by {software}; session made {} UTC",
                moment(&utc_now()),
                moment(&manifest.created)
            ),
            facts: vec![
                fact("Session", manifest.name),
                fact(if rigs.len() > 1 { "Rigs" } else { "Rig" }, or_untold(rigs.join("; "))),
                fact("Intervals", "95 % wherever \u{b1} or two ends are given".into()),
            ],
            summary: self.summary,
            parts: self.parts,
        }
    }
}

/// A calibration that has no part of its own.
fn line(kind: &Kind, mark: Mark, words: String) -> Line {
    Line { name: kind.name, part: None, mark, words, valid_for: String::new(), measured: String::new() }
}

/// Maker, model and serial number. Most models name their maker.
fn body(rig: &Rig) -> String {
    let named = |make: &&String| rig.model.as_ref().is_none_or(|model| !model.starts_with(make.as_str()));
    let names = [rig.make.as_ref().filter(named), rig.model.as_ref()];
    let name: Vec<&str> = names.into_iter().flatten().map(|name| name.trim()).collect();
    match (&rig.serial, or_untold(name.join(" "))) {
        (Some(serial), name) => format!("{name}, serial {}", serial.trim()),
        (None, name) => format!("{name}, serial not told"),
    }
}

/// Numbers of the shots that were used and of which something holds.
fn used<T>(record: &Record<T>, mut wanted: impl FnMut(usize) -> bool) -> Vec<usize> {
    let shots = record.shots.iter().enumerate().filter(|(_, shot)| shot.left_out.is_none());
    shots.map(|(number, _)| number).filter(|&number| wanted(number)).collect()
}

/// The largest picture that goes into the page, bytes.
const LARGEST: usize = 4 << 20;

/// A picture of `calibration/` that was drawn when the calibration was made, of which no record tells enough to draw it
/// again.
fn picture(session: &Session, name: &str, kind: &'static str, caption: &str) -> Piece {
    let why = match std::fs::read(session.calibration_dir().join(name)) {
        Ok(bytes) if bytes.len() <= LARGEST => {
            return Piece::Picture { kind, bytes, caption: caption.to_owned() };
        }
        Ok(_) => "it is too large for this page".to_owned(),
        Err(error) => error.to_string(),
    };
    Piece::Block(Block::Text(format!("Not shown: calibration/{name} ({why}). {caption}")))
}

/// A table of single figures.
fn figures(caption: &str, rows: Vec<Row>) -> Piece {
    let head = head(&["Figure", "Value", "Unit", "95 % interval"]);
    Piece::Table(Table { caption: caption.to_owned(), head, rows })
}

/// Headings of a table.
fn head(words: &[&str]) -> Vec<String> {
    words.iter().map(|&word| word.to_owned()).collect()
}

/// One of its rows.
fn figure(name: &str, value: String, unit: &str, interval: Option<String>, from: &[usize]) -> Row {
    let cells = vec![name.to_owned(), value, unit.to_owned(), interval.unwrap_or_default()];
    Row { cells, from: from.to_vec() }
}

/// Both ends of an interval.
fn ends([low, high]: [f64; 2], digits: usize) -> String {
    format!("{low:.digits$} to {high:.digits$}")
}

/// A number, or a dash in place of one.
fn or_dash(value: Option<f64>, digits: usize) -> String {
    value.map_or_else(|| "-".to_owned(), |value| format!("{value:.digits$}"))
}

/// Half of a 95 % interval over its standard error.
pub(in crate::pipeline) const Z95: f64 = 1.96;
