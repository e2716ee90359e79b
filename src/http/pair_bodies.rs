//! Pairs on the wire: what is asked of one, and what became of it.

use super::links;
use crate::pair::order::{Order, Part};
use crate::pair::{self, Settings};
use serde::{Deserialize, Serialize};
use std::sync::Arc;
use utoipa::ToSchema;

/// One failed check.
#[derive(Serialize, ToSchema)]
pub(super) struct ReasonBody {
    /// Stable name.
    #[schema(value_type = String, example = "overexposed")]
    code: pair::ReasonCode,
    /// What was measured.
    figure: f64,
    /// What it is held against.
    limit: f64,
    /// What it means and what to do.
    sentence: String,
}

/// One frame of a pair.
#[derive(Serialize, ToSchema)]
pub(super) struct FrameBody {
    /// File name inside the pair's folder.
    file: String,
    /// Where to fetch the original.
    url: String,
    /// Where to fetch a small JPEG of it.
    thumbnail: String,
    /// Length in bytes.
    bytes: u64,
    /// BLAKE3 of the original, hexadecimal.
    blake3: String,
    /// Shutter, aperture and sensitivity in words; empty if the file does not tell.
    settings: String,
}

/// What the flash controller saw.
#[derive(Serialize, ToSchema)]
pub(super) struct FlashBody {
    /// Pulses during the frame without flash.
    pulses_off: usize,
    /// Pulses during the frame with flash.
    pulses_on: usize,
    /// Energy of the pulse in the board's own counts.
    energy_counts: Option<f64>,
    /// What that proves, in one sentence.
    words: String,
}

/// How room and tripod drifted.
#[derive(Serialize, ToSchema)]
pub(super) struct DriftBody {
    /// The room's light later over its light before, by colour (R, G, B); `null` where it is too dark to tell.
    ambient: [Option<f64>; 3],
    /// Displacement in sites (right, down); absent where there is too little structure to tell.
    shift: Option<[f64; 2]>,
}

/// One of the times that a pair was shot.
#[derive(Serialize, ToSchema)]
pub(super) struct AttemptBody {
    /// Which, from 1.
    attempt: u32,
    /// `accepted` or `rejected`.
    #[schema(value_type = String, example = "rejected")]
    verdict: pair::Verdict,
    /// Why it was rejected.
    reasons: Vec<ReasonBody>,
}

/// One pair.
#[derive(Serialize, ToSchema)]
pub(super) struct PairBody {
    /// Where to ask for it.
    url: String,
    /// Number inside the session, from 1.
    pub(super) number: u32,
    /// Name by which scene cameras are matched.
    name: String,
    /// `accepted` or `rejected`.
    #[schema(value_type = String, example = "accepted")]
    verdict: pair::Verdict,
    /// Why it was rejected.
    reasons: Vec<ReasonBody>,
    /// Which attempt this is, from 1: the last accepted one, or else the last.
    attempt: u32,
    /// All attempts at it.
    attempts: Vec<AttemptBody>,
    /// In which order its frames were shot: `off_on`, `on_off` or `off_on_off` (brought in: `off_on_crossed`).
    #[schema(value_type = String, example = "off_on")]
    order: Order,
    /// The frame without flash; the first of them, where there are several.
    off: FrameBody,
    /// The other frames without flash before the lit one, or after it where that came first.
    more_off: Vec<FrameBody>,
    /// The frame with flash.
    on: FrameBody,
    /// Frames without flash after it.
    after: Vec<FrameBody>,
    /// A further frame with flash, through a polariser turned across.
    #[serde(skip_serializing_if = "Option::is_none")]
    crossed: Option<FrameBody>,
    /// How room and tripod drifted from the first frame without flash to the last; absent where there is one alone.
    drift: Option<DriftBody>,
    /// Where to fetch a small JPEG of the light that the flash alone threw: on less off.
    known: String,
    /// The controller's account; absent for imported pairs and manual flashes.
    flash: Option<FlashBody>,
}

impl PairBody {
    /// Out of all attempts at it; `None` without any.
    pub(super) fn new(session: &str, attempts: &[Arc<pair::PairRecord>]) -> Option<Self> {
        let record = &**pair::current(attempts)?;
        let number = record.number;
        let folder = pair::Attempt::from(record);
        let mut frames = [const { Vec::new() }; 4];
        for (slot, f) in record.frames() {
            let body = FrameBody {
                url: links::file(session, &format!("pairs/{folder}/{}", f.file)),
                thumbnail: links::thumbnail(session, number, &slot.to_string(), &f.blake3),
                file: f.file.clone(),
                bytes: f.bytes,
                blake3: f.blake3.clone(),
                settings: settings_in_words(&f.settings),
            };
            frames[match slot.part {
                Part::Off => 0,
                Part::On => 1,
                Part::After => 2,
                Part::Crossed => 3,
            }]
            .push(body);
        }
        let [mut off, mut on, after, mut crossed] = frames;
        Some(Self {
            url: links::pair(session, number),
            number,
            known: links::thumbnail(session, number, "known", &record.on.blake3),
            more_off: off.split_off(1),
            off: off.pop()?,
            on: on.pop()?,
            after,
            crossed: crossed.pop(),
            attempt: record.attempt,
            attempts: attempts.iter().map(|record| AttemptBody::from(&**record)).collect(),
            order: record.order,
            drift: record.drift.map(|d| DriftBody { ambient: d.ambient, shift: d.shift }),
            name: record.name.clone(),
            verdict: record.verdict,
            reasons: record.reasons.iter().map(ReasonBody::from).collect(),
            flash: record.flash.as_ref().map(|f| FlashBody {
                pulses_off: f.pulses_off(),
                pulses_on: f.pulses_on(),
                energy_counts: f.energy_counts(),
                words: f.words(),
            }),
        })
    }
}

impl From<&pair::Reason> for ReasonBody {
    fn from(r: &pair::Reason) -> Self {
        Self { code: r.code, figure: r.figure, limit: r.limit, sentence: r.sentence.clone() }
    }
}

impl From<&pair::PairRecord> for AttemptBody {
    fn from(record: &pair::PairRecord) -> Self {
        Self {
            attempt: record.attempt,
            verdict: record.verdict,
            reasons: record.reasons.iter().map(ReasonBody::from).collect(),
        }
    }
}

fn settings_in_words(settings: &Settings) -> String {
    let parts = [
        settings.shutter.map(|s| s.to_string()),
        settings.aperture.map(|a| a.to_string()),
        settings.iso.map(|i| i.to_string()),
    ];
    parts.into_iter().flatten().collect::<Vec<_>>().join("  ")
}

/// What is asked of the pair: its session (without it the current one, or one named by the day), its frames.
#[derive(Default, Deserialize, Serialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub(super) struct PairOrder {
    /// Name of a session that is there.
    #[serde(default)]
    pub(super) session: Option<String>,
    /// `off_on`, `on_off` or `off_on_off`; without it `off_on`, or with `again` the order that the pair had.
    #[serde(default)]
    #[schema(value_type = Option<String>, example = "off_on_off")]
    pub(super) order: Option<Order>,
    /// Frames without flash in a row, 1 to 16, of which the mean is taken; without it one, or with `again` as many as
    /// the pair had. `off_on_off` takes as many after the lit frame.
    #[serde(default)]
    #[schema(minimum = 1, maximum = 16)]
    pub(super) off_frames: Option<u8>,
    /// Number of a rejected pair that is to be shot again under its own number.
    #[serde(default)]
    pub(super) again: Option<u32>,
}
