//! The simulated studio's stage; there only with `unlit serve --studio`.

use crate::capture::Topic;
use crate::http::extract;
use crate::http::problem::{Problem, ProblemBody};
use crate::http::studio_bodies::{StageOrder, StudioBody};
use crate::http::{App, StudioControl};
use axum::Json;
use axum::extract::State;
use serde_json::json;
use std::sync::Arc;

fn studio(app: &App) -> Result<Arc<dyn StudioControl>, Problem> {
    app.studio.clone().ok_or_else(|| {
        Problem::not_found("no_studio", "real devices are in use; the studio is simulated with --studio only")
    })
}

/// How the simulated studio stands.
#[utoipa::path(get, path = "/api/v1/studio", tag = "studio",
    responses((status = 200, body = StudioBody),
        (status = 404, description = "`no_studio`", body = ProblemBody, content_type = "application/problem+json")))]
pub(super) async fn describe(State(app): State<App>) -> Result<Json<StudioBody>, Problem> {
    Ok(Json(studio(&app)?.describe()))
}

/// Moves the simulated operator: to a stop, before the card, or to put the cap on the lens.
#[utoipa::path(put, path = "/api/v1/studio/stage", tag = "studio", request_body = StageOrder,
    responses((status = 200, body = StudioBody),
        (status = 404, description = "`no_studio`", body = ProblemBody, content_type = "application/problem+json")))]
pub(super) async fn direct(
    State(app): State<App>,
    extract::Json(order): extract::Json<StageOrder>,
) -> Result<Json<StudioBody>, Problem> {
    let studio = studio(&app)?;
    studio.direct(order).map_err(|words| Problem::bad_request("value_invalid", words))?;
    let now = studio.describe();
    app.desk.events().tell(Topic::Studio, now.words.clone(), json!(now));
    Ok(Json(now))
}
