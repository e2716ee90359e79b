//! The HTTP face: routes, events, page, OpenAPI. No logic: a handler translates a request into one call of
//! the [`Desk`] and its answer back.
//!
//! [`serve`] takes a listener and a shutdown signal that the caller owns, so that tests listen on port 0.
//! What takes time becomes a job and is answered with 202; a client that leaves changes nothing. Errors are
//! problem+json (see `problem.rs`). A request's way: `listen` (how many, how slow), `guard` and `door` (who may
//! ask), `intake` (what bodies may be like), a handler.

mod bodies;
mod calibration_bodies;
mod calibration_orders;
mod camera_bodies;
mod caught;
mod document;
mod door;
mod extract;
mod file_bodies;
mod flash_bodies;
mod guard;
mod idempotency;
mod intake;
mod job_bodies;
mod links;
mod listen;
mod mirror_body;
mod page;
mod paging;
mod pair_bodies;
mod pairing;
mod pairing_bodies;
mod problem;
mod ranges;
mod routes;
mod sequence_bodies;
mod staging;
mod studio_bodies;
mod trace;
mod vitals;

pub use door::{Door, DoorError, Patience, Token, TokenError};
pub use listen::connections_that_fit;
pub use studio_bodies::{StageOrder, StudioBody};

use crate::capture::Desk;
use axum::Router;
use axum::body::Bytes;
use axum::http::header::CONTENT_TYPE;
use axum::routing::get;
use std::future::Future;
use std::sync::Arc;
use std::time::Duration;
use tokio::net::TcpListener;
use tokio::sync::{Semaphore, watch};
use vitals::Vitals;

/// How long answers may still be under way after the signal to stop.
const LAST_ANSWERS: Duration = Duration::from_secs(10);

/// The simulated studio, as far as the page and scripts may direct it.
pub trait StudioControl: Send + Sync {
    /// How it stands.
    fn describe(&self) -> StudioBody;
    /// Moves the simulated operator; the error is a sentence.
    fn direct(&self, order: StageOrder) -> Result<(), String>;
}

/// What the handlers share.
#[derive(Clone)]
struct App {
    desk: Desk,
    studio: Option<Arc<dyn StudioControl>>,
    door: Arc<Door>,
    /// Places for uploads that come in.
    uploads: Arc<Semaphore>,
    /// Turns true when the program is about to end: streams end then.
    closing: watch::Receiver<bool>,
    vitals: Vitals,
}

/// The OpenAPI document, pretty JSON with a newline at its end, as `docs/openapi.json` holds it.
pub fn openapi() -> Result<String, serde_json::Error> {
    document::text(document::api().into_openapi())
}

/// Answers whom `door` lets in on `listener` until `shutdown` resolves; then lets running answers end and returns.
pub async fn serve(
    listener: TcpListener,
    desk: Desk,
    studio: Option<Arc<dyn StudioControl>>,
    door: Door,
    shutdown: impl Future<Output = ()> + Send + 'static,
) -> std::io::Result<()> {
    let (close, closing) = watch::channel(false);
    let (patience, door) = (door.patience, Arc::new(door));
    let (uploads, vitals) = (Arc::new(Semaphore::new(staging::AT_ONCE)), Vitals::start());
    let app = App { desk, studio, door: door.clone(), uploads, closing: closing.clone(), vitals };
    let (routes, document) = document::api().split_for_parts();
    let document = Bytes::from(document::text(document).map_err(std::io::Error::other)?);
    let router = Router::new()
        .route("/", get(page::index))
        .route("/assets/{file}", get(page::file))
        .route("/pairing/{file}", get(pairing::file))
        .route("/api/v1/openapi.json", get(async || ([(CONTENT_TYPE, "application/json")], document)))
        .merge(routes)
        .fallback(routes::nothing_here)
        .method_not_allowed_fallback(routes::wrong_method)
        .layer(axum::middleware::from_fn(caught::panics))
        .layer(axum::middleware::from_fn_with_state(door, guard::guard))
        .layer(axum::middleware::from_fn_with_state(app.clone(), trace::trace))
        .with_state(app);
    let mut answering = tokio::spawn(listen::answer(listener, router, patience, closing));
    tokio::select! {
        ended = &mut answering => return ended.map_err(std::io::Error::other),
        () = shutdown => {}
    }
    close.send_replace(true);
    match tokio::time::timeout(LAST_ANSWERS, &mut answering).await {
        Ok(ended) => ended.map_err(std::io::Error::other),
        Err(_) => {
            tracing::warn!("some answers did not end within {LAST_ANSWERS:?} and were broken off");
            answering.abort();
            Ok(())
        }
    }
}
