//! How the daemon stands.

use super::blocking;
use crate::capture::Glance;
use crate::http::App;
use crate::http::bodies::RoomBody;
use crate::http::problem::Problem;
use crate::jobs::Load;
use crate::log;
use axum::Json;
use axum::extract::State;
use serde::Serialize;
use utoipa::ToSchema;

/// Which devices are ready.
#[derive(Serialize, ToSchema)]
pub(in crate::http) struct ReadyBody {
    /// The camera.
    camera: bool,
    /// The flash.
    flash: bool,
}

/// Jobs of one lane.
#[derive(Serialize, ToSchema)]
pub(in crate::http) struct LoadBody {
    /// How many run: 0 or 1.
    running: usize,
    /// How many wait.
    waiting: usize,
}

impl From<Load> for LoadBody {
    fn from(load: Load) -> Self {
        Self { running: load.running, waiting: load.waiting }
    }
}

/// Jobs of all lanes.
#[derive(Serialize, ToSchema)]
pub(in crate::http) struct LoadsBody {
    /// Work that holds camera and flash.
    rig: LoadBody,
    /// Work on one pair's files.
    develop: LoadBody,
    /// Long work on files.
    processing: LoadBody,
}

/// How the daemon stands.
#[derive(Serialize, ToSchema)]
pub(in crate::http) struct StatusBody {
    /// Version of the program.
    version: &'static str,
    /// When it began to answer, UTC.
    #[schema(example = "2026-03-01T09:30:00Z")]
    started: String,
    /// Seconds since then.
    uptime_s: f64,
    /// What is logged, as `UNLIT_LOG` says it.
    #[schema(example = "warn")]
    log: &'static str,
    /// Which devices are ready, as last seen.
    devices: ReadyBody,
    /// Name of the session to which new pairs go.
    session: Option<String>,
    /// Jobs that run and wait.
    jobs: LoadsBody,
    /// Room on the session's disk, else on that of the sessions' folder; its `pairs` is absent while a pair is being
    /// stored, too. Absent if the disk does not tell.
    room: Option<RoomBody>,
    /// Streams of events that are open.
    event_streams: usize,
}

/// How the daemon stands, for monitors: no device is asked and no file is read. What it says of the devices is what was seen
/// last; `GET /api/v1/devices` looks.
#[utoipa::path(get, path = "/api/v1/status", tag = "events", responses((status = 200, body = StatusBody)))]
pub(super) async fn status(State(app): State<App>) -> Result<Json<StatusBody>, Problem> {
    let vitals = app.vitals.clone();
    let Glance { devices, session, rig, develop, processing, room } =
        blocking(move || Ok(app.desk.glance())).await?;
    Ok(Json(StatusBody {
        version: env!("CARGO_PKG_VERSION"),
        started: vitals.started().to_owned(),
        uptime_s: vitals.uptime().as_secs_f64(),
        log: log::filter(),
        devices: ReadyBody { camera: devices.camera.ready, flash: devices.flash.ready },
        session,
        jobs: LoadsBody { rig: rig.into(), develop: develop.into(), processing: processing.into() },
        room: room.map(Into::into),
        event_streams: vitals.event_streams(),
    }))
}
