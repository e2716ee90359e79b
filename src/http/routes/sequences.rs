//! Sequences of positions: planning, directing, looking at them.

use super::blocking;
use crate::capture::SequenceError;
use crate::http::App;
use crate::http::extract::{Json as Asked, Path, Wishes};
use crate::http::problem::{Problem, ProblemBody};
use crate::http::sequence_bodies::{SequenceBody, SequencePlanBody, SequenceWish, SequenceWord};
use axum::Json;
use axum::extract::State;
use axum::http::StatusCode;

/// The table from a sequence's errors to status and code.
pub(super) fn answer_to(error: &SequenceError) -> (StatusCode, &'static str) {
    match error {
        SequenceError::NotPlanned(_) => (StatusCode::NOT_FOUND, "sequence_not_planned"),
        SequenceError::BadPlan(_) => (StatusCode::BAD_REQUEST, "value_invalid"),
        SequenceError::Refused { .. } => (StatusCode::CONFLICT, "sequence_state"),
        SequenceError::Elsewhere { .. } => (StatusCode::CONFLICT, "sequence_position"),
        SequenceError::Unfinished { .. } => (StatusCode::CONFLICT, "sequence_unfinished"),
        SequenceError::Session(error) => super::of_session(error),
    }
}

/// How a session's sequence stands.
#[utoipa::path(get, path = "/api/v1/sessions/{session}/sequence", tag = "capture",
    params(("session" = String, Path, description = "Name of the session")),
    responses((status = 200, body = SequenceBody),
        (status = 404, description = "`session_not_found`, `sequence_not_planned`", body = ProblemBody,
            content_type = "application/problem+json"),
        (status = 409, description = "`session_locked`, `session_too_new`", body = ProblemBody,
            content_type = "application/problem+json")))]
pub(super) async fn state(
    State(app): State<App>,
    Path(session): Path<String>,
) -> Result<Json<SequenceBody>, Problem> {
    Ok(Json(blocking(move || app.desk.sequence(&session)).await?.into()))
}

/// Plans a session's sequence; nothing is taken before its start. A plan of as many positions changes how a
/// sequence that is planned or paused goes on.
#[utoipa::path(put, path = "/api/v1/sessions/{session}/sequence", tag = "capture",
    params(("session" = String, Path, description = "Name of the session")),
    request_body = SequencePlanBody,
    responses((status = 201, description = "a new sequence", body = SequenceBody),
        (status = 200, description = "goes on otherwise", body = SequenceBody),
        (status = 400, description = "`value_invalid`, `body_invalid`", body = ProblemBody,
            content_type = "application/problem+json"),
        (status = 404, description = "`session_not_found`", body = ProblemBody,
            content_type = "application/problem+json"),
        (status = 409, description = "`sequence_state` (pause or cancel it first), `sequence_unfinished` (some of \
            another number of positions are done: delete it first), `session_locked`, `session_too_new`, `disk_full`", body = ProblemBody,
            content_type = "application/problem+json")))]
pub(super) async fn plan(
    State(app): State<App>,
    Path(session): Path<String>,
    Asked(plan): Asked<SequencePlanBody>,
) -> Result<(StatusCode, Json<SequenceBody>), Problem> {
    let (view, made) = blocking(move || app.desk.plan_sequence(&session, plan.into())).await?;
    let status = if made { StatusCode::CREATED } else { StatusCode::OK };
    Ok((status, Json(view.into())))
}

/// Removes a session's sequence; its pairs stay.
#[utoipa::path(delete, path = "/api/v1/sessions/{session}/sequence", tag = "capture",
    params(("session" = String, Path, description = "Name of the session")),
    responses((status = 204, description = "removed"),
        (status = 404, description = "`session_not_found`, `sequence_not_planned`", body = ProblemBody,
            content_type = "application/problem+json"),
        (status = 409, description = "`sequence_state` (a pair is being taken), `session_locked`, `session_too_new`",
            body = ProblemBody, content_type = "application/problem+json")))]
pub(super) async fn remove(
    State(app): State<App>,
    Path(session): Path<String>,
) -> Result<StatusCode, Problem> {
    blocking(move || app.desk.remove_sequence(&session)).await?;
    Ok(StatusCode::NO_CONTENT)
}

/// Tells a sequence to start, pause, resume, take the next pair, retry, skip a position or cancel. The answer is how
/// it then stands; pairs are jobs like any other, and `sequence` events tell what comes of them.
#[utoipa::path(post, path = "/api/v1/sessions/{session}/sequence/{wish}", tag = "capture",
    params(("session" = String, Path, description = "Name of the session"),
        ("wish" = SequenceWish, Path, description = "What it is to do")),
    request_body(content = Option<SequenceWord>, description = "May be empty"),
    responses((status = 200, body = SequenceBody),
        (status = 400, description = "`path_invalid`, `body_invalid`", body = ProblemBody,
            content_type = "application/problem+json"),
        (status = 404, description = "`session_not_found`, `sequence_not_planned`", body = ProblemBody,
            content_type = "application/problem+json"),
        (status = 409, description = "`sequence_state` (not as it stands), `sequence_position` (it is elsewhere), \
            `session_locked`, `session_too_new`, `disk_full`", body = ProblemBody,
            content_type = "application/problem+json")))]
pub(super) async fn direct(
    State(app): State<App>,
    Path((session, wish)): Path<(String, SequenceWish)>,
    Wishes(word): Wishes<SequenceWord>,
) -> Result<Json<SequenceBody>, Problem> {
    let view = blocking(move || app.desk.direct_sequence(&session, wish.into(), word.position)).await?;
    Ok(Json(view.into()))
}
