//! What happens, as it happens: server-sent events. A `state` snapshot comes first, and again whenever the
//! listener was too slow to hear everything.

use crate::capture::{Event, Topic};
use crate::http::App;
use crate::http::bodies::StateBody;
use crate::http::problem::Problem;
use axum::extract::State;
use axum::response::sse::{self, KeepAlive, KeepAliveStream, Sse};
use serde_json::{Value, json};
use std::convert::Infallible;
use std::time::Duration;
use tokio::sync::broadcast::error::RecvError;
use tokio::sync::mpsc;
use tokio_stream::wrappers::ReceiverStream;

/// Messages that wait for a slow client before its task waits for it.
const AHEAD: usize = 16;

/// Events as they happen. The first is `state` with everything that a page needs to begin with; the others
/// carry `words` for people and `data` for machines. Topics: `devices`, `session`, `prompt`, `prompt_done`,
/// `pair`, `calibration_shot`, `recovery`, `trouble`, `job`, `studio`. Ids count up without gaps.
#[utoipa::path(get, path = "/api/v1/events", tag = "events",
    responses((status = 200, body = StateBody, content_type = "text/event-stream")))]
pub(super) async fn listen(
    State(app): State<App>,
) -> Result<Sse<KeepAliveStream<ReceiverStream<Result<sse::Event, Infallible>>>>, Problem> {
    let (sender, receiver) = mpsc::channel(AHEAD);
    let (last_id, mut heard) = app.desk.events().listen();
    let first = snapshot(&app, last_id)?;
    let mut closing = app.closing.clone();
    tokio::spawn(async move {
        let mut next = Some(first);
        loop {
            if let Some(message) = next.take()
                && sender.send(Ok(message)).await.is_err()
            {
                return;
            }
            next = tokio::select! {
                event = heard.recv() => match event {
                    Ok(event) => message(&event).ok(),
                    Err(RecvError::Lagged(_)) => {
                        let (last_id, anew) = app.desk.events().listen();
                        heard = anew;
                        snapshot(&app, last_id).ok()
                    }
                    Err(RecvError::Closed) => return,
                },
                _ = closing.changed() => return,
                () = sender.closed() => return,
            };
        }
    });
    let alive = KeepAlive::new().interval(Duration::from_secs(15));
    Ok(Sse::new(ReceiverStream::new(receiver)).keep_alive(alive))
}

fn snapshot(app: &App, last_id: u64) -> Result<sse::Event, Problem> {
    let state = StateBody {
        version: env!("CARGO_PKG_VERSION"),
        devices: app.desk.devices().into(),
        session: app.desk.current(),
        jobs: app.desk.queue().list().into_iter().map(Into::into).collect(),
        prompt: app.desk.prompt(),
        studio: app.studio.as_ref().map(|s| s.describe()),
    };
    sse::Event::default().event("state").id(last_id.to_string()).json_data(&state).map_err(Problem::internal)
}

/// An event on the wire: jobs as the jobs routes show them, everything else as it was told.
fn message(event: &Event) -> Result<sse::Event, axum::Error> {
    sse::Event::default()
        .event(event.topic.name())
        .id(event.id.to_string())
        .json_data(json!({ "words": event.words, "data": told(event) }))
}

/// The data as the routes show the same thing.
fn told(event: &Event) -> Value {
    let mut data = event.data.clone();
    if event.topic == Topic::Job
        && let Some(job) = data.as_object_mut()
    {
        if let Some(session) = job.remove("subject") {
            job.insert("session".into(), session);
        }
        let url = job.get("id").map(|id| format!("/api/v1/jobs/{id}"));
        job.insert("url".into(), json!(url));
    }
    data
}
