//! What a flash calibration is asked for with, alike in a terminal and over HTTP.

use super::CardFacts;
use crate::calibration::{FieldFactor, Target};
use crate::pair::Lighting;
use crate::pipeline::card_tags::TagFacts;
use serde::{Deserialize, Serialize};

/// Reflectance of office paper.
const PAPER: f64 = 0.94;

/// What the flash calibration needs to know beside its shots.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct FlashOrder {
    /// Reflectance of the card, 0..1; office paper's without it.
    pub target_reflectance: Option<f64>,
    /// How the card's reflectance goes with the angle from its normal: degrees, rising, and the factor. Empty: Lambertian.
    pub target_curve: Vec<[f64; 2]>,
    /// Inner and outer radius of the ring lamp, metres; needed but for `one_shot`.
    pub ring_radii: Option<[f64; 2]>,
    /// Lets the shots tell the radii where they can.
    pub fit_radii: bool,
    /// Focal length in pixels, where no scene tells it.
    pub focal_px: Option<f64>,
    /// Side of the black squares of AprilTags on the card, metres.
    pub tag_size_m: Option<f64>,
    /// How far a tag's paper reaches beyond its square, metres; an eighth of it by default.
    pub tag_outset_m: Option<f64>,
    /// The lens's vignetting, as it is known; else the session's flat field's.
    pub vignetting: Option<[f64; 3]>,
    /// Shots that are kept from the fit, to check it.
    pub held_out: Vec<String>,
    /// The one shot that corrects the calibration that is there, in place of a new fit.
    pub one_shot: Option<String>,
    /// Polariser and flash power of the shots, where they are not those that were noted with them.
    pub lighting: Option<Lighting>,
}

impl FlashOrder {
    /// What the fit is to know of card, ring and lens.
    pub fn facts(&self) -> CardFacts {
        let radians = |[degrees, factor]: [f64; 2]| [degrees.to_radians(), factor];
        CardFacts {
            target: Target {
                reflectance: self.target_reflectance.unwrap_or(PAPER),
                curve: self.target_curve.iter().copied().map(radians).collect(),
            },
            paper: self.target_reflectance.is_none(),
            vignetting: self.vignetting.map(|coefficients| FieldFactor { coefficients }),
            ring_radii: self.ring_radii.unwrap_or_default(),
            focal_px: self.focal_px,
            free_radii: self.fit_radii,
            lighting: self.lighting,
            tags: self.tag_size_m.map(|size_m| TagFacts { size_m, outset_m: self.tag_outset_m }),
        }
    }

    /// Refuses what cannot be, with a sentence.
    pub fn checked(&self) -> Result<(), String> {
        let refuse = |wrong: bool, words: String| if wrong { Err(words) } else { Ok(()) };
        let metres = |of: Option<f64>| of.is_some_and(|m| !(m > 0.0 && m < 10.0));
        if let Some(given) = self.target_reflectance {
            let words =
                format!("target_reflectance is {given}, but a card's reflectance lies between 0 and 1");
            refuse(!(given > 0.0 && given <= 1.0), words)?;
        }
        let rising = self.target_curve.windows(2).all(|two| two[1][0] > two[0][0]);
        let within =
            |[degrees, factor]: &[f64; 2]| (0.0..89.9).contains(degrees) && *factor > 0.0 && *factor < 10.0;
        refuse(
            !(rising && self.target_curve.iter().all(within)),
            "target_curve takes angles in degrees, 0 to less than 89.9 and rising, each with the factor on the reflectance, more than 0 and less than 10".into(),
        )?;
        if let Some(focal) = self.focal_px {
            let words = format!("focal_px is {focal}, but a focal length is greater than 0");
            refuse(!(focal.is_finite() && focal > 0.0), words)?;
        }
        if let Some(wrong) = [self.tag_size_m, self.tag_outset_m].into_iter().find(|m| metres(*m)).flatten() {
            return Err(format!(
                "tag_size_m and tag_outset_m are lengths in metres; {wrong} cannot be one of a tag's"
            ));
        }
        refuse(
            self.tag_outset_m.is_some() && self.tag_size_m.is_none(),
            "tag_outset_m is of AprilTags on the card; give their tag_size_m, too".into(),
        )?;
        refuse(
            self.vignetting.is_some_and(|curve| curve.iter().any(|a| !a.is_finite())),
            "vignetting takes three coefficients, of q, q^2 and q^3".into(),
        )?;
        if let Some(lighting) = &self.lighting {
            lighting.checked()?;
        }
        if self.one_shot.is_some() {
            let alone = self.ring_radii.is_none() && !self.fit_radii && self.vignetting.is_none();
            return refuse(
                !(alone && self.held_out.is_empty()),
                "one_shot corrects what was measured: leave ring_radii, fit_radii, vignetting and held_out out".into(),
            );
        }
        let missing = "ring_radii is missing: inner and outer radius of the ring lamp in metres";
        let [inner, outer] = self.ring_radii.ok_or(missing)?;
        let words = format!(
            "ring_radii are {inner} and {outer}; give the inner, then the larger outer radius in metres"
        );
        refuse(!(inner >= 0.0 && outer > inner && outer < 1.0), words)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn an_order_is_whole_or_refused_with_what_is_wrong() {
        let judged = |order: serde_json::Value| {
            let order: FlashOrder = serde_json::from_value(order).unwrap();
            order.checked().err().unwrap_or_default()
        };
        let ring = json!([0.035, 0.085]);
        assert_eq!(judged(json!({ "ring_radii": ring })), "");
        assert_eq!(judged(json!({ "one_shot": "d01000_1", "target_reflectance": 0.9 })), "");
        for (order, words) in [
            (json!({}), "ring_radii is missing"),
            (json!({ "ring_radii": [0.1, 0.05] }), "larger outer"),
            (json!({ "ring_radii": ring, "target_reflectance": 1.2 }), "target_reflectance is 1.2"),
            (json!({ "ring_radii": ring, "target_curve": [[20, 0.9], [10, 1.0]] }), "rising"),
            (json!({ "ring_radii": ring, "target_curve": [[0, 1], [20, 0]] }), "more than 0"),
            (json!({ "ring_radii": ring, "focal_px": 0 }), "focal_px is 0"),
            (json!({ "ring_radii": ring, "tag_size_m": -0.05 }), "-0.05 cannot be"),
            (json!({ "ring_radii": ring, "tag_outset_m": 0.01 }), "tag_size_m, too"),
            (json!({ "ring_radii": ring, "one_shot": "1" }), "leave ring_radii"),
            (json!({ "ring_radii": ring, "lighting": { "flash_power": 2 } }), "flash_power is 2"),
        ] {
            let said = judged(order.clone());
            assert!(said.contains(words), "{order}: {said}");
        }
    }
}
