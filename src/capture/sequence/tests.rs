//! What the machine promises, over every order of events that chance finds.

use super::machine::{Effect, Event, Pause, Phase, State, step};
use super::view::{SequenceState, view};
use crate::session::{Between, SequencePlan};
use proptest::prelude::*;
use std::time::Duration;

fn at(seconds: f64) -> Duration {
    Duration::from_secs_f64(seconds)
}

/// Takes an event that must be taken.
fn after(plan: &SequencePlan, state: &State, event: Event, now: f64) -> (State, Vec<Effect>) {
    step(plan, state, event.clone(), at(now)).unwrap_or_else(|| panic!("{event:?} refused in {state:?}"))
}

fn good(pair: u32) -> Event {
    Event::Shot { pair, rejected: None }
}

fn bad(pair: u32) -> Event {
    Event::Shot { pair, rejected: Some("The flash stayed dark.".into()) }
}

/// A machine, its clock and its pairs, and everything that was asked of the camera.
struct Trial {
    plan: SequencePlan,
    state: State,
    now: Duration,
    pairs: u32,
    /// Positions of the pairs that were set off.
    shots: Vec<u32>,
    /// When the last pair was begun.
    begun: Option<Duration>,
}

impl Trial {
    fn new(plan: SequencePlan) -> Self {
        let state = State::planned(&plan);
        Self { plan, state, now: Duration::ZERO, pairs: 0, shots: vec![], begun: None }
    }

    /// Feeds one event and holds the machine to its promises.
    fn feed(&mut self, event: Event, shared_pair: bool) {
        let before = self.state.clone();
        let Some((next, effects)) = step(&self.plan, &before, event.clone(), self.now) else { return };
        for effect in &effects {
            match effect {
                Effect::Shoot(position) => self.shoots(&before, *position, &event),
                Effect::CancelShot => assert!(before.under_way.is_some() && event == Event::Cancel),
                Effect::Acknowledge => {
                    assert!(next.paused.is_none() || event == Event::Skip || before.paused.is_some())
                }
            }
        }
        if let Event::Begun(_) = event {
            self.begun = Some(self.now);
        }
        // A position is left out by word alone, and what is accepted stays so.
        for (was, is) in before.positions.iter().zip(&next.positions) {
            assert!(was.skipped == is.skipped || event == Event::Skip, "left out by {event:?}");
            assert!(was.accepted.is_none() || was.accepted == is.accepted);
            assert!(
                was.is_settled() || !is.is_settled() || matches!(event, Event::Skip | Event::Shot { .. })
            );
            assert!(is.pairs.starts_with(&was.pairs), "a pair was forgotten");
        }
        if before.phase == Phase::Cancelled {
            assert_eq!(next.phase, Phase::Cancelled);
        }
        if event == Event::Cancel {
            assert_eq!(next.phase, Phase::Cancelled);
        }
        if next.phase == Phase::Done {
            assert!(next.first_missing().is_none());
        }
        // Positions come in order: the present one is the first that is missing.
        if let Some(position) = next.position() {
            assert_eq!(Some(position), next.first_missing());
        }
        if shared_pair {
            self.pairs += 1;
        }
        self.state = next;
        let seen = view("vase", &self.plan, &self.state, self.now);
        assert!(
            !seen.words.is_empty()
                && !seen.words.contains("..")
                && seen.done + seen.skipped <= self.plan.positions
        );
    }

    fn shoots(&mut self, before: &State, position: u32, event: &Event) {
        assert!(before.paused.is_none(), "shot while paused by {event:?}");
        assert!(before.first_missing() == Some(position), "out of order");
        let free = match event {
            Event::Shot { rejected, .. } => rejected.is_some(),
            _ => before.under_way.is_none(),
        };
        assert!(free, "two pairs at once by {event:?}");
        let go =
            matches!(event, Event::Next | Event::Triggered | Event::Tick | Event::Retry | Event::Shot { .. });
        assert!(go, "shot by {event:?}");
        if let Some(last) = self.begun {
            let rest = Duration::from_secs_f64(self.plan.interval_s);
            assert!(self.now >= last + rest, "the interval was not kept");
        }
        if let (Phase::Waiting { since, .. }, Between::Countdown { seconds }, Event::Tick) =
            (&before.phase, self.plan.between, event)
        {
            assert!(self.now >= *since + Duration::from_secs_f64(seconds), "too early");
        }
        self.shots.push(position);
    }
}

/// A wish, or what the camera answers if it was asked.
#[derive(Clone, Debug)]
enum Turn {
    Wish(Event),
    Begun,
    Good,
    Bad,
    Broke,
    Wait(f64),
}

fn any_turn() -> impl Strategy<Value = Turn> {
    prop_oneof![
        2 => Just(Turn::Wish(Event::Start)),
        1 => Just(Turn::Wish(Event::Pause)),
        2 => Just(Turn::Wish(Event::Resume)),
        4 => Just(Turn::Wish(Event::Next)),
        3 => Just(Turn::Wish(Event::Triggered)),
        4 => Just(Turn::Wish(Event::Tick)),
        3 => Just(Turn::Wish(Event::Retry)),
        1 => Just(Turn::Wish(Event::Skip)),
        1 => Just(Turn::Wish(Event::Hindered("The disk is full.".into()))),
        4 => Just(Turn::Begun),
        4 => Just(Turn::Good),
        3 => Just(Turn::Bad),
        1 => Just(Turn::Broke),
        4 => (0.0..4.0).prop_map(Turn::Wait),
    ]
}

fn any_plan() -> impl Strategy<Value = SequencePlan> {
    let between = prop_oneof![
        Just(Between::Prompt),
        Just(Between::Hook),
        Just(Between::TriggerFile),
        (0.0..3.0).prop_map(|seconds| Between::Countdown { seconds }),
    ];
    (1u32..6, between, 0.0..3.0, 0u32..3).prop_map(|(positions, between, interval_s, retries)| SequencePlan {
        interval_s,
        retries,
        instructions: vec!["left".into()],
        ..SequencePlan::new(positions, between)
    })
}

fn play(trial: &mut Trial, turn: Turn) {
    let pair = trial.pairs + 1;
    match turn {
        Turn::Wish(event) => trial.feed(event, false),
        Turn::Begun => trial.feed(Event::Begun(pair), false),
        Turn::Good if trial.state.under_way.is_some() => trial.feed(good(pair), true),
        Turn::Bad if trial.state.under_way.is_some() => trial.feed(bad(pair), true),
        Turn::Broke => trial.feed(Event::Failed("No pair was taken.".into()), false),
        Turn::Wait(seconds) => trial.now += at(seconds),
        Turn::Good | Turn::Bad => assert!(step(&trial.plan, &trial.state, good(pair), trial.now).is_none()),
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(1000))]

    #[test]
    fn whatever_happens_in_whatever_order_the_promises_hold(
        plan in any_plan(),
        turns in proptest::collection::vec(any_turn(), 0..120),
        cancel_at in proptest::option::of(0usize..120),
    ) {
        let mut trial = Trial::new(plan);
        for (n, turn) in turns.into_iter().enumerate() {
            if cancel_at == Some(n) {
                trial.feed(Event::Cancel, false);
                let shots = trial.shots.len();
                play(&mut trial, turn);
                prop_assert_eq!(trial.shots.len(), shots, "shot after it was cancelled");
                continue;
            }
            play(&mut trial, turn);
        }
    }

    /// Whatever came before: somebody who resumes, says next and retries gets every position done, with a pair each.
    #[test]
    fn a_willing_operator_always_comes_to_the_end(
        plan in any_plan(),
        turns in proptest::collection::vec(any_turn(), 0..60),
    ) {
        let mut trial = Trial::new(plan);
        turns.into_iter().for_each(|turn| play(&mut trial, turn));
        for _ in 0..200 {
            if trial.state.phase == Phase::Done {
                break;
            }
            for event in [Event::Start, Event::Resume, Event::Retry, Event::Next, Event::Tick] {
                trial.feed(event, false);
            }
            trial.now += at(4.0);
            play(&mut trial, Turn::Good);
        }
        prop_assert_eq!(&trial.state.phase, &Phase::Done);
        for place in &trial.state.positions {
            prop_assert!(place.skipped || place.accepted.is_some());
            prop_assert!(place.accepted.is_none_or(|pair| place.pairs.contains(&pair)));
        }
        let mut all: Vec<u32> = trial.state.positions.iter().flat_map(|p| p.pairs.clone()).collect();
        let count = all.len();
        all.sort_unstable();
        all.dedup();
        prop_assert_eq!(all.len(), count, "a pair belongs to two positions");
    }
}

#[test]
fn every_event_in_every_phase_is_taken_or_refused_as_written_here() {
    let plan = SequencePlan::new(3, Between::TriggerFile);
    let since = Duration::ZERO;
    let phases = [
        Phase::Planned,
        Phase::Waiting { position: 1, since },
        Phase::Resting { position: 1, tries: 0 },
        Phase::Shooting { position: 1, tries: 0 },
        Phase::Asking { position: 1, why: "It failed.".into() },
        Phase::Done,
        Phase::Cancelled,
    ];
    let hindered = Event::Hindered("Something is in the way.".into());
    let failed = Event::Failed("It failed.".into());
    // In the order of the phases; `+` taken, `-` refused; then the same while paused.
    let table: [(Event, &str, &str); 13] = [
        (Event::Start, "+------", "+------"),
        (Event::Pause, "-++++--", "-++++--"),
        (Event::Resume, "-++++--", "-++++--"),
        (Event::Next, "-+-----", "-------"),
        (Event::Triggered, "-+-----", "-------"),
        (Event::Tick, "--+----", "-------"),
        (Event::Retry, "----+--", "-------"),
        (Event::Skip, "-++-+--", "-++-+--"),
        (Event::Cancel, "+++++-+", "+++++-+"),
        (hindered, "-++++--", "-++++--"),
        (Event::Begun(1), "---+---", "---+---"),
        (good(1), "---+---", "---+---"),
        (failed, "---+---", "---+---"),
    ];
    for (event, free, paused) in table {
        for (pause, expected) in [(None, free), (Some(Pause::Asked), paused)] {
            for (phase, expected) in phases.iter().zip(expected.chars()) {
                let mut state =
                    State { phase: phase.clone(), paused: pause.clone(), ..State::planned(&plan) };
                if let Phase::Shooting { position, .. } = phase {
                    state.under_way = Some((*position, None));
                }
                let taken = step(&plan, &state, event.clone(), at(1.0)).is_some();
                assert_eq!(taken, expected == '+', "{event:?} in {phase:?}, paused: {pause:?}");
            }
        }
    }
}

#[test]
fn a_countdown_goes_by_the_clock_it_is_told() {
    let plan = SequencePlan::new(2, Between::Countdown { seconds: 5.0 });
    let (state, _) = after(&plan, &State::planned(&plan), Event::Start, 10.0);
    assert_eq!(view("v", &plan, &state, at(12.0)).seconds_left, Some(3.0));
    assert!(step(&plan, &state, Event::Tick, at(14.9)).is_none());
    let (state, effects) = after(&plan, &state, Event::Tick, 15.0);
    assert_eq!(effects, [Effect::Shoot(1)]);
    let (state, _) = after(&plan, &state, good(1), 20.0);
    let (state, _) = after(&plan, &state, Event::Pause, 24.0);
    assert!(step(&plan, &state, Event::Tick, at(100.0)).is_none(), "paused");
    let (state, _) = after(&plan, &state, Event::Resume, 100.0);
    assert!(step(&plan, &state, Event::Tick, at(104.9)).is_none(), "counted anew");
    assert_eq!(after(&plan, &state, Event::Tick, 105.0).1, [Effect::Shoot(2)]);
    // Whoever is there sooner need not wait.
    assert_eq!(after(&plan, &state, Event::Next, 101.0).1, [Effect::Shoot(2)]);
}

#[test]
fn a_pause_lets_the_pair_end_and_begins_no_other() {
    let plan = SequencePlan::new(3, Between::Hook);
    let (state, _) = after(&plan, &State::planned(&plan), Event::Start, 0.0);
    let (state, _) = after(&plan, &state, Event::Next, 0.0);
    let (state, effects) = after(&plan, &state, Event::Pause, 1.0);
    assert_eq!((effects, view("v", &plan, &state, at(1.0)).pausing), (vec![], true));
    let (state, _) = after(&plan, &state, good(1), 2.0);
    assert_eq!(view("v", &plan, &state, at(2.0)).state, SequenceState::Paused);
    assert!(step(&plan, &state, Event::Next, at(3.0)).is_none());
    let (state, _) = after(&plan, &state, Event::Resume, 4.0);
    assert_eq!(after(&plan, &state, Event::Next, 5.0).1, [Effect::Shoot(2)]);
}

#[test]
fn a_go_that_comes_too_soon_waits_for_the_interval() {
    let plan = SequencePlan { interval_s: 10.0, ..SequencePlan::new(2, Between::Hook) };
    let (state, _) = after(&plan, &State::planned(&plan), Event::Start, 0.0);
    let (state, _) = after(&plan, &state, Event::Next, 1.0);
    // Another's pair held the rig for so long.
    let (state, _) = after(&plan, &state, Event::Begun(1), 60.0);
    let (state, _) = after(&plan, &state, good(1), 63.0);
    let (state, effects) = after(&plan, &state, Event::Next, 64.0);
    assert_eq!((effects, state.due(&plan)), (vec![], Some(at(70.0))), "from the beginning of the pair");
    assert!(step(&plan, &state, Event::Next, at(65.0)).is_none(), "one go is enough");
    assert_eq!(after(&plan, &state, Event::Tick, 70.0).1, [Effect::Shoot(2)]);
    let (state, _) = after(&plan, &state, Event::Pause, 65.0);
    let (state, _) = after(&plan, &state, Event::Resume, 66.0);
    assert!(step(&plan, &state, Event::Tick, at(70.0)).is_none(), "the go was forgotten");
    let (state, effects) = after(&plan, &state, Event::Next, 67.0);
    assert_eq!((effects, state.due(&plan)), (vec![], Some(at(70.0))), "a pause does not shorten it");
}

#[test]
fn a_rejected_pair_is_taken_again_as_often_as_planned_then_somebody_is_asked() {
    let plan = SequencePlan { retries: 1, ..SequencePlan::new(2, Between::Prompt) };
    let (state, _) = after(&plan, &State::planned(&plan), Event::Start, 0.0);
    let (state, _) = after(&plan, &state, Event::Next, 0.0);
    let (state, effects) = after(&plan, &state, bad(1), 1.0);
    assert_eq!(effects, [Effect::Shoot(1)]);
    let (asking, effects) = after(&plan, &state, bad(2), 2.0);
    assert_eq!((effects, view("v", &plan, &asking, at(2.0)).state), (vec![], SequenceState::Asking));
    assert!(step(&plan, &asking, Event::Next, at(3.0)).is_none());
    let (state, effects) = after(&plan, &asking, Event::Retry, 3.0);
    assert_eq!(effects, [Effect::Shoot(1)]);
    let (state, _) = after(&plan, &state, good(3), 4.0);
    assert_eq!((&state.positions[0].pairs, state.positions[0].accepted), (&vec![1, 2, 3], Some(3)));
    assert_eq!(state.position(), Some(2));
    assert_eq!(after(&plan, &asking, Event::Skip, 3.0).0.position(), Some(2));
    // A pair that is taken again under its own number stays one pair.
    let (state, _) = after(&plan, &asking, Event::Retry, 3.0);
    let (state, _) = after(&plan, &state, good(2), 4.0);
    assert_eq!((&state.positions[0].pairs, state.positions[0].accepted), (&vec![1, 2], Some(2)));
}

#[test]
fn a_pair_that_was_being_written_when_all_was_cancelled_is_kept() {
    let plan = SequencePlan::new(2, Between::Hook);
    let (state, _) = after(&plan, &State::planned(&plan), Event::Start, 0.0);
    let (state, _) = after(&plan, &state, Event::Next, 0.0);
    let (state, effects) = after(&plan, &state, Event::Cancel, 1.0);
    assert_eq!(effects, [Effect::CancelShot]);
    let (state, effects) = after(&plan, &state, good(1), 2.0);
    assert_eq!((&state.phase, effects, state.positions[0].accepted), (&Phase::Cancelled, vec![], Some(1)));
}

#[test]
fn people_are_told_where_they_are_and_what_to_do() {
    let mut plan = SequencePlan::new(3, Between::Prompt);
    plan.instructions = vec![String::new(), "behind the handle".into()];
    let said = |state: &State| view("vase", &plan, state, Duration::ZERO).words;
    let (first, _) = after(&plan, &State::planned(&plan), Event::Start, 0.0);
    assert_eq!(said(&first), "Position 1 of 3: get ready, then press space.");
    let (second, _) = after(&plan, &first, Event::Skip, 0.0);
    assert_eq!(said(&second), "Position 2 of 3: behind the handle, then press space.");
    let (third, _) = after(&plan, &second, Event::Skip, 0.0);
    assert_eq!(said(&third), "Position 3 of 3: move on, then press space.");
    let (shooting, _) = after(&plan, &third, Event::Next, 0.0);
    let (asking, _) = after(&plan, &shooting, bad(1), 0.0);
    assert_eq!(said(&asking), "Position 3 of 3: The flash stayed dark. Take it again, or skip the position?");
    let (done, _) = after(&plan, &shooting, good(1), 0.0);
    assert_eq!(said(&done), "1 of 3 positions is done; skipped: 1, 2.");
}
