//! Runs a session's sequence: takes wishes, keeps `sequence.json`, has pairs taken, watches clock and trigger file.
//!
//! The conductor owns no device. Each pair is set off through a [`Shooter`] and told back, so that others may shoot
//! in between. Its clock is a thread that lives only while time or the trigger file matters; whoever drops it ends that too.

use super::error::SequenceError;
use super::ledger;
use super::machine::{Effect, Event, Phase, State, step};
use super::view::{SequenceState, SequenceView, view};
use crate::capture::engine::{AfterPair, Engine, words_on};
use crate::capture::error::CaptureError;
use crate::capture::events::{Events, Topic};
use crate::capture::place::name_of;
use crate::capture::wish::PairWish;
use crate::pair::{PairRecord, Verdict};
use crate::progress::{Cancelled, Progress};
use crate::session::{SequencePlan, SequenceRecord, Session, SessionError};
use serde_json::json;
use std::collections::VecDeque;
use std::path::PathBuf;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant, SystemTime, UNIX_EPOCH};

/// Has pairs taken.
pub trait Shooter: Send + Sync {
    /// Sets a pair for `position` off, which calls [`Conductor::take_pair`] when its turn comes; the error is a
    /// sentence.
    fn begin(&self, conductor: &Arc<Conductor>, position: u32) -> Result<(), String>;
    /// Stops the pair that was set off.
    fn stop(&self);
    /// Whether the pair that was set off ended without ever getting its turn.
    fn is_lost(&self) -> bool;
}

/// What is behind the conductor's lock.
pub(super) struct Inside {
    pub(super) sequence: Option<(SequencePlan, State)>,
    /// What is on the disk.
    kept: Option<SequenceRecord>,
    /// Whether the clock's thread lives.
    pub(super) ticking: bool,
}

/// A session's sequence.
pub struct Conductor {
    session: Arc<Session>,
    pub(super) name: String,
    pub(super) trigger: PathBuf,
    pub(super) shooter: Box<dyn Shooter>,
    events: Events,
    /// When it was made: by the wall, since 1970, and by the clock that nobody puts back.
    born: (Duration, Instant),
    inside: Mutex<Inside>,
    /// A copy for those who must not wait for the disk.
    shown: Mutex<Option<(SequencePlan, State)>>,
}

/// Since 1970.
fn wall() -> Duration {
    // A clock before 1970 is a clock that is not set.
    SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default()
}

/// The sequence of a session as its files tell it at `now`.
fn restore(session: &Session, now: Duration) -> Result<Option<(SequenceRecord, State)>, SequenceError> {
    let Some(record) = session.sequence()? else { return Ok(None) };
    let pairs = session.pairs()?;
    let verdict = |number| pairs.iter().find(|pair| pair.number == number).map(|pair| pair.verdict);
    let state = ledger::restored(&record, now, |number| verdict(number).map(|v| v == Verdict::Accepted));
    Ok(Some((record, state)))
}

/// The sequence of a session that nobody conducts here.
pub(in crate::capture) fn read(session: &Session) -> Result<SequenceView, SequenceError> {
    let now = wall();
    let (record, state) =
        restore(session, now)?.ok_or_else(|| SequenceError::NotPlanned(name_of(session)))?;
    Ok(view(&name_of(session), &record.plan, &state, now))
}

impl Conductor {
    /// Takes up the session's sequence where its files say that it stood, paused. Nothing is shot before somebody
    /// wants it. `trigger` is the file to wait for where the plan wants one.
    pub fn open(
        session: Arc<Session>,
        shooter: Box<dyn Shooter>,
        events: Events,
        trigger: PathBuf,
    ) -> Result<Arc<Self>, SequenceError> {
        let born = (wall(), Instant::now());
        let restored = restore(&session, born.0)?;
        let kept = restored.as_ref().map(|(record, _)| record.clone());
        let sequence = restored.map(|(record, state)| (record.plan, state));
        let conductor = Arc::new(Self {
            name: name_of(&session),
            session,
            trigger,
            shooter,
            events,
            born,
            shown: Mutex::new(sequence.clone()),
            inside: Mutex::new(Inside { sequence, kept, ticking: false }),
        });
        if conductor.view().is_ok() {
            conductor.announce();
        }
        Ok(conductor)
    }

    pub(super) fn inside(&self) -> MutexGuard<'_, Inside> {
        // State and file are replaced whole.
        self.inside.lock().unwrap_or_else(PoisonError::into_inner)
    }

    pub(super) fn now(&self) -> Duration {
        self.born.0 + self.born.1.elapsed()
    }

    fn not_planned(&self) -> SequenceError {
        SequenceError::NotPlanned(self.name.clone())
    }

    /// How the sequence stands; never waits for a disk.
    pub fn view(&self) -> Result<SequenceView, SequenceError> {
        let shown = self.shown.lock().unwrap_or_else(PoisonError::into_inner);
        let (plan, state) = shown.as_ref().ok_or_else(|| self.not_planned())?;
        Ok(view(&self.name, plan, state, self.now()))
    }

    fn show(&self, inside: &Inside) {
        self.shown.lock().unwrap_or_else(PoisonError::into_inner).clone_from(&inside.sequence);
    }

    fn announce(&self) {
        match self.view() {
            Ok(view) => self.events.tell(Topic::Sequence, view.words.clone(), json!(view)),
            Err(gone) => self.events.tell(
                Topic::Sequence,
                gone.to_string(),
                json!({ "session": self.name, "state": "removed" }),
            ),
        }
    }

    /// Plans a sequence, or changes how one that is not under way goes on; says whether a new one was begun.
    pub fn plan(&self, plan: SequencePlan) -> Result<bool, SequenceError> {
        if let Some(fault) = plan.fault() {
            return Err(SequenceError::BadPlan(fault));
        }
        let mut inside = self.inside();
        let mut goes_on = None;
        if let Some((old, state)) = &inside.sequence {
            let busy = state.under_way.is_some()
                || (state.paused.is_none() && !state.is_over() && state.phase != Phase::Planned);
            if busy {
                return Err(self.refused("be planned anew", old, state));
            }
            let done = state.positions.iter().filter(|place| place.is_settled()).count();
            if !state.is_over() && old.positions == plan.positions {
                goes_on = Some(state.clone());
            } else if !state.is_over() && done > 0 {
                let done = u32::try_from(done).unwrap_or(u32::MAX);
                return Err(SequenceError::Unfinished { done, positions: old.positions });
            }
        }
        let made = goes_on.is_none();
        let state = goes_on.unwrap_or_else(|| State::planned(&plan));
        self.keep(&mut inside, &plan, &state)?;
        inside.sequence = Some((plan, state));
        self.show(&inside);
        self.announce();
        Ok(made)
    }

    /// Removes the sequence; its pairs stay.
    pub fn forget(&self) -> Result<(), SequenceError> {
        let mut inside = self.inside();
        let (plan, state) = inside.sequence.as_ref().ok_or_else(|| self.not_planned())?;
        if state.under_way.is_some() {
            return Err(self.refused("be removed", plan, state));
        }
        self.session.forget_sequence()?;
        (inside.sequence, inside.kept) = (None, None);
        self.show(&inside);
        self.announce();
        Ok(())
    }

    /// A wish; `position`, where given, is the only one for which it is meant.
    pub fn wish(
        self: &Arc<Self>,
        event: Event,
        position: Option<u32>,
    ) -> Result<SequenceView, SequenceError> {
        let mut inside = self.inside();
        let (plan, state) = inside.sequence.as_ref().ok_or_else(|| self.not_planned())?;
        if let Some(asked) = position
            && state.position() != Some(asked)
        {
            let stands = view(&self.name, plan, state, self.now()).words;
            return Err(SequenceError::Elsewhere { asked, stands });
        }
        self.apply(&mut inside, event)?;
        drop(inside);
        self.view()
    }

    /// Somebody shot a rejected pair again by hand, and it is good: its position is done, if it is one of the sequence's.
    pub(in crate::capture) fn mended(self: &Arc<Self>, pair: u32) {
        let _of_no_position = self.apply(&mut self.inside(), Event::Mended(pair));
    }

    /// Begins it, or goes on with it.
    pub fn go_on(self: &Arc<Self>) -> Result<SequenceView, SequenceError> {
        let planned = self.view()?.state == SequenceState::Planned;
        self.wish(if planned { Event::Start } else { Event::Resume }, None)
    }

    fn refused(&self, wish: &'static str, plan: &SequencePlan, state: &State) -> SequenceError {
        SequenceError::Refused { wish, stands: view(&self.name, plan, state, self.now()).words }
    }

    /// Writes what is to be kept, if that changed.
    fn keep(&self, inside: &mut Inside, plan: &SequencePlan, state: &State) -> Result<(), SessionError> {
        let record = ledger::record(plan, state);
        if inside.kept.as_ref() != Some(&record) {
            self.session.set_sequence(&record)?;
            inside.kept = Some(record);
        }
        Ok(())
    }

    /// Writes the state that a disk refused before, if there is one.
    pub(in crate::capture) fn write_down(&self) -> Result<(), SessionError> {
        let mut inside = self.inside();
        let Some((plan, state)) = inside.sequence.clone() else { return Ok(()) };
        self.keep(&mut inside, &plan, &state)
    }

    /// Lets something happen, and what follows from it. A wish that cannot be written down is not taken.
    pub(super) fn apply(self: &Arc<Self>, inside: &mut Inside, event: Event) -> Result<(), SequenceError> {
        self.take_in(inside, event)?;
        self.show(inside);
        self.announce();
        self.start_clock(inside);
        Ok(())
    }

    fn take_in(self: &Arc<Self>, inside: &mut Inside, event: Event) -> Result<(), SequenceError> {
        let Some((plan, state)) = inside.sequence.clone() else { return Err(self.not_planned()) };
        let wish = name(&event);
        // What has happened has happened, and what shall stop stops, whatever the disk says.
        let is_fact = matches!(
            event,
            Event::Shot { .. }
                | Event::Failed(_)
                | Event::Mended(_)
                | Event::Hindered(_)
                | Event::Pause
                | Event::Cancel
        );
        let Some((next, effects)) = step(&plan, &state, event, self.now()) else {
            return Err(self.refused(wish, &plan, &state));
        };
        let mut followers = VecDeque::new();
        match self.keep(inside, &plan, &next) {
            Err(error) if !is_fact => return Err(error.into()),
            Err(error) if next.paused.is_none() => followers.push_back(Event::Hindered(format!("{error}."))),
            Err(error) => tracing::error!("the sequence could not be written: {error}"),
            Ok(()) => {}
        }
        inside.sequence = Some((plan, next));
        for effect in effects {
            match effect {
                Effect::Shoot(position) => {
                    if let Err(why) = self.shooter.begin(self, position) {
                        followers.push_back(Event::Failed(format!("No pair was taken: {why}.")));
                    }
                }
                Effect::CancelShot => self.shooter.stop(),
                Effect::Acknowledge => followers.extend(self.acknowledge()),
            }
        }
        for event in followers {
            // Facts all; that a sequence which is over cannot be hindered any more is no error.
            let _over = self.take_in(inside, event);
        }
        Ok(())
    }

    /// Removes the trigger file, which tells the script that its position is done.
    fn acknowledge(&self) -> Option<Event> {
        match std::fs::remove_file(&self.trigger) {
            Err(error) if error.kind() != std::io::ErrorKind::NotFound => Some(Event::Hindered(format!(
                "the trigger file {} cannot be removed ({error}).",
                self.trigger.display()
            ))),
            _ => None,
        }
    }

    /// Takes the pair that was set off, on the caller's thread, and takes in what came of it.
    pub fn take_pair(
        self: &Arc<Self>,
        engine: &Engine,
        after_pair: Option<&AfterPair>,
        progress: &Progress,
    ) -> Result<PairRecord, CaptureError> {
        let mut there = None;
        let outcome = self.announced(engine, after_pair, progress, &mut there);
        let shot = |record: &PairRecord| Event::Shot {
            pair: record.number,
            rejected: (record.verdict == Verdict::Rejected).then(|| words_on(record)),
        };
        let event = match (&outcome, &there) {
            (Ok(record), _) | (Err(_), Some(record)) => shot(record),
            (Err(CaptureError::Cancelled(_)), None) => Event::Failed("The pair was cancelled.".into()),
            (Err(error), None) => Event::Failed(format!("No pair was taken: {error}.")),
        };
        let mut inside = self.inside();
        if let Err(error) = self.apply(&mut inside, event) {
            tracing::error!("the sequence of {} could not take in a pair: {error}", self.name);
        }
        outcome
    }

    /// Nobody else shoots between the announcement and the pair: whoever calls has the rig. `there`: the pair, if it is in the
    /// session although taking it failed.
    fn announced(
        self: &Arc<Self>,
        engine: &Engine,
        after_pair: Option<&AfterPair>,
        progress: &Progress,
        there: &mut Option<PairRecord>,
    ) -> Result<PairRecord, CaptureError> {
        let wish = self.pair_wish().ok_or(Cancelled)?;
        let number = wish.again.map_or_else(|| self.session.next_pair_number(), Ok)?;
        match self.apply(&mut self.inside(), Event::Begun(number)) {
            Err(SequenceError::Session(error)) => return Err(error.into()),
            Err(_) => return Err(Cancelled.into()),
            Ok(()) => {}
        }
        let attempt = || self.session.pair(number).ok();
        let before = attempt().map(|record| record.attempt);
        engine.shoot_pair_as(&self.session, wish, after_pair, progress).inspect_err(|_| {
            // The disk may have failed when the pair had its place already.
            *there = attempt().filter(|record| Some(record.attempt) != before);
        })
    }

    /// What is asked of the pair that is set off; `None` if none is. The rejected pair of its position is shot again
    /// under its own number, by which the position's camera is matched.
    fn pair_wish(&self) -> Option<PairWish> {
        let inside = self.inside();
        let (plan, state) = inside.sequence.as_ref()?;
        let (position, _) = state.under_way?;
        let before = state.positions.get(position.checked_sub(1)? as usize)?.pairs.last().copied();
        let again = before.filter(|number| self.session.rejected_pair(*number).is_ok());
        Some(PairWish { order: Some(plan.order), off_frames: Some(plan.off_frames), again })
    }
}

fn name(event: &Event) -> &'static str {
    match event {
        Event::Start => "be started",
        Event::Pause => "be paused",
        Event::Resume => "be resumed",
        Event::Next => "take the next pair",
        Event::Retry => "take the pair again",
        Event::Skip => "skip a position",
        Event::Cancel => "be cancelled",
        _ => "go on",
    }
}
