//! Calibrations, guided: what is to be shot, what waits, the fit, and how each stands.

use super::camera::offered_exposure;
use super::works::Ask;
use super::{Desk, DeskError};
use crate::calibration::guide::{Kind, Role, Seen};
use crate::capture::card::{self, CalibrationShot, calibration_shots};
use crate::capture::error::CaptureError;
use crate::capture::events::Topic;
use crate::capture::frame::ShotWish;
use crate::capture::place::{PlaceError, name_of};
use crate::jobs::{Job, Lane, WorkError};
use crate::pair::Settings;
use crate::pipeline::calibrate::guided::{self, FitOrder, Measured};
use crate::pipeline::calibrate::waiting::{self, Incoming, Origin, WaitingError, WaitingShot};
use crate::session::Session;
use crate::units::{FNumber, Iso, Seconds};
use serde_json::{Value, json};
use std::path::PathBuf;

/// Shots of one job.
const MOST_FRAMES: u32 = 100;

/// How one of a session's calibrations stands.
#[derive(Clone, Debug, PartialEq)]
pub struct CalibrationState {
    /// Which.
    pub kind: Kind,
    /// The shots that the next fit takes.
    pub shots: Vec<SeriesShot>,
    /// What these shots lack for a fit that is worth its while, in sentences.
    pub lacks: Vec<String>,
    /// What was measured; `None` if nothing was.
    pub measured: Option<Measured>,
    /// Why what was measured cannot be read.
    pub unreadable: Option<String>,
}

/// A shot that the next fit takes.
#[derive(Clone, Debug, PartialEq)]
pub struct SeriesShot {
    /// By which it is removed.
    pub id: String,
    /// As what it was shot.
    pub role: Role,
    /// Distance from the lens to the card, metres; of card shots.
    pub distance_m: Option<f64>,
    /// Its frame, from the session's folder.
    pub file: String,
    /// The same without flash; of card shots.
    pub off: Option<String>,
    /// BLAKE3 of the frame, hexadecimal.
    pub blake3: String,
    /// Where it comes from.
    pub origin: Origin,
    /// Exposure time.
    pub shutter: Option<Seconds>,
    /// Relative aperture.
    pub aperture: Option<FNumber>,
    /// Sensitivity.
    pub iso: Option<Iso>,
    /// Mean of the brightest colour, 0 at black and 1 at saturation; where it is known.
    pub mean_share: Option<f64>,
    /// Share of the sites that clip, of the colour that does most; where it is known.
    pub clipped_share: Option<f64>,
    /// Why the fit leaves it out, in sentences; empty when all is well.
    pub reasons: Vec<String>,
    /// What is wrong with its exposure, and what to do; `None` if nothing is, or it is not known.
    pub fault: Option<&'static str>,
    /// Whether what was measured comes from it.
    pub in_record: bool,
}

/// Raw files for a calibration, as they came in. The folder is removed when this is dropped.
#[derive(Debug)]
pub struct IncomingFrames {
    /// Holds the files.
    pub folder: tempfile::TempDir,
    /// As what they were shot; may be left out where there is one role only.
    pub role: Option<Role>,
    /// Distance from the lens to the card, metres; of card shots.
    pub distance_m: Option<f64>,
    /// The frames, in the order in which they were taken.
    pub frames: Vec<PathBuf>,
    /// The frame without flash of a card shot.
    pub off: Option<PathBuf>,
}

impl From<&CalibrationShot> for SeriesShot {
    fn from(shot: &CalibrationShot) -> Self {
        let Settings { shutter, aperture, iso, .. } = shot.on.settings;
        let place = |file: &str| format!("calibration/flash/{}/{file}", shot.name);
        Self {
            id: shot.name.clone(),
            role: Role::Card,
            distance_m: Some(shot.distance_m),
            file: place(&shot.on.file),
            off: Some(place(&shot.off.file)),
            blake3: shot.on.blake3.clone(),
            origin: Origin::Camera,
            shutter,
            aperture,
            iso,
            mean_share: None,
            clipped_share: None,
            reasons: shot.reasons.iter().map(|reason| reason.sentence.clone()).collect(),
            fault: None,
            in_record: false,
        }
    }
}

impl SeriesShot {
    fn waiting(kind: Kind, shot: WaitingShot) -> Self {
        let mut own = Self {
            id: shot.number.to_string(),
            role: shot.role,
            distance_m: shot.distance_m,
            file: shot.frame_path(kind),
            off: shot.off_path(kind),
            blake3: shot.frame.blake3,
            origin: shot.origin,
            shutter: shot.shutter,
            aperture: shot.aperture,
            iso: shot.iso,
            mean_share: Some(shot.mean_share),
            clipped_share: Some(shot.clipped_share),
            reasons: vec![],
            fault: None,
            in_record: false,
        };
        own.fault = kind.fault(&own.seen());
        own
    }

    /// Whether the fit takes it, and its exposure is good.
    pub fn is_usable(&self) -> bool {
        self.reasons.is_empty() && self.fault.is_none()
    }

    fn seen(&self) -> Seen {
        let Self { role, distance_m, shutter, aperture, iso, mean_share, clipped_share, .. } = *self;
        let dials = [shutter.map(|t| t.0), aperture.map(|n| n.0), iso.map(|s| s.0)];
        Seen { role, distance_m, dials, mean_share, clipped_share }
    }
}

/// What the job of a fit is called.
fn job_kind(kind: Kind) -> &'static str {
    match kind {
        Kind::Levels => "calibrate_levels",
        Kind::Noise => "calibrate_noise",
        Kind::Exposure => "calibrate_exposure",
        Kind::Flat => "calibrate_flat",
        Kind::Flash => "calibrate_flash",
        Kind::Steadiness => "calibrate_steadiness",
        Kind::Colour => "calibrate_colour",
    }
}

impl Desk {
    /// How all of a session's calibrations stand.
    pub fn calibrations(&self, session: &str) -> Result<Vec<CalibrationState>, DeskError> {
        let session = self.reader(session)?;
        Kind::ALL.into_iter().map(|kind| state(&session, kind)).collect()
    }

    /// What was measured of a kind, with all that it holds.
    pub fn calibration(&self, session: &str, kind: Kind) -> Result<Value, DeskError> {
        let session = self.reader(session)?;
        let record = guided::record(&session, kind)?;
        record
            .map(|record| json!(record))
            .ok_or_else(|| DeskError::NotMeasured { session: name_of(&session), kind })
    }

    /// Shoots for a calibration: the card with and without flash, or one frame of anything else.
    pub fn take_calibration_shot(&self, session: &str, wish: ShotWish) -> Result<Job, DeskError> {
        let ShotWish { kind, role, distance_m, exposure, count } = wish;
        let role = kind.role(role).map_err(DeskError::BadValue)?;
        match (kind, distance_m) {
            (Kind::Flash, Some(_)) if exposure.is_some() => {
                return Err(DeskError::BadValue(
                    "card shots are taken as the camera stands; turn its dials and leave exposure out".into(),
                ));
            }
            (Kind::Flash, Some(distance)) => return self.take_card_shot(session, (distance, count)),
            (Kind::Flash, None) | (_, Some(_)) => return Err(misplaced(kind)),
            _ => checked_count(count)?,
        }
        let session = self.session(session)?;
        let exposure = match exposure {
            Some(wanted) => Some(offered_exposure(
                wanted,
                &self.0.engine.camera_state().map_err(CaptureError::from)?.offered,
            )?),
            None => None,
        };
        let desk = self.clone();
        let ask = Ask::new("calibration_shot", Lane::Rig).again(json!(wish));
        self.ask(ask, name_of(&session), move |progress| {
            let mut last = Value::Null;
            for n in 0..count {
                progress.check().map_err(WorkError::from)?;
                let shot =
                    desk.0.engine.shoot_frame(&session, (kind, role), exposure, (n, count), progress)?;
                last = json!({
                    "session": name_of(&session),
                    "kind": kind,
                    "shot": shot.number.to_string(),
                    "mean_share": shot.mean_share,
                    "clipped_share": shot.clipped_share,
                });
            }
            Ok(last)
        })
    }

    /// Has raw files wait for their calibration. One that waits already is not taken twice.
    pub fn add_calibration_frames(
        &self,
        session: &str,
        kind: Kind,
        incoming: &IncomingFrames,
    ) -> Result<Vec<SeriesShot>, DeskError> {
        let IncomingFrames { role, distance_m, frames, off, .. } = incoming;
        let role = kind.role(*role).map_err(DeskError::BadValue)?;
        if kind == Kind::Flash {
            // Tags on the card may tell the distance.
            distance_m.map_or(Ok(()), checked_distance)?;
            if frames.len() > 1 {
                return Err(DeskError::BadValue(
                    "a card shot is one lit frame (file), and one without flash (off); send the next by itself".into(),
                ));
            }
        } else if distance_m.is_some() || off.is_some() {
            return Err(misplaced(kind));
        }
        let session = self.session(session)?;
        session.require_room()?;
        let mut kept = vec![];
        let off = off.as_ref().map(read).transpose()?;
        for path in frames {
            let (name, bytes) = read(path)?;
            let incoming = Incoming {
                role,
                distance_m: *distance_m,
                frame: (&name, &bytes),
                off: off.as_ref().map(|(name, bytes)| (name.as_str(), bytes.as_slice())),
                origin: Origin::Upload,
                energy_counts: None,
            };
            let shot = waiting::add(&session, kind, incoming)?;
            let words = format!("Frame {} for {} ({}) is stored.", shot.number, kind.name(), role.name());
            let id = shot.number.to_string();
            let data = json!({ "session": name_of(&session), "kind": kind, "shot": id });
            self.events().tell(Topic::CalibrationShot, words, data);
            kept.push(SeriesShot::waiting(kind, shot));
        }
        Ok(kept)
    }

    /// Removes a shot that no record comes from.
    pub fn remove_calibration_shot(&self, session: &str, kind: Kind, id: &str) -> Result<(), DeskError> {
        let session = self.session(session)?;
        let shots = state(&session, kind)?.shots;
        let none = || WaitingError::None { kind: kind.name(), shot: id.to_owned() };
        let shot = shots.into_iter().find(|shot| shot.id == id).ok_or_else(none)?;
        match id.parse() {
            Ok(number) => waiting::remove(&session, kind, number)?,
            Err(_) if shot.in_record => return Err(DeskError::ShotInRecord(shot.id)),
            Err(_) => card::remove(&session, &shot.id)?,
        }
        let words = format!("Shot {id} for {} is removed.", kind.name());
        self.events().tell(
            Topic::Calibration,
            words,
            json!({ "session": name_of(&session), "kind": kind, "removed": id }),
        );
        Ok(())
    }

    /// Fits a calibration from the shots that wait for it, then processes if all is there.
    pub fn calibrate(&self, session: &str, order: FitOrder) -> Result<Job, DeskError> {
        let kind = order.kind();
        if let FitOrder::Noise { stops: Some(stops) } = order
            && !(stops > 0.0 && stops <= 10.0)
        {
            return Err(DeskError::BadValue(format!(
                "stops is {stops}; give the stops of light from one level to the next, 1 say"
            )));
        }
        let session = self.session(session)?;
        if waiting::list(&session, kind)?.is_empty() {
            let missing = format!("shot that waits for the calibration of {}", kind.name());
            return Err(DeskError::NotReady { session: name_of(&session), missing });
        }
        let desk = self.clone();
        let ask = Ask::new(job_kind(kind), Lane::Processing).again(json!(order));
        self.ask(ask, name_of(&session), move |progress| {
            let result = (desk.0.works.calibrate)(&session, order, progress)?;
            desk.tell_of_calibration(&session, kind, &result);
            desk.process_if_ready(&session);
            Ok(result)
        })
    }

    /// Tells that a calibration was measured.
    pub(super) fn tell_of_calibration(&self, session: &Session, kind: Kind, record: &Value) {
        let good = &record["verdict"]["good"];
        let words = match record["verdict"]["sentences"][0].as_str() {
            Some(first) => format!("{}: {first}", kind.guide().title),
            None => format!("{} is measured.", kind.guide().title),
        };
        let data = json!({ "session": name_of(session), "kind": kind, "good": good });
        self.events().tell(Topic::Calibration, words, data);
    }
}

fn state(session: &Session, kind: Kind) -> Result<CalibrationState, DeskError> {
    let (measured, unreadable) = match guided::measured(session, kind) {
        Ok(measured) => (measured, None),
        Err(error) => (None, Some(error.to_string())),
    };
    let mut shots: Vec<SeriesShot> = match kind {
        Kind::Flash => calibration_shots(session)?.iter().map(SeriesShot::from).collect(),
        _ => vec![],
    };
    shots.extend(waiting::list(session, kind)?.into_iter().map(|shot| SeriesShot::waiting(kind, shot)));
    for shot in &mut shots {
        shot.in_record = measured.as_ref().is_some_and(|measured| measured.shots.contains(&shot.blake3));
    }
    let usable = shots.iter().filter(|shot| shot.is_usable());
    let lacks = kind.lacks(&usable.map(SeriesShot::seen).collect::<Vec<_>>());
    Ok(CalibrationState { kind, shots, lacks, measured, unreadable })
}

/// A distance that is missing, or where none belongs.
fn misplaced(kind: Kind) -> DeskError {
    DeskError::BadValue(match kind {
        Kind::Flash => "distance_m is missing: the distance from the lens to the card in metres".into(),
        other => format!("distance_m and off are of card shots; {} takes frames alone", other.name()),
    })
}

/// Refuses what is no distance to a card.
pub(super) fn checked_distance(distance_m: f64) -> Result<(), DeskError> {
    match distance_m > 0.0 && distance_m < 100.0 {
        true => Ok(()),
        false => Err(DeskError::BadValue(format!(
            "a card {distance_m} m away cannot be: give the distance from the lens to the card in metres"
        ))),
    }
}

/// Refuses what nobody waits for.
pub(super) fn checked_count(count: u32) -> Result<(), DeskError> {
    match (1..=MOST_FRAMES).contains(&count) {
        true => Ok(()),
        false => Err(DeskError::BadValue(format!("count is {count}; a job takes 1 to {MOST_FRAMES} shots"))),
    }
}

fn read(path: &PathBuf) -> Result<(String, Vec<u8>), DeskError> {
    let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
    let bytes = std::fs::read(path).map_err(|source| PlaceError::Disk { path: path.clone(), source })?;
    Ok((name, bytes))
}
