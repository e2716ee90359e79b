//! Calibrations on the wire: how they stand.

use super::camera_bodies::LightingBody;
use super::links;
use crate::calibration::guide::{Guide, Kind, Role, Take};
use crate::capture::{CalibrationState, SeriesShot};
use crate::pipeline::calibrate::guided::Measured;
use crate::pipeline::calibrate::waiting::Origin;
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
