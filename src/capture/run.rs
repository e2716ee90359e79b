//! One pair on its way: does the effects of the state machine and feeds back what happened.

use super::bench::Bench;
use super::error::CaptureError;
use super::events::{Events, Topic};
use super::hands::{Hands, exposure_of};
use super::machine::{Effect, End, Event, Frame, State, step};
use super::place::{Delivered, Place, PlaceError, Shots};
use super::prompt::Prompter;
use super::taken::{Decoded, Taken};
use crate::pair::{FlashRecord, Limits, Plan, Reason, Settings, Stop, Verdict, proof};
use crate::pipeline::pairs;
use crate::progress::{Cancelled, Progress};
use serde_json::json;
use std::collections::VecDeque;

/// Steps of a pair that progress counts.
const STEPS: usize = 6;

/// One pair on its way.
pub(super) struct Run<'a> {
    hands: Hands<'a>,
    place: &'a mut dyn Place,
    limits: &'a Limits,
    events: &'a Events,
    /// What the camera told before the pair.
    told: Settings,
    plan: Option<Plan>,
    off: Option<Taken>,
    on: Option<Taken>,
    settings: [Settings; 2],
    digests: [String; 2],
    flash: Option<FlashRecord>,
    reasons: Vec<Reason>,
    stop: Option<Stop>,
    error: Option<CaptureError>,
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
            place,
            limits,
            events,
            told: Settings::default(),
            plan: None,
            off: None,
            on: None,
            settings: Default::default(),
            digests: Default::default(),
            flash: None,
            reasons: Vec::new(),
            stop: None,
            error: None,
        }
    }

    /// Drives the state machine from the first event to the end.
    pub(super) fn finish(&mut self) -> Result<Verdict, CaptureError> {
        let (mut state, effects) = step(State::Ready, Event::Go);
        let mut waiting = VecDeque::from(effects);
        let mut cancelled = false;
        while let Some(effect) = waiting.pop_front() {
            if !cancelled && self.hands.progress.is_cancelled() {
                cancelled = true;
                let (next, effects) = step(state, Event::Cancel);
                if next != state {
                    state = next;
                    waiting = effects.into();
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
                let (next, effects) = step(state, event);
                if matches!(event, Event::Broke | Event::Cancel) && next != state {
                    waiting.clear();
                }
                state = next;
                waiting.extend(effects);
            }
        }
        match state {
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
                self.report("Making sure that the camera stands as planned", 0);
                self.lock()?;
                Ok(Some(Event::Locked))
            }
            Effect::Darken => {
                self.report("Making sure that the flash stays dark", 0);
                self.hands.darken()?;
                Ok(Some(Event::Dark))
            }
            Effect::Shoot(frame) => {
                match frame {
                    Frame::Off => self.report("Taking the frame without flash", 1),
                    Frame::On => self.report("Taking the frame with flash", 3),
                }
                self.turn_dials(frame)?;
                let shot = self.hands.release()?;
                *self.slot(frame) = Some(Taken::new(shot));
                Ok(Some(Event::FrameTaken))
            }
            Effect::BeginCheck(frame) => self.begin_check(frame).map(|()| None),
            Effect::CountPulses(frame) => {
                self.count(frame)?;
                Ok(Some(Event::Counted))
            }
            Effect::Arm => {
                self.report("Getting the flash ready", 2);
                self.hands.arm(self.place.tag())?;
                Ok(Some(Event::Armed))
            }
            Effect::Disarm => {
                self.hands.disarm();
                Ok(None)
            }
            Effect::Judge => {
                self.report("Checking both frames", 4);
                Ok(Some(Event::Judged(self.judge()?)))
            }
            Effect::Store(_) => {
                self.report("Storing the pair", 5);
                self.store()?;
                self.report("Stored", STEPS);
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

    fn report(&self, words: &str, done: usize) {
        self.hands.progress.report(words, done, STEPS);
    }

    fn slot(&mut self, frame: Frame) -> &mut Option<Taken> {
        match frame {
            Frame::Off => &mut self.off,
            Frame::On => &mut self.on,
        }
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

    fn turn_dials(&mut self, frame: Frame) -> Result<(), CaptureError> {
        let Some(plan) = self.plan else { return Ok(()) };
        let wanted = match frame {
            Frame::Off => plan.off,
            Frame::On => plan.on,
        };
        let turned = self.hands.turn_dials(&self.told, &wanted)?;
        if turned && frame == Frame::Off && plan.off == plan.on {
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
    fn begin_check(&mut self, frame: Frame) -> Result<(), CaptureError> {
        let (measured, stager) = (self.place.saturation(), self.place.stager());
        self.slot(frame).as_mut().map_or(Ok(()), |taken| taken.begin(measured, stager))
    }

    /// Asks the controller what it saw since the last count. It reports dark syncs too, so that silence
    /// means that the contact never closed.
    fn count(&mut self, frame: Frame) -> Result<(), CaptureError> {
        let Some(syncs) = self.hands.count()? else { return Ok(()) };
        self.reasons.extend(match frame {
            Frame::Off => proof::dark_frame(&syncs),
            Frame::On => proof::lit_frame(&syncs, self.place.tag(), self.place.sees_light()),
        });
        let record = self.flash.get_or_insert_default();
        match frame {
            Frame::Off => record.off = syncs,
            Frame::On => record.on = syncs,
        }
        Ok(())
    }

    /// The decoder's outcome for one frame, and the file's digest.
    fn decoded(&mut self, frame: Frame) -> Result<(Decoded, String), CaptureError> {
        let decoded = self.slot(frame).as_mut().and_then(Taken::decoded);
        Ok(decoded.ok_or(PlaceError::Incomplete)?)
    }

    fn judge(&mut self) -> Result<Verdict, CaptureError> {
        let ((off, off_digest), (on, on_digest)) = (self.decoded(Frame::Off)?, self.decoded(Frame::On)?);
        let energy = self.flash.as_ref().and_then(FlashRecord::energy_counts);
        let mut expected = self.place.expected(&off_digest, &on_digest, energy);
        expected.plan = self.plan.as_ref();
        if let (Some(window), Ok(photo)) = (self.place.region(), &off) {
            expected.region = Some(window.sites(photo.mosaic.dn.width(), photo.mosaic.dn.height()));
        }
        let judgement = pairs::judge(&off, &on, &expected, self.limits);
        self.reasons.extend(judgement.reasons);
        self.stop = judgement.stop;
        self.digests = [off_digest, on_digest];
        self.settings = [off, on].map(|photo| photo.map(|p| p.settings).unwrap_or_default());
        Ok(if self.reasons.is_empty() { Verdict::Accepted } else { Verdict::Rejected })
    }

    fn store(&mut self) -> Result<(), CaptureError> {
        let (Some(mut off), Some(mut on)) = (self.off.take(), self.on.take()) else {
            // The machine stores only after both frames were taken.
            return Err(PlaceError::Incomplete.into());
        };
        // The first good pair sets the plan; a rejected one leaves the operator free to set the camera otherwise.
        if let Some(plan) = self.plan
            && self.reasons.is_empty()
            && self.place.plan().is_none()
        {
            self.place.adopt(plan)?;
        }
        let [off_settings, on_settings] = std::mem::take(&mut self.settings);
        let [off_digest, on_digest] = std::mem::take(&mut self.digests);
        let staged = (off.staged().map_err(PlaceError::from)?, on.staged().map_err(PlaceError::from)?);
        self.place.store(Shots {
            off: Delivered {
                shot: &off.shot,
                settings: off_settings,
                blake3: off_digest,
                staged: staged.0.as_ref(),
            },
            on: Delivered {
                shot: &on.shot,
                settings: on_settings,
                blake3: on_digest,
                staged: staged.1.as_ref(),
            },
            flash: self.flash.take(),
            reasons: std::mem::take(&mut self.reasons),
            stop: self.stop.take(),
        })?;
        Ok(())
    }
}
