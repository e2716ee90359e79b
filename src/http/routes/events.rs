//! What happens, as it happens: server-sent events. A newcomer hears the `state` first; who comes back hears what was
//! missed, each thing once, or the `state` again where that cannot be told any more.

use super::blocking;
use crate::capture::{Event, Heard, Topic};
use crate::http::App;
use crate::http::bodies::StateBody;
use crate::http::extract::Query;
use crate::http::links;
use crate::http::paging::USUAL;
use crate::http::pair_bodies::PairBody;
use crate::http::problem::Problem;
use axum::extract::State;
use axum::http::HeaderMap;
use axum::response::sse::{self, KeepAlive, KeepAliveStream, Sse};
use serde::Deserialize;
use serde_json::{Value, json};
use std::collections::VecDeque;
use std::convert::Infallible;
use std::time::Duration;
use tokio::sync::broadcast::error::RecvError;
use tokio::sync::mpsc;
use tokio_stream::wrappers::ReceiverStream;
use utoipa::IntoParams;

/// Messages that wait for a slow client before its task waits for it.
const AHEAD: usize = 16;

/// Where to go on.
#[derive(Deserialize, IntoParams)]
#[into_params(parameter_in = Query)]
pub(super) struct GoOn {
    /// Id of the last event that was heard, for scripts that cannot set the header `Last-Event-ID`.
    last_event_id: Option<String>,
}

/// Events as they happen. The first is `state` with everything that a page needs to begin with; the others
/// carry `words` for people and `data` for machines. Topics: `devices`, `session`, `prompt`, `prompt_done`,
/// `pair`, `calibration_shot`, `calibration`, `recovery`, `trouble`, `sequence`, `mirror`, `job`, `studio`. Ids are `BOOT.N`: BOOT is this run of the
/// daemon, N counts up without gaps. With `Last-Event-ID` (or `last_event_id`) the events after that one come, each once and in
/// order; where they are not remembered any more, or are of another run, `state` comes first again.
#[utoipa::path(get, path = "/api/v1/events", tag = "events",
    params(GoOn, ("Last-Event-ID" = Option<String>, Header, description = "Id of the last event that was heard")),
    responses((status = 200, body = StateBody, content_type = "text/event-stream")))]
pub(super) async fn listen(
    State(app): State<App>,
    Query(go_on): Query<GoOn>,
    headers: HeaderMap,
) -> Result<Sse<KeepAliveStream<ReceiverStream<Result<sse::Event, Infallible>>>>, Problem> {
    let named = headers.get("last-event-id").and_then(|id| id.to_str().ok()).map(str::to_owned);
    let last = named.or(go_on.last_event_id);
    let mut ear = Ear::open(app.clone(), last.as_deref()).await?;
    let (sender, receiver) = mpsc::channel(AHEAD);
    let mut closing = app.closing.clone();
    tokio::spawn(async move {
        loop {
            tokio::select! {
                message = ear.next() => match message {
                    Some(message) => tokio::select! {
                        sent = sender.send(Ok(message)) => if sent.is_err() { return },
                        _ = closing.changed() => return,
                    },
                    None => return,
                },
                _ = closing.changed() => return,
                () = sender.closed() => return,
            }
        }
    });
    let alive = KeepAlive::new().interval(Duration::from_secs(15));
    Ok(Sse::new(ReceiverStream::new(receiver)).keep_alive(alive))
}

/// One listener: what it has yet to be told, and what it hears from now on.
struct Ear {
    app: App,
    heard: Heard,
    /// To be told before the next that is heard.
    due: VecDeque<sse::Event>,
    /// Id of the last event that went into `due`.
    last: String,
}

impl Ear {
    async fn open(app: App, last: Option<&str>) -> Result<Self, Problem> {
        let events = app.desk.events();
        match last.and_then(|last| Some((last, events.listen_after(last)?))) {
            Some((last, (missed, heard))) => {
                let mut ear = Self { heard, due: VecDeque::new(), last: last.to_owned(), app };
                missed.iter().for_each(|event| ear.take(event));
                Ok(ear)
            }
            None => {
                let (last, heard) = events.listen();
                let last = events.mark(last);
                let due = VecDeque::from([snapshot(&app, &last).await?]);
                Ok(Self { heard, due, last, app })
            }
        }
    }

    fn take(&mut self, event: &Event) {
        self.last = self.app.desk.events().mark(event.id);
        // The data was JSON before: there is nothing in it that JSON cannot say.
        self.due.extend(message(event, &self.last).ok());
    }

    /// The next message; `None` when there will be none any more.
    async fn next(&mut self) -> Option<sse::Event> {
        loop {
            if let Some(message) = self.due.pop_front() {
                return Some(message);
            }
            match self.heard.recv().await {
                Ok(event) => self.take(&event),
                // Too slow for the channel: what was missed may still be remembered.
                Err(RecvError::Lagged(_)) => {
                    *self = Self::open(self.app.clone(), Some(&self.last)).await.ok()?;
                }
                Err(RecvError::Closed) => return None,
            }
        }
    }
}

async fn snapshot(app: &App, id: &str) -> Result<sse::Event, Problem> {
    let asked = app.clone();
    let state = blocking(move || {
        let desk = &asked.desk;
        let session = desk.current();
        // What cannot be read is not worth losing the events for; whoever asks for the session is told why.
        let about = session.as_deref().and_then(|name| desk.summary(name).ok());
        let last_pair = session.as_deref().and_then(|name| {
            let attempts = desk.attempts(name).ok()?;
            PairBody::new(name, attempts.last_key_value()?.1)
        });
        Ok(StateBody {
            version: env!("CARGO_PKG_VERSION"),
            devices: desk.devices().into(),
            session,
            about: about.map(Into::into),
            last_pair,
            jobs: desk.queue().list().into_iter().take(USUAL).map(Into::into).collect(),
            prompt: desk.prompt(),
            sequences: desk.sequences().into_iter().map(Into::into).collect(),
            studio: asked.studio.as_ref().map(|s| s.describe()),
        })
    });
    sse::Event::default().event("state").id(id).json_data(&state.await?).map_err(Problem::internal)
}

/// An event on the wire: jobs as the jobs routes show them, everything else as it was told.
fn message(event: &Event, id: &str) -> Result<sse::Event, axum::Error> {
    sse::Event::default()
        .event(event.topic.name())
        .id(id)
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
        let url = job.get("id").and_then(Value::as_u64).map(links::job);
        job.insert("url".into(), json!(url));
    }
    data
}
