//! Jobs on the wire.

use super::links;
use crate::jobs;
use serde::Serialize;
use utoipa::ToSchema;

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
    /// `pair`, `develop`, `find_exposure`, `flash_shots`, `calibration_shot`, `repeatability`, `calibrate_levels`,
    /// `calibrate_noise`, `calibrate_exposure`, `calibrate_flat`, `calibrate_flash`, `calibrate_steadiness`, `calibrate_colour`, `import_scene`,
    /// `process` or `verify`.
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
