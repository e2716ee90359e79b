//! Sensor values out of camera raw files: CR2, NEF, ARW, DNG and what else is built like a TIFF.
//!
//! Takes a file, gives a [`Photo`]: the active area's DN as read, the filter array aligned to it, black and
//! saturation with where they came from, and the EXIF settings. Pixels come from `rawloader`, those of
//! uncompressed DNGs from our own reader (`rawloader` knows neither 14-bit packing nor several strips).
//! Files are not trusted: sizes are bounded before anything is allocated, a file that ends early is told
//! from a damaged one, and nothing that a file says makes the program stop.

mod dng_in;
mod error;
mod sensor;
mod table;
mod tiffdir;

pub use error::RawError;

use crate::pair::Settings;
use crate::photometry::Mosaic;
use dng_in::Storage;
use std::path::Path;
use tiffdir::{Fault, Tiff, tag};

/// The largest frame accepted, in sites.
const MAX_SITES: u64 = 400_000_000;
/// No lossless raw compression spends less than one bit a site, so that a file holds no more sites than bits.
const MAX_SITES_PER_BYTE: u64 = 8;
/// Bytes before the end of a segment of lossless JPEG in which its end marker must stand; writers pad.
const END_MARKER_WINDOW: usize = 64;

/// A decoded raw file.
#[derive(Clone, Debug, PartialEq)]
pub struct Photo {
    /// Sensor values of the active area, levels, filter array.
    pub mosaic: Mosaic,
    /// Settings out of the file's EXIF.
    pub settings: Settings,
    /// Statistics of the masked border; absent if the file has none, or too few for a mean.
    pub masked: Option<Masked>,
}

/// The masked (light-tight) border, per position of the 2x2 array counted from the active area's first
/// site, indexed `[row & 1][column & 1]`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Masked {
    /// Mean in DN: the black level.
    pub mean: [[f32; 2]; 2],
    /// Standard deviation of single sites in DN: the read noise.
    pub standard_deviation: [[f32; 2]; 2],
    /// Sites counted.
    pub sites: [[usize; 2]; 2],
}

/// Reads and decodes a raw file.
pub fn read(path: &Path) -> Result<Photo, RawError> {
    let what = path.display().to_string();
    let bytes = std::fs::read(path).map_err(|source| RawError::Read { what: what.clone(), source })?;
    decode(&bytes, &what)
}

/// Decodes a raw file's bytes; `what` names them in errors.
pub fn decode(bytes: &[u8], what: &str) -> Result<Photo, RawError> {
    if !tiffdir::is_tiff(bytes) {
        return Err(not_a_tiff(bytes, what));
    }
    let tiff = tiffdir::walk(bytes).map_err(|fault| match fault {
        Fault::Cut { needs } => RawError::Truncated { what: what.to_owned(), has: bytes.len() as u64, needs },
        Fault::Hostile(why) => RawError::Damaged { what: what.to_owned(), why: why.to_owned() },
    })?;
    check_whole(bytes, &tiff, what)?;
    let settings = super::exif::settings(bytes);
    if !tiff.directories.iter().any(|d| d.has(tag::DNG_VERSION)) {
        let (plane, description) = table::decode(bytes, what)?;
        return sensor::develop(what, plane, &description, settings);
    }
    let frame = dng_in::describe(what, &tiff)?;
    check_size(what, frame.width as u64, frame.height as u64, bytes.len())?;
    let mut plane = match frame.storage {
        Storage::Uncompressed { bits } => frame.read_uncompressed(what, bytes, bits)?,
        Storage::LosslessJpeg => table::decode_plane(bytes, what, frame.width, frame.height)?,
    };
    frame.linearize(what, &mut plane)?;
    sensor::develop(what, plane, &frame.description, settings)
}

/// Says what a file that does not open like a TIFF looks like instead.
fn not_a_tiff(bytes: &[u8], what: &str) -> RawError {
    let what = what.to_owned();
    let looks = match bytes {
        [] => return RawError::Truncated { what, has: 0, needs: 8 },
        _ if bytes.get(4..12) == Some(b"ftypcrx ") => return RawError::Cr3 { what },
        [0xff, 0xd8, ..] => "it is a JPEG, whatever its name says",
        [0x89, b'P', b'N', b'G', ..] => "it begins like a PNG",
        [b'F', b'U', b'J', b'I', ..] => "it is a Fujifilm RAF: convert it to DNG",
        [b'I', b'I', b'R' | b'U', ..] => "it is an Olympus or Panasonic raw: convert it to DNG",
        _ => "its first bytes are those of no format known here",
    };
    RawError::NotRaw { what, looks }
}

/// Every strip and tile must lie inside the file, and compressed sensor data must end with its marker:
/// decoders fill what is missing with zeros and say nothing.
fn check_whole(bytes: &[u8], tiff: &Tiff, what: &str) -> Result<(), RawError> {
    let has = bytes.len() as u64;
    let segments = |d: &tiffdir::Directory| d.segments().unwrap_or_default();
    let ends = tiff.directories.iter().flat_map(segments).map(|(offset, length)| offset + length);
    if let Some(needs) = ends.max().filter(|&needs| needs > has) {
        return Err(RawError::Truncated { what: what.to_owned(), has, needs });
    }
    let lossless = |d: &&tiffdir::Directory| {
        d.has(tag::CR2_SLICES)
            || (d.one(tag::PHOTOMETRIC) == Some(32803) && d.one(tag::COMPRESSION) == Some(7))
    };
    for (offset, length) in tiff.directories.iter().filter(lossless).flat_map(segments) {
        let end = (offset + length) as usize;
        let window = end.saturating_sub(END_MARKER_WINDOW).max(offset as usize)..end;
        if !bytes[window].windows(2).any(|pair| pair == [0xff, 0xd9]) {
            return Err(RawError::NoEndMarker { what: what.to_owned(), at: end as u64 });
        }
    }
    Ok(())
}

/// Refuses frames that no camera makes or that the file cannot hold, before anything is allocated.
fn check_size(what: &str, width: u64, height: u64, bytes: usize) -> Result<(), RawError> {
    let bytes = bytes as u64;
    match width.checked_mul(height) {
        Some(sites)
            if sites > 0 && sites <= MAX_SITES && sites <= bytes.saturating_mul(MAX_SITES_PER_BYTE) =>
        {
            Ok(())
        }
        _ => Err(RawError::Implausible { what: what.to_owned(), width, height, bytes }),
    }
}
