//! Sensor values through `rawloader`, levels and masked areas from its table of cameras.
//!
//! Three traps of the library, as measured: for camera files `blacklevels` and `whitelevels` are by colour
//! (R, G, B, second green) and an entry may be 0, which means "as the others"; `blackareas` are (top, right,
//! bottom, left); a file that is cut short decodes without an error (the caller has checked that).

use super::RawError;
use super::sensor::{Description, Plane, Rect};
use crate::photometry::{Cfa, LevelSource};
use rawloader::{RawImage, RawImageData};

/// Decodes a camera file, with everything but its pixels from the library's table.
pub(super) fn decode(bytes: &[u8], what: &str) -> Result<(Plane, Description), RawError> {
    let frame = decode_capped(bytes, what)?;
    let description = describe(what, &frame)?;
    Ok((into_plane(what, frame)?, description))
}

/// Decodes the pixels alone of a DNG whose size is already known.
pub(super) fn decode_plane(bytes: &[u8], what: &str, width: usize, height: usize) -> Result<Plane, RawError> {
    let plane = into_plane(what, decode_capped(bytes, what)?)?;
    if (plane.width, plane.height) != (width, height) {
        return Err(RawError::Damaged {
            what: what.to_owned(),
            why: format!("it holds {} x {} sites, not {width} x {height}", plane.width, plane.height),
        });
    }
    Ok(plane)
}

/// Asks for the size first, refuses what cannot be, then decodes. The library catches its own panics.
fn decode_capped(mut bytes: &[u8], what: &str) -> Result<RawImage, RawError> {
    let failed = |error: rawloader::RawLoaderError| {
        let message = error.to_string();
        let told = message.trim_start_matches("RawLoaderError: ").trim_matches('"');
        let told = told.lines().next().unwrap_or("the decoder gave no reason").to_owned();
        RawError::Decoder { what: what.to_owned(), message: told }
    };
    let size = rawloader::decode_dummy(&mut { bytes }).map_err(failed)?;
    super::check_size(what, size.width as u64, size.height as u64, bytes.len())?;
    if size.cpp != 1 {
        return Err(RawError::Demosaiced {
            what: what.to_owned(),
            how: "a reduced raw (sRAW, mRAW) or linear DNG",
        });
    }
    rawloader::decode(&mut bytes).map_err(failed)
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
