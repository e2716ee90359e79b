//! What processing needs, and processing itself. All of it becomes jobs.

use super::blocking;
use super::jobs::accepted;
use crate::capture::SceneFiles;
use crate::http::App;
use crate::http::bodies::{CardShotOrder, FlashCalibrationOrder, JobBody};
use crate::http::problem::{Problem, ProblemBody};
use axum::Json;
use axum::extract::multipart::{Field, MultipartError, MultipartRejection};
use axum::extract::rejection::JsonRejection;
use axum::extract::{Multipart, Path, State};
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
    params(("session" = String, Path, description = "Name of the session")),
    request_body(content = SceneForm, content_type = "multipart/form-data"),
    responses((status = 202, body = JobBody, headers(("Location" = String))),
        (status = 400, body = ProblemBody, content_type = "application/problem+json"),
        (status = 404, body = ProblemBody, content_type = "application/problem+json")))]
pub(super) async fn import_scene(
    State(app): State<App>,
    Path(session): Path<String>,
    form: Result<Multipart, MultipartRejection>,
) -> Result<Response, Problem> {
    let form = form.map_err(|e| Problem::new(e.status(), "body_invalid", e.body_text()))?;
    let files = stage(form).await?;
    Ok(accepted(blocking(move || app.desk.import_scene(&session, files)).await?))
}

fn part_failed(error: &MultipartError) -> Problem {
    Problem::new(error.status(), "body_invalid", error.body_text())
}

/// Writes the form's files to a folder of their own, meshes numbered so that equal names do not collide.
async fn stage(mut form: Multipart) -> Result<SceneFiles, Problem> {
    let folder = tempfile::tempdir().map_err(Problem::internal)?;
    let cameras_dir = folder.path().join("cameras");
    tokio::fs::create_dir(&cameras_dir).await.map_err(Problem::internal)?;
    let (mut cameras, mut meshes) = (Vec::new(), Vec::new());
    let (mut unit, mut scale) = ("m".to_owned(), 1.0);
    while let Some(part) = form.next_field().await.map_err(|e| part_failed(&e))? {
        match part.name() {
            Some("cameras") => cameras.push(keep(part, &cameras_dir).await?),
            Some("mesh") => {
                let own = folder.path().join(format!("mesh-{}", meshes.len()));
                tokio::fs::create_dir(&own).await.map_err(Problem::internal)?;
                meshes.push(keep(part, &own).await?);
            }
            Some("unit") => unit = part.text().await.map_err(|e| part_failed(&e))?,
            Some("scale") => {
                let text = part.text().await.map_err(|e| part_failed(&e))?;
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
    let bytes = part.bytes().await.map_err(|e| part_failed(&e))?;
    tokio::fs::write(&path, &bytes).await.map_err(Problem::internal)?;
    Ok(path)
}

/// Shoots the calibration card with and without flash.
#[utoipa::path(post, path = "/api/v1/sessions/{session}/calibration/flash/shots", tag = "processing",
    params(("session" = String, Path, description = "Name of the session")),
    request_body = CardShotOrder,
    responses((status = 202, body = JobBody, headers(("Location" = String))),
        (status = 400, body = ProblemBody, content_type = "application/problem+json"),
        (status = 404, body = ProblemBody, content_type = "application/problem+json")))]
pub(super) async fn shoot_card(
    State(app): State<App>,
    Path(session): Path<String>,
    order: Result<Json<CardShotOrder>, JsonRejection>,
) -> Result<Response, Problem> {
    let Json(order) = order?;
    Ok(accepted(blocking(move || app.desk.take_card_shot(&session, order.distance_m)).await?))
}

/// Fits the flash calibration from the card shots taken so far.
#[utoipa::path(post, path = "/api/v1/sessions/{session}/calibration/flash", tag = "processing",
    params(("session" = String, Path, description = "Name of the session")),
    request_body = FlashCalibrationOrder,
    responses((status = 202, body = JobBody, headers(("Location" = String))),
        (status = 400, body = ProblemBody, content_type = "application/problem+json"),
        (status = 404, body = ProblemBody, content_type = "application/problem+json"),
        (status = 409, body = ProblemBody, content_type = "application/problem+json")))]
pub(super) async fn calibrate_flash(
    State(app): State<App>,
    Path(session): Path<String>,
    order: Result<Json<FlashCalibrationOrder>, JsonRejection>,
) -> Result<Response, Problem> {
    let Json(order) = order?;
    let FlashCalibrationOrder { target_reflectance, ring_radii } = order;
    let ordered = blocking(move || app.desk.calibrate_flash(&session, target_reflectance, ring_radii));
    Ok(accepted(ordered.await?))
}

/// Makes the model from everything that the session holds. Starts by itself after each accepted pair once
/// scene and calibration are there; this asks for it out of turn.
#[utoipa::path(post, path = "/api/v1/sessions/{session}/process", tag = "processing",
    params(("session" = String, Path, description = "Name of the session")),
    responses((status = 202, body = JobBody, headers(("Location" = String))),
        (status = 404, body = ProblemBody, content_type = "application/problem+json"),
        (status = 409, body = ProblemBody, content_type = "application/problem+json")))]
pub(super) async fn process(
    State(app): State<App>,
    Path(session): Path<String>,
) -> Result<Response, Problem> {
    Ok(accepted(blocking(move || app.desk.process(&session)).await?))
}
