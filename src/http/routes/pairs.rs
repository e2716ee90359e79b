//! Pairs: taking them, listing them, looking at them.

use super::blocking;
use super::jobs::ordered;
use crate::capture::{DeskError, PairWish};
use crate::http::App;
use crate::http::extract::{Path, Query, Wishes};
use crate::http::idempotency::Key;
use crate::http::job_bodies::JobBody;
use crate::http::links;
use crate::http::paging::{Page, PageOrder};
use crate::http::pair_bodies::{PairBody, PairOrder};
use crate::http::problem::{Problem, ProblemBody};
use crate::pair::order::{OrderError, Slot};
use axum::Json;
use axum::extract::State;
use axum::http::{StatusCode, header};
use axum::response::{IntoResponse, Response};
use serde::Deserialize;
use utoipa::IntoParams;

/// The pairs of a session, ascending, each as the attempt that counts. `after` is the number of the last pair of the
/// page before.
#[utoipa::path(get, path = "/api/v1/sessions/{session}/pairs", tag = "capture",
    params(("session" = String, Path, description = "Name of the session", example = "birdbath"), PageOrder),
    responses((status = 200, body = Vec<PairBody>, headers(("Link" = String, description = "The next page, if any")))))]
pub(super) async fn list(
    State(app): State<App>,
    Path(session): Path<String>,
    Query(page): Query<PageOrder>,
) -> Result<Page<PairBody>, Problem> {
    let (desk, name) = (app.desk.clone(), session.clone());
    let pairs = blocking(move || {
        let attempts = desk.attempts(&name)?;
        Ok(attempts.values().filter_map(|attempts| PairBody::new(&name, attempts)).collect::<Vec<_>>())
    });
    let at = format!("{}/pairs", links::session(&session));
    page.of(pairs.await?, |pair: &PairBody| u64::from(pair.number), |number, after| number > after, &at)
}

/// One pair.
#[utoipa::path(get, path = "/api/v1/sessions/{session}/pairs/{number}", tag = "capture",
    params(("session" = String, Path, description = "Name of the session", example = "birdbath"),
        ("number" = u32, Path, description = "Number of the pair", example = 1)),
    responses((status = 200, body = PairBody)))]
pub(super) async fn one(
    State(app): State<App>,
    Path((session, number)): Path<(String, u32)>,
) -> Result<Json<PairBody>, Problem> {
    blocking(move || {
        let attempts = app.desk.attempts_at(&session, number)?;
        let missing = || DeskError::NoSuchPair { session: session.clone(), number };
        Ok(Json(PairBody::new(&session, &attempts).ok_or_else(missing)?))
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
/// job well done; its `result` tells the verdict. With `again`, a rejected pair is shot once more under its own number.
#[utoipa::path(post, path = "/api/v1/pairs", tag = "capture",
    params(When, ("Idempotency-Key" = Option<String>, Header, description = "One wish, one job, however often it is sent")),
    request_body(content = Option<PairOrder>, description = "May be empty"),
    responses(
        (status = 202, description = "queued", body = JobBody,
            headers(("Location" = String), ("Idempotency-Replayed" = Option<String>))),
        (status = 200, description = "ended (`wait=true`)", body = JobBody),
        (status = 404, description = "`session_not_found`", body = ProblemBody,
            content_type = "application/problem+json"),
        (status = 409, description = "`session_locked`, `session_too_new`, `folder_not_empty`, or `pair_accepted` (it cannot be shot again)", body = ProblemBody,
            content_type = "application/problem+json")))]
pub(super) async fn take(
    State(app): State<App>,
    Query(when): Query<When>,
    key: Key,
    Wishes(order): Wishes<PairOrder>,
) -> Result<Response, Problem> {
    let wish = PairWish { order: order.order, off_frames: order.off_frames, again: order.again };
    let named = order.session.clone();
    let job = ordered(&app, key.with(&order)?, move |desk| desk.take_pair(named.as_deref(), wish)).await?;
    if when.wait { job.ended(&app).await } else { Ok(job.into_response()) }
}

/// One of a pair's frames: `off`, `on`, and where there are more `off-2`, `after` and so on.
#[derive(Clone, Copy, Deserialize, utoipa::ToSchema)]
#[schema(value_type = String, example = "off")]
pub(in crate::http) struct FrameName(pub(super) Slot);

/// One of a pair's pictures: a frame, or `known`.
#[derive(Clone, Copy, Deserialize)]
#[serde(try_from = "String")]
pub(super) enum PictureName {
    Frame(Slot),
    Known,
}

impl TryFrom<String> for PictureName {
    type Error = OrderError;

    fn try_from(name: String) -> Result<Self, OrderError> {
        if name == "known" { Ok(Self::Known) } else { name.parse().map(Self::Frame) }
    }
}

/// Which making of a picture is meant.
#[derive(Deserialize, IntoParams)]
#[into_params(parameter_in = Query)]
pub(super) struct Making {
    /// As the pair names it: a picture with its `of` never changes and may be kept.
    of: Option<String>,
}

/// A small JPEG of a frame, or of the light that the flash alone threw. Made after the pair was accepted, else when
/// it is first asked for.
#[utoipa::path(get, path = "/api/v1/sessions/{session}/pairs/{number}/{frame}/thumbnail.jpg", tag = "capture",
    params(("session" = String, Path, description = "Name of the session", example = "birdbath"),
        ("number" = u32, Path, description = "Number of the pair", example = 1),
        ("frame" = String, Path, example = "known",
            description = "`off`, `on`, `off-2`, `after` and so on, or `known`, the light that the flash alone threw"), Making),
    responses((status = 200, body = Vec<u8>, content_type = "image/jpeg"),
        (status = 422, description = "`frame_unreadable`", body = ProblemBody, content_type = "application/problem+json")))]
pub(super) async fn thumbnail(
    State(app): State<App>,
    Path((session, number, frame)): Path<(String, u32, PictureName)>,
    Query(making): Query<Making>,
) -> Result<Response, Problem> {
    let (file, present) = blocking(move || {
        // The frame is that of the picture, whatever is shot meanwhile.
        let (file, shown) = match frame {
            PictureName::Frame(slot) => app.desk.thumbnail(&session, number, slot)?,
            PictureName::Known => app.desk.known_light(&session, number)?,
        };
        Ok((file, links::making(&shown.blake3)))
    })
    .await?;
    let bytes = tokio::fs::read(&file).await.map_err(Problem::internal)?;
    // Originals never change, and so neither does this; but the pair may be shot again, and then its pictures are others.
    let kept = if making.of == Some(present) { "private, max-age=31536000, immutable" } else { "no-cache" };
    Ok(([(header::CONTENT_TYPE, "image/jpeg"), (header::CACHE_CONTROL, kept)], bytes).into_response())
}

/// The operator has done what he was asked (switched the flash off or on).
#[utoipa::path(post, path = "/api/v1/confirm", tag = "capture",
    responses((status = 204, description = "taken"),
        (status = 409, description = "`nothing_asked`", body = ProblemBody, content_type = "application/problem+json")))]
pub(super) async fn confirm(State(app): State<App>) -> Result<StatusCode, Problem> {
    if app.desk.confirm() {
        Ok(StatusCode::NO_CONTENT)
    } else {
        Err(Problem::new(StatusCode::CONFLICT, "nothing_asked", "nothing is asked at the moment"))
    }
}
