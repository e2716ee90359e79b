//! Queue, workers and one job's life.
//!
//! A job is long work with a name: it is queued, runs on its lane's one thread, reports progress, may be
//! cancelled, and ends done, failed or cancelled. It belongs to nobody: whoever asked for it may leave. Lanes
//! keep the rig and the processor apart, so that pairs are shot while earlier ones are processed. A [`Ledger`]
//! on the disk tells the next program what this one was asked for, and under which key: jobs that it did not end are
//! interrupted.
//!
//! In: closures that take a [`Progress`]. Out: [`Job`] snapshots, on request and at every change. What the
//! work does is none of this module's business.

mod book;
mod claims;
mod lanes;
mod ledger;
mod logged;
mod queue;

use crate::progress::{Cancelled, Progress};
use serde::{Deserialize, Serialize};
use std::time::Duration;

pub use ledger::Ledger;
pub use queue::{JobsError, Queue};

/// Number of a job, from 1, unique as long as the ledger is kept.
pub type JobId = u64;

/// The thread on which a job runs. Jobs of one lane run one after the other: at the rig in the order of arrival,
/// elsewhere by turns of those they are about.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Lane {
    /// Work that holds camera and flash.
    Rig,
    /// Work on one pair's files: a breath each, and never behind long computations.
    Develop,
    /// Long computations on files.
    Processing,
}

impl Lane {
    const ALL: [Lane; 3] = [Lane::Rig, Lane::Develop, Lane::Processing];
}

/// Where a job stands.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum JobState {
    /// Waits for its lane.
    Queued,
    /// Runs.
    Running,
    /// Ended well; the job's `result` says with what.
    Done,
    /// Ended badly; the job's `problem` says why.
    Failed,
    /// Was cancelled before it could end.
    Cancelled,
    /// The program ended before the job could; the job's `problem` says what that means.
    Interrupted,
}

impl JobState {
    /// Whether the job will not change any more.
    pub fn is_final(self) -> bool {
        !matches!(self, JobState::Queued | JobState::Running)
    }
}

/// Why a job failed, for machines and for people.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Problem {
    /// Stable name of the kind of problem.
    pub code: String,
    /// The sentence for the photographer.
    pub words: String,
}

/// A job as it stood at one moment.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Job {
    /// Its number.
    pub id: JobId,
    /// What it does, a stable name: `pair`, `process`, ...
    pub kind: String,
    /// What it does it to: the session's name.
    pub subject: String,
    /// The lane on which it runs.
    pub lane: Lane,
    /// Where it stands.
    pub state: JobState,
    /// What it does just now, in words; empty before the first report.
    pub stage: String,
    /// Units of the stage that are finished.
    pub done: u64,
    /// Units of the stage in all; 0 when not known.
    pub total: u64,
    /// What came out of it, once done.
    pub result: Option<serde_json::Value>,
    /// Why it failed, once failed or interrupted.
    pub problem: Option<Problem>,
    /// When it was asked for, UTC.
    pub enqueued: String,
    /// When it began, UTC.
    pub started: Option<String>,
    /// When it ended, UTC; of an interrupted job, when that was found.
    pub ended: Option<String>,
    /// The job that this one does again.
    pub retry_of: Option<JobId>,
    /// What was asked for, as data, where it can be asked for again. Not told.
    #[serde(skip_serializing)]
    pub order: Option<serde_json::Value>,
}

/// How busy a lane is.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Load {
    /// Jobs that run.
    pub running: usize,
    /// Jobs that wait.
    pub waiting: usize,
}

/// How work ends when it does not end well.
#[derive(Debug)]
pub enum WorkError {
    /// It saw the cancel flag and stopped cleanly.
    Cancelled,
    /// It failed.
    Failed(Problem),
}

impl WorkError {
    /// A failure with its stable code and the error's own sentence.
    pub fn failed(code: impl Into<String>, error: impl std::fmt::Display) -> Self {
        WorkError::Failed(Problem { code: code.into(), words: error.to_string() })
    }
}

impl From<Cancelled> for WorkError {
    fn from(_: Cancelled) -> Self {
        WorkError::Cancelled
    }
}

/// The work itself; what it returns becomes the job's `result`.
pub type Work = Box<dyn FnOnce(&Progress) -> Result<serde_json::Value, WorkError> + Send>;

/// What is asked for, and the key by which it is known when it is asked for again.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Wish {
    /// As whoever asks chose it.
    pub key: String,
    /// Digest of what is asked for.
    pub digest: String,
}

/// A job to be queued.
pub struct Order {
    /// Stable name of what it does.
    pub kind: &'static str,
    /// The session it is about.
    pub subject: String,
    /// The lane on which to run it.
    pub lane: Lane,
    /// Whether a job of the same kind and subject that still waits makes this one superfluous.
    pub coalesce: bool,
    /// How long the rig must have been at rest before it begins.
    pub rest: Duration,
    /// What is asked for, as data, where it can be asked for again.
    pub order: Option<serde_json::Value>,
    /// The job that this one does again.
    pub retry_of: Option<JobId>,
    /// The wish of whoever may ask for it again without knowing whether it was taken.
    pub wish: Option<Wish>,
    /// Whether somebody is told that it was taken, who must not be told so of a job that a loss of power forgets.
    pub durable: bool,
    /// What to do.
    pub work: Work,
}
