//! What processing needs, and processing itself. All of it becomes jobs.

use super::blocking;
use super::jobs::{Ordered, accepted, ordered};
use crate::capture::SceneFiles;
use crate::http::App;
use crate::http::bodies::{CardShotOrder, FlashCalibrationOrder, JobBody};
use crate::http::extract::{Form, Json, Path};
use crate::http::idempotency::Key;
use crate::http::problem::{Problem, ProblemBody};
use axum::extract::multipart::Field;
use axum::extract::{Multipart, State};
use axum::response::Response;
use std::path::PathBuf;
use utoipa::ToSchema;

/// The scene's files.
#[derive(ToSchema)]
#[expect(dead_code, reason = "describes the form to OpenAPI; the parts are read one by one")]
pub(super) struct SceneForm {
    /// One BlocksExchange XML, or COLMAP's `cameras.txt` and `images.txt`.
    #[schema(value_type = Vec<String>, format = Binary)]
    cameras: Vec<Vec<u8>>,
    /// OBJ meshes, the object first.
    #[schema(value_type = Vec<String>, format = Binary)]
    mesh: Vec<Vec<u8>>,
    /// `m` (default), `cm` or `mm`.
    unit: Option<String>,
    /// Factor after the unit; 1 by default.
    scale: Option<f64>,
}

/// Imports cameras and meshes.
#[utoipa::path(post, path = "/api/v1/sessions/{session}/scene", tag = "processing",
    params(("session" = String, Path, description = "Name of the session", example = "birdbath")),
    request_body(content = SceneForm, content_type = "multipart/form-data"),
    responses((status = 202, body = JobBody, headers(("Location" = String)))))]
pub(super) async fn import_scene(
    State(app): State<App>,
    Path(session): Path<String>,
    Form(form): Form,
) -> Result<Response, Problem> {
    let files = stage(form).await?;
    Ok(accepted(blocking(move || app.desk.import_scene(&session, files)).await?))
}

/// Writes the form's files to a folder of their own, meshes numbered so that equal names do not collide.
async fn stage(mut form: Multipart) -> Result<SceneFiles, Problem> {
    let folder = tempfile::tempdir().map_err(Problem::internal)?;
    let cameras_dir = folder.path().join("cameras");
    tokio::fs::create_dir(&cameras_dir).await.map_err(Problem::internal)?;
    let (mut cameras, mut meshes) = (Vec::new(), Vec::new());
    let (mut unit, mut scale) = ("m".to_owned(), 1.0);
    while let Some(part) = form.next_field().await? {
        match part.name() {
            Some("cameras") => cameras.push(keep(part, &cameras_dir).await?),
            Some("mesh") => {
                let own = folder.path().join(format!("mesh-{}", meshes.len()));
                tokio::fs::create_dir(&own).await.map_err(Problem::internal)?;
                meshes.push(keep(part, &own).await?);
            }
            Some("unit") => unit = part.text().await?,
            Some("scale") => {
                let text = part.text().await?;
                scale = text.trim().parse().map_err(|_| {
                    Problem::bad_request("value_invalid", format!("scale is {text:?}, but must be a number"))
                })?;
            }
            other => {
                let words = format!("part {other:?} is unknown; send cameras, mesh, unit and scale");
                return Err(Problem::bad_request("body_invalid", words));
            }
        }
    }
    let cameras = match cameras.as_slice() {
        [] => return Err(Problem::bad_request("body_invalid", "no part named cameras was sent")),
        [one] => one.clone(),
        _ => cameras_dir,
    };
    if meshes.is_empty() {
        return Err(Problem::bad_request("body_invalid", "no part named mesh was sent"));
    }
    Ok(SceneFiles { folder, cameras, meshes, unit, scale })
}

/// Writes one part under its own file name.
async fn keep(part: Field<'_>, folder: &std::path::Path) -> Result<PathBuf, Problem> {
    let name = part.file_name().unwrap_or_default().to_owned();
    let plain = !name.is_empty() && !name.starts_with('.') && !name.contains(['/', '\\', '\0']);
    if !plain || name.len() > 200 {
        let words = format!("file name {name:?} cannot be used; send each file with its plain name");
        return Err(Problem::bad_request("body_invalid", words));
    }
    let path = folder.join(name);
    let bytes = part.bytes().await?;
    tokio::fs::write(&path, &bytes).await.map_err(Problem::internal)?;
    Ok(path)
}

/// Shoots the calibration card with and without flash.
#[utoipa::path(post, path = "/api/v1/sessions/{session}/calibration/flash/shots", tag = "processing",
    params(("session" = String, Path, description = "Name of the session", example = "birdbath"),
        ("Idempotency-Key" = Option<String>, Header, description = "One wish, one job, however often it is sent")),
    request_body = CardShotOrder,
    responses((status = 202, body = JobBody, headers(("Location" = String), ("Idempotency-Replayed" = Option<String>)))))]
pub(super) async fn shoot_card(
    State(app): State<App>,
    Path(session): Path<String>,
    key: Key,
    Json(order): Json<CardShotOrder>,
) -> Result<Ordered, Problem> {
    let distance = order.distance_m;
    ordered(&app, key.with(&order)?, move |desk| desk.take_card_shot(&session, distance)).await
}

/// Fits the flash calibration from the card shots taken so far.
#[utoipa::path(post, path = "/api/v1/sessions/{session}/calibration/flash", tag = "processing",
    params(("session" = String, Path, description = "Name of the session", example = "birdbath")),
    request_body = FlashCalibrationOrder,
    responses((status = 202, body = JobBody, headers(("Location" = String))),
        (status = 409, description = "`inputs_missing`, `session_locked` or `session_too_new`", body = ProblemBody, content_type = "application/problem+json")))]
pub(super) async fn calibrate_flash(
    State(app): State<App>,
    Path(session): Path<String>,
    Json(order): Json<FlashCalibrationOrder>,
) -> Result<Response, Problem> {
    let FlashCalibrationOrder { target_reflectance, ring_radii } = order;
    let ordered = blocking(move || app.desk.calibrate_flash(&session, target_reflectance, ring_radii));
    Ok(accepted(ordered.await?))
}

/// Makes the model from everything that the session holds. Starts by itself after each accepted pair once
/// scene and calibration are there; this asks for it out of turn.
#[utoipa::path(post, path = "/api/v1/sessions/{session}/process", tag = "processing",
    params(("session" = String, Path, description = "Name of the session", example = "birdbath"),
        ("Idempotency-Key" = Option<String>, Header, description = "One wish, one job, however often it is sent")),
    responses((status = 202, body = JobBody, headers(("Location" = String), ("Idempotency-Replayed" = Option<String>))),
        (status = 409, description = "`inputs_missing`, `session_locked` or `session_too_new`", body = ProblemBody, content_type = "application/problem+json")))]
pub(super) async fn process(
    State(app): State<App>,
    Path(session): Path<String>,
    key: Key,
) -> Result<Ordered, Problem> {
    ordered(&app, key.with(&())?, move |desk| desk.process(&session)).await
}
