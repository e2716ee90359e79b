//! Pairs: taking them, listing them, looking at them.

use super::jobs::{accepted, ended};
use super::{blocking, wishes};
use crate::capture::Frame;
use crate::http::App;
use crate::http::bodies::{JobBody, PairBody, PairOrder};
use crate::http::problem::{Problem, ProblemBody};
use axum::Json;
use axum::body::Bytes;
use axum::extract::rejection::{PathRejection, QueryRejection};
use axum::extract::{Path, Query, State};
use axum::http::{StatusCode, header};
use axum::response::{IntoResponse, Response};
use serde::Deserialize;
use utoipa::IntoParams;

/// All pairs of a session, ascending.
#[utoipa::path(get, path = "/api/v1/sessions/{session}/pairs", tag = "capture",
    params(("session" = String, Path, description = "Name of the session")),
    responses((status = 200, body = Vec<PairBody>),
        (status = 404, body = ProblemBody, content_type = "application/problem+json")))]
pub(super) async fn list(
    State(app): State<App>,
    Path(session): Path<String>,
) -> Result<Json<Vec<PairBody>>, Problem> {
    blocking(move || {
        let pairs = app.desk.session(&session)?.pairs()?;
        Ok(Json(pairs.into_iter().map(|pair| PairBody::new(&session, pair)).collect()))
    })
    .await
}

/// When to answer.
#[derive(Deserialize, IntoParams)]
#[into_params(parameter_in = Query)]
pub(super) struct When {
    /// Answer only once the pair is stored, rejected or has failed.
    #[serde(default)]
    wait: bool,
}

/// Takes one pair: the job is answered at once, or with `wait=true` when it has ended. A rejected pair is a
/// job well done; its `result` tells the verdict.
#[utoipa::path(post, path = "/api/v1/pairs", tag = "capture", params(When),
    request_body(content = Option<PairOrder>, description = "May be empty"),
    responses(
        (status = 202, description = "queued", body = JobBody, headers(("Location" = String))),
        (status = 200, description = "ended (`wait=true`)", body = JobBody),
        (status = 400, body = ProblemBody, content_type = "application/problem+json"),
        (status = 404, body = ProblemBody, content_type = "application/problem+json"),
        (status = 503, body = ProblemBody, content_type = "application/problem+json")))]
pub(super) async fn take(
    State(app): State<App>,
    when: Result<Query<When>, QueryRejection>,
    body: Bytes,
) -> Result<Response, Problem> {
    let Query(when) = when?;
    let order: PairOrder = wishes(&body)?;
    let desk = app.desk.clone();
    let job = blocking(move || desk.take_pair(order.session.as_deref())).await?;
    if when.wait {
        Ok(Json(JobBody::from(ended(&app, job).await?)).into_response())
    } else {
        Ok(accepted(job))
    }
}

/// One of a pair's frames.
#[derive(Clone, Copy, Deserialize, utoipa::ToSchema)]
#[serde(rename_all = "snake_case")]
pub(super) enum FrameName {
    /// Without flash.
    Off,
    /// With flash.
    On,
}

impl From<FrameName> for Frame {
    fn from(name: FrameName) -> Self {
        match name {
            FrameName::Off => Frame::Off,
            FrameName::On => Frame::On,
        }
    }
}

/// A small JPEG of a frame, made from the raw when it is first asked for.
#[utoipa::path(get, path = "/api/v1/sessions/{session}/pairs/{number}/{frame}/thumbnail.jpg", tag = "capture",
    params(("session" = String, Path, description = "Name of the session"),
        ("number" = u32, Path, description = "Number of the pair"),
        ("frame" = FrameName, Path, description = "`off` or `on`")),
    responses((status = 200, body = Vec<u8>, content_type = "image/jpeg"),
        (status = 404, body = ProblemBody, content_type = "application/problem+json"),
        (status = 422, body = ProblemBody, content_type = "application/problem+json")))]
pub(super) async fn thumbnail(
    State(app): State<App>,
    path: Result<Path<(String, u32, FrameName)>, PathRejection>,
) -> Result<Response, Problem> {
    let Path((session, number, frame)) = path?;
    let file = blocking(move || app.desk.thumbnail(&session, number, frame.into())).await?;
    let bytes = tokio::fs::read(&file).await.map_err(Problem::internal)?;
    // A pair's originals never change, and so neither does this.
    let kept = "private, max-age=31536000, immutable";
    Ok(([(header::CONTENT_TYPE, "image/jpeg"), (header::CACHE_CONTROL, kept)], bytes).into_response())
}

/// The operator has done what he was asked (switched the flash off or on).
#[utoipa::path(post, path = "/api/v1/confirm", tag = "capture",
    responses((status = 204, description = "taken"),
        (status = 409, body = ProblemBody, content_type = "application/problem+json")))]
pub(super) async fn confirm(State(app): State<App>) -> Result<StatusCode, Problem> {
    if app.desk.confirm() {
        Ok(StatusCode::NO_CONTENT)
    } else {
        Err(Problem::new(StatusCode::CONFLICT, "nothing_asked", "nothing is asked at the moment"))
    }
}
