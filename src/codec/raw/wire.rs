//! What passes between this program and its decode host: one raw file in, one answer out, over pipes.
//!
//! The question is the file's length (8 bytes, little-endian) and the file. The answer is [`MAGIC`], the length of
//! a JSON header (4 bytes), the header, and, when that is [`Answer::Frame`], the sensor plane as
//! `width * height` little-endian 16-bit values. Either side that ends early is told from one that is done.

use super::sensor::{Description, Rect};
use crate::pair::Settings;
use crate::photometry::{Cfa, LevelSource};
use serde::{Deserialize, Serialize};
use std::io::{self, Read, Write};

/// What an answer begins with, so that a program that is no decode host is told from one.
const MAGIC: &[u8; 8] = b"unlitraw";
/// The longest header that makes sense: four rectangles, some levels, the settings.
const MAX_HEADER: u32 = 256 * 1024;
/// Bytes moved at a time, so that the plane is never there twice.
const CHUNK: usize = 1 << 20;

/// A decode host's answer.
#[derive(Debug, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(super) enum Answer {
    /// Decoded; the plane follows.
    Frame(Box<Frame>),
    /// Not decoded.
    Refused(Refusal),
}

/// All of a frame but its plane. Levels are indexed from the active area's first site.
#[derive(Debug, Serialize, Deserialize)]
pub(super) struct Frame {
    pub(super) width: usize,
    pub(super) height: usize,
    pub(super) active: Rect,
    pub(super) cfa: Cfa,
    pub(super) masked: Vec<Rect>,
    pub(super) black: [[f32; 2]; 2],
    pub(super) saturation: [[f32; 2]; 2],
    pub(super) settings: Settings,
}

/// Why a frame was not decoded.
#[derive(Debug, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(super) enum Refusal {
    /// A camera, a compression or a layout that the library does not know.
    Unknown { how: String },
    /// Pixels that are no longer the sensor's.
    Demosaiced,
    /// A filter array other than 2x2 of red, green, blue.
    Pattern { pattern: String },
    /// The library failed on this file.
    Failed { message: String },
}

impl Frame {
    pub(super) fn description(&self) -> Description {
        Description {
            active: self.active,
            cfa: self.cfa,
            masked: self.masked.clone(),
            black: self.black,
            saturation: self.saturation,
            source: LevelSource::DecoderTable,
        }
    }
}

/// Writes the question.
pub(super) fn ask(out: &mut impl Write, file: &[u8]) -> io::Result<()> {
    out.write_all(&(file.len() as u64).to_le_bytes())?;
    out.write_all(file)?;
    out.flush()
}

/// Reads the question's length; the file follows.
pub(super) fn read_length(input: &mut impl Read) -> io::Result<u64> {
    let mut length = [0; 8];
    input.read_exact(&mut length)?;
    Ok(u64::from_le_bytes(length))
}

/// Writes an answer, with the plane if there is one.
pub(super) fn answer(out: &mut impl Write, answer: &Answer, plane: &[u16]) -> io::Result<()> {
    let header = serde_json::to_vec(answer)?;
    out.write_all(MAGIC)?;
    out.write_all(&(header.len() as u32).to_le_bytes())?;
    out.write_all(&header)?;
    let mut bytes = Vec::with_capacity(CHUNK);
    for part in plane.chunks(CHUNK / 2) {
        bytes.clear();
        bytes.extend(part.iter().flat_map(|dn| dn.to_le_bytes()));
        out.write_all(&bytes)?;
    }
    out.flush()
}

/// Reads an answer's header.
pub(super) fn read_answer(input: &mut impl Read) -> io::Result<Answer> {
    let mut start = [0; 12];
    input.read_exact(&mut start)?;
    let length = u32::from_le_bytes([start[8], start[9], start[10], start[11]]);
    if &start[..8] != MAGIC || length > MAX_HEADER {
        return Err(io::Error::new(io::ErrorKind::InvalidData, "it does not answer like a decode host"));
    }
    let mut header = vec![0; length as usize];
    input.read_exact(&mut header)?;
    serde_json::from_slice(&header).map_err(io::Error::from)
}

/// Reads a plane of `sites` values.
pub(super) fn read_plane(input: &mut impl Read, sites: usize) -> io::Result<Vec<u16>> {
    let mut plane: Vec<u16> = Vec::new();
    plane.try_reserve_exact(sites).map_err(|_| io::Error::from(io::ErrorKind::OutOfMemory))?;
    let mut bytes = vec![0; CHUNK.min(sites * 2)];
    while plane.len() < sites {
        let part = bytes.len().min((sites - plane.len()) * 2);
        input.read_exact(&mut bytes[..part])?;
        plane.extend(bytes[..part].chunks_exact(2).map(|b| u16::from_le_bytes([b[0], b[1]])));
    }
    Ok(plane)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_frame_comes_over_as_it_was_sent() {
        let (width, height) = (1024, 700);
        let plane: Vec<u16> = (0..width * height).map(|i| (i * 31) as u16).collect();
        let frame = Frame {
            width,
            height,
            active: Rect { top: 2, left: 4, bottom: 700, right: 1024 },
            cfa: Cfa::RGGB,
            masked: vec![Rect { top: 0, left: 0, bottom: 700, right: 2 }],
            black: [[2047.5; 2]; 2],
            saturation: [[15000.0; 2]; 2],
            settings: Settings { model: Some("EOS R5".into()), ..Settings::default() },
        };
        let mut pipe = Vec::new();
        answer(&mut pipe, &Answer::Frame(Box::new(frame)), &plane).unwrap();
        let mut pipe = pipe.as_slice();
        let Answer::Frame(frame) = read_answer(&mut pipe).unwrap() else { panic!("refused") };
        assert_eq!(frame.settings.model.as_deref(), Some("EOS R5"));
        assert_eq!(frame.active.bottom, 700);
        assert_eq!(read_plane(&mut pipe, width * height).unwrap(), plane);
        assert!(pipe.is_empty());
    }

    #[test]
    fn a_program_that_talks_otherwise_is_no_decode_host() {
        let error = read_answer(&mut b"usage: something else".as_slice()).unwrap_err();
        assert_eq!(error.kind(), io::ErrorKind::InvalidData);
        let error = read_answer(&mut b"unlitr".as_slice()).unwrap_err();
        assert_eq!(error.kind(), io::ErrorKind::UnexpectedEof);
    }
}
