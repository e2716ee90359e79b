//! Sequences over the wire.

use crate::capture::{PositionView, SequenceEvent, SequenceState, SequenceView};
use crate::pair::order::Order;
use crate::session::{Between, SequencePlan};
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// What each position, the first one too, waits for. `next` is taken for a go with all of them.
// Braces, so that serde refuses fields that are not known there too.
#[derive(Clone, Copy, Serialize, Deserialize, ToSchema)]
#[serde(tag = "kind", rename_all = "snake_case", deny_unknown_fields)]
pub(super) enum BetweenBody {
    /// The operator, who says `next` on the page.
    Prompt {},
    /// Some seconds from the end of the position before.
    Countdown {
        /// 0 to 3600.
        #[schema(example = 5.0, minimum = 0, maximum = 3600)]
        seconds: f64,
    },
    /// The file `trigger` in the session's folder, made by a script; it is removed when the position is done.
    TriggerFile {},
    /// A script, which says `next`.
    Hook {},
}

/// What is to be shot, and how one gets from position to position.
#[derive(Serialize, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub(super) struct SequencePlanBody {
    /// How many positions there are.
    #[schema(example = 24, minimum = 1, maximum = 1000)]
    positions: u32,
    /// What each of them waits for.
    between: BetweenBody,
    /// Seconds that pass at least from the beginning of a pair to that of the next.
    #[serde(default)]
    #[schema(minimum = 0, maximum = 86400)]
    interval_s: f64,
    /// How often a rejected pair is taken again unasked before `retry` or `skip` is asked for.
    #[serde(default)]
    #[schema(maximum = 10)]
    retries: u32,
    /// The order of each pair's frames: `off_on`, `on_off` or `off_on_off`.
    #[serde(default)]
    #[schema(value_type = String, default = "off_on", example = "off_on_off")]
    order: Order,
    /// Frames without flash in a row, of which the mean is taken; `off_on_off` takes as many after the lit frame.
    #[serde(default = "one")]
    #[schema(default = 1, minimum = 1, maximum = 16)]
    off_frames: u8,
    /// What to do at each position, from the first: lines of 200 characters at most, no more than positions.
    #[serde(default)]
    instructions: Vec<String>,
}

fn one() -> u8 {
    1
}

impl From<SequencePlanBody> for SequencePlan {
    fn from(body: SequencePlanBody) -> Self {
        Self {
            positions: body.positions,
            between: match body.between {
                BetweenBody::Prompt {} => Between::Prompt,
                BetweenBody::Countdown { seconds } => Between::Countdown { seconds },
                BetweenBody::TriggerFile {} => Between::TriggerFile,
                BetweenBody::Hook {} => Between::Hook,
            },
            interval_s: body.interval_s,
            retries: body.retries,
            order: body.order,
            off_frames: body.off_frames,
            instructions: body.instructions,
        }
    }
}

impl From<SequencePlan> for SequencePlanBody {
    fn from(plan: SequencePlan) -> Self {
        Self {
            positions: plan.positions,
            between: match plan.between {
                Between::Prompt => BetweenBody::Prompt {},
                Between::Countdown { seconds } => BetweenBody::Countdown { seconds },
                Between::TriggerFile => BetweenBody::TriggerFile {},
                Between::Hook => BetweenBody::Hook {},
            },
            interval_s: plan.interval_s,
            retries: plan.retries,
            order: plan.order,
            off_frames: plan.off_frames,
            instructions: plan.instructions,
        }
    }
}

/// One position.
#[derive(Serialize, ToSchema)]
pub(super) struct PositionBody {
    /// Its number, from 1.
    position: u32,
    /// Numbers of its pairs, in the order in which they were taken.
    pairs: Vec<u32>,
    /// The pair that counts.
    accepted: Option<u32>,
    /// Somebody wanted it left out.
    skipped: bool,
}

impl From<PositionView> for PositionBody {
    fn from(view: PositionView) -> Self {
        let PositionView { position, pairs, accepted, skipped } = view;
        Self { position, pairs, accepted, skipped }
    }
}

/// A session's sequence at one moment; the event `sequence` has the same for its data.
#[derive(Serialize, ToSchema)]
pub(super) struct SequenceBody {
    /// Name of its session.
    session: String,
    /// `planned`, `waiting`, `resting` (until the interval is over), `shooting`, `paused`, `asking` (for `retry` or
    /// `skip`), `done` or `cancelled`.
    #[schema(value_type = String, example = "waiting")]
    state: SequenceState,
    /// A pair is being taken, and then comes the pause.
    pausing: bool,
    /// The position that it is about, from 1.
    position: Option<u32>,
    /// Positions with an accepted pair.
    done: u32,
    /// Positions left out.
    skipped: u32,
    /// Seconds until it goes on by itself.
    seconds_left: Option<f64>,
    /// Where one is and what to do there.
    guide: Option<String>,
    /// How it stands, for people.
    words: String,
    /// What is to be shot.
    plan: SequencePlanBody,
    /// What became of each position.
    positions: Vec<PositionBody>,
}

impl From<SequenceView> for SequenceBody {
    fn from(view: SequenceView) -> Self {
        Self {
            session: view.session,
            state: view.state,
            pausing: view.pausing,
            position: view.position,
            done: view.done,
            skipped: view.skipped,
            seconds_left: view.seconds_left,
            guide: view.guide,
            words: view.words,
            plan: view.plan.into(),
            positions: view.positions.into_iter().map(Into::into).collect(),
        }
    }
}

/// What a sequence is told.
#[derive(Clone, Copy, Deserialize, ToSchema)]
#[serde(rename_all = "snake_case")]
pub(super) enum SequenceWish {
    /// Begin: the first position waits for its go.
    Start,
    /// Begin nothing new; a pair that is being taken is finished.
    Pause,
    /// Go on: the first position without an accepted pair waits for its go.
    Resume,
    /// All is in place: take the pair.
    Next,
    /// Take the pair again that was rejected or failed.
    Retry,
    /// Leave the position out.
    Skip,
    /// Give up at once; what is done stays done.
    Cancel,
}

impl From<SequenceWish> for SequenceEvent {
    fn from(wish: SequenceWish) -> Self {
        match wish {
            SequenceWish::Start => SequenceEvent::Start,
            SequenceWish::Pause => SequenceEvent::Pause,
            SequenceWish::Resume => SequenceEvent::Resume,
            SequenceWish::Next => SequenceEvent::Next,
            SequenceWish::Retry => SequenceEvent::Retry,
            SequenceWish::Skip => SequenceEvent::Skip,
            SequenceWish::Cancel => SequenceEvent::Cancel,
        }
    }
}

/// For which position a word is meant.
#[derive(Default, Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub(super) struct SequenceWord {
    /// The word is refused if the sequence is at another position: so a repeated `next` takes no second pair.
    #[schema(example = 7)]
    pub(super) position: Option<u32>,
}
