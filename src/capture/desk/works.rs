//! What takes time: pairs, card shots, calibration, import, processing. Each wish becomes a job.

use super::error::{DeskError, JobError};
use super::{Desk, FlashCard, SceneFiles};
use crate::capture::events::Topic;
use crate::capture::find::ExposureWish;
use crate::capture::place::{calibration_shots, name_of};
use crate::capture::repeat::words_on_repeatability;
use crate::jobs::{Job, Lane, Order, Work};
use crate::pair::energy::FEWEST_SHOTS;
use crate::pair::{Exposure, Plan, Verdict};
use crate::progress::Progress;
use crate::session::Session;
use serde_json::{Value, json};
use std::sync::Arc;

/// More would take a day.
const MOST_SHOTS: usize = 1000;

impl Desk {
    /// Takes the next pair of the named, current or day's session.
    pub fn take_pair(&self, session: Option<&str>) -> Result<Job, DeskError> {
        let session = self.session_for_pair(session)?;
        let desk = self.clone();
        self.enqueue("pair", &session.clone(), Lane::Rig, false, move |progress| {
            let after_pair = desk.0.after_pair.as_ref();
            let record = desk.0.engine.shoot_pair(&session, after_pair, progress)?;
            if record.verdict == Verdict::Accepted {
                desk.process_if_ready(&session);
            }
            Ok(json!({ "session": name_of(&session), "number": record.number, "verdict": record.verdict }))
        })
    }

    /// Finds the exposure of the session's pairs by test shots.
    pub fn find_exposure(&self, session: &str, wish: ExposureWish) -> Result<Job, DeskError> {
        if !(wish.target_share > 0.0 && wish.target_share < 1.0) {
            return Err(DeskError::BadValue(format!(
                "target_share is {}, but the brightest channel can end between 0 and 1 of saturation only",
                wish.target_share
            )));
        }
        let session = self.session(session)?;
        let desk = self.clone();
        self.enqueue("find_exposure", &session.clone(), Lane::Rig, false, move |progress| {
            let found = desk.0.engine.find_exposure(&session, wish, progress)?;
            desk.tell_session(&session);
            let exposure =
                |e: Exposure| json!({ "shutter_s": e.shutter, "aperture": e.aperture, "iso": e.iso });
            let Plan { off, on } = found.plan;
            Ok(json!({
                "exposure": { "off": exposure(off), "on": exposure(on), "words": found.plan.words() },
                "predicted_share": found.predicted_share,
                "ambient_share": found.ambient_share,
                "flash_share": found.flash_share,
                "shots": found.shots,
                "warnings": found.warnings,
            }))
        })
    }

    /// Shoots the calibration card at a distance in metres.
    pub fn take_card_shot(&self, session: &str, distance_m: f64) -> Result<Job, DeskError> {
        if !(distance_m > 0.0 && distance_m < 100.0) {
            return Err(DeskError::BadValue(format!(
                "a card {distance_m} m away cannot be: give the distance from the lens to the card in metres"
            )));
        }
        let session = self.session(session)?;
        let desk = self.clone();
        self.enqueue("flash_shots", &session.clone(), Lane::Rig, false, move |progress| {
            let shot = desk.0.engine.shoot_card(&session, distance_m, progress)?;
            Ok(json!({ "session": name_of(&session), "name": shot.name, "reasons": shot.reasons }))
        })
    }

    /// Shoots the scene `shots` times with nothing changed, and tells how steady the known light is.
    pub fn take_repeatability(&self, session: &str, shots: usize) -> Result<Job, DeskError> {
        if !(FEWEST_SHOTS..=MOST_SHOTS).contains(&shots) {
            return Err(DeskError::BadValue(format!(
                "shots is {shots}; a run takes {FEWEST_SHOTS} to {MOST_SHOTS}"
            )));
        }
        let session = self.session(session)?;
        let desk = self.clone();
        self.enqueue("repeatability", &session.clone(), Lane::Rig, false, move |progress| {
            let run = desk.0.engine.repeatability(&session, shots, progress)?;
            Ok(json!({
                "words": words_on_repeatability(&run),
                "shots": run.shots.len(),
                "spread": run.spread,
                "spread_error": run.spread_error,
                "corrected": run.corrected,
                "corrected_error": run.corrected_error,
                "sensor_noise": run.sensor_noise,
                "reading_noise": run.reading_noise,
            }))
        })
    }

    /// Fits the flash calibration from the session's card shots, then processes if all is there.
    pub fn calibrate_flash(
        &self,
        session: &str,
        target_reflectance: f64,
        ring_radii: [f64; 2],
    ) -> Result<Job, DeskError> {
        if !(target_reflectance > 0.0 && target_reflectance <= 1.0) {
            return Err(DeskError::BadValue(format!(
                "target_reflectance is {target_reflectance}, but a card's reflectance lies between 0 and 1"
            )));
        }
        let [inner, outer] = ring_radii;
        if !(inner >= 0.0 && outer > inner && outer < 1.0) {
            return Err(DeskError::BadValue(format!(
                "ring_radii are {inner} and {outer}; give the inner, then the larger outer radius in metres"
            )));
        }
        let session = self.session(session)?;
        let shots: Vec<_> =
            calibration_shots(&session)?.into_iter().filter(|s| s.reasons.is_empty()).collect();
        if shots.is_empty() {
            let (session, missing) = (name_of(&session), "usable shot of the calibration card".into());
            return Err(DeskError::NotReady { session, missing });
        }
        let desk = self.clone();
        let card = FlashCard { target_reflectance, ring_radii, shots };
        self.enqueue("calibrate_flash", &session.clone(), Lane::Processing, false, move |progress| {
            let result = (desk.0.works.calibrate_flash)(&session, card, progress)?;
            desk.process_if_ready(&session);
            Ok(result)
        })
    }

    /// Imports cameras and meshes, then processes if all is there.
    pub fn import_scene(&self, session: &str, files: SceneFiles) -> Result<Job, DeskError> {
        let session = self.session(session)?;
        let desk = self.clone();
        self.enqueue("import_scene", &session.clone(), Lane::Processing, false, move |progress| {
            let result = (desk.0.works.import_scene)(&session, files, progress)?;
            desk.process_if_ready(&session);
            Ok(result)
        })
    }

    /// Processes the session; refused while something is missing.
    pub fn process(&self, session: &str) -> Result<Job, DeskError> {
        let session = self.session(session)?;
        let missing = self.missing(&session)?;
        if !missing.is_empty() {
            return Err(DeskError::NotReady { session: name_of(&session), missing: missing.join(", no ") });
        }
        self.enqueue_process(&session)
    }

    fn missing(&self, session: &Session) -> Result<Vec<&'static str>, DeskError> {
        let works = &self.0.works;
        let mut missing = Vec::new();
        if !(works.has_scene)(session) {
            missing.push("scene");
        }
        if !(works.has_flash_calibration)(session) {
            missing.push("flash calibration");
        }
        if !session.pairs()?.iter().any(|p| p.verdict == Verdict::Accepted) {
            missing.push("accepted pair");
        }
        Ok(missing)
    }

    /// Starts processing unasked once everything is there.
    fn process_if_ready(&self, session: &Arc<Session>) {
        let started = match self.missing(session) {
            Ok(missing) if !missing.is_empty() => return,
            Ok(_) => self.enqueue_process(session).map(drop),
            Err(error) => Err(error),
        };
        if let Err(error) = started {
            let words = format!("Processing of {} was not started: {error}", name_of(session));
            self.0.events.tell(Topic::Trouble, words, Value::Null);
        }
    }

    fn enqueue_process(&self, session: &Arc<Session>) -> Result<Job, DeskError> {
        let (desk, own) = (self.clone(), session.clone());
        self.enqueue("process", session, Lane::Processing, true, move |progress| {
            Ok((desk.0.works.process)(&own, (), progress)?)
        })
    }

    pub(super) fn enqueue(
        &self,
        kind: &'static str,
        session: &Session,
        lane: Lane,
        coalesce: bool,
        work: impl FnOnce(&Progress) -> Result<Value, JobError> + Send + 'static,
    ) -> Result<Job, DeskError> {
        let work: Work = Box::new(move |progress| work(progress).map_err(|JobError(error)| error));
        Ok(self.0.queue.enqueue(Order { kind, subject: name_of(session), lane, coalesce, work })?)
    }
}
