//! What goes over the wire of devices, sessions and the whole state. Views of the domain's types, with links; the
//! domain's own types stay free of HTTP.

use super::job_bodies::JobBody;
use super::mirror_body::MirrorBody;
use super::pair_bodies::PairBody;
use super::studio_bodies::StudioBody;
use crate::capture::{self, SessionSummary};
use crate::http::camera_bodies::{LightingBody, PlanBody, WindowBody};
use crate::http::links;
use crate::http::sequence_bodies::SequenceBody;
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
    /// Polariser and flash power.
    lighting: LightingBody,
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
            lighting: s.lighting.into(),
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
    /// The newest 500 jobs, newest first.
    pub(super) jobs: Vec<JobBody>,
    /// What the operator is asked at the moment.
    pub(super) prompt: Option<String>,
    /// Sequences of the sessions that are open, and those that an earlier run of the daemon left under way.
    pub(super) sequences: Vec<SequenceBody>,
    /// The simulated studio; absent with real devices.
    pub(super) studio: Option<StudioBody>,
}
