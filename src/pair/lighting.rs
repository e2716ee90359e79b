//! What no file tells of how photographs are lit and seen, and the operator has to: the polariser, the flash's power.

use serde::{Deserialize, Serialize};
use std::fmt;

/// How far apart two angles of a polariser may be and still be called one, degrees: what its ring can be read to.
const SAME_ANGLE: f64 = 2.0;

/// How far apart two settings of the flash's power may be and still be called one, relative: labels are rounded.
const SAME_POWER: f64 = 0.02;

/// A linear polariser before the lens.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Polariser {
    /// Its angle in degrees, as its ring is read; a half turn is the same. Absent where nobody read it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub angle_degrees: Option<f64>,
}

/// Polariser and flash power of a session, a pair or a calibration, as the operator told them.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Lighting {
    /// The polariser; absent is none.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub polariser: Option<Polariser>,
    /// To which part of its full power the flash is set, 0 to 1; absent where nobody told.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub flash_power: Option<f64>,
}

impl Polariser {
    /// Whether both let the same light through, as far as their angles are told.
    fn same(self, other: Self) -> bool {
        let (Some(a), Some(b)) = (self.angle_degrees, other.angle_degrees) else { return true };
        let apart = (a - b).rem_euclid(180.0);
        apart.min(180.0 - apart) <= SAME_ANGLE
    }
}

impl fmt::Display for Polariser {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.angle_degrees {
            Some(angle) => write!(f, "at {angle} degrees"),
            None => f.write_str("at an angle not told"),
        }
    }
}

impl Lighting {
    /// Whether nothing was told.
    pub fn is_untold(&self) -> bool {
        *self == Self::default()
    }

    /// Refuses what cannot be, with a sentence.
    pub fn checked(self) -> Result<Self, String> {
        match (self.polariser.and_then(|p| p.angle_degrees), self.flash_power) {
            (Some(angle), _) if !(-360.0..=360.0).contains(&angle) => {
                Err(format!("the polariser's angle is {angle}; give degrees from -360 to 360"))
            }
            (_, Some(power)) if !(power > 0.0 && power <= 1.0) => Err(format!(
                "flash_power is {power}; give the part of the flash's full power, 0.25 say, above 0 and at most 1"
            )),
            _ => Ok(self),
        }
    }

    /// The polariser in words.
    pub fn polariser_words(&self) -> String {
        self.polariser.map_or_else(|| "none".into(), |p| p.to_string())
    }

    /// Whether both are seen through the same polariser, or both through none.
    pub fn same_polariser(&self, other: &Self) -> bool {
        match (self.polariser, other.polariser) {
            (Some(one), Some(other)) => one.same(other),
            (one, other) => one.is_none() && other.is_none(),
        }
    }

    /// Whether the flash was set to one power in both; what either does not tell is not held against it.
    pub fn same_power(&self, other: &Self) -> bool {
        let (Some(a), Some(b)) = (self.flash_power, other.flash_power) else { return true };
        (a / b).ln().abs() <= SAME_POWER
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn through(angle: Option<f64>) -> Lighting {
        Lighting { polariser: Some(Polariser { angle_degrees: angle }), flash_power: None }
    }

    #[test]
    fn polarisers_are_the_same_by_presence_and_by_angle_up_to_half_a_turn() {
        let none = Lighting::default();
        assert!(none.same_polariser(&none) && !none.same_polariser(&through(None)));
        assert!(!through(Some(0.0)).same_polariser(&none));
        assert!(through(Some(179.0)).same_polariser(&through(Some(0.0))));
        assert!(through(Some(30.0)).same_polariser(&through(Some(-150.0))));
        assert!(!through(Some(0.0)).same_polariser(&through(Some(90.0))));
        assert!(
            through(Some(30.0)).same_polariser(&through(None)),
            "what is not told is not held against it"
        );
    }

    #[test]
    fn powers_are_the_same_within_their_labels() {
        let at = |power| Lighting { flash_power: power, ..Lighting::default() };
        assert!(at(Some(0.25)).same_power(&at(Some(0.251))) && at(None).same_power(&at(Some(1.0))));
        assert!(!at(Some(0.25)).same_power(&at(Some(0.5))));
    }

    #[test]
    fn what_cannot_be_is_refused() {
        let at = |power| Lighting { flash_power: Some(power), ..Lighting::default() };
        assert!(at(0.25).checked().is_ok() && through(Some(-90.0)).checked().is_ok());
        for wrong in [at(0.0), at(1.5), at(f64::NAN), through(Some(400.0)), through(Some(f64::NAN))] {
            assert!(wrong.checked().is_err(), "{wrong:?}");
        }
    }

    #[test]
    fn what_was_not_told_is_not_written() {
        assert_eq!(serde_json::to_string(&Lighting::default()).unwrap(), "{}");
        let told = Lighting { flash_power: Some(0.25), ..through(Some(30.0)) };
        let json = serde_json::to_string(&told).unwrap();
        assert_eq!(json, r#"{"polariser":{"angle_degrees":30.0},"flash_power":0.25}"#);
        assert_eq!(serde_json::from_str::<Lighting>(&json).unwrap(), told);
        assert!(!told.is_untold() && Lighting::default().is_untold());
    }
}
