//! What the log says of a job: when it runs and how it ends, and of every line in between whose it is.

use super::{Job, Work, WorkError};

/// The work of `job`, its lines under its name. They stand below the request or the job that ordered it, too, if the calling
/// thread is in one.
pub(super) fn logged(job: &Job, work: Work) -> Work {
    let span = tracing::error_span!("job", id = job.id, kind = job.kind, session = job.subject);
    Box::new(move |progress| {
        span.in_scope(|| {
            tracing::info!("runs");
            let outcome = work(progress);
            match &outcome {
                Ok(_) => tracing::info!("done"),
                Err(WorkError::Cancelled) => tracing::info!("cancelled"),
                Err(WorkError::Failed(problem)) => tracing::warn!(code = problem.code, "{}", problem.words),
            }
            outcome
        })
    })
}
