//! The queue and its threads, one a lane.

use super::{Job, JobId, JobState, Lane, Order, Problem, Work, WorkError};
use crate::progress::{Progress, Report};
use std::collections::VecDeque;
use std::panic::AssertUnwindSafe;
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

/// Jobs that may wait in one lane.
const WAITING_LIMIT: usize = 64;
/// Finished jobs that are remembered.
const REMEMBERED: usize = 200;
/// Reports of one stage closer together than this reach nobody but [`Queue::get`].
const NOTICE_INTERVAL: Duration = Duration::from_millis(100);

/// Why a job was not queued or cancelled.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum JobsError {
    /// Too many wait already.
    #[error("{WAITING_LIMIT} jobs are waiting already; try again when some of them are finished")]
    Full,
    /// The queue was shut down.
    #[error("the program is shutting down and takes no more jobs")]
    Closed,
    /// No such job.
    #[error("there is no job {0}; jobs are forgotten {REMEMBERED} jobs after they finished")]
    Unknown(JobId),
    /// It ended before it could be cancelled.
    #[error("job {0} is finished and cannot be cancelled any more")]
    Finished(JobId),
}

struct Entry {
    job: Job,
    progress: Progress,
    work: Option<Work>,
}

#[derive(Default)]
struct Book {
    last_id: JobId,
    entries: VecDeque<Entry>,
    closed: bool,
}

impl Book {
    fn entry(&mut self, id: JobId) -> Option<&mut Entry> {
        self.entries.iter_mut().find(|e| e.job.id == id)
    }

    fn forget_the_oldest(&mut self) {
        while self.entries.iter().filter(|e| e.job.state.is_final()).count() > REMEMBERED {
            let Some(at) = self.entries.iter().position(|e| e.job.state.is_final()) else { return };
            self.entries.remove(at);
        }
    }
}

struct Shared {
    book: Mutex<Book>,
    woken: Condvar,
    notice: Box<dyn Fn(&Job) + Send + Sync>,
}

impl Shared {
    /// The book is consistent after every statement, so a panic elsewhere leaves it usable.
    fn book(&self) -> MutexGuard<'_, Book> {
        self.book.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Changes a job under the lock, then tells of it without the lock.
    fn change(&self, id: JobId, change: impl FnOnce(&mut Job)) {
        let job = {
            let mut book = self.book();
            let Some(entry) = book.entry(id) else { return };
            change(&mut entry.job);
            let job = entry.job.clone();
            book.forget_the_oldest();
            job
        };
        (self.notice)(&job);
    }
}

/// A cheap handle on the queue; clones share it.
#[derive(Clone)]
pub struct Queue(Arc<Shared>);

impl Queue {
    /// Starts both lanes. `notice` hears of every change of any job, from the thread that made it, and must
    /// not block.
    pub fn start(notice: impl Fn(&Job) + Send + Sync + 'static) -> std::io::Result<Self> {
        let shared =
            Arc::new(Shared { book: Mutex::default(), woken: Condvar::new(), notice: Box::new(notice) });
        for (lane, name) in [(Lane::Rig, "jobs-rig"), (Lane::Processing, "jobs-processing")] {
            let shared = shared.clone();
            std::thread::Builder::new().name(name.into()).spawn(move || work_off(&shared, lane))?;
        }
        Ok(Self(shared))
    }

    /// Queues a job and returns it as queued; with `coalesce`, rather the like job that waits already.
    pub fn enqueue(&self, order: Order) -> Result<Job, JobsError> {
        let job = {
            let mut book = self.0.book();
            if book.closed {
                return Err(JobsError::Closed);
            }
            let waiting = || book.entries.iter().map(|e| &e.job).filter(|j| j.state == JobState::Queued);
            if let Some(like) = waiting().find(|j| {
                order.coalesce && j.kind == order.kind && j.subject == order.subject && j.lane == order.lane
            }) {
                return Ok(like.clone());
            }
            if waiting().filter(|j| j.lane == order.lane).count() >= WAITING_LIMIT {
                return Err(JobsError::Full);
            }
            book.last_id += 1;
            let job = Job {
                id: book.last_id,
                kind: order.kind,
                subject: order.subject,
                lane: order.lane,
                state: JobState::Queued,
                stage: String::new(),
                done: 0,
                total: 0,
                result: None,
                problem: None,
            };
            let progress = self.progress_of(job.id);
            book.entries.push_back(Entry { job: job.clone(), progress, work: Some(order.work) });
            job
        };
        (self.0.notice)(&job);
        self.0.woken.notify_all();
        Ok(job)
    }

    fn progress_of(&self, id: JobId) -> Progress {
        let shared = Arc::downgrade(&self.0);
        let told: Mutex<Option<(Instant, String)>> = Mutex::new(None);
        Progress::new(move |report: &Report| {
            let Some(shared) = shared.upgrade() else { return };
            let due = {
                let mut told = told.lock().unwrap_or_else(PoisonError::into_inner);
                let due = told.as_ref().is_none_or(|(at, stage)| {
                    *stage != report.stage || at.elapsed() >= NOTICE_INTERVAL || report.done == report.total
                });
                if due {
                    *told = Some((Instant::now(), report.stage.clone()));
                }
                due
            };
            let apply = |job: &mut Job| {
                job.stage.clone_from(&report.stage);
                job.done = report.done;
                job.total = report.total;
            };
            if due {
                shared.change(id, apply);
            } else if let Some(entry) = shared.book().entry(id) {
                apply(&mut entry.job);
            }
        })
    }

    /// Every job that is remembered, newest first.
    pub fn list(&self) -> Vec<Job> {
        self.0.book().entries.iter().rev().map(|e| e.job.clone()).collect()
    }

    /// One job as it stands.
    pub fn get(&self, id: JobId) -> Result<Job, JobsError> {
        self.0.book().entry(id).map(|e| e.job.clone()).ok_or(JobsError::Unknown(id))
    }

    /// Asks a job to stop. One that waits is cancelled at once; one that runs stops at its next check, so
    /// the job returned may still be running.
    pub fn cancel(&self, id: JobId) -> Result<Job, JobsError> {
        let state = {
            let mut book = self.0.book();
            let entry = book.entry(id).ok_or(JobsError::Unknown(id))?;
            entry.progress.cancel();
            entry.job.state
        };
        match state {
            JobState::Queued => self.0.change(id, |job| {
                if job.state == JobState::Queued {
                    job.state = JobState::Cancelled;
                }
            }),
            JobState::Running => {}
            JobState::Done | JobState::Failed | JobState::Cancelled => return Err(JobsError::Finished(id)),
        }
        self.get(id)
    }

    /// Takes no more jobs, cancels all that wait and asks those that run to stop. Returns once nothing runs
    /// or `patience` is over; says whether everything came to rest.
    pub fn shut_down(&self, patience: Duration) -> bool {
        let ids: Vec<JobId> = {
            let mut book = self.0.book();
            book.closed = true;
            book.entries.iter().filter(|e| !e.job.state.is_final()).map(|e| e.job.id).collect()
        };
        for id in ids {
            // A job that ended in the meantime is what was wanted.
            let _ended_already = self.cancel(id);
        }
        self.0.woken.notify_all();
        let end = Instant::now() + patience;
        let mut book = self.0.book();
        while book.entries.iter().any(|e| !e.job.state.is_final()) {
            let left = end.saturating_duration_since(Instant::now());
            if left.is_zero() {
                return false;
            }
            book = self.0.woken.wait_timeout(book, left).unwrap_or_else(PoisonError::into_inner).0;
        }
        true
    }
}

/// The life of a lane's thread: takes the oldest waiting job, runs it, writes down how it ended.
fn work_off(shared: &Shared, lane: Lane) {
    while let Some((id, progress, work)) = next(shared, lane) {
        shared.change(id, |job| job.state = JobState::Running);
        // What the work leaves behind after a panic is its own (files are written aside and renamed).
        let outcome = std::panic::catch_unwind(AssertUnwindSafe(|| work(&progress)));
        shared.change(id, |job| match outcome {
            Ok(Ok(result)) => {
                job.state = JobState::Done;
                job.result = Some(result);
            }
            Ok(Err(WorkError::Cancelled)) => job.state = JobState::Cancelled,
            Ok(Err(WorkError::Failed(problem))) => {
                job.state = JobState::Failed;
                job.problem = Some(problem);
            }
            Err(panic) => {
                job.state = JobState::Failed;
                job.problem = Some(Problem { code: "internal".into(), words: words_of(&*panic) });
            }
        });
        shared.woken.notify_all();
    }
}

fn words_of(panic: &(dyn std::any::Any + Send)) -> String {
    let said = panic
        .downcast_ref::<String>()
        .map(String::as_str)
        .or_else(|| panic.downcast_ref::<&str>().copied())
        .unwrap_or("no message");
    format!("the program stumbled over its own mistake ({said}); please report it with the log")
}

/// Waits for a job of `lane`; `None` once the queue is closed.
fn next(shared: &Shared, lane: Lane) -> Option<(JobId, Progress, Work)> {
    let mut book = shared.book();
    loop {
        if book.closed {
            return None;
        }
        let waiting = book.entries.iter_mut().find(|e| e.job.lane == lane && e.job.state == JobState::Queued);
        if let Some(entry) = waiting
            && let Some(work) = entry.work.take()
        {
            // From here on no like job is taken for one that still waits.
            entry.job.state = JobState::Running;
            return Some((entry.job.id, entry.progress.clone(), work));
        }
        book = shared.woken.wait(book).unwrap_or_else(PoisonError::into_inner);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::mpsc;

    fn order(kind: &'static str, coalesce: bool, work: Work) -> Order {
        Order { kind, subject: "vase".into(), lane: Lane::Processing, coalesce, work }
    }

    fn finished(queue: &Queue, id: JobId) -> Job {
        let end = Instant::now() + Duration::from_secs(10);
        loop {
            let job = queue.get(id).unwrap();
            if job.state.is_final() {
                return job;
            }
            assert!(Instant::now() < end, "job {id} did not end: {job:?}");
            std::thread::yield_now();
        }
    }

    /// A job that runs until it is let go; the first channel tells that it runs.
    fn gated(queue: &Queue, kind: &'static str) -> (JobId, mpsc::Sender<()>) {
        let (running, runs) = mpsc::channel();
        let (go, gate) = mpsc::channel::<()>();
        let work: Work = Box::new(move |_| {
            running.send(()).unwrap();
            gate.recv().unwrap();
            Ok(serde_json::Value::Null)
        });
        let id = queue.enqueue(order(kind, true, work)).unwrap().id;
        runs.recv_timeout(Duration::from_secs(10)).unwrap();
        (id, go)
    }

    #[test]
    fn a_job_reports_progress_and_ends_done_with_its_result() {
        let (tx, rx) = mpsc::channel();
        let queue = Queue::start(move |job| tx.send((job.state, job.done)).unwrap()).unwrap();
        let work: Work = Box::new(|progress| {
            progress.report("half", 1, 2);
            Ok(serde_json::json!({"texels": 7}))
        });
        let id = queue.enqueue(order("process", false, work)).unwrap().id;
        let job = finished(&queue, id);
        assert_eq!((job.state, job.result), (JobState::Done, Some(serde_json::json!({"texels": 7}))));
        let heard: Vec<_> = rx.iter().take(4).collect();
        assert_eq!(
            heard,
            [(JobState::Queued, 0), (JobState::Running, 0), (JobState::Running, 1), (JobState::Done, 1)]
        );
    }

    #[test]
    fn a_waiting_job_swallows_its_like_and_a_running_one_does_not() {
        let queue = Queue::start(|_| {}).unwrap();
        let (running, go) = gated(&queue, "process");
        let noop = || -> Work { Box::new(|_| Ok(serde_json::Value::Null)) };
        let second = queue.enqueue(order("process", true, noop())).unwrap().id;
        let third = queue.enqueue(order("process", true, noop())).unwrap().id;
        assert_ne!(second, running);
        assert_eq!(third, second);
        go.send(()).unwrap();
        assert_eq!(finished(&queue, second).state, JobState::Done);
    }

    #[test]
    fn a_waiting_job_is_cancelled_at_once_and_never_runs() {
        let queue = Queue::start(|_| {}).unwrap();
        let (_, go) = gated(&queue, "first");
        let id = queue.enqueue(order("second", false, Box::new(|_| panic!("ran")))).unwrap().id;
        assert_eq!(queue.cancel(id).unwrap().state, JobState::Cancelled);
        go.send(()).unwrap();
        let after = queue.enqueue(order("third", false, Box::new(|_| Ok(1.into())))).unwrap().id;
        assert_eq!(finished(&queue, after).state, JobState::Done);
        assert_eq!(queue.get(id).unwrap().state, JobState::Cancelled);
        assert_eq!(queue.cancel(id), Err(JobsError::Finished(id)));
    }

    #[test]
    fn a_running_job_stops_at_its_next_check() {
        let queue = Queue::start(|_| {}).unwrap();
        let (running, runs) = mpsc::channel();
        let work: Work = Box::new(move |progress| {
            running.send(()).unwrap();
            loop {
                progress.check()?;
                std::thread::yield_now();
            }
        });
        let id = queue.enqueue(order("endless", false, work)).unwrap().id;
        runs.recv_timeout(Duration::from_secs(10)).unwrap();
        queue.cancel(id).unwrap();
        assert_eq!(finished(&queue, id).state, JobState::Cancelled);
    }

    #[test]
    fn a_panic_fails_its_job_and_spares_the_next() {
        let queue = Queue::start(|_| {}).unwrap();
        let bad = queue.enqueue(order("bad", false, Box::new(|_| panic!("boom")))).unwrap().id;
        let good = queue.enqueue(order("good", false, Box::new(|_| Ok(1.into())))).unwrap().id;
        let job = finished(&queue, bad);
        assert_eq!(job.state, JobState::Failed);
        assert!(job.problem.unwrap().words.contains("boom"));
        assert_eq!(finished(&queue, good).state, JobState::Done);
    }

    #[test]
    fn the_lanes_do_not_wait_for_each_other() {
        let queue = Queue::start(|_| {}).unwrap();
        let (_, go) = gated(&queue, "process");
        let shot = Order {
            kind: "pair",
            subject: "vase".into(),
            lane: Lane::Rig,
            coalesce: false,
            work: Box::new(|_| Ok(1.into())),
        };
        let id = queue.enqueue(shot).unwrap().id;
        assert_eq!(finished(&queue, id).state, JobState::Done);
        go.send(()).unwrap();
    }

    #[test]
    fn the_queue_is_bounded_and_closes() {
        let queue = Queue::start(|_| {}).unwrap();
        let (running, go) = gated(&queue, "first");
        for _ in 0..WAITING_LIMIT {
            queue.enqueue(order("more", false, Box::new(|_| Ok(1.into())))).unwrap();
        }
        let over = queue.enqueue(order("more", false, Box::new(|_| Ok(1.into()))));
        assert_eq!(over.err(), Some(JobsError::Full));
        assert!(!queue.shut_down(Duration::from_millis(1)), "the first job still runs");
        go.send(()).unwrap();
        assert!(queue.shut_down(Duration::from_secs(10)));
        assert_eq!(queue.get(running).unwrap().state, JobState::Done);
        let closed = queue.enqueue(order("late", false, Box::new(|_| Ok(1.into()))));
        assert_eq!(closed.err(), Some(JobsError::Closed));
    }
}
