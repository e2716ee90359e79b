//! What the machine promises.

mod trial;

use super::machine::{Effect, Event, Pause, Phase, State, step};
use super::view::{SequenceState, view};
use crate::session::{Between, SequencePlan};
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
    let table: [(Event, &str, &str); 14] = [
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
        // Of no position's pair.
        (Event::Mended(1), "-------", "-------"),
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
fn a_rejected_pair_that_is_shot_again_by_hand_does_its_position_whatever_was_going_on() {
    let plan = SequencePlan::new(2, Between::Prompt);
    let (state, _) = after(&plan, &State::planned(&plan), Event::Start, 0.0);
    let (state, _) = after(&plan, &state, Event::Next, 0.0);
    let (state, _) = after(&plan, &state, Event::Begun(1), 0.0);
    let (asking, _) = after(&plan, &state, bad(1), 1.0);
    assert!(step(&plan, &asking, Event::Mended(2), at(2.0)).is_none(), "none of the sequence's");
    let second = Phase::Waiting { position: 2, since: at(2.0) };
    let (state, effects) = after(&plan, &asking, Event::Mended(1), 2.0);
    assert_eq!((&state.phase, effects), (&second, vec![Effect::Acknowledge]));
    assert_eq!((&state.positions[0].pairs, state.positions[0].accepted), (&vec![1], Some(1)));
    assert!(step(&plan, &state, Event::Mended(1), at(3.0)).is_none(), "it is good already");

    // The sequence's own pair waits for the rig meanwhile: it is not begun, and its job ends.
    let (queued, _) = after(&plan, &asking, Event::Retry, 1.0);
    let (queued, effects) = after(&plan, &queued, Event::Mended(1), 1.5);
    assert_eq!((&queued.phase, effects), (&Phase::Shooting { position: 1, tries: 0 }, vec![]));
    assert!(step(&plan, &queued, Event::Begun(1), at(2.0)).is_none(), "what is good is not shot again");
    let (state, effects) = after(&plan, &queued, Event::Failed("The pair was cancelled.".into()), 2.0);
    assert_eq!((&state.phase, effects), (&second, vec![Effect::Acknowledge]));

    // A position that was left out is done after all.
    let (skipped, _) = after(&plan, &asking, Event::Skip, 2.0);
    let (state, effects) = after(&plan, &skipped, Event::Mended(1), 3.0);
    assert_eq!((&state.phase, effects, view("v", &plan, &state, at(3.0)).done), (&second, vec![], 1));
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
