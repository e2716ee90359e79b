//! The threads of the queue, one a lane: each does one job after the other.

use super::book::Turn;
use super::queue::Shared;
use super::{JobId, JobState, Lane, Problem, Work, WorkError};
use crate::progress::Progress;
use std::panic::AssertUnwindSafe;
use std::sync::PoisonError;

/// The life of a lane's thread: takes the oldest waiting job, runs it, writes down how it ended.
pub(super) fn work_off(shared: &Shared, lane: Lane) {
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
        book = match book.next(lane) {
            Turn::Job(id, progress, work) => return Some((id, progress, work)),
            Turn::In(wait) => shared.woken.wait_timeout(book, wait).unwrap_or_else(PoisonError::into_inner).0,
            Turn::Nobody => shared.woken.wait(book).unwrap_or_else(PoisonError::into_inner),
        };
    }
}
