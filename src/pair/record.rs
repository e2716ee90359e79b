//! `pair.json`: what a session keeps of one pair.

use super::order::{Order, Part, Program, Slot};
use super::{Drift, FlashRecord, Lighting, Polariser, Settings};
use serde::{Deserialize, Serialize};
use std::borrow::Borrow;
use std::fmt;

/// Whether processing may use the pair.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
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
    /// The polariser that it was seen through, where it is another than the pair's.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub polariser: Option<Polariser>,
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

/// One of the times that a pair was shot; a rejected one may be shot again under its own number.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
pub struct Attempt {
    /// Number of the pair, from 1.
    pub number: u32,
    /// Which time, from 1.
    pub attempt: u32,
}

impl Attempt {
    /// The first time that pair `number` was shot.
    pub fn first(number: u32) -> Self {
        Self { number, attempt: 1 }
    }

    /// Out of the name of a pair's folder.
    pub fn from_folder(name: &str) -> Option<Self> {
        let (digits, attempt) = match name.split_once('-') {
            None => (name, 1),
            Some((digits, attempt)) => (digits, attempt.parse().ok().filter(|n| *n > 1)?),
        };
        let numeral = digits.len() >= 4 && digits.bytes().all(|b| b.is_ascii_digit());
        let found = Self { number: digits.parse().ok().filter(|_| numeral)?, attempt };
        // One folder, one name: what is written otherwise is none of ours.
        (found.to_string() == name).then_some(found)
    }
}

impl fmt::Display for Attempt {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.attempt {
            1 => write!(f, "{:04}", self.number),
            attempt => write!(f, "{:04}-{attempt}", self.number),
        }
    }
}

impl From<u32> for Attempt {
    fn from(number: u32) -> Self {
        Attempt::first(number)
    }
}

impl From<&PairRecord> for Attempt {
    fn from(record: &PairRecord) -> Self {
        Attempt { number: record.number, attempt: record.attempt }
    }
}

/// One pair, whole: all frames decoded and checked.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct PairRecord {
    /// Number inside the session, from 1; the folder is `pairs/NNNN`.
    pub number: u32,
    /// Which time the pair was shot, from 1; the folder of the second is `pairs/NNNN-2`.
    #[serde(default = "one", skip_serializing_if = "is_one")]
    pub attempt: u32,
    /// Name by which scene cameras and per-view images are matched: the photo's file stem as imported, or
    /// the four-digit number as shot.
    pub name: String,
    /// Accepted or rejected.
    pub verdict: Verdict,
    /// Empty when accepted.
    pub reasons: Vec<Reason>,
    /// In which order its frames were shot.
    #[serde(default, skip_serializing_if = "is_default")]
    pub order: Order,
    /// How many frames without flash were to be shot in a row; a pair that was lost early has fewer.
    #[serde(default = "one_frame", skip_serializing_if = "is_one_frame")]
    pub off_frames: u8,
    /// The frame without flash; the first of them, where there are several.
    pub off: FrameRecord,
    /// The others.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub more_off: Vec<FrameRecord>,
    /// The frame with flash.
    pub on: FrameRecord,
    /// Frames without flash shot after it.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub after: Vec<FrameRecord>,
    /// A further frame with flash, through a polariser turned across. Nothing is made of it yet.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub crossed: Option<FrameRecord>,
    /// Polariser and flash power, as the operator told them.
    #[serde(default, skip_serializing_if = "Lighting::is_untold")]
    pub lighting: Lighting,
    /// How room and tripod drifted from the first frame without flash to the last; absent where there is one alone.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub drift: Option<Drift>,
    /// The controller's account; absent for imported pairs and manual flashes.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub flash: Option<FlashRecord>,
}

impl PairRecord {
    /// All frames with their places in the pair.
    pub fn frames(&self) -> impl Iterator<Item = (Slot, &FrameRecord)> {
        numbered(Part::Off, 1, std::slice::from_ref(&self.off))
            .chain(numbered(Part::Off, 2, &self.more_off))
            .chain(numbered(Part::On, 1, std::slice::from_ref(&self.on)))
            .chain(numbered(Part::After, 1, &self.after))
            .chain(numbered(Part::Crossed, 1, self.crossed.as_slice()))
    }

    /// The frames that show the room's light alone.
    pub fn dark_frames(&self) -> impl Iterator<Item = &FrameRecord> {
        self.frames().filter(|(slot, _)| !slot.part.is_lit()).map(|(_, frame)| frame)
    }

    /// One frame, if the pair has it.
    pub fn frame(&self, slot: Slot) -> Option<&FrameRecord> {
        self.frames().find(|(s, _)| *s == slot).map(|(_, frame)| frame)
    }

    /// The frames that it was to have.
    pub fn program(&self) -> Program {
        // A number that no pair can have is another program's; the usual one is nearest.
        Program::new(self.order, self.off_frames).unwrap_or_default()
    }
}

fn numbered(part: Part, from: usize, frames: &[FrameRecord]) -> impl Iterator<Item = (Slot, &FrameRecord)> {
    let index = move |i: usize| u8::try_from(i + from).unwrap_or(u8::MAX);
    frames.iter().enumerate().map(move |(i, frame)| (Slot { part, index: index(i) }, frame))
}

/// Of all times that one pair was shot the one that counts: the last that was accepted, or else the last.
pub fn current<R: Borrow<PairRecord>>(attempts: &[R]) -> Option<&R> {
    let accepted = attempts.iter().rfind(|record| (*record).borrow().verdict == Verdict::Accepted);
    accepted.or(attempts.last())
}

fn one() -> u32 {
    1
}

fn is_one(n: &u32) -> bool {
    *n == 1
}

fn one_frame() -> u8 {
    1
}

fn is_one_frame(n: &u8) -> bool {
    *n == 1
}

fn is_default<T: Default + PartialEq>(value: &T) -> bool {
    *value == T::default()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn folders_are_named_by_number_and_attempt_and_by_nothing_else() {
        for (number, attempt, name) in [(7, 1, "0007"), (7, 2, "0007-2"), (12_345, 11, "12345-11")] {
            let found = Attempt { number, attempt };
            assert_eq!((found.to_string().as_str(), Attempt::from_folder(name)), (name, Some(found)));
        }
        for other in [
            "", "7", "007", "0007-", "0007-1", "0007-0", "0007-02", "0007-x", "-2", "holidays", "0007-2-3",
            "+007", "0007-+2",
        ] {
            assert_eq!(Attempt::from_folder(other), None, "{other}");
        }
    }

    #[test]
    fn a_record_of_before_there_were_orders_reads_as_it_was_meant() {
        let frame = |name: &str| {
            serde_json::json!({
                "file": name, "original_name": name, "bytes": 3, "blake3": "00", "settings": {}
            })
        };
        let old = serde_json::json!({
            "number": 3, "name": "0003", "verdict": "accepted", "reasons": [],
            "off": frame("off.dng"), "on": frame("on.dng")
        });
        let record: PairRecord = serde_json::from_value(old.clone()).unwrap();
        assert_eq!((record.attempt, record.program()), (1, Program::default()));
        let names: Vec<String> = record.frames().map(|(slot, _)| slot.to_string()).collect();
        assert_eq!(names, ["off", "on"]);
        assert_eq!(serde_json::to_value(&record).unwrap(), old, "and is written as it was");
    }

    #[test]
    fn a_lit_frame_through_a_crossed_polariser_is_told_with_its_angle_and_is_no_dark_frame() {
        let frame = |name: &str| {
            serde_json::json!({
                "file": name, "original_name": name, "bytes": 3, "blake3": name, "settings": {}
            })
        };
        let mut crossed = frame("crossed.dng");
        crossed["polariser"] = serde_json::json!({ "angle_degrees": 120.0 });
        let told = serde_json::json!({
            "number": 3, "name": "0003", "verdict": "accepted", "reasons": [], "order": "off_on_crossed",
            "off": frame("off.dng"), "on": frame("on.dng"), "crossed": crossed,
            "lighting": { "polariser": { "angle_degrees": 30.0 }, "flash_power": 0.5 }
        });
        let record: PairRecord = serde_json::from_value(told.clone()).unwrap();
        let names: Vec<String> = record.frames().map(|(slot, _)| slot.to_string()).collect();
        assert_eq!(names, ["off", "on", "crossed"]);
        let angle = record.frame(Slot::CROSSED).unwrap().polariser.unwrap().angle_degrees;
        assert_eq!((record.order, angle), (Order::OffOnCrossed, Some(120.0)));
        assert_eq!(record.dark_frames().count(), 1);
        assert_eq!(serde_json::to_value(&record).unwrap(), told);
    }
}
