//! The camera: which one, how it stands, its live picture, exposure and region, histograms.

use super::blocking;
use super::jobs::{Ordered, ordered};
use super::pairs::FrameName;
use crate::capture::LivePicture;
use crate::http::App;
use crate::http::bodies::DevicesBody;
use crate::http::camera_bodies::{
    CameraBody, CameraChoice, CameraListBody, ConfirmedBody, ExposureOrder, FindOrder, FrameFiguresBody,
    LightingBody, PlanBody, WindowBody,
};
use crate::http::extract;
use crate::http::extract::{Path, Wishes};
use crate::http::idempotency::Key;
use crate::http::job_bodies::JobBody;
use crate::http::problem::{Problem, ProblemBody};
use axum::Json;
use axum::body::{Body, Bytes};
use axum::extract::State;
use axum::http::{HeaderValue, StatusCode, header};
use axum::response::{IntoResponse, Response};
use std::time::Duration;
use tokio::sync::{mpsc, watch};
use tokio_stream::StreamExt;
use tokio_stream::wrappers::ReceiverStream;

/// How long a script may wait for the first live picture.
const FIRST_PICTURE: Duration = Duration::from_secs(15);
/// Between two pictures of the stream.
const BOUNDARY: &str = "unlit-live";

/// The cameras that can be opened now, and which one is in use.
#[utoipa::path(get, path = "/api/v1/cameras", tag = "capture",
    responses((status = 200, body = Vec<CameraListBody>),
        (status = 409, description = "The camera cannot be used: `camera_not_found`, `camera_busy` or another code of a camera or its lock", body = ProblemBody,
            content_type = "application/problem+json")))]
pub(super) async fn list(State(app): State<App>) -> Result<Json<Vec<CameraListBody>>, Problem> {
    blocking(move || {
        let in_use = app.desk.devices().camera.description;
        let cameras = app.desk.cameras()?;
        Ok(Json(cameras.into_iter().map(|camera| CameraListBody::new(camera, &in_use)).collect()))
    })
    .await
}

/// How the camera stands: settings, what its dials offer, and the exposure lock item by item. Going through the
/// lock also sets what can be set.
#[utoipa::path(get, path = "/api/v1/camera", tag = "capture",
    responses((status = 200, body = CameraBody),
        (status = 409, description = "The camera cannot be used: `camera_not_found`, `camera_busy` or another code of a camera or its lock", body = ProblemBody,
            content_type = "application/problem+json")))]
pub(super) async fn state(State(app): State<App>) -> Result<Json<CameraBody>, Problem> {
    blocking(move || Ok(Json(app.desk.camera_state()?.into()))).await
}

/// Uses the camera on this port from now on.
#[utoipa::path(put, path = "/api/v1/camera", tag = "capture", request_body = CameraChoice,
    responses((status = 200, body = DevicesBody),
        (status = 409, description = "The camera cannot be used: `camera_not_found`, `camera_busy` or another code of a camera or its lock", body = ProblemBody,
            content_type = "application/problem+json")))]
pub(super) async fn choose(
    State(app): State<App>,
    extract::Json(choice): extract::Json<CameraChoice>,
) -> Result<Json<DevicesBody>, Problem> {
    blocking(move || Ok(Json(app.desk.choose_camera(&choice.port)?.into()))).await
}

/// The live picture as a stream of JPEGs (`multipart/x-mixed-replace`, what an `img` element shows). A slow
/// client gets fewer pictures, never old ones. The stream ends when there is trouble; the page asks again.
#[utoipa::path(get, path = "/api/v1/live.mjpg", tag = "capture",
    responses((status = 200, body = Vec<u8>, content_type = "multipart/x-mixed-replace"),
        (status = 409, description = "`no_live_picture`", body = ProblemBody,
            content_type = "application/problem+json")))]
pub(super) async fn live(State(app): State<App>) -> Result<Response, Problem> {
    let mut watcher = app.desk.watch_live().map_err(Problem::internal)?;
    let mut closing = app.closing.clone();
    // The first picture or the first trouble decides between a stream and an error in words.
    let first = unless_closing(&app, next_picture(&mut watcher)).await?;
    let (sender, receiver) = mpsc::channel::<Bytes>(1);
    tokio::spawn(async move {
        let mut picture = Some(first);
        while let Some(jpeg) = picture {
            if sender.send(part(&jpeg)).await.is_err() {
                return;
            }
            picture = tokio::select! {
                next = next_picture(&mut watcher) => next.ok(),
                _ = closing.changed() => return,
                () = sender.closed() => return,
            };
        }
    });
    let stream = ReceiverStream::new(receiver).map(Ok::<_, std::convert::Infallible>);
    let kind = format!("multipart/x-mixed-replace; boundary={BOUNDARY}");
    Ok((
        [(header::CONTENT_TYPE, kind), (header::CACHE_CONTROL, "no-store".into())],
        Body::from_stream(stream),
    )
        .into_response())
}

/// One picture with its head, and the boundary after it, so that clients need not wait for the next one to show it.
fn part(jpeg: &[u8]) -> Bytes {
    let head = format!("--{BOUNDARY}\r\nContent-Type: image/jpeg\r\nContent-Length: {}\r\n\r\n", jpeg.len());
    [head.as_bytes(), jpeg, b"\r\n"].concat().into()
}

async fn next_picture(
    watcher: &mut watch::Receiver<LivePicture>,
) -> Result<std::sync::Arc<Vec<u8>>, Problem> {
    let wait = async {
        loop {
            // The sender lives as long as the engine, which outlives every handler.
            if watcher.changed().await.is_err() {
                return Err(Problem::internal("live view has ended"));
            }
            match watcher.borrow_and_update().clone() {
                LivePicture::None => {}
                LivePicture::Jpeg(jpeg) => return Ok(jpeg),
                LivePicture::Trouble(words) => {
                    return Err(Problem::new(StatusCode::CONFLICT, "no_live_picture", words));
                }
            }
        }
    };
    tokio::time::timeout(FIRST_PICTURE, wait).await.unwrap_or_else(|_| {
        let words = format!("no live picture came within {FIRST_PICTURE:?}; is a pair being shot?");
        Err(Problem::new(StatusCode::CONFLICT, "no_live_picture", words))
    })
}

/// The picture, unless the program is told to end before it comes.
async fn unless_closing<T>(
    app: &App,
    picture: impl Future<Output = Result<T, Problem>>,
) -> Result<T, Problem> {
    let mut closing = app.closing.clone();
    tokio::select! {
        picture = picture => picture,
        _ = closing.wait_for(|closing| *closing) => {
            let words = "the program is about to end and waits for no live picture; ask again when it runs";
            Err(Problem::new(StatusCode::SERVICE_UNAVAILABLE, "closing", words))
        }
    }
}

/// One live picture, for scripts.
#[utoipa::path(get, path = "/api/v1/live.jpg", tag = "capture",
    responses((status = 200, body = Vec<u8>, content_type = "image/jpeg"),
        (status = 409, description = "`no_live_picture`", body = ProblemBody,
            content_type = "application/problem+json")))]
pub(super) async fn still(State(app): State<App>) -> Result<Response, Problem> {
    let mut watcher = app.desk.watch_live().map_err(Problem::internal)?;
    let jpeg = unless_closing(&app, next_picture(&mut watcher)).await?;
    let kind = HeaderValue::from_static("image/jpeg");
    Ok((
        [(header::CONTENT_TYPE, kind), (header::CACHE_CONTROL, HeaderValue::from_static("no-store"))],
        jpeg.to_vec(),
    )
        .into_response())
}

/// Sets the exposures at which the session's pairs are shot from now on. Values are the camera's labels.
#[utoipa::path(put, path = "/api/v1/sessions/{session}/exposure", tag = "capture",
    params(("session" = String, Path, description = "Name of the session", example = "birdbath")),
    request_body = ExposureOrder,
    responses((status = 200, body = PlanBody),
        (status = 409, description = "The session or the camera cannot be used: `session_locked`, `camera_not_found`, `camera_busy` or another code of a camera or its lock", body = ProblemBody,
            content_type = "application/problem+json")))]
pub(super) async fn set_exposure(
    State(app): State<App>,
    Path(session): Path<String>,
    extract::Json(order): extract::Json<ExposureOrder>,
) -> Result<Json<PlanBody>, Problem> {
    blocking(move || {
        let plan = app.desk.set_plan(&session, order.on.into(), order.off.map(Into::into))?;
        Ok(Json(plan.into()))
    })
    .await
}

/// Finds shutter, aperture and sensitivity by at most four test shots, in the session's region, and makes them
/// the session's. The job's `result` has `exposure` (as PUT exposure answers), `predicted_share`, `ambient_share`, `flash_share`,
/// `shots` and `warnings`.
#[utoipa::path(post, path = "/api/v1/sessions/{session}/find-exposure", tag = "capture",
    params(("session" = String, Path, description = "Name of the session", example = "birdbath"),
        ("Idempotency-Key" = Option<String>, Header, description = "One wish, one job, however often it is sent")),
    request_body(content = Option<FindOrder>, description = "May be empty"),
    responses((status = 202, description = "queued", body = JobBody, headers(("Location" = String), ("Idempotency-Replayed" = Option<String>)))))]
pub(super) async fn find_exposure(
    State(app): State<App>,
    Path(session): Path<String>,
    key: Key,
    Wishes(order): Wishes<FindOrder>,
) -> Result<Ordered, Problem> {
    ordered(&app, key.with(&order)?, move |desk| desk.find_exposure(&session, order.into())).await
}

/// Sets where the object is in the frame, for exposure and checks; `null` is the whole frame.
#[utoipa::path(put, path = "/api/v1/sessions/{session}/region", tag = "capture",
    params(("session" = String, Path, description = "Name of the session", example = "birdbath")),
    request_body = Option<WindowBody>,
    responses((status = 204, description = "set")))]
pub(super) async fn set_region(
    State(app): State<App>,
    Path(session): Path<String>,
    extract::Json(region): extract::Json<Option<WindowBody>>,
) -> Result<StatusCode, Problem> {
    blocking(move || {
        app.desk.set_region(&session, region.map(Into::into))?;
        Ok(StatusCode::NO_CONTENT)
    })
    .await
}

/// The operator has checked by eye what the camera does not tell (items of the lock that are `unreadable`).
/// Answers all that is confirmed for the session.
#[utoipa::path(post, path = "/api/v1/sessions/{session}/confirmed", tag = "capture",
    params(("session" = String, Path, description = "Name of the session", example = "birdbath")),
    request_body = ConfirmedBody,
    responses((status = 200, body = ConfirmedBody)))]
pub(super) async fn confirm(
    State(app): State<App>,
    Path(session): Path<String>,
    extract::Json(names): extract::Json<ConfirmedBody>,
) -> Result<Json<ConfirmedBody>, Problem> {
    blocking(move || Ok(Json(ConfirmedBody { names: app.desk.confirm_settings(&session, &names.names)? })))
        .await
}

/// Tells of the polariser before the lens and of the power that the flash is set to. Pairs and calibration shots keep what
/// is told when they are taken, and a calibration counts for its own polariser and power.
#[utoipa::path(put, path = "/api/v1/sessions/{session}/lighting", tag = "capture",
    params(("session" = String, Path, description = "Name of the session", example = "birdbath")),
    request_body = LightingBody,
    responses((status = 204, description = "set")))]
pub(super) async fn set_lighting(
    State(app): State<App>,
    Path(session): Path<String>,
    extract::Json(lighting): extract::Json<LightingBody>,
) -> Result<StatusCode, Problem> {
    blocking(move || {
        app.desk.set_lighting(&session, lighting.into())?;
        Ok(StatusCode::NO_CONTENT)
    })
    .await
}

/// Histograms of a stored frame's sensor values, a colour each, with clipped shares, in the session's region.
#[utoipa::path(get, path = "/api/v1/sessions/{session}/pairs/{number}/{frame}/histogram", tag = "capture",
    params(("session" = String, Path, description = "Name of the session", example = "birdbath"),
        ("number" = u32, Path, description = "Number of the pair", example = 1),
        ("frame" = FrameName, Path, description = "`off`, `on`, `off-2`, `after` and so on")),
    responses((status = 200, body = FrameFiguresBody),
        (status = 422, description = "`frame_unreadable`", body = ProblemBody, content_type = "application/problem+json")))]
pub(super) async fn histogram(
    State(app): State<App>,
    Path((session, number, frame)): Path<(String, u32, FrameName)>,
) -> Result<Json<FrameFiguresBody>, Problem> {
    blocking(move || Ok(Json(app.desk.histograms(&session, number, frame.0)?.into()))).await
}
