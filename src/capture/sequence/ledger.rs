//! Between the state and `sequence.json`: what is kept, and where a program that was started anew goes on.

use super::machine::{Pause, Phase, Position, State};
use crate::session::{PositionRecord, SEQUENCE_SCHEMA, SequencePlan, SequenceRecord, Stage, UnderWay};
use std::time::Duration;

/// What is kept of a state.
pub(super) fn record(plan: &SequencePlan, state: &State) -> SequenceRecord {
    let kept = |place: &Position| PositionRecord { pairs: place.pairs.clone(), skipped: place.skipped };
    SequenceRecord {
        schema: SEQUENCE_SCHEMA,
        plan: plan.clone(),
        stage: match state.phase {
            Phase::Planned => Stage::Planned,
            Phase::Cancelled => Stage::Cancelled,
            _ => Stage::Begun,
        },
        positions: state.positions.iter().map(kept).collect(),
        under_way: state.under_way.and_then(|(position, pair)| Some(UnderWay { position, pair: pair? })),
        last_begun_ms: state.last_begun.map(|begun| begun.as_millis().try_into().unwrap_or(u64::MAX)),
    }
}

/// The state out of what was kept, paused, at `now`. `accepted` says of a pair that is in the session whether it is
/// good: a position counts as done only if a pair of it is there and good.
pub(super) fn restored(
    record: &SequenceRecord,
    now: Duration,
    accepted: impl Fn(u32) -> Option<bool>,
) -> State {
    let mut positions: Vec<Position> = record
        .positions
        .iter()
        .map(|kept| Position { pairs: kept.pairs.clone(), accepted: None, skipped: kept.skipped })
        .collect();
    // The pair that was being taken when the program ended was stored, or else its number is free.
    if let Some(UnderWay { position, pair }) = record.under_way
        && let Some(place) = (position as usize).checked_sub(1).and_then(|at| positions.get_mut(at))
        && accepted(pair).is_some()
        && !place.pairs.contains(&pair)
    {
        place.pairs.push(pair);
    }
    for place in &mut positions {
        place.accepted = place.pairs.iter().rev().copied().find(|pair| accepted(*pair) == Some(true));
    }
    // A clock that was put back since must not make the interval longer than it is.
    let last_begun = record.last_begun_ms.map(|ms| Duration::from_millis(ms).min(now));
    let mut state = State { phase: Phase::Planned, paused: None, positions, under_way: None, last_begun };
    match (record.stage, state.first_missing()) {
        (Stage::Planned, _) => {}
        (Stage::Cancelled, _) => state.phase = Phase::Cancelled,
        (Stage::Begun, None) => state.phase = Phase::Done,
        (Stage::Begun, Some(position)) => {
            state.phase = Phase::Waiting { position, since: now };
            state.paused = Some(Pause::Restarted);
        }
    }
    state
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::session::Between;

    const NOW: Duration = Duration::from_secs(1000);

    fn kept(stage: Stage, pairs: [&[u32]; 3], under_way: Option<UnderWay>) -> SequenceRecord {
        let plan = SequencePlan::new(3, Between::Hook);
        let positions = pairs.map(|pairs| PositionRecord { pairs: pairs.to_vec(), skipped: false }).to_vec();
        SequenceRecord { stage, positions, under_way, ..SequenceRecord::planned(plan) }
    }

    /// Pairs 1 to 4 are there; 2 was rejected.
    fn there(pair: u32) -> Option<bool> {
        (1..=4).contains(&pair).then_some(pair != 2)
    }

    #[test]
    fn the_first_position_without_an_accepted_pair_is_next_and_nothing_begins_by_itself() {
        let state = restored(&kept(Stage::Begun, [&[1], &[2], &[]], None), NOW, there);
        assert_eq!((state.position(), &state.paused), (Some(2), &Some(Pause::Restarted)));
        // A pair whose folder was taken away is missing again, wherever it was.
        let state = restored(&kept(Stage::Begun, [&[9], &[2, 3], &[4]], None), NOW, there);
        assert_eq!((state.position(), state.positions[1].accepted), (Some(1), Some(3)));
    }

    #[test]
    fn a_pair_that_was_stored_just_before_the_end_belongs_to_its_position() {
        let under_way = |pair| Some(UnderWay { position: 3, pair });
        let state = restored(&kept(Stage::Begun, [&[1], &[2, 3], &[]], under_way(4)), NOW, there);
        assert_eq!((&state.phase, state.positions[2].accepted), (&Phase::Done, Some(4)));
        let state = restored(&kept(Stage::Begun, [&[1], &[2, 3], &[]], under_way(5)), NOW, there);
        assert_eq!((state.position(), state.positions[2].pairs.len()), (Some(3), 0));
        let strange = Some(UnderWay { position: 0, pair: 4 });
        assert_eq!(restored(&kept(Stage::Begun, [&[1], &[3], &[]], strange), NOW, there).position(), Some(3));
    }

    #[test]
    fn what_was_planned_or_cancelled_stays_so_and_keeping_loses_nothing() {
        for stage in [Stage::Planned, Stage::Cancelled, Stage::Begun] {
            let record = kept(stage, [&[1], &[2], &[]], None);
            let state = restored(&record, NOW, there);
            assert_eq!(super::record(&record.plan, &state), record);
        }
    }

    #[test]
    fn the_interval_goes_on_over_a_restart_and_never_beyond_itself() {
        for (begun, expected) in [(990, 990), (5000, 1000)] {
            let last_begun_ms = Some(begun * 1000);
            let record = SequenceRecord { last_begun_ms, ..kept(Stage::Begun, [&[1], &[], &[]], None) };
            let state = restored(&record, NOW, there);
            assert_eq!(state.last_begun, Some(Duration::from_secs(expected)));
            assert_eq!(super::record(&record.plan, &state).last_begun_ms, Some(expected * 1000));
        }
    }
}
