//! What processing needs, and processing itself. All of it becomes jobs.

use super::blocking;
use super::jobs::{Ordered, accepted, ordered};
use crate::http::App;
use crate::http::extract::{Form, Path};
use crate::http::idempotency::Key;
use crate::http::job_bodies::JobBody;
use crate::http::problem::{Problem, ProblemBody};
use crate::http::staging;
use axum::extract::State;
use axum::http::StatusCode;
use axum::response::Response;
use utoipa::ToSchema;

/// The scene's files.
#[derive(ToSchema)]
#[expect(dead_code, reason = "describes the form to OpenAPI; the parts are read one by one")]
pub(super) struct SceneForm {
    /// One BlocksExchange XML, or COLMAP's `cameras.txt` and `images.txt`.
    #[schema(value_type = Vec<String>, format = Binary)]
    cameras: Vec<Vec<u8>>,
    /// OBJ meshes, the object first.
    #[schema(value_type = Vec<String>, format = Binary)]
    mesh: Vec<Vec<u8>>,
    /// `m` (default), `cm` or `mm`.
    unit: Option<String>,
    /// Factor after the unit; 1 by default.
    scale: Option<f64>,
}

/// Imports cameras and meshes. Two uploads may come in at the same time.
#[utoipa::path(post, path = "/api/v1/sessions/{session}/scene", tag = "processing",
    params(("session" = String, Path, description = "Name of the session", example = "birdbath")),
    request_body(content = SceneForm, content_type = "multipart/form-data"),
    responses((status = 202, body = JobBody, headers(("Location" = String))),
        (status = 429, description = "`uploads_busy`: two others are coming in; or too many jobs wait, `queue_full`. \
            `Retry-After` says when to ask again.", body = ProblemBody, content_type = "application/problem+json")))]
pub(super) async fn import_scene(
    State(app): State<App>,
    Path(session): Path<String>,
    Form(form): Form,
) -> Result<Response, Problem> {
    // Before anything of it is taken.
    let (desk, name) = (app.desk.clone(), session.clone());
    blocking(move || desk.session(&name).map(drop)).await?;
    let Ok(_place) = app.uploads.try_acquire() else {
        let words =
            format!("{} scenes are coming in already; send this one when they are here", staging::AT_ONCE);
        return Err(Problem::new(StatusCode::TOO_MANY_REQUESTS, "uploads_busy", words));
    };
    let files = staging::stage(form, &app.desk.own_folder()).await?;
    Ok(accepted(blocking(move || app.desk.import_scene(&session, files)).await?))
}

/// Makes the model from everything that the session holds. Starts by itself after each accepted pair once
/// scene and calibration are there; this asks for it out of turn.
#[utoipa::path(post, path = "/api/v1/sessions/{session}/process", tag = "processing",
    params(("session" = String, Path, description = "Name of the session", example = "birdbath"),
        ("Idempotency-Key" = Option<String>, Header, description = "One wish, one job, however often it is sent")),
    responses((status = 202, body = JobBody, headers(("Location" = String), ("Idempotency-Replayed" = Option<String>))),
        (status = 409, description = "`inputs_missing`, `session_locked` or `session_too_new`", body = ProblemBody, content_type = "application/problem+json")))]
pub(super) async fn process(
    State(app): State<App>,
    Path(session): Path<String>,
    key: Key,
) -> Result<Ordered, Problem> {
    ordered(&app, key.with(&())?, move |desk| desk.process(&session)).await
}
