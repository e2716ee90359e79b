//! What the program knows of its own life: since when it runs, and how many streams of events are open.

use axum::body::Body;
use axum::http::header;
use axum::response::Response;
use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::time::{Duration, Instant};
use tokio_stream::StreamExt;

/// Counts what is counted while the program runs; clones share it.
#[derive(Clone)]
pub(super) struct Vitals(Arc<Inner>);

struct Inner {
    started: String,
    since: Instant,
    event_streams: AtomicUsize,
}

impl Vitals {
    /// Begins to count now.
    pub(super) fn start() -> Self {
        let (started, since) = (crate::session::utc_now(), Instant::now());
        Self(Arc::new(Inner { started, since, event_streams: AtomicUsize::new(0) }))
    }

    /// When the program started to answer, UTC.
    pub(super) fn started(&self) -> &str {
        &self.0.started
    }

    /// For how long it has.
    pub(super) fn uptime(&self) -> Duration {
        self.0.since.elapsed()
    }

    /// Streams of events whose clients are still there.
    pub(super) fn event_streams(&self) -> usize {
        self.0.event_streams.load(Ordering::Relaxed)
    }

    /// Counts an answer that is a stream of events for as long as it is sent.
    pub(super) fn counted(&self, answer: Response) -> Response {
        let is_stream = |value: &header::HeaderValue| value.as_bytes().starts_with(b"text/event-stream");
        if !answer.headers().get(header::CONTENT_TYPE).is_some_and(is_stream) {
            return answer;
        }
        self.0.event_streams.fetch_add(1, Ordering::Relaxed);
        let open = Open(self.clone());
        answer.map(|body| {
            Body::from_stream(body.into_data_stream().map(move |piece| {
                let _as_long_as_it_is_sent = &open;
                piece
            }))
        })
    }
}

/// One stream that is open.
struct Open(Vitals);

impl Drop for Open {
    fn drop(&mut self) {
        self.0.0.event_streams.fetch_sub(1, Ordering::Relaxed);
    }
}
