//! One pair's life as a pure function: `(state, event) -> (state, effects)`, for each program of frames.
//!
//! The machine holds no data and touches nothing; [`super::Engine`] does the effects and feeds back what
//! happened, in the order that a [`Course`] gives. What it promises, and what its tests hold it to on every path there
//! is: each frame is shot in its turn and once, the dark ones with the gate closed, the lit one with the gate open for
//! exactly one sync; nothing is stored that was not shot, checked and judged; what is being stored cannot be cancelled;
//! the gate is closed however the pair ends; nothing happens after the end.

use crate::pair::Verdict;
use crate::pair::order::{Program, Slot};
use std::collections::VecDeque;

/// How a pair ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum End {
    /// Stored; the verdict says whether processing may use it.
    Stored(Verdict),
    /// A device or the disk gave up; nothing was stored.
    Failed,
    /// Stopped on request; nothing was stored.
    Cancelled,
}

/// Where a pair stands.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum State {
    /// Nothing has been done yet.
    Ready,
    /// The camera's settings are read and set.
    Locking,
    /// The gate between camera and flash is being closed for this frame.
    Darkening(Slot),
    /// The gate is being opened for one sync, for this frame.
    Arming(Slot),
    /// The shutter is released and the file fetched.
    Shooting(Slot),
    /// The controller is asked what it saw.
    Counting(Slot),
    /// All frames are compared.
    Judging,
    /// All frames go to the session under this verdict.
    Storing(Verdict),
    /// Over.
    Ended(End),
}

/// What happened.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Event {
    /// The pair is wanted.
    Go,
    /// The camera stands as planned.
    Locked,
    /// The gate is closed, or the operator has switched the flash off.
    Dark,
    /// The gate is open for one sync, or the operator has switched the flash on.
    Armed,
    /// A whole file came from the camera.
    FrameTaken,
    /// The pulses of the frame are as they should be (or nobody counts them).
    Counted,
    /// The pulses of the frame are not as they should be: the pair will be rejected, and further frames are not worth
    /// their time.
    Unproven,
    /// The checks have spoken.
    Judged(Verdict),
    /// The pair is safe on disk.
    Stored,
    /// The last effect could not be done.
    Broke,
    /// The operator wants it to stop.
    Cancel,
}

/// What is to be done. All but `RecordIntent`, `BeginCheck`, `Disarm` and `RecordEnd` answer with one event.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Effect {
    /// Writes to the journal that a pair is about to be shot.
    RecordIntent,
    /// Goes through the exposure lock and turns the dials to the plan.
    Lock,
    /// Closes the gate, or asks the operator to switch the flash off.
    Darken,
    /// Opens the gate for one sync, or asks the operator to switch the flash on.
    Arm,
    /// Releases the shutter and fetches the file.
    Shoot(Slot),
    /// Asks the controller what it saw during the frame.
    CountPulses(Slot),
    /// Sets the decoder to work on the file; nobody waits for it before [`Effect::Judge`].
    BeginCheck(Slot),
    /// Closes the gate; best effort, nobody waits for it.
    Disarm,
    /// Waits for the decoder and compares the frames.
    Judge,
    /// Commits all frames to the session under this verdict.
    Store(Verdict),
    /// Writes to the journal that nothing was stored, and why.
    RecordEnd(End),
}

/// The next state, and what is to be done to leave it. Events that make no sense in a state change nothing.
pub fn step(program: Program, state: State, event: Event) -> (State, Vec<Effect>) {
    use {Effect as Do, Event as E, State as S};
    match (state, event) {
        (S::Ended(_), _) => (state, vec![]),
        // What is being written is finished: half a second of patience against a lost pair.
        (S::Storing(_), E::Cancel) => (state, vec![]),
        (_, E::Cancel) => (S::Ended(End::Cancelled), vec![Do::Disarm, Do::RecordEnd(End::Cancelled)]),
        (_, E::Broke) => (S::Ended(End::Failed), vec![Do::Disarm, Do::RecordEnd(End::Failed)]),
        (S::Ready, E::Go) => (S::Locking, vec![Do::RecordIntent, Do::Lock]),
        (S::Locking, E::Locked) => prepare(program.first()),
        (S::Darkening(slot), E::Dark) | (S::Arming(slot), E::Armed) => {
            (S::Shooting(slot), vec![Do::Shoot(slot)])
        }
        // Each frame is checked while the next one is shot.
        (S::Shooting(slot), E::FrameTaken) => {
            (S::Counting(slot), vec![Do::BeginCheck(slot), Do::CountPulses(slot)])
        }
        (S::Counting(slot), E::Counted) => go_on(slot, program.after(slot)),
        (S::Counting(slot), E::Unproven) => go_on(slot, program.needed_after(slot)),
        (S::Judging, E::Judged(verdict)) => (S::Storing(verdict), vec![Do::Store(verdict)]),
        (S::Storing(verdict), E::Stored) => (S::Ended(End::Stored(verdict)), vec![]),
        (_, _) => (state, vec![]),
    }
}

/// From one frame to the next: the gate stays closed between two dark ones.
fn go_on(slot: Slot, next: Option<Slot>) -> (State, Vec<Effect>) {
    match next {
        None => (State::Judging, vec![Effect::Disarm, Effect::Judge]),
        Some(next) if !slot.part.is_lit() && !next.part.is_lit() => {
            (State::Shooting(next), vec![Effect::Shoot(next)])
        }
        Some(next) => prepare(next),
    }
}

/// Brings the gate into the position that a frame needs.
fn prepare(slot: Slot) -> (State, Vec<Effect>) {
    if slot.part.is_lit() {
        (State::Arming(slot), vec![Effect::Arm])
    } else {
        (State::Darkening(slot), vec![Effect::Darken])
    }
}

/// A pair on its way: where it stands, and what waits to be done, first things first.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub struct Course {
    program: Program,
    state: State,
    waiting: VecDeque<Effect>,
}

impl Course {
    /// A pair that is wanted.
    pub fn begin(program: Program) -> Self {
        let (state, effects) = step(program, State::Ready, Event::Go);
        Self { program, state, waiting: effects.into() }
    }

    /// Where it stands.
    pub fn state(&self) -> State {
        self.state
    }

    /// The next thing to do; nothing is left after the end.
    pub fn next_effect(&mut self) -> Option<Effect> {
        self.waiting.pop_front()
    }

    /// Takes in what happened. What breaks or cancels a pair makes everything moot that still waited.
    pub fn hear(&mut self, event: Event) {
        let (next, effects) = step(self.program, self.state, event);
        if matches!(event, Event::Broke | Event::Cancel) && next != self.state {
            self.waiting.clear();
        }
        self.state = next;
        self.waiting.extend(effects);
    }
}

#[cfg(test)]
#[path = "machine_tests.rs"]
mod tests;
