//! Calibrations, guided: how each stands, its shots, its fit.

use super::blocking;
use super::jobs::{accepted, ordered};
use crate::calibration::guide::Kind;
use crate::http::App;
use crate::http::calibration_bodies::{CalibrationBody, CalibrationKind, CalibrationShotBody};
use crate::http::calibration_orders::{CalibrationOrder, CalibrationShotForm, CalibrationShotOrder, Fit};
use crate::http::extract::{Either, Path, Wishes};
use crate::http::idempotency::Key;
use crate::http::job_bodies::JobBody;
use crate::http::problem::{Problem, ProblemBody};
use crate::http::staging;
use axum::Json;
use axum::extract::State;
use axum::http::StatusCode;
use axum::response::{IntoResponse, Response};
use serde_json::Value;

/// How all of a session's calibrations stand, in the order in which they are best made: what to shoot, the shots
/// that wait, and what was measured.
#[utoipa::path(get, path = "/api/v1/sessions/{session}/calibration", tag = "processing",
    params(("session" = String, Path, description = "Name of the session", example = "birdbath")),
    responses((status = 200, body = Vec<CalibrationBody>)))]
pub(super) async fn list(
    State(app): State<App>,
    Path(session): Path<String>,
) -> Result<Json<Vec<CalibrationBody>>, Problem> {
    blocking(move || {
        let states = app.desk.calibrations(&session)?;
        Ok(Json(states.into_iter().map(|state| CalibrationBody::new(&session, state)).collect()))
    })
    .await
}

/// What was measured, with all that it holds: figures with their errors, residuals, shots, verdict.
#[utoipa::path(get, path = "/api/v1/sessions/{session}/calibration/{kind}", tag = "processing",
    params(("session" = String, Path, description = "Name of the session", example = "birdbath"),
        ("kind" = CalibrationKind, Path, description = "Which calibration")),
    responses((status = 200, description = "the record as it is kept", body = Value),
        (status = 404, description = "`session_not_found` or `calibration_not_measured`", body = ProblemBody,
            content_type = "application/problem+json")))]
pub(super) async fn record(
    State(app): State<App>,
    Path((session, kind)): Path<(String, CalibrationKind)>,
) -> Result<Json<Value>, Problem> {
    Ok(Json(blocking(move || app.desk.calibration(&session, kind.into())).await?))
}

/// Takes a shot for a calibration. With JSON or nothing, the camera shoots as it stands (a job): a frame without flash; of
/// the colour chart and of steadiness lit by the flash; of the card, one without and one with flash. A form brings raw files
/// instead; one that is there already is not taken twice.
#[utoipa::path(post, path = "/api/v1/sessions/{session}/calibration/{kind}/shots", tag = "processing",
    params(("session" = String, Path, description = "Name of the session", example = "birdbath"),
        ("kind" = CalibrationKind, Path, description = "For which calibration"),
        ("Idempotency-Key" = Option<String>, Header, description = "One wish, one job, however often it is sent")),
    request_body(content((Option<CalibrationShotOrder> = "application/json"), (CalibrationShotForm = "multipart/form-data"))),
    responses((status = 202, description = "the camera will shoot", body = JobBody, headers(("Location" = String), ("Idempotency-Replayed" = Option<String>))),
        (status = 201, description = "the files wait for the fit", body = Vec<CalibrationShotBody>),
        (status = 409, description = "`shot_twice` (it waits in another role), `disk_full`, `session_locked` or `session_too_new`",
            body = ProblemBody, content_type = "application/problem+json"),
        (status = 422, description = "`body_invalid`, `idempotency_key_reused`, or `frame_unreadable`: no raw file that can be decoded",
            body = ProblemBody, content_type = "application/problem+json"),
        (status = 429, description = "`uploads_busy`: two others are coming in; or too many jobs wait, `queue_full`. \
            `Retry-After` says when to ask again.", body = ProblemBody, content_type = "application/problem+json")))]
pub(super) async fn shoot(
    State(app): State<App>,
    Path((session, kind)): Path<(String, CalibrationKind)>,
    key: Key,
    shot: Either<CalibrationShotOrder>,
) -> Result<Response, Problem> {
    let kind = Kind::from(kind);
    let form = match shot {
        Either::Wishes(order) => {
            let wish = key.with(&order)?;
            let order = order.of(kind);
            let asked = ordered(&app, wish, move |desk| desk.take_calibration_shot(&session, order));
            return Ok(asked.await?.into_response());
        }
        Either::Form(form) => form,
    };
    // Before anything of it is taken.
    let (desk, name) = (app.desk.clone(), session.clone());
    blocking(move || desk.session(&name).map(drop)).await?;
    let Ok(_place) = app.uploads.try_acquire() else {
        let words =
            format!("{} uploads are coming in already; send this one when they are here", staging::AT_ONCE);
        return Err(Problem::new(StatusCode::TOO_MANY_REQUESTS, "uploads_busy", words));
    };
    let frames = staging::stage_frames(form, &app.desk.own_folder()).await?;
    let shots = blocking(move || {
        let shots = app.desk.add_calibration_frames(&session, kind, &frames)?;
        Ok(shots.into_iter().map(|shot| CalibrationShotBody::new(&session, shot)).collect::<Vec<_>>())
    });
    Ok((StatusCode::CREATED, Json(shots.await?)).into_response())
}

/// Removes a shot that waits for its fit.
#[utoipa::path(delete, path = "/api/v1/sessions/{session}/calibration/{kind}/shots/{shot}", tag = "processing",
    params(("session" = String, Path, description = "Name of the session", example = "birdbath"),
        ("kind" = CalibrationKind, Path, description = "Of which calibration"),
        ("shot" = String, Path, description = "Id of the shot", example = "1")),
    responses((status = 204, description = "removed"),
        (status = 404, description = "`session_not_found` or `shot_not_found`", body = ProblemBody,
            content_type = "application/problem+json"),
        (status = 409, description = "`shot_in_use` (the calibration comes from it), `session_locked` or `session_too_new`",
            body = ProblemBody, content_type = "application/problem+json")))]
pub(super) async fn remove(
    State(app): State<App>,
    Path((session, kind, shot)): Path<(String, CalibrationKind, String)>,
) -> Result<StatusCode, Problem> {
    blocking(move || app.desk.remove_calibration_shot(&session, kind.into(), &shot)).await?;
    Ok(StatusCode::NO_CONTENT)
}

/// Fits a calibration to the shots that wait for it (a job; its `result` is the record). If it can be relied on, the
/// shots become the record's; else they wait on, for others to be added.
#[utoipa::path(post, path = "/api/v1/sessions/{session}/calibration/{kind}", tag = "processing",
    params(("session" = String, Path, description = "Name of the session", example = "birdbath"),
        ("kind" = CalibrationKind, Path, description = "Which calibration")),
    request_body(content = Option<CalibrationOrder>, description = "May be empty but for the flash"),
    responses((status = 202, body = JobBody, headers(("Location" = String))),
        (status = 409, description = "`inputs_missing`, `session_locked` or `session_too_new`", body = ProblemBody, content_type = "application/problem+json")))]
pub(super) async fn calibrate(
    State(app): State<App>,
    Path((session, kind)): Path<(String, CalibrationKind)>,
    Wishes(order): Wishes<CalibrationOrder>,
) -> Result<Response, Problem> {
    let fit = order.of(kind.into()).map_err(|words| Problem::bad_request("value_invalid", words))?;
    let ordered = blocking(move || match fit {
        Fit::Flash(order) => app.desk.calibrate_flash(&session, order),
        Fit::Other(order) => app.desk.calibrate(&session, order),
    });
    Ok(accepted(ordered.await?))
}
