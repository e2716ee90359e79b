//! Jobs: looking at them, waiting for them, cancelling them.

use crate::capture::DeskError;
use crate::http::App;
use crate::http::bodies::JobBody;
use crate::http::problem::{Problem, ProblemBody};
use crate::jobs::Job;
use axum::Json;
use axum::extract::rejection::PathRejection;
use axum::extract::{Path, State};
use axum::http::{StatusCode, header};
use axum::response::{IntoResponse, Response};
use tokio::sync::broadcast::error::RecvError;

/// All jobs that are remembered, newest first.
#[utoipa::path(get, path = "/api/v1/jobs", tag = "processing", responses((status = 200, body = Vec<JobBody>)))]
pub(super) async fn list(State(app): State<App>) -> Json<Vec<JobBody>> {
    Json(app.desk.queue().list().into_iter().map(Into::into).collect())
}

/// One job.
#[utoipa::path(get, path = "/api/v1/jobs/{id}", tag = "processing",
    params(("id" = u64, Path, description = "Number of the job")),
    responses((status = 200, body = JobBody),
        (status = 404, body = ProblemBody, content_type = "application/problem+json")))]
pub(super) async fn one(
    State(app): State<App>,
    id: Result<Path<u64>, PathRejection>,
) -> Result<Json<JobBody>, Problem> {
    let Path(id) = id?;
    Ok(Json(app.desk.queue().get(id).map_err(DeskError::from)?.into()))
}

/// Cancels a job. One that runs stops at its next step, so the answer may still say `running`.
#[utoipa::path(delete, path = "/api/v1/jobs/{id}", tag = "processing",
    params(("id" = u64, Path, description = "Number of the job")),
    responses((status = 200, body = JobBody),
        (status = 404, body = ProblemBody, content_type = "application/problem+json"),
        (status = 409, body = ProblemBody, content_type = "application/problem+json")))]
pub(super) async fn cancel(
    State(app): State<App>,
    id: Result<Path<u64>, PathRejection>,
) -> Result<Json<JobBody>, Problem> {
    let Path(id) = id?;
    Ok(Json(app.desk.queue().cancel(id).map_err(DeskError::from)?.into()))
}

/// The answer to whoever asked for a job.
pub(super) fn accepted(job: Job) -> Response {
    let location = format!("/api/v1/jobs/{}", job.id);
    (StatusCode::ACCEPTED, [(header::LOCATION, location)], Json(JobBody::from(job))).into_response()
}

/// The job once it has ended, or as it stands when the program ends first.
pub(super) async fn ended(app: &App, job: Job) -> Result<Job, Problem> {
    let (_, mut heard) = app.desk.events().listen();
    let mut closing = app.closing.clone();
    loop {
        // Asked after listening began, so that an end in between is not missed.
        let job = app.desk.queue().get(job.id).map_err(DeskError::from)?;
        if job.state.is_final() || *closing.borrow() {
            return Ok(job);
        }
        tokio::select! {
            event = heard.recv() => if let Err(RecvError::Closed) = event { return Ok(job) },
            _ = closing.changed() => {}
        }
    }
}
