//! Queue, workers and one job's life.
//!
//! A job is long work with a name: it is queued, runs on its lane's one thread, reports progress, may be
//! cancelled, and ends done, failed or cancelled. It belongs to nobody: whoever asked for it may leave. Two
//! lanes keep the rig and the processor apart, so that pairs are shot while earlier ones are processed.
//!
//! In: closures that take a [`Progress`]. Out: [`Job`] snapshots, on request and at every change. What the
//! work does is none of this module's business.

mod queue;

use crate::progress::{Cancelled, Progress};
use serde::Serialize;

pub use queue::{JobsError, Queue};

/// Number of a job, from 1, unique while the queue lives.
pub type JobId = u64;

/// The thread on which a job runs. Jobs of one lane run one after the other, in the order of arrival.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Lane {
    /// Work that holds camera and flash.
    Rig,
    /// Work on files.
    Processing,
}

/// Where a job stands.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
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
}

impl JobState {
    /// Whether the job will not change any more.
    pub fn is_final(self) -> bool {
        matches!(self, JobState::Done | JobState::Failed | JobState::Cancelled)
    }
}

/// Why a job failed, for machines and for people.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Problem {
    /// Stable name of the kind of problem.
    pub code: String,
    /// The sentence for the photographer.
    pub words: String,
}

/// A job as it stood at one moment.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Job {
    /// Its number.
    pub id: JobId,
    /// What it does, a stable name: `pair`, `process`, ...
    pub kind: &'static str,
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
    /// Why it failed, once failed.
    pub problem: Option<Problem>,
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
    /// What to do.
    pub work: Work,
}
