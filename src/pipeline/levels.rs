//! Raw files read with the best saturation known, and a session's own table of it.
//!
//! Everything that judges or processes frames reads them through [`read`] or [`decode`]: the decoder's levels are
//! then replaced by the session's `calibration/saturation.json`, or by what [`crate::photometry::saturation`]
//! has for the body. [`calibrate`] measures the session's table from deliberately blown frames.

use crate::codec::raw::{self, Photo, RawError};
use crate::photometry::saturation::{self, Entry, NotBlown, SaturationTable};
use crate::progress::{Cancelled, Progress};
use crate::session::{Session, SessionError};
use std::path::{Path, PathBuf};

/// Why a saturation table could not be read, measured or kept.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum SaturationError {
    /// The disk refused.
    #[error("{path}: {source}; check that the disk is there, writable and not full")]
    Io {
        /// Which file.
        path: PathBuf,
        /// The system's own word.
        source: std::io::Error,
    },
    /// `saturation.json` is broken.
    #[error("{path} is damaged ({source}); run `unlit calibrate saturation` again, or remove it")]
    Damaged {
        /// The file.
        path: PathBuf,
        /// What is wrong with it.
        source: serde_json::Error,
    },
    /// A frame cannot be decoded.
    #[error(transparent)]
    Raw(#[from] RawError),
    /// A frame is not blown.
    #[error("{path}: {source}")]
    NotBlown {
        /// The frame.
        path: PathBuf,
        /// What it shows instead.
        source: NotBlown,
    },
    /// A frame does not tell whose saturation it shows.
    #[error("{path} does not tell its {setting}; give a raw file as the camera wrote it")]
    Untold {
        /// The frame.
        path: PathBuf,
        /// What is missing.
        setting: &'static str,
    },
    /// The session refused.
    #[error(transparent)]
    Session(#[from] SessionError),
    /// Stopped on request.
    #[error(transparent)]
    Cancelled(#[from] Cancelled),
}

fn file(session: &Session) -> PathBuf {
    session.calibration_dir().join("saturation.json")
}

/// The session's own table; empty if none was measured.
pub fn load(session: &Session) -> Result<SaturationTable, SaturationError> {
    let path = file(session);
    match std::fs::read(&path) {
        Ok(bytes) => {
            serde_json::from_slice(&bytes).map_err(|source| SaturationError::Damaged { path, source })
        }
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => Ok(SaturationTable::default()),
        Err(source) => Err(SaturationError::Io { path, source }),
    }
}

/// Reads and decodes a raw file; `measured` is the session's own table.
pub fn read(path: &Path, measured: &SaturationTable) -> Result<Photo, RawError> {
    Ok(settled(raw::read(path)?, measured))
}

/// Decodes a raw file's bytes; `what` names them in errors, `measured` is the session's own table.
pub fn decode(bytes: &[u8], what: &str, measured: &SaturationTable) -> Result<Photo, RawError> {
    Ok(settled(raw::decode(bytes, what)?, measured))
}

fn settled(mut photo: Photo, measured: &SaturationTable) -> Photo {
    saturation::settle(&mut photo.mosaic, photo.settings.model.as_deref(), photo.settings.iso, measured);
    photo
}

/// Measures saturation from deliberately blown frames and keeps it in the session, for each body and ISO that
/// occurs; of several frames of one, the lowest values count. Gives the entries measured.
pub fn calibrate(
    session: &Session,
    frames: &[PathBuf],
    progress: &Progress,
) -> Result<Vec<Entry>, SaturationError> {
    let mut table = load(session)?;
    let mut measured = SaturationTable::default();
    for (done, path) in frames.iter().enumerate() {
        progress.check()?;
        progress.report("measuring saturation", done, frames.len());
        let photo = raw::read(path)?;
        let untold = |setting| SaturationError::Untold { path: path.clone(), setting };
        let model = photo.settings.model.as_deref().ok_or_else(|| untold("camera model"))?;
        let iso = photo.settings.iso.ok_or_else(|| untold("ISO"))?;
        let mut values = saturation::measure(&photo.mosaic)
            .map_err(|source| SaturationError::NotBlown { path: path.clone(), source })?;
        let name = path.file_name().map_or_else(Default::default, |n| n.to_string_lossy());
        let mut origin = format!("measured from {name}");
        if let Some(other) = measured.find(model, Some(iso)) {
            origin = format!("{}, {name}", other.origin);
            for (value, other) in values.as_flattened_mut().iter_mut().zip(other.saturation.concat()) {
                *value = value.min(other);
            }
        }
        let entry = Entry { model: model.to_owned(), isos: vec![iso.0], saturation: values, origin };
        measured.replace(entry);
    }
    for entry in &measured.entries {
        table.replace(entry.clone());
    }
    let path = file(session);
    let bytes = serde_json::to_vec_pretty(&table)
        .map_err(|source| SaturationError::Damaged { path: path.clone(), source })?;
    session.keep(&path, &bytes)?;
    progress.report("measuring saturation", frames.len(), frames.len());
    Ok(measured.entries)
}
