//! One file a subject. The path of each handler is written once, beside it.

mod calibration;
mod camera;
mod events;
mod files;
mod flash;
mod jobs;
mod pairing;
pub(super) mod pairs;
mod processing;
mod sequences;
mod sessions;
mod status;
mod studio;
mod verify;

use super::App;
use super::intake;
use super::problem::Problem;
use crate::capture::{CaptureError, DeskError, PlaceError, ThumbnailError};
use crate::jobs::JobsError;
use crate::pipeline::calibrate::waiting::WaitingError;
use crate::session::SessionError;
use axum::extract::DefaultBodyLimit;
use axum::http::{Method, StatusCode, Uri};
use axum::middleware::from_fn;
use std::io::ErrorKind;
use utoipa_axum::router::OpenApiRouter;
use utoipa_axum::routes;

/// All routes of the API.
pub(super) fn all() -> OpenApiRouter<App> {
    let uploads = OpenApiRouter::new()
        .routes(routes!(processing::import_scene))
        .layer(DefaultBodyLimit::disable())
        .layer(from_fn(intake::upload));
    let shots = OpenApiRouter::new()
        .routes(routes!(calibration::shoot))
        .layer(DefaultBodyLimit::disable())
        .layer(from_fn(intake::either));
    OpenApiRouter::new()
        .routes(routes!(sessions::devices))
        .routes(routes!(status::status))
        .routes(routes!(sessions::list, sessions::enter))
        .routes(routes!(sessions::one))
        .routes(routes!(pairs::list))
        .routes(routes!(pairs::one))
        .routes(routes!(pairs::take))
        .routes(routes!(pairs::thumbnail))
        .routes(routes!(pairs::confirm))
        .routes(routes!(jobs::list))
        .routes(routes!(jobs::one, jobs::cancel))
        .routes(routes!(jobs::retry))
        .routes(routes!(camera::list))
        .routes(routes!(camera::state, camera::choose))
        .routes(routes!(camera::live))
        .routes(routes!(camera::still))
        .routes(routes!(camera::set_exposure))
        .routes(routes!(camera::find_exposure))
        .routes(routes!(camera::set_region))
        .routes(routes!(camera::set_lighting))
        .routes(routes!(camera::confirm))
        .routes(routes!(camera::histogram))
        .routes(routes!(flash::account))
        .routes(routes!(flash::repeatability))
        .routes(routes!(sequences::state, sequences::plan, sequences::remove))
        .routes(routes!(sequences::direct))
        .routes(routes!(events::listen))
        .routes(routes!(files::list))
        .routes(routes!(files::fetch))
        .routes(routes!(calibration::list))
        .routes(routes!(calibration::record, calibration::calibrate))
        .routes(routes!(calibration::remove))
        .routes(routes!(processing::process))
        .routes(routes!(verify::verify))
        .routes(routes!(studio::describe))
        .routes(routes!(studio::direct))
        .routes(routes!(pairing::state, pairing::pair, pairing::leave))
        .routes(routes!(pairing::ticket))
        // What takes files is merged after this layer: it has its own.
        .layer(from_fn(intake::json))
        .merge(uploads)
        .merge(shots)
}

pub(super) async fn nothing_here(uri: Uri) -> Problem {
    Problem::not_found(
        "not_found",
        format!("there is nothing at {}; docs/openapi.json lists all", uri.path()),
    )
}

pub(super) async fn wrong_method(method: Method, uri: Uri) -> Problem {
    let words = format!("{} does not take {method}; docs/openapi.json tells what it takes", uri.path());
    Problem::new(StatusCode::METHOD_NOT_ALLOWED, "method_not_allowed", words)
}

/// The table from the desk's errors to status and code.
impl From<DeskError> for Problem {
    fn from(error: DeskError) -> Self {
        let (status, code) = match &error {
            DeskError::BadName(_) => (StatusCode::BAD_REQUEST, "session_name_invalid"),
            DeskError::BadValue(_) => (StatusCode::BAD_REQUEST, "value_invalid"),
            DeskError::Window(_) => (StatusCode::BAD_REQUEST, "region_invalid"),
            DeskError::Capture(
                error @ (CaptureError::NoThread(_) | CaptureError::Place(_) | CaptureError::Levels(_)),
            ) => (StatusCode::INTERNAL_SERVER_ERROR, error.code()),
            // A camera that is missing or asleep is a state of the house that one must reckon with.
            DeskError::Capture(error) => (StatusCode::CONFLICT, error.code()),
            DeskError::NoSuchSession(_) => (StatusCode::NOT_FOUND, "session_not_found"),
            DeskError::NoSuchPair { .. } => (StatusCode::NOT_FOUND, "pair_not_found"),
            DeskError::NoSuchFile { .. } => (StatusCode::NOT_FOUND, "file_not_found"),
            DeskError::NoSuchFrame { .. } => (StatusCode::NOT_FOUND, "frame_not_found"),
            DeskError::NotReady { .. } => (StatusCode::CONFLICT, "inputs_missing"),
            DeskError::NotMeasured { .. } => (StatusCode::NOT_FOUND, "calibration_not_measured"),
            DeskError::ShotInRecord(_) => (StatusCode::CONFLICT, "shot_in_use"),
            DeskError::Waiting(error) => of_waiting(error),
            DeskError::Record(_) => (StatusCode::INTERNAL_SERVER_ERROR, "session_unreadable"),
            DeskError::Session(error) | DeskError::Place(PlaceError::Session(error)) => of_session(error),
            DeskError::Sequence(error) => sequences::answer_to(error),
            DeskError::Energy(_) => (StatusCode::INTERNAL_SERVER_ERROR, "session_unreadable"),
            DeskError::Place(PlaceError::Order(_)) => (StatusCode::BAD_REQUEST, "order_invalid"),
            DeskError::Place(_) => (StatusCode::INTERNAL_SERVER_ERROR, "disk_failed"),
            DeskError::Jobs(JobsError::Full) => (StatusCode::TOO_MANY_REQUESTS, "queue_full"),
            DeskError::Jobs(JobsError::Closed) => (StatusCode::SERVICE_UNAVAILABLE, "closing"),
            DeskError::Jobs(JobsError::Unknown(_)) => (StatusCode::NOT_FOUND, "job_not_found"),
            DeskError::Jobs(JobsError::Finished(_)) => (StatusCode::CONFLICT, "job_finished"),
            DeskError::Jobs(JobsError::NotRetryable(_)) => (StatusCode::CONFLICT, "job_not_retryable"),
            DeskError::Jobs(JobsError::NotRepeatable(..)) => (StatusCode::CONFLICT, "job_not_repeatable"),
            DeskError::Jobs(JobsError::KeyReused(_)) => {
                (StatusCode::UNPROCESSABLE_ENTITY, "idempotency_key_reused")
            }
            DeskError::Thumbnail(ThumbnailError::Disk { .. }) => {
                (StatusCode::INTERNAL_SERVER_ERROR, "disk_failed")
            }
            DeskError::Thumbnail(ThumbnailError::Record(_)) => {
                (StatusCode::INTERNAL_SERVER_ERROR, "session_unreadable")
            }
            DeskError::Thumbnail(_) => (StatusCode::UNPROCESSABLE_ENTITY, "frame_unreadable"),
        };
        Problem::new(status, code, error)
    }
}

/// The table from a session's errors to status and code.
fn of_session(error: &SessionError) -> (StatusCode, &'static str) {
    match error {
        SessionError::NotASession { .. } => (StatusCode::NOT_FOUND, "session_not_found"),
        SessionError::NoSuchPair { .. } => (StatusCode::NOT_FOUND, "pair_not_found"),
        SessionError::PairAccepted { .. } => (StatusCode::CONFLICT, "pair_accepted"),
        SessionError::Locked { .. } => (StatusCode::CONFLICT, "session_locked"),
        SessionError::NotEmpty { .. } => (StatusCode::CONFLICT, "folder_not_empty"),
        SessionError::NoRoom { .. } => (StatusCode::CONFLICT, "disk_full"),
        SessionError::Io { source, .. } if is_full(source) => (StatusCode::CONFLICT, "disk_full"),
        SessionError::Damaged { .. } => (StatusCode::INTERNAL_SERVER_ERROR, "session_damaged"),
        SessionError::TooNew { .. } => (StatusCode::CONFLICT, "session_too_new"),
        _ => (StatusCode::INTERNAL_SERVER_ERROR, "session_failed"),
    }
}

/// The table from errors of shots that wait for their calibration to status and code.
fn of_waiting(error: &WaitingError) -> (StatusCode, &'static str) {
    match error {
        WaitingError::None { .. } => (StatusCode::NOT_FOUND, "shot_not_found"),
        WaitingError::Twice { .. } => (StatusCode::CONFLICT, "shot_twice"),
        WaitingError::Raw(_) => (StatusCode::UNPROCESSABLE_ENTITY, "frame_unreadable"),
        WaitingError::Session(error) => of_session(error),
        WaitingError::Io { source, .. } if is_full(source) => (StatusCode::CONFLICT, "disk_full"),
        WaitingError::Io { .. } => (StatusCode::INTERNAL_SERVER_ERROR, "disk_failed"),
        _ => (StatusCode::INTERNAL_SERVER_ERROR, "session_unreadable"),
    }
}

/// Whether there is no room left, for anybody or for this user.
pub(super) fn is_full(error: &std::io::Error) -> bool {
    matches!(error.kind(), ErrorKind::StorageFull | ErrorKind::QuotaExceeded)
}

/// Runs what may wait for a disk or a device on a thread that may block.
async fn blocking<T: Send + 'static>(
    work: impl FnOnce() -> Result<T, DeskError> + Send + 'static,
) -> Result<T, Problem> {
    let span = tracing::Span::current();
    match tokio::task::spawn_blocking(move || span.in_scope(work)).await {
        Ok(outcome) => Ok(outcome?),
        Err(panic) => Err(Problem::internal(format!("the handler stumbled: {panic}"))),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::capture::SequenceError;
    use axum::response::IntoResponse;

    #[test]
    fn a_session_that_cannot_be_used_is_the_same_refusal_from_a_sequence() {
        let path = || "vase".into();
        let io = |kind: ErrorKind| SessionError::Io { path: path(), source: kind.into() };
        for (error, status) in [
            (SessionError::NotASession { path: path() }, 404),
            (SessionError::Locked { path: path(), holder: None }, 409),
            (SessionError::TooNew { path: path(), found: 9, known: 1 }, 409),
            (io(ErrorKind::StorageFull), 409),
            (io(ErrorKind::PermissionDenied), 500),
        ] {
            let words = error.to_string();
            let problem = Problem::from(DeskError::Sequence(SequenceError::Session(error)));
            assert_eq!(problem.into_response().status().as_u16(), status, "{words}");
        }
    }
}
