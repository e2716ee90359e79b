//! The pairs of a sequence: their frames, and those that are taken again.

use super::desk::Studio;
use crate::fake_rig::{Room, Trouble};
use unlit::capture::{PairWish, SequenceEvent, SequenceState};
use unlit::pair::order::{Order, Program};
use unlit::session::{Between, SequencePlan};

#[test]
fn every_pair_of_a_sequence_has_the_frames_of_its_plan_also_when_taken_again() {
    let room = Room::with(Trouble::Misfire);
    let order = SequencePlan {
        order: Order::OffOnOff,
        off_frames: 2,
        ..SequencePlan::new(2, Between::Countdown { seconds: 0.0 })
    };
    let studio = Studio::open(room.rig(), order);
    studio.wish(SequenceEvent::Start);
    studio.until(SequenceState::Asking, Some(1));
    room.heal();
    studio.wish(SequenceEvent::Retry);
    studio.until(SequenceState::Done, None);
    let program = Program::new(Order::OffOnOff, 2).unwrap();
    let attempts = studio.desk.attempts("vase").unwrap();
    let counts: Vec<_> = attempts.values().map(Vec::len).collect();
    assert_eq!(counts, [2, 1]);
    for record in attempts.values().flatten() {
        assert_eq!((record.program(), record.frames().count()), (program, 5), "{record:?}");
    }
    let kept = studio.desk.session("vase").unwrap().sequence().unwrap().unwrap().plan;
    assert_eq!((kept.order, kept.off_frames), (Order::OffOnOff, 2));
}

#[test]
fn a_rejected_pair_asks_and_is_taken_again() {
    let room = Room::with(Trouble::Misfire);
    let studio = Studio::open(room.rig(), SequencePlan { retries: 1, ..SequencePlan::new(2, Between::Hook) });
    studio.wish(SequenceEvent::Start);
    studio.wish(SequenceEvent::Next);
    let view = studio.until(SequenceState::Asking, Some(1));
    assert!(view.words.starts_with("Position 1 of 2: Pair 1 was rejected: "), "{}", view.words);
    room.heal();
    studio.wish(SequenceEvent::Retry);
    let view = studio.until(SequenceState::Waiting, Some(2));
    assert_eq!((&view.positions[0].pairs, view.positions[0].accepted), (&vec![1], Some(1)));
    let attempts = studio.desk.attempts("vase").unwrap()[&1].len();
    assert_eq!(attempts, 3, "each attempt is kept, under the number by which its camera is matched");

    // A pair that failed is no pair: it asks too, and the position may be left out.
    room.set(Trouble::Refuses(0));
    studio.wish(SequenceEvent::Next);
    let view = studio.until(SequenceState::Asking, Some(2));
    assert!(view.words.contains("No pair was taken: ") && view.positions[1].pairs.is_empty(), "{view:?}");
    let view = studio.wish(SequenceEvent::Skip);
    assert_eq!(
        (view.state, view.words.as_str()),
        (SequenceState::Done, "1 of 2 positions is done; skipped: 2.")
    );
}

#[test]
fn a_rejected_pair_that_somebody_shoots_again_by_hand_does_its_position() {
    let room = Room::with(Trouble::Misfire);
    let studio = Studio::open(room.rig(), SequencePlan::new(2, Between::Hook));
    studio.wish(SequenceEvent::Start);
    studio.wish(SequenceEvent::Next);
    studio.until(SequenceState::Asking, Some(1));
    let by_hand = PairWish { again: Some(1), ..PairWish::default() };
    // Rejected once more, it changes nothing.
    studio.ended(&studio.desk.take_pair(Some("vase"), by_hand).unwrap());
    assert_eq!(studio.view().state, SequenceState::Asking);
    room.heal();
    studio.ended(&studio.desk.take_pair(Some("vase"), by_hand).unwrap());
    let view = studio.until(SequenceState::Waiting, Some(2));
    assert_eq!((&view.positions[0].pairs, view.positions[0].accepted), (&vec![1], Some(1)));
    studio.wish(SequenceEvent::Next);
    assert_eq!(Studio::pairs(&studio.until(SequenceState::Done, None)), [[1], [2]]);
    // The pair's job ends after the sequence has come on.
    let job = studio.desk.queue().list().into_iter().find(|job| job.kind == "pair").unwrap();
    assert_eq!(studio.ended(&job).result.unwrap()["attempt"], 1);
}
