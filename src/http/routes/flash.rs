//! The flash over a session.

use super::jobs::accepted;
use super::{blocking, wishes};
use crate::http::App;
use crate::http::bodies::JobBody;
use crate::http::flash_bodies::{FlashAccountBody, RepeatabilityOrder};
use crate::http::problem::{Problem, ProblemBody};
use axum::Json;
use axum::body::Bytes;
use axum::extract::{Path, State};
use axum::response::Response;

/// What the session's pairs tell of the flash: the proof of each frame, energies, trend and advice.
#[utoipa::path(get, path = "/api/v1/sessions/{session}/flash", tag = "capture",
    params(("session" = String, Path, description = "Name of the session")),
    responses((status = 200, body = FlashAccountBody),
        (status = 404, body = ProblemBody, content_type = "application/problem+json")))]
pub(super) async fn account(
    State(app): State<App>,
    Path(session): Path<String>,
) -> Result<Json<FlashAccountBody>, Problem> {
    Ok(Json(blocking(move || app.desk.flash_account(&session)).await?.into()))
}

/// Shoots a plain surface again and again with nothing changed, and tells how steady the known light is, before and
/// after division by the measured energy. Only figures are kept. Needs a flash controller.
#[utoipa::path(post, path = "/api/v1/sessions/{session}/repeatability", tag = "capture",
    params(("session" = String, Path, description = "Name of the session")),
    request_body(content = Option<RepeatabilityOrder>, description = "May be empty"),
    responses((status = 202, body = JobBody, headers(("Location" = String))),
        (status = 400, body = ProblemBody, content_type = "application/problem+json"),
        (status = 404, body = ProblemBody, content_type = "application/problem+json")))]
pub(super) async fn repeatability(
    State(app): State<App>,
    Path(session): Path<String>,
    body: Bytes,
) -> Result<Response, Problem> {
    let order: RepeatabilityOrder = wishes(&body)?;
    Ok(accepted(blocking(move || app.desk.take_repeatability(&session, order.shots)).await?))
}
