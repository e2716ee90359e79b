//! One pair on its way: does the effects of the state machine and feeds back what happened.

use super::bench::{Bench, FlashKind};
use super::engine::CaptureError;
use super::machine::{Effect, End, Event, Frame, State, step};
use super::place::{Place, PlaceError, Shots};
use super::prompt::Prompter;
use crate::codec::raw::{self, Photo};
use crate::pair::{self, FlashRecord, FrameView, Limits, Reason, ReasonCode, Verdict};
use crate::progress::{Cancelled, Progress};
use crate::rig::{Flash, FlashError, FlashShot, ShotFile};
use std::collections::VecDeque;
use std::time::{Duration, Instant};

/// How long the gate stays open for the lit frame. A tethered body may take seconds from the request to the
/// release.
const ARMED_FOR: Duration = Duration::from_secs(15);
/// How long the controller's word on a sync may be under way after the camera has delivered the file.
const SYNC_PATIENCE: Duration = Duration::from_millis(700);
/// How long a flash may take to recycle before the pair is given up.
const RECYCLE_PATIENCE: Duration = Duration::from_secs(30);
/// Steps of a pair that progress counts.
const STEPS: usize = 6;

/// One frame on its way: the file, and what the decoder made of it.
struct Taken {
    file: ShotFile,
    photo: Option<Photo>,
}

/// One pair on its way.
pub(super) struct Run<'a> {
    bench: &'a mut Bench,
    place: &'a mut dyn Place,
    prompter: &'a Prompter,
    limits: &'a Limits,
    progress: &'a Progress,
    off: Option<Taken>,
    on: Option<Taken>,
    flash: Option<FlashRecord>,
    reasons: Vec<Reason>,
    error: Option<CaptureError>,
}

impl<'a> Run<'a> {
    pub(super) fn new(
        bench: &'a mut Bench,
        place: &'a mut dyn Place,
        prompter: &'a Prompter,
        limits: &'a Limits,
        progress: &'a Progress,
    ) -> Self {
        Self {
            bench,
            place,
            prompter,
            limits,
            progress,
            off: None,
            on: None,
            flash: None,
            reasons: Vec::new(),
            error: None,
        }
    }

    /// Drives the state machine from the first event to the end.
    pub(super) fn finish(&mut self) -> Result<Verdict, CaptureError> {
        let (mut state, effects) = step(State::Ready, Event::Go);
        let mut waiting = VecDeque::from(effects);
        let mut cancelled = false;
        while let Some(effect) = waiting.pop_front() {
            if !cancelled && self.progress.is_cancelled() {
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
            Effect::Darken => {
                self.progress.report("Making sure that the flash stays dark", 0, STEPS);
                self.darken()?;
                Ok(Some(Event::Dark))
            }
            Effect::Shoot(frame) => {
                let (words, done) = match frame {
                    Frame::Off => ("Taking the frame without flash", 1),
                    Frame::On => ("Taking the frame with flash", 3),
                };
                self.progress.report(words, done, STEPS);
                let file = self.release()?;
                *self.slot(frame) = Some(Taken { file, photo: None });
                Ok(Some(Event::FrameTaken))
            }
            Effect::CountPulses(frame) => {
                self.count(frame)?;
                Ok(Some(Event::Counted))
            }
            Effect::Check(frame) => {
                if frame == Frame::On {
                    self.progress.report("Checking both frames", 4, STEPS);
                }
                self.check(frame);
                Ok(Some(Event::Checked))
            }
            Effect::Arm => {
                self.progress.report("Getting the flash ready", 2, STEPS);
                self.arm()?;
                Ok(Some(Event::Armed))
            }
            Effect::Disarm => {
                if let Ok(FlashKind::Controller(flash)) = self.bench.flash()
                    && let Err(error) = flash.disarm()
                {
                    // The gate was opened once with a time to live and closes by itself.
                    tracing::warn!("the flash could not be disarmed: {error}");
                    self.bench.note_flash_error(&error);
                }
                Ok(None)
            }
            Effect::Judge => Ok(Some(Event::Judged(self.judge()))),
            Effect::Store(_) => {
                self.progress.report("Storing the pair", 5, STEPS);
                self.store()?;
                self.progress.report("Stored", STEPS, STEPS);
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

    fn slot(&mut self, frame: Frame) -> &mut Option<Taken> {
        match frame {
            Frame::Off => &mut self.off,
            Frame::On => &mut self.on,
        }
    }

    fn release(&mut self) -> Result<ShotFile, CaptureError> {
        let shot = self.bench.camera().and_then(|camera| camera.shoot());
        shot.map(|shot| shot.raw).map_err(|error| {
            self.bench.note_camera_error(&error);
            error.into()
        })
    }

    /// Closes the gate and forgets the syncs of the past.
    fn darken(&mut self) -> Result<(), CaptureError> {
        // Without a camera nobody should be sent to switch a flash.
        if let Err(error) = self.bench.camera() {
            return Err(error.into());
        }
        let done = match self.bench.flash()? {
            FlashKind::Controller(flash) => {
                flash.disarm().and_then(|()| flash.syncs(Duration::ZERO).map(drop))
            }
            FlashKind::Manual => {
                self.prompter.ask("Switch the flash off, then confirm.", self.progress)?;
                Ok(())
            }
            FlashKind::None => return Err(CaptureError::NoFlash),
        };
        done.map_err(|error| self.flash_error(error))
    }

    fn arm(&mut self) -> Result<(), CaptureError> {
        let tag = self.place.tag();
        let done = match self.bench.flash()? {
            FlashKind::Controller(flash) => arm_when_recycled(flash.as_mut(), tag, self.progress)?,
            FlashKind::Manual => {
                self.prompter.ask("Switch the flash on, then confirm.", self.progress)?;
                Ok(())
            }
            FlashKind::None => return Err(CaptureError::NoFlash),
        };
        done.map_err(|error| self.flash_error(error))
    }

    fn flash_error(&mut self, error: FlashError) -> CaptureError {
        self.bench.note_flash_error(&error);
        error.into()
    }

    /// Asks the controller what it saw since the last count. It reports dark syncs too, so that silence
    /// means that the contact never closed.
    fn count(&mut self, frame: Frame) -> Result<(), CaptureError> {
        let FlashKind::Controller(flash) = self.bench.flash()? else { return Ok(()) };
        let syncs = flash.syncs(SYNC_PATIENCE).map_err(|error| self.flash_error(error))?;
        let record = self.flash.get_or_insert_default();
        let lit: Vec<&FlashShot> = syncs.iter().filter(|s| s.triggered).collect();
        let pulses = u32::try_from(lit.len()).unwrap_or(u32::MAX);
        match frame {
            Frame::Off => {
                record.pulses_off = pulses;
                if pulses != 0 {
                    self.reasons.push(Reason {
                        code: ReasonCode::Misfire,
                        figure: f64::from(pulses),
                        limit: 0.0,
                        sentence: "The flash fired during the frame without flash; check that nothing else \
                                   triggers it (radio trigger, optical slave) and take the pair again."
                            .into(),
                    });
                }
            }
            Frame::On => {
                record.pulses_on = pulses;
                record.energy_counts = lit.last().and_then(|s| s.energy_counts);
                if let Some(sentence) = what_was_wrong_with_the_pulse(&syncs, &lit) {
                    let (figure, limit) = (f64::from(pulses), 1.0);
                    self.reasons.push(Reason { code: ReasonCode::Misfire, figure, limit, sentence });
                }
            }
        }
        Ok(())
    }

    fn check(&mut self, frame: Frame) {
        let Some(taken) = self.slot(frame) else { return };
        match raw::decode(&taken.file.bytes, &taken.file.name) {
            Ok(photo) => taken.photo = Some(photo),
            Err(error) => self.reasons.push(error.reason()),
        }
    }

    fn judge(&mut self) -> Verdict {
        let photos = (
            self.off.as_ref().and_then(|t| t.photo.as_ref()),
            self.on.as_ref().and_then(|t| t.photo.as_ref()),
        );
        // A frame that could not be decoded has left its reason already.
        if let (Some(off), Some(on)) = photos {
            self.reasons.extend(pair::judge(view(off), view(on), self.limits));
        }
        if self.reasons.is_empty() { Verdict::Accepted } else { Verdict::Rejected }
    }

    fn store(&mut self) -> Result<(), CaptureError> {
        let (Some(off), Some(on)) = (self.off.take(), self.on.take()) else {
            // The machine stores only after both frames were taken.
            return Err(PlaceError::Incomplete.into());
        };
        self.place.store(Shots {
            off: off.file,
            on: on.file,
            off_settings: off.photo.map(|p| p.settings).unwrap_or_default(),
            on_settings: on.photo.map(|p| p.settings).unwrap_or_default(),
            flash: self.flash.take(),
            reasons: std::mem::take(&mut self.reasons),
        })?;
        Ok(())
    }
}

fn view(photo: &Photo) -> FrameView<'_> {
    FrameView { mosaic: &photo.mosaic, settings: &photo.settings }
}

/// Arms, waiting for a flash that says how long it still recycles.
fn arm_when_recycled(
    flash: &mut dyn Flash,
    tag: u32,
    progress: &Progress,
) -> Result<Result<(), FlashError>, Cancelled> {
    let end = Instant::now() + RECYCLE_PATIENCE;
    loop {
        match flash.arm(tag, ARMED_FOR) {
            Err(FlashError::NotReady { wait_ms }) if Instant::now() < end => {
                progress.check()?;
                std::thread::sleep(Duration::from_millis(wait_ms.clamp(10, 250)));
            }
            outcome => return Ok(outcome),
        }
    }
}

/// A sentence if the lit frame did not get exactly one pulse.
fn what_was_wrong_with_the_pulse(syncs: &[FlashShot], lit: &[&FlashShot]) -> Option<String> {
    match (syncs.len(), lit.len()) {
        (_, 1) => None,
        (0, 0) => Some(
            "The camera's sync contact never closed, so the flash stayed dark; check the sync cable and that \
             the camera uses its mechanical shutter."
                .into(),
        ),
        (_, 0) => Some(
            "The flash controller did not let the flash fire in the frame with flash; take the pair again.".into(),
        ),
        (_, n) => Some(format!(
            "The flash fired {n} times during the frame with flash; switch off pre-flash and multi-flash modes."
        )),
    }
}
