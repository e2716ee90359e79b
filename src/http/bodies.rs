//! What goes over the wire. Views of the domain's types, with links; the domain's own types stay free of HTTP.

use super::mirror_body::MirrorBody;
use crate::capture::{self, SessionSummary};
use crate::http::camera_bodies::{PlanBody, WindowBody};
use crate::http::links;
use crate::http::sequence_bodies::SequenceBody;
use crate::jobs;
use crate::pair::order::{Order, Part};
use crate::pair::{self, Settings};
use crate::session::Room;
use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

/// How one device stands.
#[derive(Serialize, ToSchema)]
pub(super) struct DeviceBody {
    /// Whether it can be used now.
    ready: bool,
    /// What it is; empty when there is none.
    description: String,
    /// "ready", or what is the matter and what to do.
    words: String,
}

/// Camera and flash.
#[derive(Serialize, ToSchema)]
pub(super) struct DevicesBody {
    /// The camera.
    camera: DeviceBody,
    /// The flash.
    flash: DeviceBody,
}

impl From<capture::Devices> for DevicesBody {
    fn from(devices: capture::Devices) -> Self {
        let body = |d: capture::DeviceState| DeviceBody {
            ready: d.ready,
            description: d.description,
            words: d.words,
        };
        Self { camera: body(devices.camera), flash: body(devices.flash) }
    }
}

/// A file that can be fetched.
#[derive(Serialize, ToSchema)]
pub(super) struct ResultBody {
    /// Its name.
    name: String,
    /// Where to fetch it.
    url: String,
}

/// A session in a few words.
#[derive(Serialize, ToSchema)]
pub(super) struct SessionBody {
    /// Its name.
    name: String,
    /// When it was made, UTC.
    created: String,
    /// Whether new pairs go there.
    current: bool,
    /// Pairs stored.
    pairs: usize,
    /// Those that processing uses.
    accepted: usize,
    /// Whether a scene is there.
    has_scene: bool,
    /// Whether a flash calibration is there.
    has_flash_calibration: bool,
    /// At which exposures its pairs are shot; absent before the first pair.
    exposure: Option<PlanBody>,
    /// Where the object is in the frame; absent: the whole frame.
    region: Option<WindowBody>,
    /// Settings that the camera does not tell and the operator has confirmed.
    confirmed: Vec<String>,
    /// Finished results.
    results: Vec<ResultBody>,
    /// Room on its disk; absent if that is not known.
    room: Option<RoomBody>,
    /// What had to be put right when it was opened, in sentences.
    recovered: Vec<String>,
    /// Its second copy; absent without `--mirror`, and until the session is opened.
    mirror: Option<MirrorBody>,
    /// Why nothing else is known of it, if so.
    problem: Option<String>,
}

/// Room on the disk that a session lies on.
#[derive(Serialize, ToSchema)]
pub(super) struct RoomBody {
    /// Bytes that may still be written.
    free_bytes: u64,
    /// How many more pairs as large as the largest so far fit; absent before the first.
    pairs: Option<u64>,
}

impl From<Room> for RoomBody {
    fn from(room: Room) -> Self {
        Self { free_bytes: room.free, pairs: room.pairs() }
    }
}

impl From<SessionSummary> for SessionBody {
    fn from(s: SessionSummary) -> Self {
        let results = s
            .results
            .iter()
            .map(|file| ResultBody {
                name: file.rsplit('/').next().unwrap_or(file).to_owned(),
                url: links::file(&s.name, file),
            })
            .collect();
        Self {
            results,
            name: s.name,
            created: s.created,
            current: s.current,
            pairs: s.pairs,
            accepted: s.accepted,
            has_scene: s.has_scene,
            has_flash_calibration: s.has_flash_calibration,
            exposure: s.plan.map(Into::into),
            region: s.region.map(Into::into),
            confirmed: s.confirmed,
            room: s.room.map(Into::into),
            recovered: s.recovered,
            mirror: s.mirror.map(Into::into),
            problem: s.problem,
        }
    }
}

/// The session to make or open.
#[derive(Deserialize, ToSchema)]
pub(super) struct NewSession {
    /// Its name: a folder of this name is made under the sessions folder.
    #[schema(example = "birdbath")]
    pub(super) name: String,
}

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
    /// In which order its frames were shot: `off_on`, `on_off` or `off_on_off`.
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
    /// How room and tripod drifted from the first frame without flash to the last; absent where there is one alone.
    drift: Option<DriftBody>,
    /// Where to fetch a small JPEG of the light that the flash alone threw: on less off.
    known: String,
    /// The controller's account; absent for imported pairs and manual flashes.
    flash: Option<FlashBody>,
}

impl PairBody {
    /// Out of all attempts at it; `None` without any.
    pub(super) fn new(session: &str, attempts: &[pair::PairRecord]) -> Option<Self> {
        let record = pair::current(attempts)?;
        let number = record.number;
        let folder = pair::Attempt::from(record);
        let mut frames = [Vec::new(), Vec::new(), Vec::new()];
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
            }]
            .push(body);
        }
        let [mut off, mut on, after] = frames;
        Some(Self {
            url: links::pair(session, number),
            number,
            known: links::thumbnail(session, number, "known", &record.on.blake3),
            more_off: off.split_off(1),
            off: off.pop()?,
            on: on.pop()?,
            after,
            attempt: record.attempt,
            attempts: attempts.iter().map(AttemptBody::from).collect(),
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

/// Why a job failed.
#[derive(Serialize, ToSchema)]
pub(super) struct JobProblemBody {
    /// Stable name.
    code: String,
    /// The sentence for people.
    words: String,
}

/// A job.
#[derive(Serialize, ToSchema)]
pub(super) struct JobBody {
    /// Its number.
    id: u64,
    /// Where to ask for it.
    url: String,
    /// `pair`, `develop`, `find_exposure`, `flash_shots`, `repeatability`, `calibrate_flash`, `import_scene`, `process` or
    /// `verify`.
    #[schema(example = "pair")]
    kind: String,
    /// The session it is about.
    session: String,
    /// `queued`, `running`, `done`, `failed`, `cancelled` or `interrupted`: the program ended before the job did.
    #[schema(value_type = String, example = "queued")]
    state: jobs::JobState,
    /// What it does just now, in words.
    stage: String,
    /// Units of the stage that are finished.
    done: u64,
    /// Units of the stage in all; 0 when not known.
    total: u64,
    /// What came out of it: for a pair its session, number and verdict.
    #[schema(value_type = Option<Object>)]
    result: Option<serde_json::Value>,
    /// Why it failed, or what it means that it was interrupted.
    problem: Option<JobProblemBody>,
    /// When it was asked for, UTC.
    enqueued: String,
    /// When it began, UTC.
    started: Option<String>,
    /// When it ended, UTC; of an interrupted job, when that was found.
    ended: Option<String>,
    /// The job that this one does again.
    retry_of: Option<u64>,
}

impl From<jobs::Job> for JobBody {
    fn from(job: jobs::Job) -> Self {
        Self {
            id: job.id,
            url: links::job(job.id),
            kind: job.kind,
            session: job.subject,
            state: job.state,
            stage: job.stage,
            done: job.done,
            total: job.total,
            result: job.result,
            problem: job.problem.map(|p| JobProblemBody { code: p.code, words: p.words }),
            enqueued: job.enqueued,
            started: job.started,
            ended: job.ended,
            retry_of: job.retry_of,
        }
    }
}

/// Where the calibration card stands.
#[derive(Deserialize, Serialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub(super) struct CardShotOrder {
    /// Distance from the lens to the card along the axis, metres.
    #[schema(example = 1.0)]
    pub(super) distance_m: f64,
}

/// What the flash calibration needs to know beside its shots.
#[derive(Deserialize, ToSchema)]
#[serde(deny_unknown_fields)]
pub(super) struct FlashCalibrationOrder {
    /// Reflectance of the card, 0..1.
    #[schema(example = 0.94)]
    pub(super) target_reflectance: f64,
    /// Inner and outer radius of the ring lamp, metres.
    #[schema(example = json!([0.035, 0.085]))]
    pub(super) ring_radii: [f64; 2],
}

/// The simulated studio as it stands.
#[derive(Clone, Debug, PartialEq, Serialize, ToSchema)]
pub struct StudioBody {
    /// Where the simulated operator stands, in words.
    pub words: String,
    /// The stop, from 1; absent before the card or with the cap on the lens.
    pub stop: Option<usize>,
    /// Stops in all.
    pub stops: usize,
    /// Distance of the card when the card is up, metres.
    pub card_distance_m: Option<f64>,
    /// Whether the cap is on the lens.
    pub lens_cap: bool,
}

/// What the simulated operator is to do: exactly one of the three.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize, ToSchema)]
#[serde(untagged, deny_unknown_fields)]
pub enum StageOrder {
    /// Go to a stop, counted from 1.
    Stop {
        /// The stop.
        stop: usize,
    },
    /// Put the white card up.
    Card {
        /// Distance from the lens along the axis, metres.
        card_distance_m: f64,
    },
    /// Put the cap on the lens.
    LensCap {
        /// Must be true.
        lens_cap: bool,
    },
}

/// Everything that a page needs to begin with.
#[derive(Serialize, ToSchema)]
pub(super) struct StateBody {
    /// Version of the program.
    pub(super) version: &'static str,
    /// Camera and flash.
    pub(super) devices: DevicesBody,
    /// Name of the session to which new pairs go.
    pub(super) session: Option<String>,
    /// The same session in a few words, with the room on its disk.
    pub(super) about: Option<SessionBody>,
    /// Its newest pair.
    pub(super) last_pair: Option<PairBody>,
    /// Jobs, newest first.
    pub(super) jobs: Vec<JobBody>,
    /// What the operator is asked at the moment.
    pub(super) prompt: Option<String>,
    /// Sequences of the sessions that are open, and those that an earlier run of the daemon left under way.
    pub(super) sequences: Vec<SequenceBody>,
    /// The simulated studio; absent with real devices.
    pub(super) studio: Option<StudioBody>,
}
