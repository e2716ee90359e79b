//! One pair's life as a pure function: `(state, event) -> (state, effects)`.
//!
//! The machine holds no data and touches nothing; [`super::Engine`] does the effects and feeds back what
//! happened. What it promises, and what its property test holds it to: the dark frame is shot with the gate
//! closed, the lit one with the gate open, each once; nothing is stored that was not shot, checked and
//! judged; a gate that was opened is closed again however the pair ends; nothing happens after the end.

use crate::pair::Verdict;
use serde::Serialize;

/// One of the pair's two frames.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Frame {
    /// Without flash.
    Off,
    /// With flash.
    On,
}

/// How a pair ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum End {
    /// Stored; the verdict says whether processing may use it.
    Stored(Verdict),
    /// A device or the disk gave up; nothing was stored.
    Failed,
    /// Stopped on request; nothing was stored.
    Cancelled,
}

/// Where a pair stands.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum State {
    /// Nothing has been done yet.
    Ready,
    /// The camera's settings are read and set.
    Locking,
    /// The gate between camera and flash is being closed.
    Darkening,
    /// The shutter is released and the file fetched.
    Shooting(Frame),
    /// The controller is asked what it saw.
    Counting(Frame),
    /// The gate is being opened for one sync.
    Arming,
    /// Both frames are compared.
    Judging,
    /// Both frames go to the session under this verdict.
    Storing(Verdict),
    /// Over.
    Ended(End),
}

/// What happened.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Event {
    /// The pair is wanted.
    Go,
    /// The camera stands as planned.
    Locked,
    /// The gate is closed, or the operator has switched the flash off.
    Dark,
    /// A whole file came from the camera.
    FrameTaken,
    /// The pulses of the frame are known (or nobody counts them).
    Counted,
    /// The gate is open for one sync, or the operator has switched the flash on.
    Armed,
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
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Effect {
    /// Writes to the journal that a pair is about to be shot.
    RecordIntent,
    /// Goes through the exposure lock and turns the dials to the plan.
    Lock,
    /// Closes the gate, or asks the operator to switch the flash off.
    Darken,
    /// Releases the shutter and fetches the file.
    Shoot(Frame),
    /// Asks the controller what it saw during the frame.
    CountPulses(Frame),
    /// Sets the decoder to work on the file; nobody waits for it before [`Effect::Judge`].
    BeginCheck(Frame),
    /// Opens the gate for one sync, or asks the operator to switch the flash on.
    Arm,
    /// Closes the gate; best effort, nobody waits for it.
    Disarm,
    /// Waits for the decoder and compares the frames.
    Judge,
    /// Commits both frames to the session under this verdict.
    Store(Verdict),
    /// Writes to the journal that nothing was stored, and why.
    RecordEnd(End),
}

/// The next state, and what is to be done to leave it. Events that make no sense in a state change nothing.
pub fn step(state: State, event: Event) -> (State, Vec<Effect>) {
    use {Effect as Do, Event as E, Frame::*, State as S};
    match (state, event) {
        (S::Ended(_), _) => (state, vec![]),
        // What is being written is finished: half a second of patience against a lost pair.
        (S::Storing(_), E::Cancel) => (state, vec![]),
        (_, E::Cancel) => (S::Ended(End::Cancelled), vec![Do::Disarm, Do::RecordEnd(End::Cancelled)]),
        (_, E::Broke) => (S::Ended(End::Failed), vec![Do::Disarm, Do::RecordEnd(End::Failed)]),
        (S::Ready, E::Go) => (S::Locking, vec![Do::RecordIntent, Do::Lock]),
        (S::Locking, E::Locked) => (S::Darkening, vec![Do::Darken]),
        (S::Darkening, E::Dark) => (S::Shooting(Off), vec![Do::Shoot(Off)]),
        // The unlit frame is checked while the lit one is shot.
        (S::Shooting(frame), E::FrameTaken) => {
            (S::Counting(frame), vec![Do::BeginCheck(frame), Do::CountPulses(frame)])
        }
        (S::Counting(Off), E::Counted) => (S::Arming, vec![Do::Arm]),
        (S::Arming, E::Armed) => (S::Shooting(On), vec![Do::Shoot(On)]),
        (S::Counting(On), E::Counted) => (S::Judging, vec![Do::Disarm, Do::Judge]),
        (S::Judging, E::Judged(verdict)) => (S::Storing(verdict), vec![Do::Store(verdict)]),
        (S::Storing(verdict), E::Stored) => (S::Ended(End::Stored(verdict)), vec![]),
        (_, _) => (state, vec![]),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn any_event() -> impl Strategy<Value = Event> {
        prop_oneof![
            Just(Event::Go),
            Just(Event::Locked),
            Just(Event::Dark),
            Just(Event::FrameTaken),
            Just(Event::Counted),
            Just(Event::Armed),
            Just(Event::Judged(Verdict::Accepted)),
            Just(Event::Judged(Verdict::Rejected)),
            Just(Event::Stored),
            Just(Event::Broke),
            Just(Event::Cancel),
        ]
    }

    /// The event by which the world answers an effect when all goes well.
    fn answer(effect: Effect, verdict: Verdict) -> Option<Event> {
        match effect {
            Effect::RecordIntent | Effect::BeginCheck(_) | Effect::Disarm | Effect::RecordEnd(_) => None,
            Effect::Lock => Some(Event::Locked),
            Effect::Darken => Some(Event::Dark),
            Effect::Shoot(_) => Some(Event::FrameTaken),
            Effect::CountPulses(_) => Some(Event::Counted),
            Effect::Arm => Some(Event::Armed),
            Effect::Judge => Some(Event::Judged(verdict)),
            Effect::Store(_) => Some(Event::Stored),
        }
    }

    fn keeps_its_promises(effects: &[Effect], end: Option<End>) {
        let at = |wanted: Effect| effects.iter().position(|e| *e == wanted);
        let count = |wanted: Effect| effects.iter().filter(|e| **e == wanted).count();
        let mut open = false;
        for effect in effects {
            match effect {
                Effect::Arm => open = true,
                Effect::Darken | Effect::Disarm => open = false,
                Effect::Shoot(Frame::Off) => assert!(!open, "dark frame with the gate open: {effects:?}"),
                Effect::Shoot(Frame::On) => assert!(open, "lit frame with the gate closed: {effects:?}"),
                _ => {}
            }
        }
        for frame in [Frame::Off, Frame::On] {
            assert!(count(Effect::Shoot(frame)) <= 1, "{frame:?} shot twice: {effects:?}");
        }
        if let Some(store) = effects.iter().position(|e| matches!(e, Effect::Store(_))) {
            for needed in
                [Effect::Lock, Effect::BeginCheck(Frame::Off), Effect::BeginCheck(Frame::On), Effect::Judge]
            {
                assert!(at(needed).is_some_and(|n| n < store), "stored before {needed:?}: {effects:?}");
            }
            assert!(at(Effect::RecordIntent).is_some_and(|n| n < store));
        }
        match end {
            Some(End::Failed | End::Cancelled) => {
                assert!(!open, "ended with the gate open: {effects:?}");
                assert_eq!(effects.iter().filter(|e| matches!(e, Effect::RecordEnd(_))).count(), 1);
            }
            Some(End::Stored(verdict)) => {
                assert!(!open, "ended with the gate open: {effects:?}");
                assert_eq!(count(Effect::Store(verdict)), 1);
            }
            None => {}
        }
    }

    proptest! {
        #[test]
        fn whatever_happens_in_whatever_order_the_promises_hold(
            events in proptest::collection::vec(any_event(), 0..60)
        ) {
            let mut state = State::Ready;
            let mut done = Vec::new();
            for event in events {
                let before = state;
                let (next, effects) = step(state, event);
                if let State::Ended(_) = before {
                    prop_assert_eq!(next, before);
                    prop_assert!(effects.is_empty());
                }
                done.extend(effects);
                state = next;
            }
            let end = match state { State::Ended(end) => Some(end), _ => None };
            keeps_its_promises(&done, end);
        }

        #[test]
        fn a_world_that_answers_ends_every_pair(
            interruption in proptest::option::of((0usize..12, any_event())),
            rejected in any::<bool>(),
        ) {
            let verdict = if rejected { Verdict::Rejected } else { Verdict::Accepted };
            let (mut state, mut waiting) = step(State::Ready, Event::Go);
            let mut done = Vec::new();
            for turn in 0..40 {
                if let Some((when, event)) = interruption && when == turn {
                    let (next, effects) = step(state, event);
                    if next != state {
                        waiting = effects;
                    }
                    state = next;
                }
                if waiting.is_empty() { break }
                let effect = waiting.remove(0);
                done.push(effect);
                if let Some(event) = answer(effect, verdict) {
                    let (next, effects) = step(state, event);
                    state = next;
                    waiting.extend(effects);
                }
            }
            let State::Ended(end) = state else { panic!("{state:?} after {done:?}") };
            if interruption.is_none() {
                prop_assert_eq!(end, End::Stored(verdict));
            }
        }
    }

    #[test]
    fn a_pair_in_the_order_of_the_day() {
        let mut state = State::Ready;
        let mut done = Vec::new();
        for event in [
            Event::Go,
            Event::Locked,
            Event::Dark,
            Event::FrameTaken,
            Event::Counted,
            Event::Armed,
            Event::FrameTaken,
            Event::Counted,
            Event::Judged(Verdict::Accepted),
            Event::Stored,
        ] {
            let (next, effects) = step(state, event);
            done.extend(effects);
            state = next;
        }
        assert_eq!(state, State::Ended(End::Stored(Verdict::Accepted)));
        assert_eq!(
            done,
            [
                Effect::RecordIntent,
                Effect::Lock,
                Effect::Darken,
                Effect::Shoot(Frame::Off),
                Effect::BeginCheck(Frame::Off),
                Effect::CountPulses(Frame::Off),
                Effect::Arm,
                Effect::Shoot(Frame::On),
                Effect::BeginCheck(Frame::On),
                Effect::CountPulses(Frame::On),
                Effect::Disarm,
                Effect::Judge,
                Effect::Store(Verdict::Accepted),
            ]
        );
    }

    #[test]
    fn a_pair_that_is_being_written_cannot_be_cancelled() {
        let storing = State::Storing(Verdict::Accepted);
        assert_eq!(step(storing, Event::Cancel), (storing, vec![]));
    }
}
