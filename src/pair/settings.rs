//! Camera settings as a file's EXIF or the camera's own report gives them.

use crate::units::{FNumber, Iso, Seconds};
use serde::{Deserialize, Serialize};

/// What is known of the settings of one frame. Absent means not told, never zero.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Settings {
    /// Camera maker.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub make: Option<String>,
    /// Camera model.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub model: Option<String>,
    /// Body serial number.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub serial: Option<String>,
    /// Lens model.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub lens: Option<String>,
    /// Exposure time.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub shutter: Option<Seconds>,
    /// Relative aperture.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub aperture: Option<FNumber>,
    /// Sensitivity.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub iso: Option<Iso>,
    /// Focal length in millimetres.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub focal_length_mm: Option<f64>,
    /// Exposure program as EXIF words it ("Manual").
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub exposure_program: Option<String>,
    /// White balance as EXIF words it ("Manual").
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub white_balance: Option<String>,
    /// When the frame was taken, EXIF's local time, `YYYY-MM-DDTHH:MM:SS`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub taken_at: Option<String>,
    /// Focus mode as ExifTool words the maker's note ("Manual Focus (3)").
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub focus_mode: Option<String>,
    /// Drive mode as ExifTool words the maker's note ("Single").
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub drive_mode: Option<String>,
    /// Highlight tone priority as ExifTool words the maker's note ("Off"): it shifts the sensor's gain.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub highlight_tone_priority: Option<String>,
    /// Long exposure noise reduction as ExifTool words the maker's note ("Off").
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub long_exposure_noise_reduction: Option<String>,
    /// High ISO noise reduction as ExifTool words the maker's note ("Standard").
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub high_iso_noise_reduction: Option<String>,
}
