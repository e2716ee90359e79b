//! Devices and sessions.

use super::blocking;
use crate::http::App;
use crate::http::bodies::{DevicesBody, NewSession, SessionBody};
use crate::http::extract;
use crate::http::extract::Path;
use crate::http::problem::{Problem, ProblemBody};
use axum::Json;
use axum::extract::State;
use axum::http::StatusCode;

/// Looks for camera and flash and says how they stand. While a pair is being shot: as last seen.
#[utoipa::path(get, path = "/api/v1/devices", tag = "capture",
    responses((status = 200, body = DevicesBody)))]
pub(super) async fn devices(State(app): State<App>) -> Result<Json<DevicesBody>, Problem> {
    Ok(Json(blocking(move || Ok(app.desk.look())).await?.into()))
}

/// All sessions of the sessions folder.
#[utoipa::path(get, path = "/api/v1/sessions", tag = "capture",
    responses((status = 200, body = Vec<SessionBody>)))]
pub(super) async fn list(State(app): State<App>) -> Result<Json<Vec<SessionBody>>, Problem> {
    let all = blocking(move || app.desk.summaries()).await?;
    Ok(Json(all.into_iter().map(Into::into).collect()))
}

/// Makes a session, or opens it if it is there; new pairs go there from now on.
#[utoipa::path(post, path = "/api/v1/sessions", tag = "capture", request_body = NewSession,
    responses(
        (status = 201, description = "made", body = SessionBody),
        (status = 200, description = "was there", body = SessionBody),
        (status = 409, body = ProblemBody, content_type = "application/problem+json")))]
pub(super) async fn enter(
    State(app): State<App>,
    extract::Json(order): extract::Json<NewSession>,
) -> Result<(StatusCode, Json<SessionBody>), Problem> {
    blocking(move || {
        let (_, made) = app.desk.enter(&order.name)?;
        let status = if made { StatusCode::CREATED } else { StatusCode::OK };
        Ok((status, Json(app.desk.summary(&order.name)?.into())))
    })
    .await
}

/// One session.
#[utoipa::path(get, path = "/api/v1/sessions/{session}", tag = "capture",
    params(("session" = String, Path, description = "Name of the session", example = "birdbath")),
    responses((status = 200, body = SessionBody)))]
pub(super) async fn one(
    State(app): State<App>,
    Path(session): Path<String>,
) -> Result<Json<SessionBody>, Problem> {
    Ok(Json(blocking(move || app.desk.summary(&session)).await?.into()))
}
