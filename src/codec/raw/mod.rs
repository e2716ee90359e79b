//! Sensor values out of camera raw files: CR2, NEF, ARW, DNG and what else is built like a TIFF; CR3, RAF.
//!
//! Takes a file, gives a [`Photo`]: the active area's DN as read, the filter array aligned to it, black and
//! saturation with where they came from, and the EXIF settings. Pixels come from `rawloader`, those of
//! uncompressed DNGs from our own reader (`rawloader` knows neither 14-bit packing nor several strips), and what
//! neither knows (CR3, newer bodies, other compressions) from `rawler`, in a process of its own: see
//! [`set_decoder_program`]. A damaged file is damaged for all of them and is not passed on.
//! Files are not trusted: sizes are bounded before anything is allocated, a file that ends early is told
//! from a damaged one, and nothing that a file says makes the program stop.

pub(in crate::codec) mod boxes;
pub mod colour;
mod dng_in;
mod error;
pub mod host;
mod second;
mod sensor;
mod table;
pub(in crate::codec) mod tiffdir;
mod wire;

pub use error::RawError;
pub use second::set_decoder_program;

use crate::pair::Settings;
use crate::photometry::Mosaic;
use dng_in::Storage;
use std::path::Path;
use table::Refused;
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
    if boxes::is_cr3(bytes) {
        check_whole_cr3(bytes, what)?;
        return decode_second(bytes, what, "a Canon CR3", super::exif::settings(bytes));
    }
    if bytes.starts_with(RAF) {
        check_whole_raf(bytes, what)?;
        return decode_second(bytes, what, "a Fujifilm RAF", Settings::default());
    }
    if !tiffdir::is_tiff(bytes) {
        return Err(not_a_tiff(bytes, what));
    }
    let tiff = tiffdir::walk(bytes).map_err(|fault| match fault {
        Fault::Cut { needs } => RawError::Truncated { what: what.to_owned(), has: bytes.len() as u64, needs },
        Fault::Hostile(why) => RawError::Damaged { what: what.to_owned(), why: why.to_owned() },
    })?;
    check_whole(bytes, &tiff, what)?;
    let settings = super::exif::of_tiff(&tiff);
    if !tiff.directories.iter().any(|d| d.has(tag::DNG_VERSION)) {
        return match table::decode(bytes, what) {
            Ok((plane, description)) => sensor::develop(what, plane, &description, settings),
            Err(Refused::Unknown(why)) => decode_second(bytes, what, &why, settings),
            Err(Refused::Broken(error)) => Err(error),
        };
    }
    let frame = dng_in::describe(what, &tiff)?;
    check_size(what, frame.width as u64, frame.height as u64, bytes.len())?;
    let size = (frame.width, frame.height);
    let mut plane = match frame.storage {
        Storage::Uncompressed { bits } => frame.read_uncompressed(what, bytes, bits)?,
        Storage::LosslessJpeg => match table::decode_plane(bytes, what, size) {
            Ok(plane) => plane,
            Err(Refused::Unknown(why)) => return second_dng(bytes, what, &why, &frame, settings),
            Err(Refused::Broken(error)) => return Err(error),
        },
        Storage::Other => return second_dng(bytes, what, "a compressed DNG", &frame, settings),
    };
    frame.linearize(what, &mut plane)?;
    sensor::develop(what, plane, &frame.description, settings)
}

/// Decodes with the second decoder alone, whoever else could: for comparing the two. Levels and areas are the
/// second decoder's, also where the file has its own.
pub fn decode_with_second(bytes: &[u8], what: &str) -> Result<Photo, RawError> {
    decode_second(bytes, what, "asked for", super::exif::settings(bytes))
}

/// What the first decoders do not know, levels and areas from the second one's table. What the file itself tells
/// of its settings goes before what the decoder makes of it.
fn decode_second(bytes: &[u8], what: &str, why: &str, own: Settings) -> Result<Photo, RawError> {
    let (plane, frame) = second::decode(bytes, what, why)?;
    let settings = if own == Settings::default() { frame.settings.clone() } else { own };
    sensor::develop(what, plane, &frame.description(), settings)
}

/// A DNG whose compression only the second decoder knows: its plane, already linear, with the file's own levels.
fn second_dng(
    bytes: &[u8],
    what: &str,
    why: &str,
    frame: &dng_in::DngFrame,
    settings: Settings,
) -> Result<Photo, RawError> {
    let (plane, _) = second::decode(bytes, what, why)?;
    table::check_plane_size(what, &plane, (frame.width, frame.height))?;
    sensor::develop(what, plane, &frame.description, settings)
}

/// How a Fujifilm RAF opens.
const RAF: &[u8] = b"FUJIFILMCCD-RAW";

/// Says what a file of none of the known formats looks like instead.
fn not_a_tiff(bytes: &[u8], what: &str) -> RawError {
    let what = what.to_owned();
    let looks = match bytes {
        [] => return RawError::Truncated { what, has: 0, needs: 8 },
        [0xff, 0xd8, ..] => "it is a JPEG, whatever its name says",
        [0x89, b'P', b'N', b'G', ..] => "it begins like a PNG",
        _ => "its first bytes are those of no format known here",
    };
    RawError::NotRaw { what, looks }
}

/// A CR3's boxes must lie inside the file.
fn check_whole_cr3(bytes: &[u8], what: &str) -> Result<(), RawError> {
    let (what, has, needs) = (what.to_owned(), bytes.len() as u64, boxes::needs(bytes));
    match needs > has {
        true => Err(RawError::Truncated { what, has, needs }),
        false if !boxes::has_data(bytes) => Err(RawError::NoSensorData { what }),
        false => Ok(()),
    }
}

/// A RAF says at its front where its JPEG (84), its header of the sensor data (92) and the sensor data (100) lie,
/// each as offset and length, big-endian.
fn check_whole_raf(bytes: &[u8], what: &str) -> Result<(), RawError> {
    let has = bytes.len() as u64;
    let word = |at: usize| {
        let four = bytes.get(at..at + 4)?.try_into().ok()?;
        Some(u64::from(u32::from_be_bytes(four)))
    };
    let end = |at: usize| Some(word(at)? + word(at + 4)?);
    let needs = [84, 92, 100].into_iter().map(|at| end(at).unwrap_or(108)).max().unwrap_or(108);
    if needs > has {
        return Err(RawError::Truncated { what: what.to_owned(), has, needs });
    }
    Ok(())
}

/// Every strip and tile must lie inside the file, and compressed sensor data must end with its marker:
/// decoders fill what is missing with zeros and say nothing.
fn check_whole(bytes: &[u8], tiff: &Tiff, what: &str) -> Result<(), RawError> {
    let has = bytes.len() as u64;
    let segments = |d: &tiffdir::Directory| {
        let mut segments = d.segments().unwrap_or_default();
        // Panasonic's strips say "elsewhere": a tag of its own tells where.
        segments.retain(|(offset, _)| *offset != u64::from(u32::MAX));
        segments
    };
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
