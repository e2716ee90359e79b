//! Errors on the wire: `application/problem+json` (RFC 9457), each with a stable `code`.
//!
//! The code is for scripts and never changes; `detail` is the domain's own sentence, for people. Which domain error
//! has which status is written in one table, in `routes/mod.rs`.

use super::trace;
use axum::Json;
use axum::extract::multipart::{MultipartError, MultipartRejection};
use axum::extract::rejection::{BytesRejection, JsonRejection, PathRejection, QueryRejection};
use axum::http::{HeaderValue, StatusCode, header};
use axum::response::{IntoResponse, Response};
use serde::Serialize;
use utoipa::ToSchema;

/// Seconds after which it is worth asking again where the queue was full.
const TRY_AGAIN_S: u16 = 5;

/// A problem, as RFC 9457 lays it out.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, ToSchema)]
pub(super) struct ProblemBody {
    /// The HTTP status again.
    #[schema(example = 404)]
    pub(super) status: u16,
    /// Stable name of the problem, for scripts.
    #[schema(example = "session_not_found")]
    pub(super) code: String,
    /// The status in words.
    #[schema(example = "Not Found")]
    pub(super) title: String,
    /// What is the matter and what to do, for people.
    pub(super) detail: String,
    /// Id of the request, as in the header `x-request-id` and in the log.
    #[serde(skip_serializing_if = "Option::is_none")]
    #[schema(example = "3f9a1c0277d2b6e8")]
    pub(super) request_id: Option<String>,
}

/// A problem on its way to the client.
#[derive(Debug)]
pub(super) struct Problem {
    status: StatusCode,
    code: String,
    detail: String,
}

impl Problem {
    pub(super) fn new(status: StatusCode, code: impl Into<String>, detail: impl std::fmt::Display) -> Self {
        Self { status, code: code.into(), detail: detail.to_string() }
    }

    pub(super) fn not_found(code: &str, detail: impl std::fmt::Display) -> Self {
        Self::new(StatusCode::NOT_FOUND, code, detail)
    }

    pub(super) fn bad_request(code: &str, detail: impl std::fmt::Display) -> Self {
        Self::new(StatusCode::BAD_REQUEST, code, detail)
    }

    pub(super) fn internal(detail: impl std::fmt::Display) -> Self {
        Self::new(StatusCode::INTERNAL_SERVER_ERROR, "internal", detail)
    }
}

impl IntoResponse for Problem {
    fn into_response(self) -> Response {
        if self.status.is_server_error() {
            tracing::error!(code = self.code, "{}", self.detail);
        }
        let body = ProblemBody {
            status: self.status.as_u16(),
            code: self.code,
            title: self.status.canonical_reason().unwrap_or("Error").to_owned(),
            detail: self.detail,
            request_id: trace::request_id(),
        };
        let mut response = (self.status, Json(body)).into_response();
        response
            .headers_mut()
            .insert(header::CONTENT_TYPE, HeaderValue::from_static("application/problem+json"));
        if matches!(response.status(), StatusCode::TOO_MANY_REQUESTS | StatusCode::SERVICE_UNAVAILABLE) {
            response.headers_mut().insert(header::RETRY_AFTER, HeaderValue::from(TRY_AGAIN_S));
        }
        response
    }
}

/// A body that cannot be taken: too large, of another type, or not of the form that it should have.
fn body_refused(status: StatusCode, words: impl std::fmt::Display) -> Problem {
    let code = match status {
        StatusCode::PAYLOAD_TOO_LARGE => "body_too_large",
        StatusCode::UNSUPPORTED_MEDIA_TYPE => "content_type_unsupported",
        _ => "body_invalid",
    };
    Problem::new(status, code, words)
}

impl From<JsonRejection> for Problem {
    fn from(rejection: JsonRejection) -> Self {
        body_refused(rejection.status(), rejection.body_text())
    }
}

impl From<BytesRejection> for Problem {
    fn from(rejection: BytesRejection) -> Self {
        body_refused(rejection.status(), rejection.body_text())
    }
}

impl From<MultipartRejection> for Problem {
    fn from(rejection: MultipartRejection) -> Self {
        body_refused(rejection.status(), rejection.body_text())
    }
}

impl From<MultipartError> for Problem {
    fn from(error: MultipartError) -> Self {
        body_refused(error.status(), error.body_text())
    }
}

impl From<PathRejection> for Problem {
    fn from(rejection: PathRejection) -> Self {
        Self::new(rejection.status(), "path_invalid", rejection.body_text())
    }
}

impl From<QueryRejection> for Problem {
    fn from(rejection: QueryRejection) -> Self {
        Self::new(rejection.status(), "query_invalid", rejection.body_text())
    }
}
