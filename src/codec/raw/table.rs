//! Sensor values through `rawloader`, levels and masked areas from its table of cameras.
//!
//! Three traps of the library, as measured: for camera files `blacklevels` and `whitelevels` are by colour
//! (R, G, B, second green) and an entry may be 0, which means "as the others"; `blackareas` are (top, right,
//! bottom, left); a file that is cut short decodes without an error (the caller has checked that).

use super::RawError;
use super::sensor::{Description, Plane, Rect};
use crate::photometry::{Cfa, LevelSource};
use rawloader::{RawImage, RawImageData};

/// Why the library gave nothing.
pub(super) enum Refused {
    /// It does not know the camera or the way of storing, in its own words: another decoder may.
    Unknown(String),
    /// The file is at fault, whoever decodes it.
    Broken(RawError),
}

impl From<RawError> for Refused {
    fn from(error: RawError) -> Self {
        Refused::Broken(error)
    }
}

/// Decodes a camera file, with everything but its pixels from the library's table.
pub(super) fn decode(bytes: &[u8], what: &str) -> Result<(Plane, Description), Refused> {
    let frame = decode_capped(bytes, what)?;
    let description = describe(what, &frame)?;
    Ok((into_plane(what, frame)?, description))
}

/// Decodes the pixels alone of a DNG whose (width, height) is already known.
pub(super) fn decode_plane(bytes: &[u8], what: &str, size: (usize, usize)) -> Result<Plane, Refused> {
    let plane = into_plane(what, decode_capped(bytes, what)?)?;
    check_plane_size(what, &plane, size)?;
    Ok(plane)
}

/// Refuses a plane of another (width, height) than the file's own directory says.
pub(super) fn check_plane_size(what: &str, plane: &Plane, size: (usize, usize)) -> Result<(), RawError> {
    if (plane.width, plane.height) == size {
        return Ok(());
    }
    let (width, height) = size;
    Err(RawError::Damaged {
        what: what.to_owned(),
        why: format!("it holds {} x {} sites, not {width} x {height}", plane.width, plane.height),
    })
}

/// The table's matrix from CIE XYZ to the camera's RGB, for D65; `None` for a camera that it does not know. No pixel is
/// decoded.
pub(super) fn colour(bytes: &[u8]) -> Option<[[f64; 3]; 3]> {
    let frame = rawloader::decode_dummy(&mut { bytes }).ok()?;
    let [r, g, b, _] = frame.xyz_to_cam;
    Some([r, g, b].map(|row| row.map(f64::from)))
}

/// Asks for the size first, refuses what cannot be, then decodes. The library catches its own panics.
fn decode_capped(mut bytes: &[u8], what: &str) -> Result<RawImage, Refused> {
    let failed = |error: rawloader::RawLoaderError| {
        let message = error.to_string();
        let told = message.trim_start_matches("RawLoaderError: ").trim_matches('"');
        let told = told.lines().next().unwrap_or("the decoder gave no reason").to_owned();
        if is_ignorance(&told) {
            Refused::Unknown(told)
        } else {
            Refused::Broken(RawError::Decoder { what: what.to_owned(), message: told })
        }
    };
    let size = rawloader::decode_dummy(&mut { bytes }).map_err(failed)?;
    super::check_size(what, size.width as u64, size.height as u64, bytes.len())?;
    if size.cpp != 1 {
        return Err(Refused::Broken(RawError::Demosaiced {
            what: what.to_owned(),
            how: "a reduced raw (sRAW, mRAW) or linear DNG",
        }));
    }
    rawloader::decode(&mut bytes).map_err(failed)
}

/// Whether the library says that it does not know something, rather than that something is wrong.
fn is_ignorance(message: &str) -> bool {
    const CAMERA: [&str; 2] = ["Couldn't find camera", "Couldn't find a decoder for make"];
    // A lossless JPEG with a predictor that the standard does not have is damaged, not unknown.
    let predictor = (2..=7).any(|p| message == format!("ljpeg: predictor {p} not supported"));
    let storage = ["Don't know", "unsupported compression", "not supported yet", "not implemented yet"];
    CAMERA.iter().any(|start| message.starts_with(start))
        || predictor
        || (!message.starts_with("TIFF") && storage.iter().any(|words| message.contains(words)))
}

fn into_plane(what: &str, frame: RawImage) -> Result<Plane, RawError> {
    let RawImage { width, height, data, .. } = frame;
    match data {
        RawImageData::Integer(dn) if dn.len() == width * height => Ok(Plane { width, height, dn }),
        RawImageData::Integer(dn) => Err(RawError::Decoder {
            what: what.to_owned(),
            message: format!("{} values for {width} x {height} sites", dn.len()),
        }),
        RawImageData::Float(_) => {
            Err(RawError::Unsupported { what: what.to_owned(), how: "floating-point sensor data".to_owned() })
        }
    }
}

fn describe(what: &str, frame: &RawImage) -> Result<Description, RawError> {
    let [top, right, bottom, left] = frame.crops;
    let (Some(right), Some(bottom)) = (frame.width.checked_sub(right), frame.height.checked_sub(bottom))
    else {
        return Err(RawError::Damaged {
            what: what.to_owned(),
            why: format!("a {} x {} frame is smaller than the model's border", frame.width, frame.height),
        });
    };
    let active = Rect { top, left, bottom, right };
    if (frame.cfa.width, frame.cfa.height) != (2, 2) {
        return Err(RawError::Pattern { what: what.to_owned(), pattern: frame.cfa.to_string() });
    }
    // The library's own colour of each position, which tells the two greens apart on some models.
    let index = |row: usize, column: usize| frame.cfa.color_at(row + top, column + left).min(3);
    let positions = [[index(0, 0), index(0, 1)], [index(1, 0), index(1, 1)]];
    let green_for_the_second = |c: usize| if c == 3 { 1 } else { c as u8 };
    let levels = |by_colour: [u16; 4]| {
        let fallback = by_colour.into_iter().find(|&v| v > 0).unwrap_or(0);
        let level = |c: usize| f32::from(if by_colour[c] > 0 { by_colour[c] } else { fallback });
        positions.map(|row| row.map(level))
    };
    let masked = frame.blackareas.iter().filter_map(|&(top, right, bottom, left)| {
        let (right, bottom) = ((right as usize).min(frame.width), (bottom as usize).min(frame.height));
        let rect = Rect { top: top as usize, left: left as usize, bottom, right };
        (rect.top < rect.bottom && rect.left < rect.right).then_some(rect)
    });
    Ok(Description {
        active,
        cfa: Cfa(positions.map(|row| row.map(green_for_the_second))),
        masked: masked.collect(),
        black: levels(frame.blacklevels),
        saturation: levels(frame.whitelevels),
        source: LevelSource::DecoderTable,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_the_library_does_not_know_is_told_from_what_is_damaged() {
        for unknown in [
            "Couldn't find camera \\\"SONY\\\" \\\"ILCE-1\\\" mode \\\"\\\".",
            "Couldn't find a decoder for make \\\"Nikon\\\".",
            "DNG: Don't know about 14 bps images",
            "NEF: Don't know compression 34713",
            "RAF: Don't know how to decode compressed yet",
            "ljpeg: predictor 6 not supported",
        ] {
            assert!(is_ignorance(unknown), "{unknown}");
        }
        for damaged in [
            "Caught a panic while decoding.",
            "ljpeg: predictor 77 not supported",
            "ljpeg: invalid DHT table",
            "CR2: Couldn't find raw info",
            "TIFF: don't know marker 0x0",
        ] {
            assert!(!is_ignorance(damaged), "{damaged}");
        }
    }
}
