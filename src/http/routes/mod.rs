//! One file a subject. The path of each handler is written once, beside it.

mod camera;
mod events;
mod files;
mod flash;
mod jobs;
mod pairs;
mod processing;
mod sessions;
mod studio;

use super::App;
use super::problem::Problem;
use crate::capture::{DeskError, PlaceError};
use crate::jobs::JobsError;
use crate::session::SessionError;
use axum::extract::DefaultBodyLimit;
use axum::http::{Method, StatusCode, Uri};
use serde::de::DeserializeOwned;
use utoipa_axum::router::OpenApiRouter;
use utoipa_axum::routes;

/// Largest scene upload in bytes; every other body must fit into axum's 2 MB.
const UPLOAD_LIMIT: usize = 1 << 30;

/// All routes of the API.
pub(super) fn all() -> OpenApiRouter<App> {
    let uploads = OpenApiRouter::new()
        .routes(routes!(processing::import_scene))
        .layer(DefaultBodyLimit::max(UPLOAD_LIMIT));
    OpenApiRouter::new()
        .merge(uploads)
        .routes(routes!(sessions::devices))
        .routes(routes!(sessions::list, sessions::enter))
        .routes(routes!(sessions::one))
        .routes(routes!(pairs::list))
        .routes(routes!(pairs::take))
        .routes(routes!(pairs::thumbnail))
        .routes(routes!(pairs::confirm))
        .routes(routes!(jobs::list))
        .routes(routes!(jobs::one, jobs::cancel))
        .routes(routes!(camera::list))
        .routes(routes!(camera::state, camera::choose))
        .routes(routes!(camera::live))
        .routes(routes!(camera::still))
        .routes(routes!(camera::set_exposure))
        .routes(routes!(camera::find_exposure))
        .routes(routes!(camera::set_region))
        .routes(routes!(camera::confirm))
        .routes(routes!(camera::histogram))
        .routes(routes!(flash::account))
        .routes(routes!(flash::repeatability))
        .routes(routes!(events::listen))
        .routes(routes!(files::fetch))
        .routes(routes!(processing::shoot_card))
        .routes(routes!(processing::calibrate_flash))
        .routes(routes!(processing::process))
        .routes(routes!(studio::describe))
        .routes(routes!(studio::direct))
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
            DeskError::Capture(error) => (StatusCode::SERVICE_UNAVAILABLE, error.code()),
            DeskError::NoSuchSession(_) => (StatusCode::NOT_FOUND, "session_not_found"),
            DeskError::NoSuchPair { .. } => (StatusCode::NOT_FOUND, "pair_not_found"),
            DeskError::NotReady { .. } => (StatusCode::CONFLICT, "inputs_missing"),
            DeskError::Session(error) | DeskError::Place(PlaceError::Session(error)) => match error {
                SessionError::Locked { .. } => (StatusCode::CONFLICT, "session_locked"),
                SessionError::NotEmpty { .. } => (StatusCode::CONFLICT, "folder_not_empty"),
                SessionError::Damaged { .. } => (StatusCode::INTERNAL_SERVER_ERROR, "session_damaged"),
                SessionError::TooNew { .. } => (StatusCode::CONFLICT, "session_too_new"),
                _ => (StatusCode::INTERNAL_SERVER_ERROR, "session_failed"),
            },
            DeskError::Energy(_) => (StatusCode::INTERNAL_SERVER_ERROR, "session_unreadable"),
            DeskError::Place(_) => (StatusCode::INTERNAL_SERVER_ERROR, "disk_failed"),
            DeskError::Jobs(JobsError::Full | JobsError::Closed) => {
                (StatusCode::SERVICE_UNAVAILABLE, "queue_full")
            }
            DeskError::Jobs(JobsError::Unknown(_)) => (StatusCode::NOT_FOUND, "job_not_found"),
            DeskError::Jobs(JobsError::Finished(_)) => (StatusCode::CONFLICT, "job_finished"),
            DeskError::Thumbnail(_) => (StatusCode::UNPROCESSABLE_ENTITY, "frame_unreadable"),
        };
        Problem::new(status, code, error)
    }
}

/// A body of JSON that may be left out: no body means no wishes, whatever the content type says.
fn wishes<T: Default + DeserializeOwned>(body: &[u8]) -> Result<T, Problem> {
    if body.is_empty() {
        return Ok(T::default());
    }
    serde_json::from_slice(body).map_err(|e| Problem::bad_request("body_invalid", e))
}

/// Runs what may wait for a disk or a device on a thread that may block.
async fn blocking<T: Send + 'static>(
    work: impl FnOnce() -> Result<T, DeskError> + Send + 'static,
) -> Result<T, Problem> {
    match tokio::task::spawn_blocking(work).await {
        Ok(outcome) => Ok(outcome?),
        Err(panic) => Err(Problem::internal(format!("the handler stumbled: {panic}"))),
    }
}
