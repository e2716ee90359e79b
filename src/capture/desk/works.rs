//! What takes time: pairs, card shots, calibration, import, processing. Each wish becomes a job.

use super::calibration::{checked_count, checked_distance};
use super::error::{DeskError, JobError};
use super::{Desk, FlashCard, SceneFiles};
use crate::calibration::FEWEST_SHOTS;
use crate::calibration::guide::Kind;
use crate::capture::card::calibration_shots;
use crate::capture::error::CaptureError;
use crate::capture::events::Topic;
use crate::capture::find::ExposureWish;
use crate::capture::place::name_of;
use crate::capture::repeat::words_on_repeatability;
use crate::capture::thumbnail::{self, ThumbnailError};
use crate::capture::wish::PairWish;
use crate::jobs::{Job, Lane, Order, Work, WorkError};
use crate::pair::{Exposure, PairRecord, Plan, Verdict};
use crate::pipeline::calibrate::waiting;
use crate::pipeline::flash::FlashOrder;
use crate::progress::Progress;
use crate::session::Session;
use serde_json::{Value, json};
use std::ops::Deref;
use std::sync::{Arc, PoisonError};
use std::time::Duration;

/// A whole solve begins unasked once no pair was shot for this long: while the photographer shoots, it would be of
/// yesterday as soon as it is done.
pub(super) const REST: Duration = Duration::from_secs(5);

/// More would take a day.
const MOST_SHOTS: usize = 1000;

/// How a wish is queued.
pub(super) struct Ask {
    kind: &'static str,
    lane: Lane,
    coalesce: bool,
    rest: Duration,
    order: Option<Value>,
    durable: bool,
}

impl Ask {
    /// Somebody's wish, which he is told was taken.
    pub(super) fn new(kind: &'static str, lane: Lane) -> Self {
        Self { kind, lane, coalesce: false, rest: Duration::ZERO, order: None, durable: true }
    }

    /// It can be asked for again ([`Desk::retry`]) with this.
    pub(super) fn again(self, order: Value) -> Self {
        Self { order: Some(order), ..self }
    }

    /// Whoever asks for the same before it begins gets this one.
    pub(super) fn coalescing(self) -> Self {
        Self { coalesce: true, ..self }
    }

    /// The house's own wish, once the rig has been at rest for so long.
    pub(super) fn unasked(self, rest: Duration) -> Self {
        Self { rest, durable: false, ..self }
    }
}

impl Desk {
    /// Takes the next pair of the named, current or day's session, or a rejected one again. What cannot be wished for is
    /// refused at once.
    pub fn take_pair(&self, session: Option<&str>, wish: PairWish) -> Result<Job, DeskError> {
        let session = self.session_for_pair(session)?;
        wish.program(&session)?;
        let desk = self.clone();
        self.ask(Ask::new("pair", Lane::Rig).again(json!(wish)), name_of(&session), move |progress| {
            let after_pair = desk.0.after_pair.as_ref();
            desk.keep_sequence(&session).map_err(CaptureError::from)?;
            let record = desk.0.engine.shoot_pair_as(&session, wish, after_pair, progress)?;
            if record.verdict == Verdict::Accepted && wish.again.is_some() {
                desk.mend_sequence(&session, record.number);
            }
            desk.go_on_from(&session, &record);
            let (number, attempt, verdict) = (record.number, record.attempt, record.verdict);
            Ok(json!({ "session": name_of(&session), "number": number, "attempt": attempt, "verdict": verdict }))
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
        let ask = Ask::new("find_exposure", Lane::Rig).again(json!(wish));
        self.ask(ask, name_of(&session), move |progress| {
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

    /// Shoots the calibration card at a distance in metres, so many times.
    pub fn take_card_shot(&self, session: &str, (distance_m, count): (f64, u32)) -> Result<Job, DeskError> {
        checked_distance(distance_m)?;
        checked_count(count)?;
        let session = self.session(session)?;
        let desk = self.clone();
        let ask = Ask::new("flash_shots", Lane::Rig).again(json!((distance_m, count)));
        self.ask(ask, name_of(&session), move |progress| {
            let mut last = Value::Null;
            for _ in 0..count {
                progress.check().map_err(WorkError::from)?;
                let shot = desk.0.engine.shoot_card(&session, distance_m, progress)?;
                last = json!({ "session": name_of(&session), "name": shot.name, "reasons": shot.reasons });
                if !shot.reasons.is_empty() {
                    // The next would be no better.
                    break;
                }
            }
            Ok(last)
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
        let ask = Ask::new("repeatability", Lane::Rig).again(json!(shots));
        self.ask(ask, name_of(&session), move |progress| {
            let run = desk.0.engine.repeatability(&session, shots, progress)?;
            Ok(json!({
                "words": words_on_repeatability(&run),
                "shots": run.frames.len(),
                "spread": run.light_deviation,
                "spread_error": run.standard_error(run.light_deviation),
                "corrected": run.light_by_energy_deviation,
                "corrected_error": run.light_by_energy_deviation.map(|by_energy| run.standard_error(by_energy)),
                "sensor_noise": run.sensor_deviation,
                "reading_noise": run.reading_deviation,
            }))
        })
    }

    /// Fits the flash calibration from the session's card shots, then processes if all is there.
    pub fn calibrate_flash(&self, session: &str, order: FlashOrder) -> Result<Job, DeskError> {
        order.checked().map_err(DeskError::BadValue)?;
        let session = self.session(session)?;
        let shots: Vec<_> =
            calibration_shots(&session)?.into_iter().filter(|s| s.reasons.is_empty()).collect();
        let sent = waiting::list(&session, Kind::Flash)?;
        let known = |id: &String| {
            shots.iter().any(|shot| shot.name == *id)
                || sent.iter().any(|shot| shot.number.to_string() == *id)
        };
        if let Some(stranger) = order.held_out.iter().chain(&order.one_shot).find(|id| !known(id)) {
            return Err(DeskError::BadValue(format!(
                "{stranger:?} is none of the card shots that can be used; held_out and one_shot take the ids of such"
            )));
        }
        if shots.is_empty() && sent.is_empty() {
            let (session, missing) = (name_of(&session), "usable shot of the calibration card".into());
            return Err(DeskError::NotReady { session, missing });
        }
        let desk = self.clone();
        let ask = Ask::new("calibrate_flash", Lane::Processing).again(json!(order));
        let card = FlashCard { order, shots };
        self.ask(ask, name_of(&session), move |progress| {
            let result = (desk.0.works.calibrate_flash)(&session, card, progress)?;
            desk.tell_of_calibration(&session, Kind::Flash, &result);
            desk.process_if_ready(&session);
            Ok(result)
        })
    }

    /// Imports cameras and meshes, then processes if all is there.
    pub fn import_scene(&self, session: &str, files: SceneFiles) -> Result<Job, DeskError> {
        let session = self.session(session)?;
        let desk = self.clone();
        self.ask(Ask::new("import_scene", Lane::Processing), name_of(&session), move |progress| {
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
        self.enqueue_process(session, Ask::new("process", Lane::Processing))
    }

    /// Makes what a page shows of a pair: small JPEGs of both frames and of the light that the flash alone threw.
    pub fn develop(&self, session: &str, number: u32) -> Result<Job, DeskError> {
        let session = self.session(session)?;
        self.pair(&session, number)?;
        self.enqueue_develop(&session, number, Ask::new("develop", Lane::Develop))
    }

    /// Sets off what an accepted pair makes possible.
    pub(super) fn go_on_from(&self, session: &Arc<Session>, record: &PairRecord) {
        if record.verdict == Verdict::Accepted {
            self.develop_unasked(session, record.number);
            self.process_if_ready(session);
        }
    }

    fn develop_unasked(&self, session: &Arc<Session>, number: u32) {
        let ask = Ask::new("develop", Lane::Develop).unasked(Duration::ZERO);
        if let Err(error) = self.enqueue_develop(session, number, ask) {
            // The page has them made when it shows them.
            tracing::warn!("pair {number} of {} is not developed ahead: {error}", name_of(session));
        }
    }

    fn enqueue_develop(&self, session: &Arc<Session>, number: u32, ask: Ask) -> Result<Job, DeskError> {
        let own = session.clone();
        self.ask(ask.again(json!(number)), name_of(session), move |progress| {
            let unreadable = |e: ThumbnailError| WorkError::failed("frame_unreadable", e);
            let record = own.pair(number).map_err(|e| WorkError::failed("session_unreadable", e))?;
            let frames: Vec<_> = record.frames().collect();
            let steps = frames.len() + 1;
            for (done, (_, frame)) in frames.into_iter().enumerate() {
                progress.report("Developing the pair", done, steps);
                progress.check().map_err(WorkError::from)?;
                thumbnail::of_frame(&own, &record, frame).map_err(unreadable)?;
            }
            progress.report("Developing the pair", steps - 1, steps);
            thumbnail::of_known_light(&own, &record).map_err(unreadable)?;
            Ok(json!({ "session": name_of(&own), "number": number }))
        })
    }

    pub(super) fn missing(&self, session: &Session) -> Result<Vec<&'static str>, DeskError> {
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
    pub(super) fn process_if_ready(&self, session: &Arc<Session>) {
        let started = match self.missing(session) {
            Ok(missing) if !missing.is_empty() => return,
            Ok(_) => {
                let ask = Ask::new("process", Lane::Processing).unasked(REST);
                self.enqueue_process(session.clone(), ask).map(drop)
            }
            Err(error) => Err(error),
        };
        if let Err(error) = started {
            let words = format!("Processing of {} was not started: {error}", name_of(session));
            self.0.events.tell(Topic::Trouble, words, Value::Null);
        }
    }

    pub(super) fn enqueue_process(
        &self,
        session: impl Deref<Target = Session> + Send + 'static,
        ask: Ask,
    ) -> Result<Job, DeskError> {
        let (process, subject) = (self.0.works.process.clone(), name_of(&session));
        let ask = ask.again(json!({})).coalescing();
        self.ask(ask, subject, move |progress| Ok(process(&session, (), progress)?))
    }

    /// Queues a job about the session of this name as `ask` says.
    pub(super) fn ask(
        &self,
        ask: Ask,
        subject: String,
        work: impl FnOnce(&Progress) -> Result<Value, JobError> + Send + 'static,
    ) -> Result<Job, DeskError> {
        let Ask { kind, lane, coalesce, rest, order, durable, .. } = ask;
        // What a retried job sets off is no retry.
        let retry_of = self.1.retry_of.filter(|id| self.0.queue.get(*id).is_ok_and(|job| job.kind == kind));
        // Nor is it what was wished for.
        let wish = self.1.wish.lock().unwrap_or_else(PoisonError::into_inner).take();
        let work: Work = Box::new(move |progress| work(progress).map_err(|JobError(error)| error));
        let order = Order { kind, subject, lane, coalesce, rest, order, retry_of, wish, durable, work };
        Ok(self.0.queue.enqueue(order)?)
    }
}
