//! Canon's maker notes: what EXIF does not tell of a frame but the exposure lock must know.
//!
//! Takes the directory of the notes, adds to [`Settings`]. Tags 0x0001 (CameraSettings, 16-bit, counted from 1) and
//! 0x4018 (LightingOpt, 32-bit, counted from 1), in the words that ExifTool prints; a number that it has no word for
//! is told as `Unknown (n)`.

use super::raw::tiffdir::Directory;
use crate::pair::Settings;

pub(super) const CAMERA_SETTINGS: u16 = 0x0001;
pub(super) const LIGHTING: u16 = 0x4018;

/// Places in CameraSettings.
pub(super) const QUALITY: usize = 3;
pub(super) const DRIVE: usize = 5;
pub(super) const FOCUS: usize = 7;
/// Places in LightingOpt.
pub(super) const TONE_PRIORITY: usize = 3;
pub(super) const LONG_EXPOSURE: usize = 4;
pub(super) const HIGH_ISO: usize = 5;

const DRIVES: &[(i64, &str)] = &[
    (0, "Single"),
    (1, "Continuous"),
    (2, "Movie"),
    (3, "Continuous, Speed Priority"),
    (4, "Continuous, Low"),
    (5, "Continuous, High"),
    (6, "Silent Single"),
    (8, "Continuous, High+"),
    (9, "Single, Silent"),
    (10, "Continuous, Silent"),
];
const FOCUSES: &[(i64, &str)] = &[
    (0, "One-shot AF"),
    (1, "AI Servo AF"),
    (2, "AI Focus AF"),
    (3, "Manual Focus (3)"),
    (4, "Single"),
    (5, "Continuous"),
    (6, "Manual Focus (6)"),
    (16, "Pan Focus"),
    (256, "AF + MF"),
    (257, "Live View"),
    (512, "Movie Snap Focus"),
    (519, "Movie Servo AF"),
];
const OFF_ON: &[(i64, &str)] = &[(0, "Off"), (1, "On")];
const OFF_AUTO_ON: &[(i64, &str)] = &[(0, "Off"), (1, "Auto"), (2, "On")];
const STRENGTHS: &[(i64, &str)] = &[(0, "Standard"), (1, "Low"), (2, "Strong"), (3, "Off")];

/// Adds what the notes tell.
pub(super) fn add(settings: &mut Settings, notes: &Directory) {
    let camera = notes.unsigned(CAMERA_SETTINGS).unwrap_or_default();
    // -1 stands for what the body does not tell.
    let signed_16 = |at: usize| camera.get(at).map(|v| i64::from(*v as u16 as i16)).filter(|v| *v >= 0);
    settings.drive_mode = word(signed_16(DRIVE), DRIVES);
    settings.focus_mode = word(signed_16(FOCUS), FOCUSES);
    let lighting = notes.unsigned(LIGHTING).unwrap_or_default();
    let signed_32 = |at: usize| lighting.get(at).map(|v| i64::from(*v as u32 as i32)).filter(|v| *v >= 0);
    settings.highlight_tone_priority = word(signed_32(TONE_PRIORITY), OFF_ON);
    settings.long_exposure_noise_reduction = word(signed_32(LONG_EXPOSURE), OFF_AUTO_ON);
    settings.high_iso_noise_reduction = word(signed_32(HIGH_ISO), STRENGTHS);
}

fn word(value: Option<i64>, words: &[(i64, &str)]) -> Option<String> {
    let value = value?;
    let known = words.iter().find(|(number, _)| *number == value);
    Some(known.map_or_else(|| format!("Unknown ({value})"), |(_, word)| (*word).to_owned()))
}

/// Canon's numbers for the words of `settings`, as (drive, focus, [tone priority, long exposure, high ISO]); a word
/// that is absent or none of Canon's has no number.
pub(super) fn numbers(settings: &Settings) -> (Option<i16>, Option<i16>, [Option<i32>; 3]) {
    let number = |told: &Option<String>, words: &[(i64, &str)]| {
        let told = told.as_deref()?;
        words.iter().find(|(_, word)| *word == told).map(|(number, _)| *number as i32)
    };
    (
        number(&settings.drive_mode, DRIVES).map(|n| n as i16),
        number(&settings.focus_mode, FOCUSES).map(|n| n as i16),
        [
            number(&settings.highlight_tone_priority, OFF_ON),
            number(&settings.long_exposure_noise_reduction, OFF_AUTO_ON),
            number(&settings.high_iso_noise_reduction, STRENGTHS),
        ],
    )
}
