//! What is queued, what runs, what has ended; and whose turn it is.

use super::claims::Claims;
use super::ledger::Past;
use super::{Job, JobId, JobState, JobsError, Lane, Order, Wish, Work};
use crate::progress::Progress;
use std::collections::{HashMap, VecDeque};
use std::time::{Duration, Instant};

/// Jobs that may wait in one lane.
pub(super) const WAITING_LIMIT: usize = 64;
/// Finished jobs that are remembered, beside those that a key stands for.
pub(super) const REMEMBERED: usize = 200;

pub(super) struct Entry {
    pub(super) job: Job,
    pub(super) progress: Progress,
    pub(super) work: Option<Work>,
    /// How long the rig must have been at rest before it begins.
    pub(super) rest: Duration,
}

/// Whose turn it is.
pub(super) enum Turn {
    /// This job's.
    Job(JobId, Progress, Work),
    /// Nobody's before the rig has rested this much longer.
    In(Duration),
    /// Nobody's.
    Nobody,
}

#[derive(Default)]
pub(super) struct Book {
    pub(super) last_id: JobId,
    pub(super) entries: VecDeque<Entry>,
    pub(super) closed: bool,
    /// Keys under which jobs were asked for.
    pub(super) claims: Claims,
    /// Changes of which the ledger has yet to hear.
    pub(super) unwritten: usize,
    /// When the last job at the rig ended.
    rested_since: Option<Instant>,
    /// Turns that were given, and the last one of each subject.
    turns: u64,
    served: HashMap<(Lane, String), u64>,
}

impl Book {
    /// Goes on where an earlier program ended.
    pub(super) fn after(past: Past) -> Self {
        let past_work = |job| Entry { job, progress: Progress::silent(), work: None, rest: Duration::ZERO };
        let entries = past.jobs.into_iter().map(past_work).collect();
        Self { last_id: past.last_id, entries, claims: past.claims, ..Self::default() }
    }

    pub(super) fn entry(&mut self, id: JobId) -> Option<&mut Entry> {
        self.entries.iter_mut().find(|e| e.job.id == id)
    }

    fn waiting(&self, lane: Lane) -> impl Iterator<Item = &Entry> {
        self.entries.iter().filter(move |e| e.job.lane == lane && e.job.state == JobState::Queued)
    }

    pub(super) fn is_full(&self, lane: Lane) -> bool {
        self.waiting(lane).count() >= WAITING_LIMIT
    }

    /// A job that waits and does all that `order` asks for; it does so as early as the more impatient of both.
    pub(super) fn like(&mut self, order: &Order) -> Option<Job> {
        let entry = self.entries.iter_mut().find(|e| {
            let job = &e.job;
            order.coalesce
                && job.state == JobState::Queued
                && (job.kind.as_str(), &job.subject, job.lane) == (order.kind, &order.subject, order.lane)
        })?;
        entry.rest = entry.rest.min(order.rest);
        Some(entry.job.clone())
    }

    /// The work of jobs that were cancelled before they began: to be dropped where nobody waits.
    pub(super) fn unused(&mut self) -> Vec<Work> {
        let over = |e: &&mut Entry| e.job.state.is_final();
        self.entries.iter_mut().filter(over).filter_map(|e| e.work.take()).collect()
    }

    /// The job that this key stands for at this moment; an error if it does so for another wish.
    pub(super) fn claimed(&mut self, wish: &Wish, now: u64) -> Result<Option<Job>, JobsError> {
        let Some(claim) = self.claims.of(&wish.key, now) else { return Ok(None) };
        if claim.wish != wish.digest {
            return Err(JobsError::KeyReused(wish.key.clone()));
        }
        let id = claim.job;
        Ok(self.entry(id).map(|entry| entry.job.clone()))
    }

    pub(super) fn forget_the_oldest(&mut self) {
        let claimed = self.claims.jobs();
        let may_go = |entry: &Entry| entry.job.state.is_final() && !claimed.contains(&entry.job.id);
        let mut surplus = self.entries.iter().filter(|e| may_go(e)).count().saturating_sub(REMEMBERED);
        self.entries.retain(|entry| {
            let goes = surplus > 0 && may_go(entry);
            surplus -= usize::from(goes);
            !goes
        });
    }

    /// The rig has nothing more to do.
    pub(super) fn rig_ended(&mut self) {
        self.rested_since = Some(Instant::now());
    }

    /// How long `wanted` of rest still lacks; `None` while the rig is at work.
    fn lacks(&self, wanted: Duration) -> Option<Duration> {
        if wanted.is_zero() {
            return Some(wanted);
        }
        let busy = |e: &Entry| e.job.lane == Lane::Rig && !e.job.state.is_final();
        let rest = |since: Instant| wanted.saturating_sub(since.elapsed());
        (!self.entries.iter().any(busy)).then(|| self.rested_since.map_or(Duration::ZERO, rest))
    }

    /// Takes the job of `lane` whose turn it is: at the rig the oldest; elsewhere the oldest of the subject that has
    /// waited longest for a turn, so that no session waits for all of another's work.
    pub(super) fn next(&mut self, lane: Lane) -> Turn {
        let (mut best, mut soonest): (Option<(u64, JobId)>, Option<Duration>) = (None, None);
        for entry in self.waiting(lane) {
            match self.lacks(entry.rest) {
                Some(Duration::ZERO) => {
                    let served = match lane {
                        Lane::Rig => 0,
                        _ => self.served.get(&(lane, entry.job.subject.clone())).copied().unwrap_or(0),
                    };
                    if best.is_none_or(|(turn, _)| served < turn) {
                        best = Some((served, entry.job.id));
                    }
                }
                Some(lacks) => soonest = Some(soonest.map_or(lacks, |s| s.min(lacks))),
                None => {}
            }
        }
        let Some((_, id)) = best else { return soonest.map_or(Turn::Nobody, Turn::In) };
        self.turns += 1;
        let turn = self.turns;
        let Some(entry) = self.entry(id) else { return Turn::Nobody };
        let Some(work) = entry.work.take() else { return Turn::Nobody };
        // From here on no like job is taken for one that still waits.
        entry.job.state = JobState::Running;
        let (progress, subject) = (entry.progress.clone(), entry.job.subject.clone());
        self.served.insert((lane, subject), turn);
        Turn::Job(id, progress, work)
    }
}
