//! `jobs.jsonl`: what was asked for and what came of it, a line each, so that the next program knows.
//!
//! The ledger serves the queue and never stands in its way: a line that cannot be written is told once, and the
//! work goes on. It is read and shortened when it is opened; whoever opens it has locked the folder of the sessions, so that
//! no second program writes to it.

use super::claims::{Claim, Claims, unix_seconds};
use super::{Job, JobId, JobState, Problem};
use crate::session::{lines, store, utc_now};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::fs::OpenOptions;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Mutex, PoisonError};

/// Jobs that are carried over from one program to the next, beside those that a key stands for.
const CARRIED: usize = 100;

/// One line.
#[derive(Serialize, Deserialize)]
#[serde(tag = "event", rename_all = "snake_case")]
enum Line {
    /// Numbers up to this one are spent.
    Spent { job: JobId },
    /// A job as it stands.
    Job {
        #[serde(flatten)]
        job: Box<Job>,
        /// What was asked for; a job does not tell it.
        #[serde(default, skip_serializing_if = "Option::is_none", rename = "asked")]
        order: Option<serde_json::Value>,
    },
    /// A key stands for a job.
    Claimed(Claim),
    /// A job began.
    Started { job: JobId, at: String },
    /// A job ended.
    Ended {
        job: JobId,
        at: String,
        state: JobState,
        #[serde(default, skip_serializing_if = "Option::is_none")]
        result: Option<serde_json::Value>,
        #[serde(default, skip_serializing_if = "Option::is_none")]
        problem: Option<Problem>,
    },
}

/// What an earlier program left.
#[derive(Debug, Default)]
pub(super) struct Past {
    /// The last number that is spent.
    pub(super) last_id: JobId,
    /// Its jobs, all ended, ascending.
    pub(super) jobs: Vec<Job>,
    /// The keys that stand for them.
    pub(super) claims: Claims,
}

impl Past {
    fn forget_the_oldest(&mut self) {
        let claimed = self.claims.jobs();
        let mut left = self.jobs.len();
        self.jobs.retain(|job| {
            left -= 1;
            left < CARRIED || claimed.contains(&job.id)
        });
    }
}

/// The open file.
#[derive(Debug)]
pub struct Ledger {
    path: PathBuf,
    past: Mutex<Past>,
    /// Lines are written one after the other.
    alone: Mutex<()>,
    troubled: AtomicBool,
}

impl Ledger {
    /// Opens the ledger in a folder of its own, made if need be. What an earlier program did not end is interrupted,
    /// and says so in the words that `words` has for its kind.
    pub fn open(folder: &Path, words: impl Fn(&Job) -> String) -> std::io::Result<Self> {
        std::fs::create_dir_all(folder)?;
        store::remove_temporaries(folder)?;
        let path = folder.join("jobs.jsonl");
        let mut past = read(&lines::read(&path)?);
        for job in past.jobs.iter_mut().filter(|job| !job.state.is_final()) {
            job.state = JobState::Interrupted;
            job.ended = Some(utc_now());
            job.problem = Some(Problem { code: "interrupted".into(), words: words(job) });
        }
        past.forget_the_oldest();
        let spent = std::iter::once(Line::Spent { job: past.last_id });
        let jobs = past.jobs.iter().map(whole);
        let claims = past.claims.iter().cloned().map(Line::Claimed);
        let mut text = String::new();
        for line in spent.chain(jobs).chain(claims) {
            text += &serde_json::to_string(&line)?;
            text.push('\n');
        }
        store::write_atomic(&path, text.as_bytes())?;
        Ok(Self { path, past: Mutex::new(past), alone: Mutex::default(), troubled: AtomicBool::new(false) })
    }

    /// What an earlier program left; given once.
    pub(super) fn take_past(&self) -> Past {
        std::mem::take(&mut *self.past.lock().unwrap_or_else(PoisonError::into_inner))
    }

    /// Writes down that a job was asked for; `durable`: on the disk when this returns.
    pub(super) fn enqueued(&self, job: &Job, durable: bool) -> Option<String> {
        self.write(&whole(job), durable)
    }

    /// Writes down that a key stands for a job; on the disk when this returns.
    pub(super) fn claimed(&self, claim: &Claim) -> Option<String> {
        self.write(&Line::Claimed(claim.clone()), true)
    }

    /// Brings to the disk what was asked for so far.
    pub(super) fn sync(&self) -> Option<String> {
        self.written(OpenOptions::new().append(true).open(&self.path).and_then(|file| file.sync_data()))
    }

    /// Writes down that a job began or ended. A sentence comes back where writing fails for the first time.
    pub(super) fn changed(&self, job: &Job) -> Option<String> {
        let (id, ended) = (job.id, job.ended.clone());
        let line = match (job.state, ended) {
            (JobState::Queued, _) => return None,
            (JobState::Running, _) => {
                Line::Started { job: id, at: job.started.clone().unwrap_or_else(utc_now) }
            }
            (state, ended) => Line::Ended {
                job: id,
                at: ended.unwrap_or_else(utc_now),
                state,
                result: job.result.clone(),
                problem: job.problem.clone(),
            },
        };
        self.write(&line, false)
    }

    fn write(&self, line: &Line, durable: bool) -> Option<String> {
        let _alone = self.alone.lock().unwrap_or_else(PoisonError::into_inner);
        let write = if durable { lines::append_synced } else { lines::append };
        self.written(
            serde_json::to_string(line).map_err(Into::into).and_then(|line| write(&self.path, &line)),
        )
    }

    /// A sentence where writing fails for the first time.
    fn written(&self, outcome: std::io::Result<()>) -> Option<String> {
        match outcome {
            Ok(()) => {
                self.troubled.store(false, Ordering::Relaxed);
                None
            }
            Err(error) => {
                tracing::warn!("{} could not be written: {error}", self.path.display());
                let first = !self.troubled.swap(true, Ordering::Relaxed);
                first.then(|| {
                    format!(
                        "The list of jobs, {}, could not be written: {error}. Work goes on; after a restart \
                         it may not be known what was asked for. Look at the disk.",
                        self.path.display()
                    )
                })
            }
        }
    }
}

fn whole(job: &Job) -> Line {
    Line::Job { job: Box::new(job.clone()), order: job.order.clone() }
}

/// Jobs out of lines. A line that makes no sense costs what it said, never the rest.
fn read(text: &str) -> Past {
    let mut last_id = 0;
    let mut jobs = BTreeMap::<JobId, Job>::new();
    let mut claims = Claims::default();
    for line in text.lines() {
        match serde_json::from_str(line) {
            Ok(Line::Spent { job }) => last_id = last_id.max(job),
            Ok(Line::Job { mut job, order }) => {
                last_id = last_id.max(job.id);
                job.order = order;
                jobs.insert(job.id, *job);
            }
            Ok(Line::Claimed(claim)) => claims.keep(claim),
            Ok(Line::Started { job, at }) => {
                if let Some(job) = jobs.get_mut(&job) {
                    job.state = JobState::Running;
                    job.started = Some(at);
                }
            }
            Ok(Line::Ended { job, at, state, result, problem }) => {
                if let Some(job) = jobs.get_mut(&job) {
                    *job = Job { state, result, problem, ended: Some(at), ..job.clone() };
                }
            }
            Err(error) => tracing::warn!("a line of the list of jobs is left out: {error}"),
        }
    }
    claims.forget(unix_seconds());
    claims.forget_strangers(|job| jobs.contains_key(&job));
    Past { last_id, jobs: jobs.into_values().collect(), claims }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::jobs::Lane;
    use serde_json::json;

    fn job(id: JobId) -> Job {
        Job {
            id,
            kind: "process".into(),
            subject: "vase".into(),
            lane: Lane::Processing,
            state: JobState::Queued,
            stage: String::new(),
            done: 0,
            total: 0,
            result: None,
            problem: None,
            enqueued: utc_now(),
            started: None,
            ended: None,
            retry_of: Some(1),
            order: Some(json!({ "size": 7 })),
        }
    }

    fn opened(folder: &Path) -> (Ledger, Past) {
        let ledger = Ledger::open(folder, |job| format!("{} was cut short", job.kind)).unwrap();
        let past = ledger.take_past();
        (ledger, past)
    }

    #[test]
    fn what_did_not_end_is_interrupted_and_what_did_stays_as_it_ended() {
        let folder = tempfile::tempdir().unwrap();
        {
            let (ledger, past) = opened(folder.path());
            assert_eq!((past.last_id, past.jobs.len()), (0, 0));
            for id in [5, 6, 7] {
                assert_eq!(ledger.enqueued(&job(id), id == 5), None);
            }
            let running = Job { state: JobState::Running, started: Some(utc_now()), ..job(6) };
            assert_eq!(ledger.changed(&running), None);
            let done =
                Job { state: JobState::Done, result: Some(json!(3)), ended: Some("E".into()), ..job(5) };
            assert_eq!(ledger.changed(&done), None);
        }
        // Killed in the middle of a line.
        let path = folder.path().join("jobs.jsonl");
        let mut torn = std::fs::read(&path).unwrap();
        torn.extend(b"{\"event\":\"ended\",\"job\":6,");
        std::fs::write(&path, torn).unwrap();
        for _ in 0..2 {
            let (_ledger, past) = opened(folder.path());
            assert_eq!(past.last_id, 7);
            let states: Vec<_> = past.jobs.iter().map(|j| (j.id, j.state)).collect();
            use JobState::{Done, Interrupted};
            assert_eq!(states, [(5, Done), (6, Interrupted), (7, Interrupted)]);
            assert_eq!((&past.jobs[0].result, &past.jobs[0].order), (&Some(json!(3)), &job(5).order));
            assert_eq!(past.jobs[1].problem.as_ref().unwrap().words, "process was cut short");
            assert!(past.jobs[1].started.is_some() && past.jobs[2].started.is_none());
        }
    }

    #[test]
    fn it_is_shortened_when_opened_and_numbers_go_on() {
        let folder = tempfile::tempdir().unwrap();
        {
            let (ledger, _) = opened(folder.path());
            (1..=1000).for_each(|id| assert_eq!(ledger.enqueued(&job(id), false), None));
        }
        for _ in 0..2 {
            let (_ledger, past) = opened(folder.path());
            assert_eq!((past.last_id, past.jobs.len(), past.jobs[0].id), (1000, CARRIED, 901));
        }
        let text = std::fs::read_to_string(folder.path().join("jobs.jsonl")).unwrap();
        assert_eq!(text.lines().count(), CARRIED + 1);
    }

    #[test]
    fn a_damaged_line_costs_nothing_but_itself() {
        let folder = tempfile::tempdir().unwrap();
        let (ledger, _) = opened(folder.path());
        ledger.enqueued(&job(1), false);
        drop(ledger);
        let path = folder.path().join("jobs.jsonl");
        let text = std::fs::read_to_string(&path).unwrap();
        std::fs::write(&path, format!("no line\n{text}{{\"event\":\"ended\",\"job\":99}}\n")).unwrap();
        let (_ledger, past) = opened(folder.path());
        assert_eq!((past.last_id, past.jobs.len()), (1, 1));
    }

    #[test]
    fn trouble_with_the_disk_is_told_once_and_harms_nobody() {
        let folder = tempfile::tempdir().unwrap();
        let (ledger, _) = opened(folder.path());
        // A folder in its place cannot be written.
        let path = folder.path().join("jobs.jsonl");
        std::fs::remove_file(&path).unwrap();
        std::fs::create_dir(&path).unwrap();
        assert!(ledger.enqueued(&job(1), true).unwrap().contains("Work goes on"));
        assert_eq!(ledger.enqueued(&job(2), true), None);
        std::fs::remove_dir(&path).unwrap();
        assert_eq!(ledger.enqueued(&job(3), true), None);
        assert!(path.is_file());
    }
}
