//! The machine beside a witness who knows the promises and nothing of the machine: every state of both that can be
//! reached together is visited, for every program.

use super::*;
use crate::pair::order::Order;
use proptest::prelude::*;
use std::cell::Cell;
use std::collections::{HashSet, VecDeque};

const EVENTS: [Event; 12] = [
    Event::Go,
    Event::Locked,
    Event::Dark,
    Event::Armed,
    Event::FrameTaken,
    Event::Counted,
    Event::Unproven,
    Event::Judged(Verdict::Accepted),
    Event::Judged(Verdict::Rejected),
    Event::Stored,
    Event::Broke,
    Event::Cancel,
];

fn programs() -> impl Iterator<Item = Program> {
    let all = Order::ALL.into_iter().flat_map(|order| [1, 2, 3, 4, 16].map(|n| Program::new(order, n)));
    all.map(Result::unwrap)
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
enum Gate {
    /// As whoever had the controller before left it.
    Untouched,
    Closed,
    /// Open for one sync.
    Open,
    /// The sync came.
    Spent,
}

/// What has been done so far, as far as the promises ask for it.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
struct Witness {
    slots: Vec<Slot>,
    intended: bool,
    locked: bool,
    gate: Gate,
    /// Frames that were shot, checked and counted.
    shot: Vec<Slot>,
    checked: Vec<Slot>,
    counted: Vec<Slot>,
    /// The last count has shown that the pair will be rejected, or one has.
    unproven: bool,
    lost: bool,
    judged: Option<Verdict>,
    stored: Option<Verdict>,
    ends: Vec<End>,
    /// Effects so far: a path that never ends would show in it.
    done: usize,
}

impl Witness {
    fn of(program: Program) -> Self {
        Self {
            slots: program.slots(),
            intended: false,
            locked: false,
            gate: Gate::Untouched,
            shot: vec![],
            checked: vec![],
            counted: vec![],
            unproven: false,
            lost: false,
            judged: None,
            stored: None,
            ends: vec![],
            done: 0,
        }
    }

    /// The frames that may be shot now: the next, or the next needed one if the pair is lost anyway.
    fn due(&self) -> Option<Slot> {
        let mut left =
            self.slots.iter().copied().skip_while(|s| self.shot.last().is_some_and(|last| last != s));
        if !self.shot.is_empty() {
            left.next();
        }
        left.find(|slot| !self.unproven || slot.is_needed())
    }

    fn sees(&mut self, effect: Effect) {
        self.done += 1;
        assert!(self.done <= 4 * self.slots.len() + 10, "no end: {self:?}");
        assert!(self.ends.is_empty(), "{effect:?} after the end: {self:?}");
        match effect {
            Effect::RecordIntent => {
                assert!(!self.intended && !self.locked && self.shot.is_empty());
                self.intended = true;
            }
            Effect::Lock => {
                assert!(self.intended && !self.locked, "{self:?}");
                self.locked = true;
            }
            Effect::Darken | Effect::Disarm => self.gate = Gate::Closed,
            Effect::Arm => {
                assert_ne!(self.gate, Gate::Open, "opened twice: {self:?}");
                assert!(
                    self.due().is_some_and(|slot| slot.part.is_lit()),
                    "opened for no lit frame: {self:?}"
                );
                self.gate = Gate::Open;
            }
            Effect::Shoot(slot) => {
                assert!(self.locked && self.stored.is_none(), "{self:?}");
                assert_eq!(Some(slot), self.due(), "out of turn: {self:?}");
                assert_eq!(self.shot, self.counted, "shot before the last one was counted: {self:?}");
                let needed = if slot.part.is_lit() { Gate::Open } else { Gate::Closed };
                assert_eq!(self.gate, needed, "{slot} with this gate: {self:?}");
                if slot.part.is_lit() {
                    self.gate = Gate::Spent;
                }
                self.shot.push(slot);
            }
            Effect::BeginCheck(slot) => {
                assert_eq!(self.shot.last(), Some(&slot));
                assert!(!self.checked.contains(&slot), "checked twice: {self:?}");
                self.checked.push(slot);
            }
            Effect::CountPulses(slot) => {
                assert_eq!(self.shot.last(), Some(&slot));
                assert!(!self.counted.contains(&slot), "counted twice: {self:?}");
                self.counted.push(slot);
            }
            Effect::Judge => {
                assert_eq!(self.due(), None, "judged before all was shot: {self:?}");
                assert_eq!(self.shot, self.checked, "{self:?}");
                assert_eq!(self.shot, self.counted, "{self:?}");
                assert!(self.slots.iter().all(|slot| !slot.is_needed() || self.shot.contains(slot)));
                assert!(self.lost || self.shot == self.slots, "{self:?}");
                assert_eq!(self.gate, Gate::Closed, "judged with the gate open: {self:?}");
            }
            Effect::Store(verdict) => {
                assert_eq!(self.judged, Some(verdict), "stored unchecked: {self:?}");
                assert_eq!(self.stored, None, "stored twice: {self:?}");
                self.stored = Some(verdict);
            }
            Effect::RecordEnd(end) => self.ends.push(end),
        }
    }

    fn hears(&mut self, event: Event) {
        match event {
            Event::Counted => self.unproven = false,
            Event::Unproven => (self.unproven, self.lost) = (true, true),
            Event::Judged(verdict) => self.judged = Some(verdict),
            _ => {}
        }
    }

    /// What must hold wherever the machine has come to rest.
    fn agrees_with(&self, state: State) {
        let State::Ended(end) = state else { return };
        assert!(matches!(self.gate, Gate::Closed), "ended with the gate open: {self:?}");
        match end {
            End::Stored(verdict) => {
                assert_eq!((self.stored, self.ends.as_slice()), (Some(verdict), &[][..]), "{self:?}");
            }
            End::Failed => assert_eq!(self.ends, [end], "{self:?}"),
            End::Cancelled => {
                assert_eq!(self.ends, [end], "{self:?}");
                assert_eq!(self.stored, None, "cancelled while it was stored: {self:?}");
            }
        }
    }
}

/// The events by which the world may answer an effect; none where nobody waits for one.
fn answers(effect: Effect) -> Vec<Event> {
    match effect {
        Effect::RecordIntent | Effect::BeginCheck(_) | Effect::Disarm | Effect::RecordEnd(_) => vec![],
        Effect::Lock => vec![Event::Locked],
        Effect::Darken => vec![Event::Dark],
        Effect::Arm => vec![Event::Armed],
        Effect::Shoot(_) => vec![Event::FrameTaken],
        Effect::CountPulses(_) => vec![Event::Counted, Event::Unproven],
        Effect::Judge => vec![Event::Judged(Verdict::Accepted), Event::Judged(Verdict::Rejected)],
        Effect::Store(_) => vec![Event::Stored],
    }
}

/// Everything that may follow when the next effect is done, fails in the middle, or is cancelled before or in it.
fn turns(course: &Course, witness: &Witness) -> Vec<(Course, Witness)> {
    let mut before = course.clone();
    let Some(effect) = before.next_effect() else { return vec![] };
    let mut all = vec![];
    let mut cancelled = before.clone();
    cancelled.hear(Event::Cancel);
    if cancelled.state() != before.state() {
        all.push((cancelled, witness.clone()));
    }
    let mut seen = witness.clone();
    seen.sees(effect);
    let mut events: Vec<Option<Event>> = answers(effect).into_iter().map(Some).collect();
    if events.is_empty() {
        events.push(None);
    }
    // Whoever stores or writes the end down asks nobody whether he should stop.
    if !matches!(effect, Effect::Store(_) | Effect::Disarm | Effect::RecordEnd(_)) {
        events.push(Some(Event::Cancel));
    }
    if !matches!(effect, Effect::Disarm | Effect::RecordEnd(_)) {
        events.push(Some(Event::Broke));
    }
    for event in events {
        let (mut course, mut witness) = (before.clone(), seen.clone());
        if let Some(event) = event {
            course.hear(event);
            witness.hears(event);
        }
        all.push((course, witness));
    }
    all
}

#[test]
fn every_path_of_every_program_keeps_every_promise_and_ends() {
    for program in programs() {
        let start = (Course::begin(program), Witness::of(program));
        let mut known = HashSet::from([start.clone()]);
        let mut open = VecDeque::from([start]);
        let mut ends = HashSet::new();
        while let Some((course, witness)) = open.pop_front() {
            let next = turns(&course, &witness);
            if next.is_empty() {
                let State::Ended(end) = course.state() else { panic!("stuck: {course:?} {witness:?}") };
                witness.agrees_with(course.state());
                ends.insert(end);
            }
            for turn in next {
                if known.insert(turn.clone()) {
                    open.push_back(turn);
                }
            }
        }
        let (good, bad) = (End::Stored(Verdict::Accepted), End::Stored(Verdict::Rejected));
        assert_eq!(ends, HashSet::from([good, bad, End::Failed, End::Cancelled]), "{program:?}");
        assert!(known.len() > 10 * program.slots().len(), "{program:?}: {}", known.len());
    }
}

#[test]
fn every_event_in_every_state_keeps_every_promise() {
    for program in programs() {
        let start = (State::Ready, Witness::of(program));
        let mut known = HashSet::from([start.clone()]);
        let mut open = VecDeque::from([start]);
        let mut states = HashSet::new();
        while let Some((state, witness)) = open.pop_front() {
            states.insert(state);
            for event in EVENTS {
                let (next, effects) = step(program, state, event);
                if next == state {
                    assert_eq!(effects, [], "{event:?} in {state:?} changes nothing and does something");
                    continue;
                }
                assert!(!matches!(state, State::Ended(_)), "{event:?} after the end");
                assert!(!(matches!(state, State::Storing(_)) && event == Event::Cancel));
                let mut witness = witness.clone();
                witness.hears(event);
                effects.into_iter().for_each(|effect| witness.sees(effect));
                witness.agrees_with(next);
                if known.insert((next, witness.clone())) {
                    open.push_back((next, witness));
                }
            }
        }
        // Ready, locking, judging, two kinds of storing, four ends; each frame shot and counted; the gate for some.
        let least = 9 + 2 * program.slots().len() + 2;
        assert!(states.len() >= least, "{program:?}: {states:?}");
    }
}

proptest! {
    #[test]
    fn whatever_happens_in_whatever_order_the_promises_hold(
        order in 0usize..3,
        off_frames in 1u8..=16,
        events in proptest::collection::vec(0usize..EVENTS.len(), 0..200),
    ) {
        let program = Program::new(Order::ALL[order], off_frames).unwrap();
        let (mut state, mut witness) = (State::Ready, Witness::of(program));
        for event in events.into_iter().map(|i| EVENTS[i]) {
            let (next, effects) = step(program, state, event);
            if next != state {
                witness.hears(event);
            }
            effects.into_iter().for_each(|effect| witness.sees(effect));
            witness.agrees_with(next);
            state = next;
        }
    }
}

/// All that is done when all goes well, in words.
fn done(order: Order, off_frames: u8, count: impl Fn(Slot) -> Event) -> String {
    let mut course = Course::begin(Program::new(order, off_frames).unwrap());
    let mut words = vec![];
    while let Some(effect) = course.next_effect() {
        words.push(match effect {
            Effect::Shoot(slot) => slot.to_string(),
            Effect::BeginCheck(_) | Effect::CountPulses(_) => String::new(),
            other => format!("{other:?}").to_lowercase(),
        });
        let answer = match effect {
            Effect::CountPulses(slot) => Some(count(slot)),
            other => answers(other).first().copied(),
        };
        answer.into_iter().for_each(|event| course.hear(event));
    }
    assert_eq!(course.state(), State::Ended(End::Stored(Verdict::Accepted)));
    words.retain(|word| !word.is_empty());
    words.join(" ")
}

#[test]
fn pairs_in_the_order_of_the_day() {
    let well = |order, n| done(order, n, |_| Event::Counted);
    assert_eq!(well(Order::OffOn, 1), "recordintent lock darken off arm on disarm judge store(accepted)");
    assert_eq!(
        well(Order::OnOff, 2),
        "recordintent lock arm on darken off off-2 disarm judge store(accepted)"
    );
    assert_eq!(
        well(Order::OffOnOff, 2),
        "recordintent lock darken off off-2 arm on darken after after-2 disarm judge store(accepted)"
    );
}

#[test]
fn a_pair_that_is_lost_takes_no_more_frames_than_it_needs_to_be_one() {
    // Whoever knows that a pair is lost says so from then on.
    let lost_at = |order, slot| {
        let lost = Cell::new(false);
        done(order, 3, |s| {
            lost.set(lost.get() || s == slot);
            if lost.get() { Event::Unproven } else { Event::Counted }
        })
    };
    let off_2 = Slot { index: 2, ..Slot::OFF };
    assert!(lost_at(Order::OffOnOff, Slot::OFF).contains("darken off arm on disarm judge"));
    assert!(lost_at(Order::OffOnOff, off_2).contains("darken off off-2 arm on disarm judge"));
    assert!(lost_at(Order::OffOnOff, Slot::ON).contains("off-3 arm on disarm judge"));
    assert!(lost_at(Order::OnOff, Slot::ON).contains("arm on darken off disarm judge"));
}

#[test]
fn a_pair_that_is_being_written_cannot_be_cancelled() {
    let storing = State::Storing(Verdict::Accepted);
    assert_eq!(step(Program::default(), storing, Event::Cancel), (storing, vec![]));
}
