//! `pair.json`: what a session keeps of one pair.

use super::{FlashRecord, Settings};
use serde::{Deserialize, Serialize};

/// Whether processing may use the pair.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Verdict {
    /// Every check passed.
    Accepted,
    /// At least one check failed; the reasons say which.
    Rejected,
}

/// Why a pair was rejected.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ReasonCode {
    /// The lit frame shows no flash light, or not exactly one pulse of it.
    Misfire,
    /// Flash light reached the unlit frame.
    NotDark,
    /// The flash light is there but too little to measure with.
    Weak,
    /// Too large a share of sites is clipped.
    Overexposed,
    /// Camera or object moved between the two frames.
    Moved,
    /// The two frames differ in their settings.
    SettingsChanged,
    /// The room's light fell between the two frames.
    AmbientChanged,
    /// The camera delivered the same frame twice.
    Repeated,
    /// A file ends before its data does.
    Truncated,
    /// A file is no raw that can be decoded.
    Unreadable,
}

/// One failed check: a figure, the limit it broke, and a sentence for the photographer.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Reason {
    /// Stable name.
    pub code: ReasonCode,
    /// What was measured.
    pub figure: f64,
    /// What it is held against.
    pub limit: f64,
    /// What it means and what to do.
    pub sentence: String,
}

/// One of a pair's two original files.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct FrameRecord {
    /// File name inside the pair's folder (`off.dng`).
    pub file: String,
    /// The name under which the camera or the photographer had it.
    pub original_name: String,
    /// Length in bytes.
    pub bytes: u64,
    /// BLAKE3 of the file, hexadecimal.
    pub blake3: String,
    /// Settings out of the file's EXIF.
    pub settings: Settings,
    /// The JPEG that the camera wrote of the same release, where it writes RAW+JPEG.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub jpeg: Option<CompanionRecord>,
}

/// A second file of one release.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct CompanionRecord {
    /// File name inside the pair's folder (`off.jpg`).
    pub file: String,
    /// The name under which the camera had it.
    pub original_name: String,
    /// Length in bytes.
    pub bytes: u64,
    /// BLAKE3 of the file, hexadecimal.
    pub blake3: String,
}

/// One pair, whole: both frames decoded and checked.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct PairRecord {
    /// Number inside the session, from 1; the folder is `pairs/NNNN`.
    pub number: u32,
    /// Name by which scene cameras and per-view images are matched: the photo's file stem as imported, or
    /// the four-digit number as shot.
    pub name: String,
    /// Accepted or rejected.
    pub verdict: Verdict,
    /// Empty when accepted.
    pub reasons: Vec<Reason>,
    /// The frame without flash.
    pub off: FrameRecord,
    /// The frame with flash.
    pub on: FrameRecord,
    /// The controller's account; absent for imported pairs and manual flashes.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub flash: Option<FlashRecord>,
}
