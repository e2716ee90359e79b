//! Small JPEGs of raw frames, for lists, made by [`crate::photometry::preview`].

use crate::codec::{jpeg, raw};
use crate::pair::{FrameRecord, PairRecord};
use crate::photometry::preview::{for_the_eye, reduced};
use crate::pipeline::calibrate::RecordError;
use crate::pipeline::scale::SessionScale;
use crate::raster::Image;
use crate::session::{Session, advice, store};
use std::path::PathBuf;

/// Longest edge of a thumbnail in pixels.
const EDGE: usize = 480;
/// JPEG quality, 1..100.
const QUALITY: u8 = 85;

/// Why there is no thumbnail.
#[derive(Debug, thiserror::Error)]
pub enum ThumbnailError {
    /// The frame is no readable raw.
    #[error(transparent)]
    Raw(#[from] raw::RawError),
    /// The session's exposure table cannot be read.
    #[error(transparent)]
    Record(#[from] RecordError),
    /// The encoder refused.
    #[error(transparent)]
    Jpeg(#[from] jpeg::JpegError),
    /// The disk refused.
    #[error("{path}: {source}; {}", advice(source))]
    Disk {
        /// File or folder.
        path: PathBuf,
        /// The system's own word.
        source: std::io::Error,
    },
}

/// The path of the thumbnail of a pair's frame, made if it is not there yet. Named by the original's digest, so that it
/// can never show another frame.
pub(super) fn of_frame(
    session: &Session,
    pair: &PairRecord,
    record: &FrameRecord,
) -> Result<PathBuf, ThumbnailError> {
    let folder = session.derived_dir().join("thumbnails");
    let path = folder.join(format!("{}.jpg", record.blake3));
    if path.is_file() {
        return Ok(path);
    }
    let photo = raw::read(&session.pair_dir(pair).join(&record.file))?;
    let bytes = jpeg::encode(&for_the_eye(&reduced(&photo.mosaic, EDGE)), QUALITY)?;
    let disk = |source| ThumbnailError::Disk { path: path.clone(), source };
    std::fs::create_dir_all(&folder).map_err(disk)?;
    store::write_atomic(&path, &bytes).map_err(disk)?;
    Ok(path)
}

/// The path of a small JPEG of the light that the flash alone threw: on less off. Named by the originals' digests and
/// the session's exposure table.
pub(super) fn of_known_light(session: &Session, pair: &PairRecord) -> Result<PathBuf, ThumbnailError> {
    let folder = session.derived_dir().join("known");
    let frames: Vec<_> = pair.frames().collect();
    let scale = SessionScale::load(session)?;
    let digests = frames.iter().map(|(_, frame)| frame.blake3.clone());
    let digests: Vec<String> = digests.chain(scale.told()).collect();
    let name = store::digest(digests.join(" ").as_bytes());
    let path = folder.join(format!("{name}.jpg"));
    if path.is_file() {
        return Ok(path);
    }
    let place = session.pair_dir(pair);
    // What cannot be scaled counts as equal: this is for the eye, and processing will name it.
    let room = scale.room_ratio(&pair.on.settings, &pair.off.settings).unwrap_or(1.0) as f32;
    let on = reduced(&raw::read(&place.join(&pair.on.file))?.mosaic, EDGE);
    let dark: Vec<_> = frames.iter().filter(|(slot, _)| !slot.part.is_lit()).collect();
    let share = room / dark.len() as f32;
    let mut known = on;
    for (_, frame) in dark {
        let off = reduced(&raw::read(&place.join(&frame.file))?.mosaic, EDGE);
        let (width, height) = (known.width().min(off.width()), known.height().min(off.height()));
        known = Image::from_fn(width, height, |x, y| {
            let (off, on) = (off.at(x, y), known.at(x, y));
            std::array::from_fn(|c| on[c] - share * off[c])
        });
    }
    let known = known.map(|light| light.map(|value| value.max(0.0)));
    let bytes = jpeg::encode(&for_the_eye(&known), QUALITY)?;
    let disk = |source| ThumbnailError::Disk { path: path.clone(), source };
    std::fs::create_dir_all(&folder).map_err(disk)?;
    store::write_atomic(&path, &bytes).map_err(disk)?;
    Ok(path)
}
