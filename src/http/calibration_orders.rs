//! Calibrations on the wire: what is asked for.

use super::camera_bodies::{ExposureBody, LightingBody};
use crate::calibration::colour::ChartKind;
use crate::calibration::guide::{Kind, Role};
use crate::capture::ShotWish;
use crate::pipeline::calibrate::guided::FitOrder;
use crate::pipeline::flash::FlashOrder;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// A frame to be shot.
#[derive(Default, Deserialize, Serialize, ToSchema)]
#[serde(default, deny_unknown_fields)]
pub(super) struct CalibrationShotOrder {
    /// As what; may be left out where there is one role only.
    #[schema(value_type = Option<String>, example = "dark")]
    #[serde(skip_serializing_if = "Option::is_none")]
    role: Option<Role>,
    /// Distance from the lens to the card along the axis, metres; of card shots.
    #[schema(example = 1.0)]
    #[serde(skip_serializing_if = "Option::is_none")]
    distance_m: Option<f64>,
    /// Where the dials are to stand for this frame; as they stand without it. Afterwards they stand as before. Not of card
    /// shots.
    #[serde(skip_serializing_if = "Option::is_none")]
    exposure: Option<ExposureBody>,
    /// How many, one after the other with nothing changed in between, 1 to 100; one without it. Of card shots, each a
    /// frame without flash and one with it.
    #[schema(example = 40)]
    #[serde(skip_serializing_if = "Option::is_none")]
    count: Option<u32>,
}

impl CalibrationShotOrder {
    /// The wish for a shot of this kind.
    pub(super) fn of(self, kind: Kind) -> ShotWish {
        let Self { role, distance_m, exposure, count } = self;
        ShotWish { kind, role, distance_m, exposure: exposure.map(Into::into), count: count.unwrap_or(1) }
    }
}

/// Raw files of the camera.
#[derive(ToSchema)]
#[expect(dead_code, reason = "describes the form to OpenAPI; the parts are read one by one")]
pub(super) struct CalibrationShotForm {
    /// The frames in the order in which they were taken; of a card shot the lit one.
    #[schema(value_type = Vec<String>, format = Binary)]
    file: Vec<Vec<u8>>,
    /// The frame without flash of a card shot, where the room was not dark.
    #[schema(value_type = Option<String>, format = Binary)]
    off: Option<Vec<u8>>,
    /// As what they were shot; may be left out where there is one role only.
    role: Option<String>,
    /// Distance from the lens to the card, metres; of card shots, where no AprilTags tell it.
    distance_m: Option<f64>,
}

/// What a fit needs to know beside its shots. A field of another kind is refused.
#[derive(Default, Deserialize, ToSchema)]
#[serde(default, deny_unknown_fields)]
pub(super) struct CalibrationOrder {
    /// `flash`: reflectance of the card, 0..1; that of office paper without it, which is neither measured nor quite
    /// Lambertian.
    #[schema(example = 0.94)]
    target_reflectance: Option<f64>,
    /// `flash`: how the card's reflectance goes with the angle from its normal: degrees, rising, and the factor.
    #[schema(example = json!([[0.0, 1.0], [20.0, 0.99], [40.0, 0.97]]))]
    target_curve: Option<Vec<[f64; 2]>>,
    /// `flash`: inner and outer radius of the ring lamp, metres; needed but with `one_shot`.
    #[schema(example = json!([0.035, 0.085]))]
    ring_radii: Option<[f64; 2]>,
    /// `flash`: lets the shots tell the radii where they can, in place of the ruler.
    fit_radii: Option<bool>,
    /// `flash`: focal length in pixels, where no scene is imported yet.
    focal_px: Option<f64>,
    /// `flash`: side of the black squares of AprilTags (tag36h11) on the card, metres.
    #[schema(example = 0.07)]
    tag_size_m: Option<f64>,
    /// `flash`: how far a tag's paper reaches beyond its black square, metres; an eighth of it without this.
    tag_outset_m: Option<f64>,
    /// `flash`: coefficients of the lens's vignetting 1 + a1 q + a2 q^2 + a3 q^3, q = (r / half diagonal)^2; the session's
    /// flat field's without it.
    vignetting: Option<[f64; 3]>,
    /// `flash`: ids of shots that are kept from the fit, to check it.
    held_out: Option<Vec<String>>,
    /// `flash`: id of the one shot that corrects the calibration that is there for another power, in place of a fit.
    #[schema(example = "d01000_1")]
    one_shot: Option<String>,
    /// `flash`: polariser and power, where they are not those that were noted with the shots.
    lighting: Option<LightingBody>,
    /// `noise`: stops of light from one level to the next, if the light was changed and not the shutter time.
    #[schema(example = 1.0)]
    stops: Option<f64>,
    /// `colour`: `colorchecker24`, `colorchecker24_before2014` or `spydercheckr24`; without it whichever fits best.
    #[schema(value_type = Option<String>, example = "colorchecker24")]
    chart: Option<ChartKind>,
    /// `colour`: outer corners of the four corner patches, pixels from the top left corner, where the chart is not
    /// found without help.
    corners_px: Option<[[f64; 2]; 4]>,
}

/// An order that makes sense.
pub(super) enum Fit {
    /// Of the flash.
    Flash(FlashOrder),
    /// Of anything else.
    Other(FitOrder),
}

impl CalibrationOrder {
    /// The order for this kind; the error is a sentence.
    pub(super) fn of(self, kind: Kind) -> Result<Fit, String> {
        let given = [
            ("target_reflectance", Kind::Flash, self.target_reflectance.is_some()),
            ("target_curve", Kind::Flash, self.target_curve.is_some()),
            ("ring_radii", Kind::Flash, self.ring_radii.is_some()),
            ("fit_radii", Kind::Flash, self.fit_radii.is_some()),
            ("focal_px", Kind::Flash, self.focal_px.is_some()),
            ("tag_size_m", Kind::Flash, self.tag_size_m.is_some()),
            ("tag_outset_m", Kind::Flash, self.tag_outset_m.is_some()),
            ("vignetting", Kind::Flash, self.vignetting.is_some()),
            ("held_out", Kind::Flash, self.held_out.is_some()),
            ("one_shot", Kind::Flash, self.one_shot.is_some()),
            ("lighting", Kind::Flash, self.lighting.is_some()),
            ("stops", Kind::Noise, self.stops.is_some()),
            ("chart", Kind::Colour, self.chart.is_some()),
            ("corners_px", Kind::Colour, self.corners_px.is_some()),
        ];
        if let Some((field, of, _)) = given.into_iter().find(|(_, of, given)| *given && *of != kind) {
            return Err(format!(
                "{field} is of the calibration of {}, not of {}; leave it out",
                of.name(),
                kind.name()
            ));
        }
        Ok(match kind {
            Kind::Levels => Fit::Other(FitOrder::Levels),
            Kind::Noise => Fit::Other(FitOrder::Noise { stops: self.stops }),
            Kind::Exposure => Fit::Other(FitOrder::Exposure),
            Kind::Flat => Fit::Other(FitOrder::Flat),
            Kind::Steadiness => Fit::Other(FitOrder::Steadiness),
            Kind::Colour => Fit::Other(FitOrder::Colour { chart: self.chart, corners_px: self.corners_px }),
            Kind::Flash => Fit::Flash(FlashOrder {
                target_reflectance: self.target_reflectance,
                target_curve: self.target_curve.unwrap_or_default(),
                ring_radii: self.ring_radii,
                fit_radii: self.fit_radii.unwrap_or_default(),
                focal_px: self.focal_px,
                tag_size_m: self.tag_size_m,
                tag_outset_m: self.tag_outset_m,
                vignetting: self.vignetting,
                held_out: self.held_out.unwrap_or_default(),
                one_shot: self.one_shot,
                lighting: self.lighting.map(Into::into),
            }),
        })
    }
}
