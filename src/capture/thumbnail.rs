//! Small JPEGs of raw frames, for lists. For the eye alone: nothing is ever computed from them.
//!
//! Black is subtracted and whole 2x2 cells are averaged, so that no demosaicing is needed. One brightness
//! scale (saturation = white) and one neutral point (the frame's own mean, grey world) make off and on
//! comparable; the sRGB curve follows.

use crate::codec::{jpeg, raw};
use crate::pair::{FrameRecord, PairRecord};
use crate::photometry::Mosaic;
use crate::pipeline::develop::exposure_ratio;
use crate::raster::Image;
use crate::raster::srgb::encode_u8;
use crate::session::{Session, store};
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
    /// The encoder refused.
    #[error(transparent)]
    Jpeg(#[from] jpeg::JpegError),
    /// The disk refused.
    #[error("{path}: {source}; check that the disk is there, writable and not full")]
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
    let small = render(&photo.mosaic);
    let bytes = jpeg::encode(&small, QUALITY)?;
    let disk = |source| ThumbnailError::Disk { path: path.clone(), source };
    std::fs::create_dir_all(&folder).map_err(disk)?;
    store::write_atomic(&path, &bytes).map_err(disk)?;
    Ok(path)
}

/// The path of a small JPEG of the light that the flash alone threw: on less off. Named by both originals' digests.
pub(super) fn of_known_light(session: &Session, pair: &PairRecord) -> Result<PathBuf, ThumbnailError> {
    let folder = session.derived_dir().join("known");
    let frames: Vec<_> = pair.frames().collect();
    let digests: Vec<&str> = frames.iter().map(|(_, frame)| frame.blake3.as_str()).collect();
    let name = store::digest(digests.join(" ").as_bytes());
    let path = folder.join(format!("{name}.jpg"));
    if path.is_file() {
        return Ok(path);
    }
    let place = session.pair_dir(pair);
    // What one frame does not tell counts as equal: this is for the eye, and processing will name it.
    let room = exposure_ratio(&pair.on.settings, &pair.off.settings).unwrap_or(1.0) as f32;
    let on = reduced(&raw::read(&place.join(&pair.on.file))?.mosaic);
    let dark: Vec<_> = frames.iter().filter(|(slot, _)| !slot.part.is_lit()).collect();
    let share = room / dark.len() as f32;
    let mut known = on;
    for (_, frame) in dark {
        let off = reduced(&raw::read(&place.join(&frame.file))?.mosaic);
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

/// Averages blocks of whole filter cells to at most [`EDGE`] pixels a side and encodes them for the eye.
fn render(mosaic: &Mosaic) -> Image<[u8; 3]> {
    for_the_eye(&reduced(mosaic))
}

/// Means of blocks, 0 = black, 1 = saturation.
fn reduced(mosaic: &Mosaic) -> Image<[f32; 3]> {
    let (cells_x, cells_y) = (mosaic.dn.width() / 2, mosaic.dn.height() / 2);
    let block = cells_x.max(cells_y).div_ceil(EDGE).max(1);
    Image::from_fn(cells_x / block, cells_y / block, |x, y| average(mosaic, x, y, block))
}

fn for_the_eye(linear: &Image<[f32; 3]>) -> Image<[u8; 3]> {
    let count = linear.pixels().len().max(1) as f32;
    let mean =
        linear.pixels().iter().fold([0.0f32; 3], |sum, p| std::array::from_fn(|c| sum[c] + p[c] / count));
    let neutral = mean.map(|m| if m > 1e-4 { mean[1] / m } else { 1.0 });
    linear.map(|p| std::array::from_fn(|c| encode_u8(p[c] * neutral[c])))
}

/// Mean of a block of cells per colour, 0 = black, 1 = saturation.
fn average(mosaic: &Mosaic, x: usize, y: usize, block: usize) -> [f32; 3] {
    let mut sum = [0.0f32; 3];
    let mut count = [0.0f32; 3];
    for row in y * block * 2..(y + 1) * block * 2 {
        for column in x * block * 2..(x + 1) * block * 2 {
            let (r, c) = (row & 1, column & 1);
            let (black, white) = (mosaic.levels.black[r][c], mosaic.levels.saturation[r][c]);
            let colour = mosaic.cfa.colour(column, row);
            sum[colour] += (f32::from(*mosaic.dn.at(column, row)) - black) / (white - black).max(1.0);
            count[colour] += 1.0;
        }
    }
    std::array::from_fn(|c| sum[c] / count[c].max(1.0))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::photometry::{Cfa, LevelSource, Levels};

    fn even(width: usize, height: usize, dn: u16) -> Mosaic {
        Mosaic {
            dn: Image::filled(width, height, dn),
            cfa: Cfa::RGGB,
            levels: Levels {
                black: [[100.0; 2]; 2],
                saturation: [[1100.0; 2]; 2],
                black_source: LevelSource::FileTag,
                saturation_source: LevelSource::FileTag,
            },
        }
    }

    #[test]
    fn black_is_black_saturation_is_white_and_a_fifth_is_middle_grey() {
        assert_eq!(render(&even(8, 4, 100)).pixels()[0], [0; 3]);
        assert_eq!(render(&even(8, 4, 1100)).pixels()[0], [255; 3]);
        assert_eq!(render(&even(8, 4, 316)).pixels()[0], [128; 3]);
    }

    #[test]
    fn no_edge_is_longer_than_allowed_and_no_frame_is_too_small() {
        let small = render(&even(2 * EDGE * 3 + 2, 400, 500));
        assert!(small.width() <= EDGE && small.width() > EDGE / 2, "{}", small.width());
        assert_eq!(render(&even(1, 1, 500)).pixels().len(), 0);
    }
}
