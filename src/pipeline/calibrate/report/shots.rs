//! The shots of a calibration as the report lists them, with small pictures: made when a shot is read for the first
//! time, kept in `derived/calibration/` under the shot's BLAKE3, and made again if they are gone.

use crate::calibration::Shot;
use crate::codec::jpeg::{self, JpegError};
use crate::codec::raw::RawError;
use crate::export::calibration_report::ShotRow;
use crate::photometry::Mosaic;
use crate::photometry::levels::MeasuredLevels;
use crate::photometry::preview::{for_the_eye, reduced};
use crate::pipeline::calibrate::SeriesError;
use crate::pipeline::levels;
use crate::progress::Progress;
use crate::session::{Session, store};
use std::path::PathBuf;

/// Longest edge of a picture in pixels.
const EDGE: usize = 96;
/// JPEG quality, 1..100.
const QUALITY: u8 = 80;

/// Why a shot cannot be shown.
#[derive(Debug, thiserror::Error)]
enum NoPicture {
    #[error("its file cannot be read any more: {0}")]
    Gone(std::io::Error),
    #[error("its file is not the one that was measured (BLAKE3 differs)")]
    Changed,
    #[error(transparent)]
    Raw(#[from] RawError),
    #[error(transparent)]
    Jpeg(#[from] JpegError),
}

/// A small JPEG of a frame.
pub(in crate::pipeline::calibrate) fn picture(frame: &Mosaic) -> Result<Vec<u8>, JpegError> {
    jpeg::encode(&for_the_eye(&reduced(frame, EDGE)), QUALITY)
}

/// Keeps the picture of the shot with this digest.
pub(in crate::pipeline::calibrate) fn keep(
    session: &Session,
    blake3: &str,
    jpeg: &[u8],
) -> Result<(), SeriesError> {
    let path = path(session, blake3);
    let io = |source| SeriesError::Io { path: path.clone(), source };
    std::fs::create_dir_all(path.parent().unwrap_or(session.path())).map_err(io)?;
    store::write_atomic(&path, jpeg).map_err(io)
}

fn path(session: &Session, blake3: &str) -> PathBuf {
    session.derived_dir().join("calibration").join(format!("{blake3}.jpg"))
}

/// Rows of the shots' table; `roles` say what each was for, where that is known.
pub(super) fn rows(
    session: &Session,
    kind: &str,
    shots: &[Shot],
    roles: &[String],
    progress: &Progress,
) -> Result<Vec<ShotRow>, SeriesError> {
    let stage = format!("writing the report: {}", kind.to_lowercase());
    let mut rows = vec![];
    for (number, shot) in shots.iter().enumerate() {
        progress.check()?;
        progress.report(&stage, number, shots.len());
        let mut role = match (&shot.left_out, roles.get(number)) {
            (Some(why), Some(role)) if !role.is_empty() => format!("{role}; left out: {why}"),
            (Some(why), _) => format!("left out: {why}"),
            (None, Some(role)) if !role.is_empty() => role.clone(),
            (None, _) => "used".to_owned(),
        };
        let thumbnail = match made(session, shot) {
            Ok((jpeg, new)) => {
                if new {
                    keep(session, &shot.blake3, &jpeg)?;
                }
                Some(jpeg)
            }
            Err(why) => {
                role += &format!("; NOT SHOWN: {why}");
                None
            }
        };
        let exposure = [
            shot.shutter.map(|s| s.to_string()),
            shot.aperture.map(|n| n.to_string()),
            shot.iso.map(|i| i.to_string()),
        ];
        let exposure: Vec<String> = exposure.into_iter().flatten().collect();
        rows.push(ShotRow {
            thumbnail,
            file: shot.file.clone(),
            blake3: shot.blake3.clone(),
            exposure: exposure.join(", "),
            role,
            used: shot.left_out.is_none(),
        });
    }
    progress.report(&stage, shots.len(), shots.len());
    Ok(rows)
}

/// The picture of a shot, and whether it was made just now.
fn made(session: &Session, shot: &Shot) -> Result<(Vec<u8>, bool), NoPicture> {
    let file = session.path().join(&shot.file);
    // A picture that is there does not show that its shot still is.
    std::fs::metadata(&file).map_err(NoPicture::Gone)?;
    if let Ok(jpeg) = std::fs::read(path(session, &shot.blake3)) {
        return Ok((jpeg, false));
    }
    let bytes = std::fs::read(&file).map_err(NoPicture::Gone)?;
    if store::digest(&bytes) != shot.blake3 {
        return Err(NoPicture::Changed);
    }
    let photo = levels::decode(&bytes, &shot.file, &MeasuredLevels::default())?;
    Ok((picture(&photo.mosaic)?, true))
}
