//! The flash over a session.

use super::blocking;
use crate::http::App;
use crate::http::flash_bodies::FlashAccountBody;
use crate::http::problem::{Problem, ProblemBody};
use axum::Json;
use axum::extract::{Path, State};

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
