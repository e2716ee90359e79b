//! Camera settings out of a file's EXIF (CIPA DC-008) and, for Canon, its maker notes.
//!
//! Takes a raw file's bytes (CR2, NEF, ARW, DNG and what else is built like a TIFF; CR3), gives [`Settings`];
//! whatever the file does not tell, or tells as zero or blank, is absent. Labels stay labels: 1/125 comes back as
//! 0.008 s. Only the directories are read, which are few kilobytes of a long file, and a file that ends early tells
//! what is still there.

use super::canon;
use super::raw::boxes;
use super::raw::tiffdir::{self, Directory, Tiff};
use crate::pair::Settings;
use crate::units::{FNumber, Iso, Seconds};

mod tag {
    pub(super) const MAKE: u16 = 271;
    pub(super) const MODEL: u16 = 272;
    pub(super) const DATE_TIME: u16 = 306;
    pub(super) const EXPOSURE_TIME: u16 = 33434;
    pub(super) const F_NUMBER: u16 = 33437;
    pub(super) const EXPOSURE_PROGRAM: u16 = 34850;
    pub(super) const SENSITIVITY: u16 = 34855;
    pub(super) const STANDARD_OUTPUT_SENSITIVITY: u16 = 34865;
    pub(super) const RECOMMENDED_EXPOSURE_INDEX: u16 = 34866;
    pub(super) const ISO_SPEED: u16 = 34867;
    pub(super) const DATE_TIME_ORIGINAL: u16 = 36867;
    pub(super) const FOCAL_LENGTH: u16 = 37386;
    pub(super) const WHITE_BALANCE: u16 = 41987;
    pub(super) const BODY_SERIAL: u16 = 42033;
    pub(super) const LENS_MODEL: u16 = 42036;
    pub(super) const DNG_SERIAL: u16 = 50735;
}

/// Settings of a raw file; all absent if its directories cannot be read.
pub fn settings(bytes: &[u8]) -> Settings {
    if boxes::is_cr3(bytes) {
        return of_cr3(bytes);
    }
    if !tiffdir::is_tiff(bytes) {
        return Settings::default();
    }
    of_tiff(&tiffdir::survey(bytes).0)
}

/// Settings of a file whose directories have been walked.
pub(super) fn of_tiff(tiff: &Tiff) -> Settings {
    let mut settings = from_directories(&tiff.directories);
    if let (Some("Canon"), Some(notes)) = (settings.make.as_deref(), tiff.maker_notes.first()) {
        canon::add(&mut settings, notes);
    }
    settings
}

/// A CR3 keeps the first directory, EXIF and the maker's notes as three small TIFF files.
fn of_cr3(bytes: &[u8]) -> Settings {
    let found = boxes::blocks(bytes);
    fn walked(block: Option<&[u8]>) -> Option<Tiff<'_>> {
        block.filter(|b| tiffdir::is_tiff(b)).map(|b| tiffdir::survey(b).0)
    }
    let (main, exif, notes) = (walked(found.main), walked(found.exif), walked(found.maker_notes));
    let directories: Vec<Directory> =
        [main, exif].into_iter().flatten().flat_map(|tiff| tiff.directories).collect();
    let mut settings = from_directories(&directories);
    if let Some(notes) = notes.as_ref().and_then(|tiff| tiff.directories.first()) {
        canon::add(&mut settings, notes);
    }
    settings
}

fn from_directories(all: &[Directory]) -> Settings {
    Settings {
        make: text(all, tag::MAKE),
        model: text(all, tag::MODEL),
        serial: text(all, tag::BODY_SERIAL).or_else(|| text(all, tag::DNG_SERIAL)),
        lens: text(all, tag::LENS_MODEL),
        shutter: positive(all, tag::EXPOSURE_TIME).map(Seconds),
        aperture: positive(all, tag::F_NUMBER).map(FNumber),
        iso: iso(all).map(Iso),
        focal_length_mm: positive(all, tag::FOCAL_LENGTH),
        exposure_program: number(all, tag::EXPOSURE_PROGRAM).and_then(program_word),
        white_balance: number(all, tag::WHITE_BALANCE).and_then(white_balance_word),
        taken_at: text(all, tag::DATE_TIME_ORIGINAL)
            .and_then(|t| date(&t))
            .or_else(|| text(all, tag::DATE_TIME).and_then(|t| date(&t))),
        ..Settings::default()
    }
}

/// The tag's string in the first directory that has it, trimmed; `None` when blank.
fn text(all: &[Directory], tag: u16) -> Option<String> {
    let line = all.iter().find_map(|d| d.ascii(tag))?;
    let line = String::from_utf8_lossy(line);
    let line = line.trim_matches(|c: char| c.is_whitespace() || c == '\0');
    (!line.is_empty()).then(|| line.to_owned())
}

/// The tag's first value as a number.
fn number(all: &[Directory], tag: u16) -> Option<f64> {
    all.iter().find_map(|d| d.numbers(tag)?.first().copied())
}

fn positive(all: &[Directory], tag: u16) -> Option<f64> {
    number(all, tag).filter(|v| v.is_finite() && *v > 0.0)
}

/// ISO label. The 16-bit tag holds 65535 when the value does not fit; then the 32-bit ones tell.
fn iso(all: &[Directory]) -> Option<f64> {
    positive(all, tag::SENSITIVITY)
        .filter(|v| *v < 65535.0)
        .or_else(|| positive(all, tag::RECOMMENDED_EXPOSURE_INDEX))
        .or_else(|| positive(all, tag::STANDARD_OUTPUT_SENSITIVITY))
        .or_else(|| positive(all, tag::ISO_SPEED))
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

pub(super) fn program_word(value: f64) -> Option<String> {
    PROGRAMS.get((value as usize).checked_sub(1)?).map(|w| (*w).to_owned())
}

pub(super) fn white_balance_word(value: f64) -> Option<String> {
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

/// `YYYY:MM:DD HH:MM:SS` as `YYYY-MM-DDTHH:MM:SS`; `None` for anything else.
pub(super) fn date(exif_date: &str) -> Option<String> {
    let shape = b"0000:00:00 00:00:00";
    let fits = exif_date.len() == shape.len()
        && exif_date.bytes().zip(shape).all(|(is, &like)| match like {
            b'0' => is.is_ascii_digit(),
            separator => is == separator,
        });
    let (date, time) = exif_date.split_once(' ').filter(|_| fits)?;
    // Cameras whose clock was never set write zeros.
    (!date.starts_with("0000")).then(|| format!("{}T{time}", date.replace(':', "-")))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_date_is_turned_round_and_what_is_none_is_absent() {
        assert_eq!(date("2026:05:04 10:00:04").as_deref(), Some("2026-05-04T10:00:04"));
        for none in
            ["", "0000:00:00 00:00:00", "    :  :     :  :  ", "2026-05-04 10:00:04", "2026:05:04 10:00"]
        {
            assert_eq!(date(none), None, "{none}");
        }
    }

    #[test]
    fn settings_of_no_raw_at_all_are_absent() {
        assert_eq!(settings(b"not a raw"), Settings::default());
        assert_eq!(settings(b""), Settings::default());
        assert_eq!(settings(b"II*\0"), Settings::default());
    }
}
