//! The flash over a session.

use super::blocking;
use super::jobs::{Ordered, ordered};
use crate::http::App;
use crate::http::extract::{Path, Wishes};
use crate::http::flash_bodies::{FlashAccountBody, RepeatabilityOrder};
use crate::http::idempotency::Key;
use crate::http::job_bodies::JobBody;
use crate::http::problem::Problem;
use axum::Json;
use axum::extract::State;

/// What the session's pairs tell of the flash: the proof of each frame, energies, trend and advice.
#[utoipa::path(get, path = "/api/v1/sessions/{session}/flash", tag = "capture",
    params(("session" = String, Path, description = "Name of the session", example = "birdbath")),
    responses((status = 200, body = FlashAccountBody)))]
pub(super) async fn account(
    State(app): State<App>,
    Path(session): Path<String>,
) -> Result<Json<FlashAccountBody>, Problem> {
    Ok(Json(blocking(move || app.desk.flash_account(&session)).await?.into()))
}

/// Shoots a plain surface again and again with nothing changed, and tells how steady the known light is, before and
/// after division by the measured energy. Only figures are kept. Needs a flash controller.
#[utoipa::path(post, path = "/api/v1/sessions/{session}/repeatability", tag = "capture",
    params(("session" = String, Path, description = "Name of the session", example = "birdbath"),
        ("Idempotency-Key" = Option<String>, Header, description = "One wish, one job, however often it is sent")),
    request_body(content = Option<RepeatabilityOrder>, description = "May be empty"),
    responses((status = 202, body = JobBody, headers(("Location" = String), ("Idempotency-Replayed" = Option<String>)))))]
pub(super) async fn repeatability(
    State(app): State<App>,
    Path(session): Path<String>,
    key: Key,
    Wishes(order): Wishes<RepeatabilityOrder>,
) -> Result<Ordered, Problem> {
    let shots = order.shots;
    ordered(&app, key.with(&order)?, move |desk| desk.take_repeatability(&session, shots)).await
}
