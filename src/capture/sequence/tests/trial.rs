//! The promises, over every order of events that chance finds.

use super::*;
use proptest::prelude::*;

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
            assert!(was.accepted.is_none() || is.accepted.is_some());
            assert!(
                was.is_settled()
                    || !is.is_settled()
                    || matches!(event, Event::Skip | Event::Shot { .. } | Event::Mended(_))
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
        // Positions come in order: the present one is the first that is missing, or was when its pair was set off.
        if let Some(position) = next.position()
            && !matches!(next.phase, Phase::Shooting { .. })
        {
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
    /// Somebody shoots this pair again by hand, and it is good.
    Mended(u32),
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
        1 => (1u32..6).prop_map(Turn::Mended),
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
        Turn::Mended(pair) => trial.feed(Event::Mended(pair), false),
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
