//! Whether a session is still what was stored.

use super::blocking;
use super::jobs::accepted;
use crate::http::App;
use crate::http::extract::Path;
use crate::http::job_bodies::JobBody;
use crate::http::problem::Problem;
use axum::extract::State;
use axum::response::Response;

/// Reads every original, calibration result and scene file of a session again and compares it with its checksum. The
/// job's `result` says whether the session is `whole`, how many `pairs`, `calibration_shots`, `originals`, `bytes` and
/// `kept` files (results, scene) were found as they were stored, and names under `findings` what is not: its `path`, the
/// `damage` (`missing`, `altered`, `unreadable`; `unknown` does no harm) and `why`.
#[utoipa::path(post, path = "/api/v1/sessions/{session}/verify", tag = "capture",
    params(("session" = String, Path, description = "Name of the session")),
    responses((status = 202, body = JobBody, headers(("Location" = String)))))]
pub(super) async fn verify(State(app): State<App>, Path(session): Path<String>) -> Result<Response, Problem> {
    Ok(accepted(blocking(move || app.desk.verify(&session)).await?))
}
