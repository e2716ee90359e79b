//! A sequence's life as a pure function: `(plan, state, event, now) -> (state, effects)`.
//!
//! It touches nothing and has no clock but the one it is told (since 1970, and never back); [`super::Conductor`] does the effects and feeds
//! back what happened. What it promises, and what its property tests hold it to: positions are taken in order;
//! none is left out unless somebody said so; nothing is shot without a go, nor while paused, nor before the
//! interval is over; of two goes for one position one counts; a position whose pair was accepted is never shot
//! again; nothing is shot after it was cancelled.

use crate::session::{Between, SequencePlan};
use std::time::Duration;

/// What is known of one position.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(super) struct Position {
    /// Numbers of its pairs, in the order in which they were taken.
    pub(super) pairs: Vec<u32>,
    /// The pair that counts.
    pub(super) accepted: Option<u32>,
    /// Somebody wanted it left out.
    pub(super) skipped: bool,
}

impl Position {
    /// Whether nothing more is to be shot there.
    pub(super) fn is_settled(&self) -> bool {
        self.accepted.is_some() || self.skipped
    }
}

/// What a sequence does. Positions count from 1.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum Phase {
    /// Nothing yet.
    Planned,
    /// Waits for the go of a position.
    Waiting {
        /// Which.
        position: u32,
        /// Since when.
        since: Duration,
    },
    /// Has its go, and waits until the interval is over.
    Resting {
        /// Which.
        position: u32,
        /// How often its pair was rejected since somebody said go.
        tries: u32,
    },
    /// A pair is being taken.
    Shooting {
        /// Which.
        position: u32,
        /// How often its pair was rejected since somebody said go.
        tries: u32,
    },
    /// No pair came of it: the operator says what now.
    Asking {
        /// Which.
        position: u32,
        /// What happened, in a sentence.
        why: String,
    },
    /// Every position is settled.
    Done,
    /// Given up.
    Cancelled,
}

/// Why nothing new is begun.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) enum Pause {
    /// Somebody wanted it.
    Asked,
    /// The program was started anew.
    Restarted,
    /// Something is in the way, in a sentence.
    Hindered(String),
}

/// Where a sequence stands.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct State {
    /// What it does.
    pub(super) phase: Phase,
    /// Set while nothing new may be begun; a pair that is being taken is finished.
    pub(super) paused: Option<Pause>,
    /// What is known of each position.
    pub(super) positions: Vec<Position>,
    /// A pair that was begun and has not ended: its position, and its number once that is known.
    pub(super) under_way: Option<(u32, Option<u32>)>,
    /// When the last pair was begun, by the clock: it is kept over a restart.
    pub(super) last_begun: Option<Duration>,
}

/// What happened.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Event {
    /// Somebody wants the sequence begun.
    Start,
    /// Somebody wants nothing new begun.
    Pause,
    /// Somebody wants it to go on.
    Resume,
    /// All is in place: the operator's or the script's word.
    Next,
    /// The trigger file is there.
    Triggered,
    /// Time went by.
    Tick,
    /// Take the pair again.
    Retry,
    /// Leave the position out.
    Skip,
    /// Give up.
    Cancel,
    /// An effect could not be done; a sentence.
    Hindered(String),
    /// The pair is about to be shot, and will have this number.
    Begun(u32),
    /// The pair is stored.
    Shot {
        /// Its number.
        pair: u32,
        /// Why it was rejected, in a sentence; `None` if it is good.
        rejected: Option<String>,
    },
    /// No pair came of it; a sentence.
    Failed(String),
    /// Somebody shot this rejected pair again by hand, and it is good.
    Mended(u32),
}

/// What is to be done.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Effect {
    /// Takes a pair; answered with `Shot` or `Failed`, and with `Begun` before.
    Shoot(u32),
    /// Stops the pair that is being taken.
    CancelShot,
    /// Removes the trigger file: its position is done, or it lay there before anybody was asked.
    Acknowledge,
}

impl State {
    /// A sequence of which nothing is done.
    pub(super) fn planned(plan: &SequencePlan) -> Self {
        State {
            phase: Phase::Planned,
            paused: None,
            positions: vec![Position::default(); plan.positions as usize],
            under_way: None,
            last_begun: None,
        }
    }

    /// The first position that is neither done nor left out.
    pub(super) fn first_missing(&self) -> Option<u32> {
        (1..).zip(&self.positions).find(|(_, place)| !place.is_settled()).map(|(position, _)| position)
    }

    /// The position that it is about.
    pub(super) fn position(&self) -> Option<u32> {
        match self.phase {
            Phase::Waiting { position, .. }
            | Phase::Resting { position, .. }
            | Phase::Shooting { position, .. }
            | Phase::Asking { position, .. } => Some(position),
            Phase::Planned => self.first_missing(),
            Phase::Done | Phase::Cancelled => None,
        }
    }

    /// Whether it has ended.
    pub(super) fn is_over(&self) -> bool {
        matches!(self.phase, Phase::Done | Phase::Cancelled)
    }

    /// When the next [`Event::Tick`] brings it on by itself.
    pub(super) fn due(&self, plan: &SequencePlan) -> Option<Duration> {
        match (&self.phase, plan.between) {
            _ if self.paused.is_some() => None,
            (Phase::Waiting { since, .. }, Between::Countdown { seconds }) => {
                Some(since.saturating_add(span(seconds)))
            }
            (Phase::Resting { .. }, _) => Some(self.rested(plan)),
            _ => None,
        }
    }

    /// Whether it waits for the trigger file.
    pub(super) fn watches(&self, plan: &SequencePlan) -> bool {
        self.paused.is_none()
            && plan.between == Between::TriggerFile
            && matches!(self.phase, Phase::Waiting { .. })
    }

    /// When the interval since the last pair is over.
    fn rested(&self, plan: &SequencePlan) -> Duration {
        self.last_begun.map_or(Duration::ZERO, |begun| begun.saturating_add(span(plan.interval_s)))
    }

    fn place(&mut self, position: u32) -> Option<&mut Position> {
        self.positions.get_mut((position as usize).checked_sub(1)?)
    }

    /// Waits at the first position that is missing.
    fn go_on(&mut self, now: Duration) {
        self.phase = match self.first_missing() {
            Some(position) => Phase::Waiting { position, since: now },
            None => Phase::Done,
        };
    }

    /// The position is settled: whoever waits for that hears of it, and the next is waited at.
    fn leave(&mut self, now: Duration, to_do: &mut Vec<Effect>) {
        to_do.push(Effect::Acknowledge);
        self.go_on(now);
    }

    /// Takes a pair, or waits until the interval is over.
    fn shoot(
        &mut self,
        plan: &SequencePlan,
        position: u32,
        tries: u32,
        now: Duration,
        to_do: &mut Vec<Effect>,
    ) {
        if now < self.rested(plan) {
            self.phase = Phase::Resting { position, tries };
        } else {
            self.phase = Phase::Shooting { position, tries };
            self.under_way = Some((position, None));
            to_do.push(Effect::Shoot(position));
        }
    }

    /// Begins nothing new; a go that waited for the interval is forgotten.
    fn pause(&mut self, why: Pause, now: Duration) {
        self.paused.get_or_insert(why);
        if let Phase::Resting { position, .. } = self.phase {
            self.phase = Phase::Waiting { position, since: now };
        }
    }

    /// Whether nothing more is to be shot at a position.
    fn is_settled(&self, position: u32) -> bool {
        let place = (position as usize).checked_sub(1).and_then(|at| self.positions.get(at));
        place.is_some_and(Position::is_settled)
    }

    /// Takes in what came of the pair that was under way; `None` if there was none.
    fn ended(&mut self, pair: Option<u32>, accepted: bool) -> Option<()> {
        let (position, _) = self.under_way.take()?;
        let place = self.place(position)?;
        if let Some(pair) = pair {
            // A pair that is taken again under its own number is the same pair.
            if !place.pairs.contains(&pair) {
                place.pairs.push(pair);
            }
            if accepted {
                place.accepted = Some(pair);
            }
        }
        Some(())
    }
}

fn span(seconds: f64) -> Duration {
    Duration::try_from_secs_f64(seconds).unwrap_or_default()
}

/// The next state, and what is to be done; `None` where the event makes no sense.
pub(super) fn step(
    plan: &SequencePlan,
    state: &State,
    event: Event,
    now: Duration,
) -> Option<(State, Vec<Effect>)> {
    let mut next = state.clone();
    let mut to_do = Vec::new();
    match (state.phase.clone(), event) {
        // A wish that is fulfilled already is no mistake: whoever lost an answer may ask again.
        (Phase::Cancelled, Event::Cancel) => {}
        (
            Phase::Planned | Phase::Done | Phase::Cancelled,
            Event::Pause | Event::Resume | Event::Hindered(_),
        ) => {
            return None;
        }

        (Phase::Planned, Event::Start) => {
            to_do.push(Effect::Acknowledge);
            next.go_on(now);
        }
        (_, Event::Pause) => next.pause(Pause::Asked, now),
        (_, Event::Hindered(why)) => next.pause(Pause::Hindered(why), now),
        (Phase::Waiting { position, .. }, Event::Resume) if state.paused.is_some() => {
            to_do.push(Effect::Acknowledge);
            next.paused = None;
            next.phase = Phase::Waiting { position, since: now };
        }
        (_, Event::Resume) => next.paused = None,

        (Phase::Waiting { position, .. }, Event::Next) if state.paused.is_none() => {
            next.shoot(plan, position, 0, now, &mut to_do);
        }
        (Phase::Waiting { position, .. }, Event::Triggered) if state.watches(plan) => {
            next.shoot(plan, position, 0, now, &mut to_do);
        }
        (Phase::Waiting { position, .. }, Event::Tick) if state.due(plan).is_some_and(|due| due <= now) => {
            next.shoot(plan, position, 0, now, &mut to_do);
        }
        (Phase::Resting { position, tries }, Event::Tick)
            if state.due(plan).is_some_and(|due| due <= now) =>
        {
            next.shoot(plan, position, tries, now, &mut to_do);
        }
        (Phase::Asking { position, .. }, Event::Retry) if state.paused.is_none() => {
            next.shoot(plan, position, 0, now, &mut to_do);
        }
        (
            Phase::Waiting { position, .. }
            | Phase::Resting { position, .. }
            | Phase::Asking { position, .. },
            Event::Skip,
        ) => {
            next.place(position)?.skipped = true;
            next.leave(now, &mut to_do);
        }

        (phase, Event::Cancel) if phase != Phase::Done => {
            next.phase = Phase::Cancelled;
            next.paused = None;
            if state.under_way.is_some() {
                to_do.push(Effect::CancelShot);
            }
        }

        (_, Event::Begun(pair)) => {
            let (position, None) = state.under_way? else { return None };
            if state.is_settled(position) {
                return None;
            }
            next.under_way = Some((position, Some(pair)));
            next.last_begun = Some(now);
        }
        (phase, Event::Shot { pair, rejected }) => {
            next.ended(Some(pair), rejected.is_none())?;
            // A pair that was being written when all was cancelled is kept, and nothing follows.
            if let Phase::Shooting { position, tries } = phase {
                match rejected {
                    Some(_) if next.is_settled(position) => next.leave(now, &mut to_do),
                    None => next.leave(now, &mut to_do),
                    Some(_) if tries < plan.retries && state.paused.is_none() => {
                        next.shoot(plan, position, tries + 1, now, &mut to_do);
                    }
                    Some(why) => next.phase = Phase::Asking { position, why },
                }
            }
        }
        (phase, Event::Failed(why)) => {
            next.ended(None, false)?;
            match phase {
                Phase::Shooting { position, .. } if next.is_settled(position) => next.leave(now, &mut to_do),
                Phase::Shooting { position, .. } => next.phase = Phase::Asking { position, why },
                _ => {}
            }
        }
        (phase, Event::Mended(pair)) => {
            let unsettled = |place: &&mut Position| place.accepted.is_none() && place.pairs.contains(&pair);
            next.positions.iter_mut().find(unsettled)?.accepted = Some(pair);
            match phase {
                // A pair that was set off meanwhile is not begun any more.
                Phase::Waiting { position, .. }
                | Phase::Resting { position, .. }
                | Phase::Asking { position, .. }
                    if next.is_settled(position) =>
                {
                    next.leave(now, &mut to_do);
                }
                _ => {}
            }
        }
        _ => return None,
    }
    Some((next, to_do))
}
