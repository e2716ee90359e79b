//! The queue: what is asked for, changed, told of and ended.

use super::book::{Book, Entry, REMEMBERED, WAITING_LIMIT};
use super::claims::{Claim, unix_seconds};
use super::lanes::work_off;
use super::logged::logged;
use super::{Job, JobId, JobState, Lane, Ledger, Load, Order, Wish};
use crate::progress::{Progress, Report};
use crate::session::utc_now;
use std::collections::HashSet;
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

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
    /// It did not come to an end that a retry could mend.
    #[error("job {0} waits, runs or is done: only what failed, was cancelled or interrupted is retried")]
    NotRetryable(JobId),
    /// What it was made from is gone, or somebody else's; a sentence says what to do.
    #[error("job {0} cannot be repeated: {1}")]
    NotRepeatable(JobId, String),
    /// The key stands for another wish.
    #[error("the key {0:?} came with another wish before; give each wish a key of its own")]
    KeyReused(String),
}

/// Hears of jobs.
type Notice = Box<dyn Fn(&Job) + Send + Sync>;
/// Hears of trouble with the ledger, in a sentence.
type Trouble = Box<dyn Fn(String) + Send + Sync>;

pub(super) struct Shared {
    book: Mutex<Book>,
    /// Held while a job is admitted, the ledger's disk included; looking at jobs never waits for it.
    admission: Mutex<()>,
    /// Keys under which somebody asks for a job just now: the next who comes with one waits for what becomes of it.
    asking: Mutex<HashSet<String>>,
    asked: Condvar,
    pub(super) woken: Condvar,
    notice: Notice,
    ledger: Option<(Ledger, Trouble)>,
}

impl Shared {
    /// The book is consistent after every statement, so a panic elsewhere leaves it usable.
    pub(super) fn book(&self) -> MutexGuard<'_, Book> {
        self.book.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Keys are inserted and removed whole.
    fn asking(&self) -> MutexGuard<'_, HashSet<String>> {
        self.asking.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Changes a job; the ledger, whose disk may be slow, hears of it without the lock.
    pub(super) fn change(&self, id: JobId, change: impl FnOnce(&mut Job)) {
        let changed = self.apply(&mut self.book(), id, change);
        if let Some(job) = changed {
            self.write_change(&job);
        }
    }

    fn write_change(&self, job: &Job) {
        self.write_down(|ledger| ledger.changed(job));
        self.book().unwritten -= 1;
        self.woken.notify_all();
    }

    /// Changes a job and tells of it under one lock: who listens hears of changes in the order in which they happened.
    /// Gives the job if the ledger must hear of it, by [`write_change`](Self::write_change).
    fn apply(&self, book: &mut Book, id: JobId, change: impl FnOnce(&mut Job)) -> Option<Job> {
        let entry = book.entry(id)?;
        let before = (entry.job.started.clone(), entry.job.state);
        change(&mut entry.job);
        let now = || Some(utc_now());
        if entry.job.state == JobState::Running && entry.job.started.is_none() {
            entry.job.started = now();
        }
        if entry.job.state.is_final() && entry.job.ended.is_none() {
            entry.job.ended = now();
        }
        let job = entry.job.clone();
        if job.lane == Lane::Rig && job.state.is_final() {
            book.rig_ended();
        }
        book.forget_the_oldest();
        (self.notice)(&job);
        let unwritten = before != (job.started.clone(), job.state);
        book.unwritten += usize::from(unwritten);
        unwritten.then_some(job)
    }

    /// What the ledger cannot write is told; the work goes on.
    fn write_down(&self, write: impl FnOnce(&Ledger) -> Option<String>) {
        if let Some((ledger, trouble)) = &self.ledger
            && let Some(words) = write(ledger)
        {
            trouble(words);
        }
    }
}

/// A cheap handle on the queue; clones share it.
#[derive(Clone)]
pub struct Queue(Arc<Shared>);

impl Queue {
    /// Starts all lanes. `notice` hears of every change of any job, in the order in which they happen, from the thread
    /// that made it; it must neither block nor ask the queue. Nothing is written down.
    pub fn start(notice: impl Fn(&Job) + Send + Sync + 'static) -> std::io::Result<Self> {
        Self::begin(Book::default(), Box::new(notice), None)
    }

    /// The same with a ledger: numbers go on from there, and its jobs are remembered. `trouble` hears in a sentence
    /// when it cannot be written.
    pub fn resume(
        ledger: Ledger,
        notice: impl Fn(&Job) + Send + Sync + 'static,
        trouble: impl Fn(String) + Send + Sync + 'static,
    ) -> std::io::Result<Self> {
        let book = Book::after(ledger.take_past());
        Self::begin(book, Box::new(notice), Some((ledger, Box::new(trouble))))
    }

    fn begin(book: Book, notice: Notice, ledger: Option<(Ledger, Trouble)>) -> std::io::Result<Self> {
        let shared = Arc::new(Shared {
            book: Mutex::new(book),
            admission: Mutex::default(),
            asking: Mutex::default(),
            asked: Condvar::new(),
            woken: Condvar::new(),
            notice,
            ledger,
        });
        for lane in Lane::ALL {
            let shared = shared.clone();
            let name = match lane {
                Lane::Rig => "jobs-rig",
                Lane::Develop => "jobs-develop",
                Lane::Processing => "jobs-processing",
            };
            std::thread::Builder::new().name(name.into()).spawn(move || work_off(&shared, lane))?;
        }
        Ok(Self(shared))
    }

    /// Queues a job and returns it as queued; with `coalesce`, rather the like job that waits already.
    pub fn enqueue(&self, order: Order) -> Result<Job, JobsError> {
        let _alone = self.0.admission.lock().unwrap_or_else(PoisonError::into_inner);
        let id = {
            let mut book = self.0.book();
            if book.closed {
                return Err(JobsError::Closed);
            }
            if let Some(like) = book.like(&order) {
                drop(book);
                if order.durable {
                    // The one that waits may be one that a loss of power forgets.
                    self.0.write_down(Ledger::sync);
                }
                if let Some(wish) = order.wish {
                    self.claim(wish, like.id);
                }
                // It may be due now.
                self.0.woken.notify_all();
                return Ok(like);
            }
            if book.is_full(order.lane) {
                return Err(JobsError::Full);
            }
            book.last_id += 1;
            book.last_id
        };
        let job = Job {
            id,
            kind: order.kind.to_owned(),
            subject: order.subject,
            lane: order.lane,
            state: JobState::Queued,
            stage: String::new(),
            done: 0,
            total: 0,
            result: None,
            problem: None,
            enqueued: utc_now(),
            started: None,
            ended: None,
            retry_of: order.retry_of,
            order: order.order,
        };
        self.0.write_down(|ledger| ledger.enqueued(&job, order.durable));
        // What begins is known by its key: else a crash between the two would have it done twice.
        if let Some(wish) = order.wish {
            self.claim(wish, job.id);
        }
        let progress = self.progress_of(job.id);
        {
            let mut book = self.0.book();
            if book.closed {
                drop(book);
                let cancelled = Job { state: JobState::Cancelled, ended: Some(utc_now()), ..job };
                self.0.write_down(|ledger| ledger.changed(&cancelled));
                return Err(JobsError::Closed);
            }
            let work = Some(logged(&job, order.work));
            book.entries.push_back(Entry { job: job.clone(), progress, work, rest: order.rest });
            (self.0.notice)(&job);
        }
        self.0.woken.notify_all();
        Ok(job)
    }

    /// The job that `ask` queues with this wish, or that was queued before for the same wish under the same key; and
    /// whether it was before, by this program or by one whose ledger this one goes on with. A wish that is refused leaves
    /// its key free. Who comes with the same key meanwhile waits, and nobody else.
    pub fn once<E: From<JobsError>>(
        &self,
        wish: Wish,
        ask: impl FnOnce(Wish) -> Result<Job, E>,
    ) -> Result<(Job, bool), E> {
        let _alone = Asking::under(&self.0, &wish.key);
        if let Some(job) = self.0.book().claimed(&wish, unix_seconds())? {
            return Ok((job, true));
        }
        Ok((ask(wish)?, false))
    }

    /// From now on the wish's key stands for this job.
    fn claim(&self, wish: Wish, job: JobId) {
        let claim = Claim { key: wish.key, wish: wish.digest, job, at: unix_seconds() };
        self.0.write_down(|ledger| ledger.claimed(&claim));
        self.0.book().claims.keep(claim);
    }

    /// Waits until another job can wait in this lane.
    pub fn wait_for_room(&self, lane: Lane) -> Result<(), JobsError> {
        let mut book = self.0.book();
        while !book.closed {
            if !book.is_full(lane) {
                return Ok(());
            }
            book = self.0.woken.wait(book).unwrap_or_else(PoisonError::into_inner);
        }
        Err(JobsError::Closed)
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

    /// How busy a lane is.
    pub fn load(&self, lane: Lane) -> Load {
        let book = self.0.book();
        let count =
            |state| book.entries.iter().filter(|e| e.job.lane == lane && e.job.state == state).count();
        Load { running: count(JobState::Running), waiting: count(JobState::Queued) }
    }

    /// A job that did not come to a good end, and what was asked for then.
    pub fn to_repeat(&self, id: JobId) -> Result<(Job, serde_json::Value), JobsError> {
        let job = self.get(id)?;
        if !matches!(job.state, JobState::Failed | JobState::Cancelled | JobState::Interrupted) {
            return Err(JobsError::NotRetryable(id));
        }
        match job.order.clone() {
            Some(order) => Ok((job, order)),
            None => {
                Err(JobsError::NotRepeatable(id, "what was sent with it is not kept; send it again".into()))
            }
        }
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
            JobState::Queued => {
                self.0.change(id, |job| {
                    if job.state == JobState::Queued {
                        job.state = JobState::Cancelled;
                    }
                });
                // What it holds may take time to go, or ask the queue.
                let unused = self.0.book().unused();
                drop(unused);
            }
            JobState::Running => {}
            _ => return Err(JobsError::Finished(id)),
        }
        // What waits for the rig may be due now.
        self.0.woken.notify_all();
        self.get(id)
    }

    /// Takes no more jobs, cancels all that wait and asks those that run to stop, then calls `closed`, all without waiting
    /// for anybody's disk. Returns once nothing runs and the ledger has heard of it, or `patience` is over; says whether
    /// everything came to rest.
    pub fn shut_down(&self, patience: Duration, closed: impl FnOnce()) -> bool {
        let end = Instant::now() + patience;
        let waited = self.close();
        closed();
        // A disk that hangs holds this thread, and nobody else.
        let own = self.clone();
        let writing = move || {
            waited.iter().for_each(|job| own.0.write_change(job));
            let unused = own.0.book().unused();
            drop(unused);
        };
        if let Err(error) = std::thread::Builder::new().name("jobs-end".into()).spawn(writing) {
            tracing::error!("no thread to be had to write down what is cancelled: {error}");
        }
        let mut book = self.0.book();
        while book.unwritten > 0 || book.entries.iter().any(|e| !e.job.state.is_final()) {
            let left = end.saturating_duration_since(Instant::now());
            if left.is_zero() {
                return false;
            }
            book = self.0.woken.wait_timeout(book, left).unwrap_or_else(PoisonError::into_inner).0;
        }
        true
    }

    /// Nothing is begun from now on. Gives the jobs that waited, of which the ledger has yet to hear.
    fn close(&self) -> Vec<Job> {
        let mut book = self.0.book();
        book.closed = true;
        let open = |e: &&mut Entry| !e.job.state.is_final();
        book.entries.iter_mut().filter(open).for_each(|e| e.progress.cancel());
        let waiting = book.entries.iter().filter(|e| e.job.state == JobState::Queued);
        let waiting: Vec<JobId> = waiting.map(|e| e.job.id).collect();
        let cancel = |id| self.0.apply(&mut book, id, |job| job.state = JobState::Cancelled);
        let waited = waiting.into_iter().filter_map(cancel).collect();
        self.0.woken.notify_all();
        waited
    }
}

/// Nobody else asks under this key as long as this lives.
struct Asking<'a> {
    shared: &'a Shared,
    key: String,
}

impl<'a> Asking<'a> {
    fn under(shared: &'a Shared, key: &str) -> Self {
        let mut asking = shared.asking();
        while !asking.insert(key.to_owned()) {
            asking = shared.asked.wait(asking).unwrap_or_else(PoisonError::into_inner);
        }
        Self { shared, key: key.to_owned() }
    }
}

impl Drop for Asking<'_> {
    fn drop(&mut self) {
        self.shared.asking().remove(&self.key);
        self.shared.asked.notify_all();
    }
}

#[cfg(test)]
mod tests;
