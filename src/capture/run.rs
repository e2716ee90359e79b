//! One pair on its way: does the effects of the state machine and feeds back what happened.

use super::bench::Bench;
use super::error::CaptureError;
use super::events::{Events, Topic};
use super::hands::{Hands, exposure_of};
use super::machine::{Course, Effect, End, Event, State};
use super::place::{Delivered, Place, PlaceError, Shots};
use super::prompt::Prompter;
use super::taken::Taken;
use crate::pair::order::{Part, Program, Slot};
use crate::pair::{Drift, FlashRecord, Limits, Plan, Reason, Settings, Stop, Verdict, proof};
use crate::pipeline::pairs;
use crate::progress::{Cancelled, Progress};
use serde_json::json;
use std::sync::mpsc::{self, RecvTimeoutError};
use std::time::Duration;

/// Whoever waits for the disk longer than this is told what he waits for. A pair is stored in half a second.
const DISK_PATIENCE: Duration = Duration::from_secs(3);

/// Steps of a pair that progress counts beside its frames: arming, judging, storing, the end.
const STEPS: usize = 4;

/// One pair on its way.
pub(super) struct Run<'a> {
    hands: Hands<'a>,
    place: &'a mut dyn Place,
    limits: &'a Limits,
    events: &'a Events,
    program: Program,
    /// What the camera told before the pair.
    told: Settings,
    plan: Option<Plan>,
    /// In the order in which they were shot.
    frames: Vec<Taken>,
    flash: Option<FlashRecord>,
    reasons: Vec<Reason>,
    drift: Option<Drift>,
    stop: Option<Stop>,
    error: Option<CaptureError>,
    /// Steps that are done.
    done: usize,
}

impl<'a> Run<'a> {
    pub(super) fn new(
        bench: &'a mut Bench,
        place: &'a mut dyn Place,
        prompter: &'a Prompter,
        limits: &'a Limits,
        progress: &'a Progress,
        events: &'a Events,
    ) -> Self {
        Self {
            hands: Hands { bench, prompter, progress },
            program: place.program(),
            place,
            limits,
            events,
            told: Settings::default(),
            plan: None,
            frames: Vec::new(),
            flash: None,
            reasons: Vec::new(),
            drift: None,
            stop: None,
            error: None,
            done: 0,
        }
    }

    /// Drives the state machine from the first event to the end.
    pub(super) fn finish(&mut self) -> Result<Verdict, CaptureError> {
        let mut course = Course::begin(self.program);
        let mut cancelled = false;
        while let Some(effect) = course.next_effect() {
            if !cancelled && self.hands.progress.is_cancelled() {
                cancelled = true;
                let before = course.state();
                course.hear(Event::Cancel);
                if course.state() != before {
                    continue;
                }
            }
            let event = match self.perform(effect) {
                Ok(event) => event,
                Err(CaptureError::Cancelled(_)) => Some(Event::Cancel),
                Err(error) => {
                    self.error.get_or_insert(error);
                    Some(Event::Broke)
                }
            };
            if let Some(event) = event {
                course.hear(event);
            }
        }
        match course.state() {
            State::Ended(End::Stored(verdict)) => Ok(verdict),
            State::Ended(End::Cancelled) => Err(Cancelled.into()),
            _ => Err(self.error.take().unwrap_or(CaptureError::Cancelled(Cancelled))),
        }
    }

    /// Does one effect; gives the event that answers it, where there is one.
    fn perform(&mut self, effect: Effect) -> Result<Option<Event>, CaptureError> {
        match effect {
            Effect::RecordIntent => self.place.intend().map(|()| None).map_err(Into::into),
            Effect::Lock => {
                self.report("Making sure that the camera stands as planned");
                self.lock()?;
                Ok(Some(Event::Locked))
            }
            Effect::Darken => {
                self.report("Making sure that the flash stays dark");
                self.hands.darken()?;
                Ok(Some(Event::Dark))
            }
            Effect::Arm => {
                self.step("Getting the flash ready");
                if self.frames.is_empty() {
                    // Nothing was darkened yet: what the controller saw before is none of this pair's.
                    self.hands.close_gate()?;
                }
                self.hands.arm(self.place.tag())?;
                Ok(Some(Event::Armed))
            }
            Effect::Shoot(slot) => {
                self.step(&words_on(slot, self.program));
                self.turn_dials(slot)?;
                let shot = self.hands.release()?;
                self.frames.push(Taken::new(slot, shot));
                Ok(Some(Event::FrameTaken))
            }
            Effect::BeginCheck(slot) => self.begin_check(slot).map(|()| None),
            Effect::CountPulses(slot) => {
                self.count(slot)?;
                let proven = self.reasons.is_empty();
                Ok(Some(if proven { Event::Counted } else { Event::Unproven }))
            }
            Effect::Disarm => {
                self.hands.disarm();
                Ok(None)
            }
            Effect::Judge => {
                self.step(if self.frames.len() > 2 { "Checking all frames" } else { "Checking both frames" });
                Ok(Some(Event::Judged(self.judge()?)))
            }
            Effect::Store(_) => {
                self.step("Storing the pair");
                self.tell_if_slow(Self::store)?;
                let steps = self.program.slots().len() + STEPS;
                self.hands.progress.report("Stored", steps, steps);
                Ok(Some(Event::Stored))
            }
            Effect::RecordEnd(end) => {
                let why = match (&self.error, end) {
                    (Some(error), _) => error.to_string(),
                    (None, End::Cancelled) => "cancelled on request".to_owned(),
                    (None, _) => "stopped".to_owned(),
                };
                if let Err(error) = self.place.abandon(&why) {
                    tracing::error!("the journal could not be written: {error}");
                }
                Ok(None)
            }
        }
    }

    fn report(&self, words: &str) {
        self.hands.progress.report(words, self.done, self.program.slots().len() + STEPS);
    }

    fn step(&mut self, words: &str) {
        self.done += 1;
        self.report(words);
    }

    fn frame(&mut self, slot: Slot) -> Result<&mut Taken, PlaceError> {
        self.frames.iter_mut().find(|frame| frame.slot == slot).ok_or(PlaceError::Incomplete)
    }

    /// Reads the camera and settles the plan: the session's, or else what the dials show now.
    fn lock(&mut self) -> Result<(), CaptureError> {
        self.told = self.hands.lock()?;
        self.plan = self.place.plan();
        if self.plan.is_none()
            && let Some(exposure) = exposure_of(&self.told)
        {
            self.plan = Some(Plan { off: exposure, on: exposure });
        }
        Ok(())
    }

    fn turn_dials(&mut self, slot: Slot) -> Result<(), CaptureError> {
        let Some(plan) = self.plan else { return Ok(()) };
        let wanted = if slot.part.is_lit() { plan.on } else { plan.off };
        let turned = self.hands.turn_dials(&self.told, &wanted)?;
        if turned && self.frames.is_empty() && plan.off == plan.on {
            let words =
                format!("The camera stood otherwise: its dials were turned back to the session's {wanted}.");
            self.events.tell(Topic::Recovery, words, json!({ "code": "dials_turned" }));
        }
        self.told = Settings {
            shutter: Some(wanted.shutter),
            aperture: Some(wanted.aperture),
            iso: Some(wanted.iso),
            ..std::mem::take(&mut self.told)
        };
        Ok(())
    }

    /// Has a frame checked and written to the disk while the next one is shot.
    fn begin_check(&mut self, slot: Slot) -> Result<(), CaptureError> {
        if !slot.is_needed() {
            // However many there are, the photographs of a few are in memory at a time.
            self.compare_dark()?;
        }
        let (measured, stager) = (self.place.levels(), self.place.stager());
        self.frame(slot)?.begin(measured, stager)
    }

    /// Asks the controller what it saw since the last count. It reports dark syncs too, so that silence
    /// means that the contact never closed.
    fn count(&mut self, slot: Slot) -> Result<(), CaptureError> {
        let Some(syncs) = self.hands.count()? else { return Ok(()) };
        let record = self.flash.get_or_insert_default();
        if slot.part.is_lit() {
            self.reasons.extend(proof::lit_frame(&syncs, self.place.tag(), self.place.sees_light()));
            record.on = syncs;
        } else {
            self.reasons.extend(proof::dark_frame(&syncs));
            record.off.extend(syncs);
        }
        Ok(())
    }

    /// Holds the further frames without flash that are decoded or being decoded against the first.
    fn compare_dark(&mut self) -> Result<(), CaptureError> {
        let plan = self.plan;
        let Ok(first) = self.frame(Slot::OFF) else { return Ok(()) };
        let Some((unlit, digest)) = first.decoded() else { return Ok(()) };
        for frame in &mut self.frames {
            let slot = frame.slot;
            if slot.is_needed() {
                continue;
            }
            // Looked at once, and gone: its settings and its digest stay.
            let Some((photo, digest)) = frame.decoded() else { continue };
            let (reasons, drift) = pairs::judge_dark(&unlit, &photo, slot, plan.as_ref(), self.limits);
            frame.seen(photo.map(|p| p.settings).unwrap_or_default(), digest);
            for reason in reasons {
                if !self.reasons.contains(&reason) {
                    self.reasons.push(reason);
                }
            }
            self.drift = drift.or(self.drift);
        }
        self.frame(Slot::OFF)?.keep(unlit, digest);
        Ok(())
    }

    fn judge(&mut self) -> Result<Verdict, CaptureError> {
        self.compare_dark()?;
        let mut decoded = |slot| self.frame(slot)?.decoded().ok_or(PlaceError::Incomplete);
        let ((off, off_digest), (on, on_digest)) = (decoded(Slot::OFF)?, decoded(Slot::ON)?);
        let further = self.frames.iter().filter(|frame| !frame.slot.is_needed());
        let further: Vec<String> = further.map(|frame| frame.digest().to_owned()).collect();
        let energy = self.flash.as_ref().and_then(FlashRecord::energy_counts);
        let mut expected = self.place.expected(&off_digest, &on_digest, energy);
        expected.plan = self.plan.as_ref();
        if let Some(files) = &mut expected.files {
            files.more = &further;
        }
        if let (Some(window), Ok(photo)) = (self.place.region(), &off) {
            expected.region = Some(window.sites(photo.mosaic.dn.width(), photo.mosaic.dn.height()));
        }
        let judgement = pairs::judge(&off, &on, &expected, self.limits);
        for reason in judgement.reasons {
            if !self.reasons.contains(&reason) {
                self.reasons.push(reason);
            }
        }
        self.stop = judgement.stop;
        for (slot, photo, digest) in [(Slot::OFF, off, off_digest), (Slot::ON, on, on_digest)] {
            self.frame(slot)?.seen(photo.map(|p| p.settings).unwrap_or_default(), digest);
        }
        Ok(if self.reasons.is_empty() { Verdict::Accepted } else { Verdict::Rejected })
    }

    /// Does what waits for the disk, and tells if that takes long.
    fn tell_if_slow<T>(&mut self, work: impl FnOnce(&mut Self) -> T) -> T {
        let (progress, events) = (self.hands.progress.clone(), self.events.clone());
        let (done, steps) = (self.done, self.program.slots().len() + STEPS);
        let (ends, ended) = mpsc::channel::<()>();
        std::thread::scope(|scope| {
            let watch = std::thread::Builder::new().name("disk watch".into()).spawn_scoped(scope, move || {
                if ended.recv_timeout(DISK_PATIENCE) == Err(RecvTimeoutError::Timeout) {
                    let seconds = DISK_PATIENCE.as_secs();
                    let stage = format!("Storing the pair: the disk has taken more than {seconds} s");
                    progress.report(&stage, done, steps);
                    let words = format!(
                        "The disk has taken more than {seconds} s to store a pair. The pair is safe once its job is done; \
                         check the disk's cable or network, or shoot to another disk."
                    );
                    events.tell(Topic::Trouble, words, json!({ "code": "disk_slow" }));
                }
            });
            if let Err(error) = watch {
                tracing::warn!("nobody watches the disk: {error}");
            }
            let outcome = work(self);
            drop(ends);
            outcome
        })
    }

    fn store(&mut self) -> Result<(), CaptureError> {
        // The first good pair sets the plan; a rejected one leaves the operator free to set the camera otherwise.
        if let Some(plan) = self.plan
            && self.reasons.is_empty()
            && self.place.plan().is_none()
        {
            self.place.adopt(plan)?;
        }
        let mut frames = std::mem::take(&mut self.frames);
        frames.sort_by_key(|frame| frame.slot);
        let mut staged = Vec::new();
        for frame in &mut frames {
            staged.push(frame.staged().map_err(PlaceError::from)?);
        }
        let mut of_part = [Vec::new(), Vec::new(), Vec::new()];
        for (frame, staged) in frames.iter().zip(&staged) {
            let part = match frame.slot.part {
                Part::Off => 0,
                Part::On => 1,
                Part::After => 2,
                // No program shoots one.
                Part::Crossed => continue,
            };
            of_part[part].push(Delivered {
                shot: &frame.shot,
                settings: frame.settings(),
                blake3: frame.digest().to_owned(),
                staged: staged.as_ref(),
            });
        }
        let [off, on, after] = of_part;
        let (mut off, mut on) = (off.into_iter(), on.into_iter());
        // The machine stores only after both frames were taken.
        let (Some(first), Some(lit)) = (off.next(), on.next()) else {
            return Err(PlaceError::Incomplete.into());
        };
        self.place.store(Shots {
            off: first,
            more_off: off.collect(),
            on: lit,
            after,
            drift: self.drift,
            flash: self.flash.take(),
            reasons: std::mem::take(&mut self.reasons),
            stop: self.stop.take(),
        })?;
        Ok(())
    }
}

/// What is done just now.
fn words_on(slot: Slot, program: Program) -> String {
    let what = match slot.part {
        Part::On => return "Taking the frame with flash".into(),
        Part::Off => "without flash",
        Part::After => "without flash once more",
        Part::Crossed => return "Taking the frame with flash through the crossed polariser".into(),
    };
    match program.off_frames() {
        1 => format!("Taking the frame {what}"),
        n => format!("Taking frame {} of {n} {what}", slot.index),
    }
}
