//! What can be wrong with a raw file, each in a sentence that says what to do.

use crate::pair::{Reason, ReasonCode};
use crate::photometry::levels::Unmeasured;

/// Why a file gives no sensor values. `what` names the file.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum RawError {
    /// The file cannot be read from the disk.
    #[error("{what} cannot be read: {source}; check the path and its permissions")]
    Read {
        /// The file.
        what: String,
        /// The system's own word.
        source: std::io::Error,
    },
    /// It was read with the levels of another body.
    #[error("{what} cannot be judged: {source}")]
    OtherBody {
        /// The file.
        what: String,
        /// Whose levels, and whose file.
        source: Unmeasured,
    },
    /// The file is shorter than its own directory says.
    #[error(
        "{what} is cut short: {has} bytes are there, its directory speaks of {needs}; copy it again from the camera's card"
    )]
    Truncated {
        /// The file.
        what: String,
        /// Bytes there.
        has: u64,
        /// Bytes that its directory needs at least.
        needs: u64,
    },
    /// The compressed sensor data does not end with its end marker.
    #[error(
        "{what} is cut short: its compressed sensor data has no end marker (EOI) at byte {at}; copy it again from the camera's card"
    )]
    NoEndMarker {
        /// The file.
        what: String,
        /// Where the marker should be.
        at: u64,
    },
    /// Not a raw file of any kind.
    #[error(
        "{what} is no camera raw file ({looks}); give the raw that the camera wrote (CR2, CR3, NEF, ARW, RAF, RW2, ORF, DNG)"
    )]
    NotRaw {
        /// The file.
        what: String,
        /// What its first bytes look like.
        looks: &'static str,
    },
    /// The file holds already demosaiced pixels.
    #[error(
        "{what} has no CFA: already demosaiced ({how}), so the sensor's own values are gone; give the camera's original raw or a DNG that is not linear"
    )]
    Demosaiced {
        /// The file.
        what: String,
        /// What the file calls its pixels.
        how: &'static str,
    },
    /// Only previews inside.
    #[error("{what} holds no sensor data, only previews or metadata; give the camera's original raw")]
    NoSensorData {
        /// The file.
        what: String,
    },
    /// The filter array is not a 2x2 Bayer pattern of red, green and blue.
    #[error(
        "{what} has the colour filter array {pattern}; only 2x2 arrays of one red, two green, one blue are supported"
    )]
    Pattern {
        /// The file.
        what: String,
        /// The array as the file gives it.
        pattern: String,
    },
    /// More pixels than any camera has, or than the file can hold.
    #[error(
        "{what} claims {width} x {height} sites in {bytes} bytes, which cannot be true; the file is damaged"
    )]
    Implausible {
        /// The file.
        what: String,
        /// Claimed columns.
        width: u64,
        /// Claimed rows.
        height: u64,
        /// Length of the file.
        bytes: u64,
    },
    /// The file contradicts itself.
    #[error("{what} is damaged or hostile: {why}; copy it again from the camera's card")]
    Damaged {
        /// The file.
        what: String,
        /// What is wrong.
        why: String,
    },
    /// A camera or a layout of pixels that none of the readers knows.
    #[error(
        "{what} stores its sensor data in a way that cannot be read here ({how}); convert it to an uncompressed or losslessly compressed DNG"
    )]
    Unsupported {
        /// The file.
        what: String,
        /// Compression or layout.
        how: String,
    },
    /// Only the second decoder reads such files, and nobody told where it is.
    #[error(
        "{what} needs the second decoder ({why}), and this program does not know where to find it; name an `unlit` binary with `set_decoder_program`, or use `unlit` itself"
    )]
    NoSecondDecoder {
        /// The file.
        what: String,
        /// What the first decoder does not know.
        why: String,
    },
    /// The second decoder's process did not get to the end of the file.
    #[error(
        "{what} cannot be decoded: the second decoder was stopped, {how}; the file is probably damaged: copy it again from the camera's card"
    )]
    DecoderProcess {
        /// The file.
        what: String,
        /// How it ended.
        how: String,
    },
    /// The decoder library gave up.
    #[error(
        "{what} cannot be decoded: {message}; if other programs open it, convert it to DNG, else copy it again from the card"
    )]
    Decoder {
        /// The file.
        what: String,
        /// The library's own words.
        message: String,
    },
}

impl RawError {
    /// The reason under which a pair with this file is rejected: `truncated` with the bytes there against
    /// the bytes needed, `unreadable` with 0 frames decoded against 1 for everything else.
    pub fn reason(&self) -> Reason {
        let (code, figure, limit) = match self {
            RawError::Truncated { has, needs, .. } => (ReasonCode::Truncated, *has as f64, *needs as f64),
            RawError::NoEndMarker { .. } => (ReasonCode::Truncated, 0.0, 1.0),
            _ => (ReasonCode::Unreadable, 0.0, 1.0),
        };
        Reason { code, figure, limit, sentence: self.to_string() }
    }
}
