//! Jobs: looking at them, waiting for them, cancelling them.

use super::blocking;
use crate::capture::{Desk, DeskError};
use crate::http::App;
use crate::http::extract::{Path, Query};
use crate::http::idempotency::Key;
use crate::http::job_bodies::JobBody;
use crate::http::links;
use crate::http::paging::{Page, PageOrder};
use crate::http::problem::{Problem, ProblemBody};
use crate::jobs::{Job, Wish};
use axum::Json;
use axum::extract::State;
use axum::http::{HeaderName, HeaderValue, StatusCode, header};
use axum::response::{IntoResponse, Response};
use tokio::sync::broadcast::error::RecvError;

/// The jobs that are remembered, newest first. `after` is the number of the last job of the page before.
#[utoipa::path(get, path = "/api/v1/jobs", tag = "processing", params(PageOrder),
    responses((status = 200, body = Vec<JobBody>, headers(("Link" = String, description = "The next page, if any")))))]
pub(super) async fn list(
    State(app): State<App>,
    Query(page): Query<PageOrder>,
) -> Result<Page<JobBody>, Problem> {
    let jobs = app.desk.queue().list();
    Ok(page.of(jobs, |job| job.id, |id, after| id < after, "/api/v1/jobs")?.map(Into::into))
}

/// One job.
#[utoipa::path(get, path = "/api/v1/jobs/{id}", tag = "processing",
    params(("id" = u64, Path, description = "Number of the job", example = 1)),
    responses((status = 200, body = JobBody)))]
pub(super) async fn one(State(app): State<App>, Path(id): Path<u64>) -> Result<Json<JobBody>, Problem> {
    Ok(Json(app.desk.queue().get(id).map_err(DeskError::from)?.into()))
}

/// Cancels a job. One that runs stops at its next step, so the answer may still say `running`.
#[utoipa::path(delete, path = "/api/v1/jobs/{id}", tag = "processing",
    params(("id" = u64, Path, description = "Number of the job", example = 1)),
    responses((status = 200, body = JobBody),
        (status = 409, description = "`job_finished`", body = ProblemBody, content_type = "application/problem+json")))]
pub(super) async fn cancel(State(app): State<App>, Path(id): Path<u64>) -> Result<Json<JobBody>, Problem> {
    // The ledger's disk may be slow, and so may be what the job held.
    blocking(move || Ok(Json(app.desk.queue().cancel(id)?.into()))).await
}

/// Asks again for what a job that failed, was cancelled or interrupted was asked for; the new job names the old one
/// in `retry_of`. What a job was sent with (a scene's files) is not kept: such a job is sent again.
#[utoipa::path(post, path = "/api/v1/jobs/{id}/retry", tag = "processing",
    params(("id" = u64, Path, description = "Number of the job", example = 1),
        ("Idempotency-Key" = Option<String>, Header, description = "One wish, one job, however often it is sent")),
    responses((status = 202, body = JobBody, headers(("Location" = String), ("Idempotency-Replayed" = Option<String>))),
        (status = 409, description = "`job_not_retryable` (it ended well or has not ended), `job_not_repeatable`, or what the \
            same wish is refused for anew", body = ProblemBody, content_type = "application/problem+json")))]
pub(super) async fn retry(State(app): State<App>, Path(id): Path<u64>, key: Key) -> Result<Ordered, Problem> {
    ordered(&app, key.with(&())?, move |desk| desk.retry(id)).await
}

/// A job that was asked for, and whether it was asked for before under the same key.
pub(super) struct Ordered {
    job: Job,
    replayed: bool,
}

/// Asks the desk for a job; once for each key, where the request has one.
pub(super) async fn ordered(
    app: &App,
    asked: Option<Wish>,
    order: impl FnOnce(&Desk) -> Result<Job, DeskError> + Send + 'static,
) -> Result<Ordered, Problem> {
    let app = app.clone();
    blocking(move || {
        let (job, replayed) = match asked {
            Some(wish) => app.desk.once(wish, order)?,
            None => (order(&app.desk)?, false),
        };
        Ok(Ordered { job, replayed })
    })
    .await
}

impl Ordered {
    /// The same job, once it has ended.
    pub(super) async fn ended(self, app: &App) -> Result<Response, Problem> {
        let Ordered { job, replayed } = self;
        let body = Json(JobBody::from(ended(app, job).await?));
        Ok(marked((StatusCode::OK, body).into_response(), replayed))
    }
}

impl IntoResponse for Ordered {
    fn into_response(self) -> Response {
        marked(accepted(self.job), self.replayed)
    }
}

fn marked(mut response: Response, replayed: bool) -> Response {
    if replayed {
        let name = HeaderName::from_static("idempotency-replayed");
        response.headers_mut().insert(name, HeaderValue::from_static("true"));
    }
    response
}

/// The answer to whoever asked for a job.
pub(super) fn accepted(job: Job) -> Response {
    let location = links::job(job.id);
    (StatusCode::ACCEPTED, [(header::LOCATION, location)], Json(JobBody::from(job))).into_response()
}

/// The job once it has ended, or as it stands when the program ends first.
async fn ended(app: &App, job: Job) -> Result<Job, Problem> {
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
