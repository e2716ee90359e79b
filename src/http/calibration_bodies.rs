//! Calibrations on the wire.

use super::camera_bodies::{ExposureBody, LightingBody};
use super::links;
use crate::calibration::colour::ChartKind;
use crate::calibration::guide::{Guide, Kind, Role, Take};
use crate::capture::{CalibrationState, SeriesShot, ShotWish};
use crate::pipeline::calibrate::guided::{FitOrder, Measured};
use crate::pipeline::calibrate::waiting::Origin;
use crate::pipeline::flash::FlashOrder;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// A kind of calibration, in a path.
#[derive(Clone, Copy, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub(super) enum CalibrationKind {
    /// Black and saturation of the sensor.
    Levels,
    /// Gain, read noise, linearity.
    Noise,
    /// What the steps of ISO, shutter and aperture truly do.
    Exposure,
    /// Vignetting.
    Flat,
    /// The flash.
    Flash,
    /// Repeatability of the flash.
    Steadiness,
    /// Camera RGB to linear sRGB and ACEScg.
    Colour,
}

impl From<CalibrationKind> for Kind {
    fn from(kind: CalibrationKind) -> Self {
        match kind {
            CalibrationKind::Levels => Kind::Levels,
            CalibrationKind::Noise => Kind::Noise,
            CalibrationKind::Exposure => Kind::Exposure,
            CalibrationKind::Flat => Kind::Flat,
            CalibrationKind::Flash => Kind::Flash,
            CalibrationKind::Steadiness => Kind::Steadiness,
            CalibrationKind::Colour => Kind::Colour,
        }
    }
}

/// Frames of one role.
#[derive(Serialize, ToSchema)]
pub(super) struct TakeBody {
    /// `dark`, `blown`, `even`, `step`, `card`, `lit`, `chart` or `room`.
    #[schema(value_type = String, example = "dark")]
    role: Role,
    /// What such frames are called.
    name: &'static str,
    /// How to take one.
    words: &'static str,
    /// How many are wanted.
    count: &'static str,
    /// The same as a number; 0 where none is needed.
    wanted: usize,
    /// Shots that wait and can be used.
    taken: usize,
}

/// How a calibration is made, in words for people.
#[derive(Serialize, ToSchema)]
pub(super) struct GuideBody {
    /// Its name for people.
    title: &'static str,
    /// What it tells, and what is used without it.
    gives: &'static str,
    /// What to do, in order.
    steps: Vec<&'static str>,
    /// The frames that it takes.
    takes: Vec<TakeBody>,
    /// How the same is done from files in a terminal.
    command: &'static str,
}

/// A shot that the next fit takes.
#[derive(Serialize, ToSchema)]
pub(super) struct CalibrationShotBody {
    /// By which it is removed.
    #[schema(example = "1")]
    id: String,
    /// As what it was shot.
    #[schema(value_type = String, example = "dark")]
    role: Role,
    /// Distance from the lens to the card, metres; of card shots.
    distance_m: Option<f64>,
    /// Path of its frame inside the session folder.
    file: String,
    /// Where to fetch the frame.
    url: String,
    /// Where to fetch the frame without flash; of card shots.
    off_url: Option<String>,
    /// BLAKE3 of the frame, hexadecimal.
    blake3: String,
    /// `camera` or `upload`.
    #[schema(value_type = String, example = "camera")]
    origin: Origin,
    /// Exposure time as labelled.
    shutter_s: Option<f64>,
    /// Relative aperture as labelled.
    aperture: Option<f64>,
    /// Sensitivity as labelled.
    iso: Option<f64>,
    /// The exposure in words.
    exposure: String,
    /// Mean of the brightest colour, 0 at black and 1 at saturation; absent of card shots that were taken here.
    mean_share: Option<f64>,
    /// Share of the sites that clip, of the colour that does most.
    clipped_share: Option<f64>,
    /// Why the fit leaves it out, in sentences.
    reasons: Vec<String>,
    /// What is wrong with its exposure, and what to do; absent if nothing is, and of card shots that were taken here.
    fault: Option<&'static str>,
    /// Whether what was measured comes from it.
    in_record: bool,
}

/// Of what a calibration is true; what does not limit it, or is not known, is absent or empty.
#[derive(Serialize, ToSchema)]
pub(super) struct ValidityBody {
    /// Camera maker.
    make: Option<String>,
    /// Camera model.
    model: Option<String>,
    /// Body serial number.
    serial: Option<String>,
    /// Lens.
    lens: Option<String>,
    /// Relative apertures.
    apertures: Vec<f64>,
    /// Sensitivities.
    isos: Vec<f64>,
    /// Polariser and flash power.
    lighting: LightingBody,
    /// All of it in one sentence.
    words: String,
}

/// A file of a calibration.
#[derive(Serialize, ToSchema)]
pub(super) struct CalibrationFileBody {
    /// Its name: `levels.json` (the record), `levels.svg` (the figure), `report.html`.
    #[schema(example = "levels.svg")]
    name: String,
    /// Where to fetch it.
    url: String,
}

/// What was measured, in short; `GET .../calibration/{kind}` has all of it.
#[derive(Serialize, ToSchema)]
pub(super) struct MeasuredBody {
    /// When, UTC.
    measured: String,
    /// Whether processing should use it.
    good: bool,
    /// What to make of it, the most important first.
    sentences: Vec<String>,
    /// Of what it is true.
    validity: ValidityBody,
    /// How many shots it comes from, those left out included.
    shots: usize,
    /// Record, figure and report.
    files: Vec<CalibrationFileBody>,
}

/// How one calibration stands.
#[derive(Serialize, ToSchema)]
pub(super) struct CalibrationBody {
    /// `levels`, `noise`, `exposure`, `flat`, `flash`, `steadiness` or `colour`.
    #[schema(value_type = String, example = "levels")]
    kind: Kind,
    /// How it is made.
    guide: GuideBody,
    /// The shots that the next fit takes.
    shots: Vec<CalibrationShotBody>,
    /// What they lack for a fit that is worth its while, in sentences.
    lacks: Vec<String>,
    /// What was measured; absent if nothing was.
    measured: Option<MeasuredBody>,
    /// Why what was measured cannot be read.
    unreadable: Option<String>,
}

impl CalibrationBody {
    pub(super) fn new(session: &str, state: CalibrationState) -> Self {
        let CalibrationState { kind, shots, lacks, measured, unreadable } = state;
        let Guide { title, gives, steps, takes, command, .. } = *kind.guide();
        let take = |take: &Take| TakeBody {
            role: take.role,
            name: take.name,
            words: take.words,
            count: take.count,
            wanted: take.wanted,
            taken: shots.iter().filter(|shot| shot.role == take.role && shot.is_usable()).count(),
        };
        let takes = takes.iter().map(take).collect();
        Self {
            kind,
            guide: GuideBody { title, gives, steps: steps.to_vec(), takes, command },
            shots: shots.into_iter().map(|shot| CalibrationShotBody::new(session, shot)).collect(),
            lacks,
            measured: measured.map(|measured| MeasuredBody::new(session, measured)),
            unreadable,
        }
    }
}

impl CalibrationShotBody {
    pub(super) fn new(session: &str, shot: SeriesShot) -> Self {
        let SeriesShot { shutter, aperture, iso, .. } = shot;
        let told =
            [shutter.map(|v| v.to_string()), aperture.map(|v| v.to_string()), iso.map(|v| v.to_string())];
        Self {
            url: links::file(session, &shot.file),
            off_url: shot.off.map(|off| links::file(session, &off)),
            id: shot.id,
            role: shot.role,
            distance_m: shot.distance_m,
            file: shot.file,
            blake3: shot.blake3,
            origin: shot.origin,
            shutter_s: shutter.map(|v| v.0),
            aperture: aperture.map(|v| v.0),
            iso: iso.map(|v| v.0),
            exposure: told.into_iter().flatten().collect::<Vec<_>>().join(", "),
            mean_share: shot.mean_share,
            clipped_share: shot.clipped_share,
            reasons: shot.reasons,
            fault: shot.fault,
            in_record: shot.in_record,
        }
    }
}

impl MeasuredBody {
    fn new(session: &str, measured: Measured) -> Self {
        let Measured { when, verdict, validity, files, shots } = measured;
        let words = validity.words();
        let file = |path: String| CalibrationFileBody {
            url: links::file(session, &path),
            name: path.rsplit('/').next().unwrap_or(&path).to_owned(),
        };
        Self {
            measured: when,
            good: verdict.good,
            sentences: verdict.sentences,
            validity: ValidityBody {
                make: validity.rig.make,
                model: validity.rig.model,
                serial: validity.rig.serial,
                lens: validity.rig.lens,
                apertures: validity.apertures.iter().map(|n| n.0).collect(),
                isos: validity.isos.iter().map(|iso| iso.0).collect(),
                lighting: validity.rig.lighting.into(),
                words,
            },
            shots: shots.len(),
            files: files.into_iter().map(file).collect(),
        }
    }
}

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
