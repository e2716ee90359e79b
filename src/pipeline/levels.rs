//! Raw files read with the best levels known.
//!
//! Everything that judges or processes frames reads them through [`read`] or [`decode`]: the decoder's levels are then
//! replaced by the session's `calibration/levels.json` (`unlit calibrate levels`), where it is of the same body and ISO,
//! or by what [`crate::photometry::levels`] has for the body.

use super::calibrate::{self, RecordError};
use crate::calibration::LevelsFit;
use crate::codec::raw::{self, Photo, RawError};
use crate::photometry::levels::{self, MeasuredLevels, Origin};
use crate::session::Session;
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
    Ok(settled(raw::read(path)?, measured))
}

/// Decodes a raw file's bytes; `what` names them in errors, `measured` are the session's own levels.
pub fn decode(bytes: &[u8], what: &str, measured: &MeasuredLevels) -> Result<Photo, RawError> {
    Ok(settled(raw::decode(bytes, what)?, measured))
}

fn settled(mut photo: Photo, measured: &MeasuredLevels) -> Photo {
    let settings = &photo.settings;
    let origin =
        Origin { model: settings.model.as_deref(), serial: settings.serial.as_deref(), iso: settings.iso };
    levels::settle(&mut photo.mosaic, origin, measured);
    photo
}
