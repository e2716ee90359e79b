//! The HTTP face: routes, events, page, OpenAPI. No logic: a handler translates a request into one call of
//! the [`Desk`] and its answer back.
//!
//! [`serve`] takes a listener and a shutdown signal that the caller owns, so that tests listen on port 0.
//! What takes time becomes a job and is answered with 202; a client that leaves changes nothing. Errors are
//! problem+json (see `problem.rs`); who may ask at all is decided in `guard.rs`.

mod bodies;
mod camera_bodies;
mod flash_bodies;
mod guard;
mod page;
mod problem;
mod routes;

pub use bodies::{StageOrder, StudioBody};
pub use guard::{NotLoopback, loopback_only};

use crate::capture::Desk;
use axum::Router;
use axum::routing::get;
use std::future::Future;
use std::sync::Arc;
use std::time::Duration;
use tokio::net::TcpListener;
use tokio::sync::watch;
use utoipa::OpenApi;
use utoipa_axum::router::OpenApiRouter;

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
    /// Turns true when the program is about to end: streams end then.
    closing: watch::Receiver<bool>,
}

#[derive(OpenApi)]
#[openapi(
    info(
        title = "unlit",
        description = "Takes the light out of photographed objects: pairs, calibration, processing. \
                       Answers loopback only. Errors are `application/problem+json` with a stable `code`.",
        license(name = "MIT OR Apache-2.0", identifier = "MIT OR Apache-2.0")
    ),
    tags(
        (name = "capture", description = "Devices, sessions, pairs"),
        (name = "processing", description = "Scene, calibration, model, jobs"),
        (name = "events", description = "What happens, as it happens"),
        (name = "studio", description = "The simulated studio (`unlit serve --studio`)"),
    )
)]
struct Document;

fn api() -> OpenApiRouter<App> {
    OpenApiRouter::with_openapi(Document::openapi()).merge(routes::all())
}

/// The OpenAPI document, pretty JSON with a newline at its end, as `docs/openapi.json` holds it.
pub fn openapi() -> Result<String, serde_json::Error> {
    // `{*path}` is axum's way to say that a parameter may hold slashes; OpenAPI has none.
    Ok(api().into_openapi().to_pretty_json()?.replace("/{*path}", "/{path}") + "\n")
}

/// Answers on `listener` until `shutdown` resolves; then lets running answers end and returns.
pub async fn serve(
    listener: TcpListener,
    desk: Desk,
    studio: Option<Arc<dyn StudioControl>>,
    shutdown: impl Future<Output = ()> + Send + 'static,
) -> std::io::Result<()> {
    let (close, closing_at) = watch::channel(false);
    let closing = closing_at.clone();
    let (routes, _document) = api().split_for_parts();
    let router = Router::new()
        .route("/", get(page::index))
        .route("/assets/{file}", get(page::file))
        .merge(routes)
        .fallback(routes::nothing_here)
        .method_not_allowed_fallback(routes::wrong_method)
        .layer(axum::middleware::from_fn(guard::guard))
        .with_state(App { desk, studio, closing });
    let mut ending = closing_at.clone();
    let answering = axum::serve(listener, router).with_graceful_shutdown(async move {
        shutdown.await;
        close.send_replace(true);
    });
    tokio::select! {
        ended = answering => ended,
        () = async {
            // An error says that the sender is gone: then there is nothing left to wait for.
            drop(ending.wait_for(|closing| *closing).await);
            tokio::time::sleep(LAST_ANSWERS).await;
        } => Ok(()),
    }
}
