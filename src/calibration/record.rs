//! A calibration as it is kept: figures, the shots that they come from, and of which rig they are true.

use crate::pair::{Lighting, Settings};
use crate::units::{FNumber, Iso, Seconds};
use serde::{Deserialize, Serialize};

/// Form of the records that this program writes; one that is higher was written by a later program.
pub const SCHEMA: u32 = 2;

/// A fit with all that makes its figures traceable. In JSON the fit's own fields stand beside these.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Record<T> {
    /// [`SCHEMA`] at the time of writing.
    pub schema: u32,
    /// When the fit was made, UTC.
    pub measured: String,
    /// Name and version of the program that made it.
    pub software: String,
    /// Of what it is true.
    pub rig: Rig,
    /// Every shot that was given, those left out included.
    pub shots: Vec<Shot>,
    /// What to make of it.
    pub verdict: Verdict,
    /// The figures with their residuals.
    #[serde(flatten)]
    pub fit: T,
}

/// Body and lens that took the shots, as their files tell (absent is what no file tells), and what the operator told.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Rig {
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
    /// Polariser and flash power.
    #[serde(default, skip_serializing_if = "Lighting::is_untold")]
    pub lighting: Lighting,
}

/// One shot of a series.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Shot {
    /// Its copy's path from the session's folder, with slashes.
    pub file: String,
    /// BLAKE3, hexadecimal.
    pub blake3: String,
    /// Exposure time.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub shutter: Option<Seconds>,
    /// Relative aperture.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub aperture: Option<FNumber>,
    /// Sensitivity.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub iso: Option<Iso>,
    /// Why it was left out of the fit, in words; absent if it was used.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub left_out: Option<String>,
}

/// An ISO whose shots did not tell what they were taken for. What the other ISOs' shots told stands.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct NotMeasured {
    /// ISO label.
    pub iso: Iso,
    /// Why, in words.
    pub why: String,
}

impl NotMeasured {
    /// In one sentence.
    pub(super) fn words(&self, missing: &str) -> String {
        format!("At {} {missing}: {}.", self.iso, self.why)
    }
}

/// Whether a fit can be relied on, in words for people.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Verdict {
    /// Whether processing should use it.
    pub good: bool,
    /// One sentence a finding, the most important first.
    pub sentences: Vec<String>,
}

/// Two shots, or a calibration and a photograph, that are not of one rig.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("its {what} is {found:?}, but that of {of} is {expected:?}")]
pub struct OtherRig {
    /// What differs.
    pub what: &'static str,
    /// What it is. Boxed, as the next: it stands in errors of errors of errors.
    pub found: Box<str>,
    /// What it should be.
    pub expected: Box<str>,
    /// Whose it should be: "the calibration", "the first shot".
    pub of: &'static str,
}

impl Rig {
    /// The rig that a file's settings tell.
    pub fn of(settings: &Settings) -> Self {
        let Settings { make, model, serial, lens, .. } = settings.clone();
        Self { make, model, serial, lens, lighting: Lighting::default() }
    }

    /// Whether it is known which body it is. If not, frames of every body pass for its own, and that has to be said.
    pub fn tells_body(&self) -> bool {
        self.model.is_some()
    }

    /// Refuses a frame of another body. What either does not tell is not held against it.
    pub fn same_body(&self, settings: &Settings, of: &'static str) -> Result<(), OtherRig> {
        let found = Self::of(settings);
        same("camera model", &found.model, &self.model, of)?;
        same("body serial number", &found.serial, &self.serial, of)
    }

    /// Refuses a frame of another body or through another lens.
    pub fn same_lens(&self, settings: &Settings, of: &'static str) -> Result<(), OtherRig> {
        self.same_body(settings, of)?;
        same("lens", &settings.lens, &self.lens, of)
    }

    /// Refuses what was seen through another polariser, or through one where here is none. What nobody told counts as
    /// none: a polariser takes half of the light and more.
    pub fn same_polariser(&self, lighting: &Lighting, of: &'static str) -> Result<(), OtherRig> {
        if self.lighting.same_polariser(lighting) {
            return Ok(());
        }
        let (found, expected) = (lighting.polariser_words(), self.lighting.polariser_words());
        Err(OtherRig { what: "polariser", found: found.into(), expected: expected.into(), of })
    }

    /// Refuses another power of the flash, as far as both were told.
    pub fn same_power(&self, lighting: &Lighting, of: &'static str) -> Result<(), OtherRig> {
        let power = |of: &Lighting| of.flash_power.unwrap_or(1.0).to_string().into();
        match self.lighting.same_power(lighting) {
            true => Ok(()),
            false => {
                let (found, expected) = (power(lighting), power(&self.lighting));
                Err(OtherRig { what: "flash power", found, expected, of })
            }
        }
    }
}

fn same(
    what: &'static str,
    found: &Option<String>,
    expected: &Option<String>,
    of: &'static str,
) -> Result<(), OtherRig> {
    match (found, expected) {
        (Some(found), Some(expected)) if found.trim() != expected.trim() => {
            Err(OtherRig { what, found: found.as_str().into(), expected: expected.as_str().into(), of })
        }
        _ => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::pair::Polariser;

    fn settings(model: &str, serial: Option<&str>, lens: Option<&str>) -> Settings {
        let text = |t: &str| t.to_owned();
        Settings {
            model: Some(model.into()),
            serial: serial.map(text),
            lens: lens.map(text),
            ..Settings::default()
        }
    }

    #[test]
    fn another_body_or_lens_is_refused_and_what_is_not_told_is_not() {
        let rig = Rig::of(&settings("EOS 6D", Some("17"), Some("50 mm")));
        assert_eq!(rig.same_lens(&settings("EOS 6D", None, None), "the calibration"), Ok(()));
        assert_eq!(rig.same_body(&settings("EOS 6D", Some("17"), Some("35 mm")), "the calibration"), Ok(()));
        let told = |other: Settings| rig.same_lens(&other, "the calibration").unwrap_err().to_string();
        assert!(told(settings("EOS 5DS", Some("17"), None)).contains("camera model"));
        assert!(told(settings("EOS 6D", Some("18"), None)).contains("serial number is \"18\""));
        let lens = told(settings("EOS 6D", Some("17"), Some("35 mm")));
        assert_eq!(lens, "its lens is \"35 mm\", but that of the calibration is \"50 mm\"");
    }

    #[test]
    fn another_polariser_is_refused() {
        let through = |angle: f64| Lighting {
            polariser: Some(Polariser { angle_degrees: Some(angle) }),
            ..Lighting::default()
        };
        let rig = Rig { lighting: through(30.0), ..Rig::default() };
        assert_eq!(rig.same_polariser(&through(210.0), "the calibration"), Ok(()));
        let told = |rig: &Rig, other: Lighting| {
            rig.same_polariser(&other, "the calibration").unwrap_err().to_string()
        };
        let crossed = told(&rig, through(120.0));
        assert_eq!(
            crossed,
            "its polariser is \"at 120 degrees\", but that of the calibration is \"at 30 degrees\""
        );
        assert!(told(&rig, Lighting::default()).contains("polariser is \"none\""));
        assert!(told(&Rig::default(), through(0.0)).contains("calibration is \"none\""));
        let json = serde_json::to_string(&rig).unwrap();
        assert_eq!(serde_json::from_str::<Rig>(&json).unwrap(), rig);
        assert_eq!(serde_json::to_string(&Rig::default()).unwrap(), "{}");
    }

    #[test]
    fn a_records_fit_stands_beside_its_origin() {
        #[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
        struct Fit {
            black_dn: [[f64; 2]; 2],
        }
        let record = Record {
            schema: SCHEMA,
            measured: "2026-11-23T10:00:00Z".into(),
            software: "unlit".into(),
            rig: Rig::default(),
            shots: vec![],
            verdict: Verdict { good: true, sentences: vec![] },
            fit: Fit { black_dn: [[2048.0; 2]; 2] },
        };
        let json = serde_json::to_value(&record).unwrap();
        assert_eq!(json["black_dn"][1][0], 2048.0);
        assert_eq!(serde_json::from_value::<Record<Fit>>(json).unwrap(), record);
    }
}
