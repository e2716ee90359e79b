//! Raw files read with the best levels known.
//!
//! Everything that judges or processes frames reads them through [`read`] or [`decode`]: the decoder's levels are then
//! replaced by the session's `calibration/levels.json` (`unlit calibrate levels`), where it is of the same body and ISO,
//! or by what [`crate::photometry::levels`] has for the body. A frame of another body than the session's levels is refused;
//! [`remark`] says why they do not count for a frame of their own body.

use super::calibrate::{self, RecordError};
use crate::calibration::LevelsFit;
use crate::codec::raw::{self, Photo, RawError};
use crate::pair::Settings;
use crate::photometry::levels::{self, MeasuredLevels, Origin, Unmeasured};
use crate::session::Session;
use crate::units::Iso;
use std::path::Path;

/// The calibration's name: `calibration/levels.json`.
pub(super) const KIND: &str = "levels";

/// The session's own levels; empty if none were measured.
pub fn load(session: &Session) -> Result<MeasuredLevels, RecordError> {
    let record = calibrate::load::<LevelsFit>(session, KIND)?;
    Ok(record.map_or_else(MeasuredLevels::default, |record| record.fit.measured(&record.rig)))
}

/// Reads and decodes a raw file; `measured` are the session's own levels.
pub fn read(path: &Path, measured: &MeasuredLevels) -> Result<Photo, RawError> {
    settled(raw::read(path)?, measured, || path.display().to_string())
}

/// Decodes a raw file's bytes; `what` names them in errors, `measured` are the session's own levels.
pub fn decode(bytes: &[u8], what: &str, measured: &MeasuredLevels) -> Result<Photo, RawError> {
    settled(raw::decode(bytes, what)?, measured, || what.to_owned())
}

/// Why the session's own levels do not count for a frame of these settings, in words for people; `None` if they do, or if
/// none were measured.
pub fn remark(measured: &MeasuredLevels, settings: &Settings) -> Option<String> {
    remarks(measured, [settings]).pop()
}

/// The same for many frames: each reason once, and once for all ISOs that were not measured.
pub fn remarks<'a>(measured: &MeasuredLevels, frames: impl IntoIterator<Item = &'a Settings>) -> Vec<String> {
    let (mut found, mut others) = (vec![], vec![]);
    for settings in frames {
        match measured.find(origin(settings)) {
            Ok(_) => {}
            Err(Unmeasured::OtherIso { isos, .. }) => others.extend(isos),
            Err(why) => found.extend(Some(sentence(&why)).filter(|why| !found.contains(why))),
        }
    }
    others.sort_by(|a: &Iso, b| a.0.total_cmp(&b.0));
    others.dedup();
    if !others.is_empty() {
        let measured = measured.isos.iter().map(|at| at.iso).collect();
        found.push(sentence(&Unmeasured::OtherIso { isos: others, measured }));
    }
    found
}

fn sentence(why: &Unmeasured) -> String {
    let why = why.to_string();
    let mut letters = why.chars();
    letters.next().map_or(String::new(), |first| format!("{}{}.", first.to_uppercase(), letters.as_str()))
}

/// Refuses a frame of another body than the one that was measured.
pub(super) fn same_body(measured: &MeasuredLevels, settings: &Settings, what: &str) -> Result<(), RawError> {
    match measured.find(origin(settings)) {
        Err(source @ Unmeasured::OtherBody { .. }) => {
            Err(RawError::OtherBody { what: what.to_owned(), source })
        }
        _ => Ok(()),
    }
}

fn origin(settings: &Settings) -> Origin<'_> {
    Origin { model: settings.model.as_deref(), serial: settings.serial.as_deref(), iso: settings.iso }
}

fn settled(
    mut photo: Photo,
    measured: &MeasuredLevels,
    what: impl FnOnce() -> String,
) -> Result<Photo, RawError> {
    match levels::settle(&mut photo.mosaic, origin(&photo.settings), measured) {
        Err(source @ Unmeasured::OtherBody { .. }) => Err(RawError::OtherBody { what: what(), source }),
        _ => Ok(photo),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::photometry::levels::LevelsAt;

    #[test]
    fn all_isos_without_levels_are_named_in_one_sentence() {
        let at = LevelsAt { iso: Iso(100.0), black: [[None; 2]; 2], saturation: [[None; 2]; 2] };
        let measured = MeasuredLevels { model: Some("A".into()), serial: None, isos: vec![at] };
        let of =
            |iso: Option<f64>| Settings { model: Some("A".into()), iso: iso.map(Iso), ..Settings::default() };
        let frames = [Some(200.0), Some(100.0), Some(125.0), None, Some(200.0), None].map(of);
        let said = remarks(&measured, &frames);
        assert_eq!(said.len(), 2, "{said:?}");
        assert!(said[0].ends_with("does not tell its ISO."), "{said:?}");
        assert!(said[1].contains("at ISO 100, not at ISO 125, ISO 200, where"), "{said:?}");
        assert_eq!(remark(&measured, &frames[1]), None);
    }
}
