//! A sequence as people and scripts see it.

use super::machine::{Pause, Phase, State};
use crate::session::{Between, SequencePlan};
use serde::Serialize;
use std::time::Duration;

/// What a sequence does, in a word.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum SequenceState {
    /// Not begun.
    Planned,
    /// Waits for the go of its position.
    Waiting,
    /// Has its go and waits until the interval is over.
    Resting,
    /// A pair is being taken.
    Shooting,
    /// Nothing new is begun.
    Paused,
    /// No pair came of it: taken again, or the position left out?
    Asking,
    /// Every position is done or left out.
    Done,
    /// Given up.
    Cancelled,
}

impl SequenceState {
    /// Whether it was begun and is not over.
    pub fn is_under_way(self) -> bool {
        !matches!(self, SequenceState::Planned | SequenceState::Done | SequenceState::Cancelled)
    }
}

/// One position.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct PositionView {
    /// Its number, from 1.
    pub position: u32,
    /// Numbers of its pairs, in the order in which they were taken.
    pub pairs: Vec<u32>,
    /// The pair that counts.
    pub accepted: Option<u32>,
    /// Somebody wanted it left out.
    pub skipped: bool,
}

/// A sequence at one moment.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct SequenceView {
    /// Name of its session.
    pub session: String,
    /// What it does.
    pub state: SequenceState,
    /// A pair that is being taken is the last one before the pause.
    pub pausing: bool,
    /// The position that it is about, from 1.
    pub position: Option<u32>,
    /// Positions with an accepted pair.
    pub done: u32,
    /// Positions left out.
    pub skipped: u32,
    /// Seconds until it goes on by itself.
    pub seconds_left: Option<f64>,
    /// Where one is and what to do there, in words.
    pub guide: Option<String>,
    /// How it stands, in words.
    pub words: String,
    /// What is to be shot.
    pub plan: SequencePlan,
    /// What became of each position.
    pub positions: Vec<PositionView>,
}

/// A sequence as it stands at `now`.
pub(super) fn view(session: &str, plan: &SequencePlan, state: &State, now: Duration) -> SequenceView {
    let count = |wanted: fn(&super::machine::Position) -> bool| {
        u32::try_from(state.positions.iter().filter(|place| wanted(place)).count()).unwrap_or(u32::MAX)
    };
    let seconds_left = state.due(plan).map(|due| due.saturating_sub(now).as_secs_f64());
    let done = count(|place| place.accepted.is_some());
    SequenceView {
        session: session.to_owned(),
        state: match (&state.phase, &state.paused) {
            (Phase::Waiting { .. } | Phase::Resting { .. } | Phase::Asking { .. }, Some(_)) => {
                SequenceState::Paused
            }
            (Phase::Planned, _) => SequenceState::Planned,
            (Phase::Waiting { .. }, _) => SequenceState::Waiting,
            (Phase::Resting { .. }, _) => SequenceState::Resting,
            (Phase::Shooting { .. }, _) => SequenceState::Shooting,
            (Phase::Asking { .. }, _) => SequenceState::Asking,
            (Phase::Done, _) => SequenceState::Done,
            (Phase::Cancelled, _) => SequenceState::Cancelled,
        },
        pausing: state.paused.is_some() && matches!(state.phase, Phase::Shooting { .. }),
        position: state.position(),
        done,
        skipped: count(|place| place.accepted.is_none() && place.skipped),
        seconds_left,
        guide: state.position().map(|position| guide(plan, position)),
        words: words(plan, state, done, seconds_left.unwrap_or_default()),
        plan: plan.clone(),
        positions: (1..)
            .zip(&state.positions)
            .map(|(position, place)| PositionView {
                position,
                pairs: place.pairs.clone(),
                accepted: place.accepted,
                skipped: place.skipped,
            })
            .collect(),
    }
}

fn instruction(plan: &SequencePlan, position: u32) -> Option<&str> {
    let line = plan.instructions.get((position as usize).checked_sub(1)?)?;
    (!line.trim().is_empty()).then_some(line.as_str())
}

fn guide(plan: &SequencePlan, position: u32) -> String {
    let what = instruction(plan, position).unwrap_or(if position == 1 { "get ready" } else { "move on" });
    format!("Position {position} of {}: {what}", plan.positions)
}

fn words(plan: &SequencePlan, state: &State, done: u32, seconds: f64) -> String {
    let of = plan.positions;
    let so_far = format!("{done} of {of} positions {}", if done == 1 { "is done" } else { "are done" });
    match (&state.phase, &state.paused) {
        (Phase::Planned, _) => format!("{of} positions are planned; nothing is taken before the start."),
        (Phase::Done, _) => match skipped(state) {
            None if of == 1 => "The position is done.".into(),
            None => format!("All {of} positions are done."),
            Some(list) => format!("{so_far}; skipped: {list}."),
        },
        (Phase::Cancelled, _) => format!("The sequence was cancelled: {so_far}."),
        (Phase::Shooting { position, .. }, pause) => {
            let then = if pause.is_some() { " Then comes the pause." } else { "" };
            format!("Position {position} of {of}: taking the pair.{then}")
        }
        (
            Phase::Waiting { position, .. }
            | Phase::Resting { position, .. }
            | Phase::Asking { position, .. },
            Some(pause),
        ) => match pause {
            Pause::Asked => format!("Paused at position {position} of {of}; resume when all is in place."),
            Pause::Restarted => format!(
                "The program was started anew: {so_far}, and the sequence is paused at position {position}; \
                 resume it when all is in place."
            ),
            Pause::Hindered(why) => {
                format!("Paused at position {position} of {of}: {why} Resume when that is put right.")
            }
        },
        (Phase::Asking { position, why }, None) => {
            format!("Position {position} of {of}: {why} Take it again, or skip the position?")
        }
        (Phase::Resting { position, .. }, None) => {
            format!(
                "Position {position} of {of}: the pair is taken in {seconds:.0} s, when the interval is over."
            )
        }
        (Phase::Waiting { position, .. }, None) => {
            let guide = guide(plan, *position);
            match plan.between {
                Between::Prompt => format!("{guide}, then press space."),
                Between::Countdown { .. } => format!("{guide}; the pair is taken in {seconds:.0} s."),
                Between::TriggerFile => format!("{guide}; waits for the trigger file."),
                Between::Hook => format!("{guide}; waits for the script's word."),
            }
        }
    }
}

/// Positions left out, as a list in words.
fn skipped(state: &State) -> Option<String> {
    let left_out: Vec<String> = (1..)
        .zip(&state.positions)
        .filter(|(_, place)| place.accepted.is_none() && place.skipped)
        .map(|(position, _): (u32, _)| position.to_string())
        .collect();
    (!left_out.is_empty()).then(|| left_out.join(", "))
}
