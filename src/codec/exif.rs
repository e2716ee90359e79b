//! Camera settings out of a file's EXIF (CIPA DC-008), for CR2, NEF, ARW, DNG and JPEG.
//!
//! Takes a file's bytes, gives [`Settings`]; whatever the file does not tell, or tells as zero or blank,
//! is absent. Labels stay labels: 1/125 comes back as 0.008 s.

use crate::pair::Settings;
use crate::units::{FNumber, Iso, Seconds};
use exif::{Context, Exif, In, Tag, Value};

/// DNG's CameraSerialNumber, for files whose EXIF has none.
const DNG_SERIAL: Tag = Tag(Context::Tiff, 50735);

/// Settings of a TIFF-like file (CR2, NEF, ARW, DNG); all absent if its EXIF cannot be read.
pub fn settings(bytes: &[u8]) -> Settings {
    let mut reader = exif::Reader::new();
    reader.continue_on_error(true);
    match reader.read_raw(bytes.to_vec()) {
        Ok(exif) => from_exif(&exif),
        Err(exif::Error::PartialResult(partial)) => from_exif(&partial.into_inner().0),
        Err(_) => Settings::default(),
    }
}

fn from_exif(exif: &Exif) -> Settings {
    Settings {
        make: text(exif, Tag::Make),
        model: text(exif, Tag::Model),
        serial: text(exif, Tag::BodySerialNumber).or_else(|| text(exif, DNG_SERIAL)),
        lens: text(exif, Tag::LensModel),
        shutter: positive(exif, Tag::ExposureTime).map(Seconds),
        aperture: positive(exif, Tag::FNumber).map(FNumber),
        iso: iso(exif).map(Iso),
        focal_length_mm: positive(exif, Tag::FocalLength),
        exposure_program: number(exif, Tag::ExposureProgram).and_then(program_word),
        white_balance: number(exif, Tag::WhiteBalance).and_then(white_balance_word),
        taken_at: text(exif, Tag::DateTimeOriginal)
            .and_then(|t| date(&t))
            .or_else(|| text(exif, Tag::DateTime).and_then(|t| date(&t))),
    }
}

/// The tag's first string, trimmed; `None` when blank.
fn text(exif: &Exif, tag: Tag) -> Option<String> {
    let Value::Ascii(lines) = &exif.get_field(tag, In::PRIMARY)?.value else { return None };
    let line = lines.iter().find(|l| !l.is_empty())?;
    let line = String::from_utf8_lossy(line);
    let line = line.trim_matches(|c: char| c.is_whitespace() || c == '\0');
    (!line.is_empty()).then(|| line.to_owned())
}

/// The tag's first value as a number.
fn number(exif: &Exif, tag: Tag) -> Option<f64> {
    match &exif.get_field(tag, In::PRIMARY)?.value {
        Value::Rational(v) => v.first().map(exif::Rational::to_f64),
        Value::SRational(v) => v.first().map(exif::SRational::to_f64),
        other => other.get_uint(0).map(f64::from),
    }
}

fn positive(exif: &Exif, tag: Tag) -> Option<f64> {
    number(exif, tag).filter(|v| v.is_finite() && *v > 0.0)
}

/// ISO label. The 16-bit tag holds 65535 when the value does not fit; then the 32-bit ones tell.
fn iso(exif: &Exif) -> Option<f64> {
    positive(exif, Tag::PhotographicSensitivity)
        .filter(|v| *v < 65535.0)
        .or_else(|| positive(exif, Tag::RecommendedExposureIndex))
        .or_else(|| positive(exif, Tag::StandardOutputSensitivity))
        .or_else(|| positive(exif, Tag::ISOSpeed))
}

/// EXIF's words for ExposureProgram, from 1.
const PROGRAMS: [&str; 8] = [
    "Manual",
    "Normal program",
    "Aperture priority",
    "Shutter priority",
    "Creative program",
    "Action program",
    "Portrait mode",
    "Landscape mode",
];
/// EXIF's words for WhiteBalance, from 0.
const WHITE_BALANCES: [&str; 2] = ["Auto", "Manual"];

fn program_word(value: f64) -> Option<String> {
    PROGRAMS.get((value as usize).checked_sub(1)?).map(|w| (*w).to_owned())
}

fn white_balance_word(value: f64) -> Option<String> {
    WHITE_BALANCES.get(value as usize).map(|w| (*w).to_owned())
}

/// EXIF's number for a word of [`Settings::exposure_program`].
pub(super) fn program_number(word: &str) -> Option<u16> {
    PROGRAMS.iter().position(|w| *w == word).map(|i| i as u16 + 1)
}

/// EXIF's number for a word of [`Settings::white_balance`].
pub(super) fn white_balance_number(word: &str) -> Option<u16> {
    WHITE_BALANCES.iter().position(|w| *w == word).map(|i| i as u16)
}

/// `YYYY:MM:DD HH:MM:SS` as `YYYY-MM-DDTHH:MM:SS`.
fn date(exif_date: &str) -> Option<String> {
    let at = exif::DateTime::from_ascii(exif_date.as_bytes()).ok()?;
    Some(format!(
        "{:04}-{:02}-{:02}T{:02}:{:02}:{:02}",
        at.year, at.month, at.day, at.hour, at.minute, at.second
    ))
}
