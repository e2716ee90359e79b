//! Progress of long work, and the flag that cancels it.
//!
//! A [`Progress`] is handed down into every computation that may take longer than a breath. The work calls
//! [`Progress::report`] now and then and [`Progress::check`] once a tile; whoever started it sees the
//! reports and may raise the cancel flag from any thread.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

/// The work was cancelled on request; nothing half-done was left under a final name.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("cancelled")]
pub struct Cancelled;

/// One report: `done` of `total` units of the named stage.
#[derive(Clone, Debug, PartialEq, serde::Serialize)]
pub struct Report {
    /// What is being done, in words a photographer understands.
    pub stage: String,
    /// Units finished.
    pub done: u64,
    /// Units in all; 0 when not known.
    pub total: u64,
}

type Sink = dyn Fn(&Report) + Send + Sync;

/// A cheap handle: reports upwards, is cancelled from above. Clones share both.
#[derive(Clone)]
pub struct Progress {
    cancel: Arc<AtomicBool>,
    sink: Arc<Sink>,
}

impl Progress {
    /// Reports go to `sink`, which must not block for long.
    pub fn new(sink: impl Fn(&Report) + Send + Sync + 'static) -> Self {
        Self { cancel: Arc::new(AtomicBool::new(false)), sink: Arc::new(sink) }
    }

    /// Nobody listens; still cancellable.
    pub fn silent() -> Self {
        Self::new(|_| {})
    }

    /// Tells that `done` of `total` units of `stage` are finished.
    pub fn report(&self, stage: &str, done: usize, total: usize) {
        (self.sink)(&Report { stage: stage.to_owned(), done: done as u64, total: total as u64 });
    }

    /// Asks the work to stop at its next [`Progress::check`].
    pub fn cancel(&self) {
        self.cancel.store(true, Ordering::Relaxed);
    }

    /// Whether the work was asked to stop.
    pub fn is_cancelled(&self) -> bool {
        self.cancel.load(Ordering::Relaxed)
    }

    /// The same for what must come to its end once it has begun: reports go on, and nobody's wish stops it.
    pub fn unstoppable(&self) -> Self {
        Self { cancel: Arc::default(), sink: self.sink.clone() }
    }

    /// `Err(Cancelled)` once the work was asked to stop: `progress.check()?`.
    pub fn check(&self) -> Result<(), Cancelled> {
        if self.is_cancelled() { Err(Cancelled) } else { Ok(()) }
    }
}

impl std::fmt::Debug for Progress {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Progress").field("cancelled", &self.is_cancelled()).finish()
    }
}
