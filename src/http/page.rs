//! The control page: the files of `web/dist`, inside the binary.

use super::extract::Path;
use super::problem::Problem;
use axum::http::{HeaderMap, HeaderValue, StatusCode, header};
use axum::response::{IntoResponse, Response};
use rust_embed::RustEmbed;

#[derive(RustEmbed)]
#[folder = "web/dist"]
struct Dist;

/// `GET /`.
pub(super) async fn index(headers: HeaderMap) -> Response {
    asset("index.html", &headers)
}

/// `GET /assets/...`.
pub(super) async fn file(Path(name): Path<String>, headers: HeaderMap) -> Response {
    asset(&format!("assets/{name}"), &headers)
}

/// File names do not change from build to build, so browsers ask each time and are told when nothing changed.
fn asset(name: &str, headers: &HeaderMap) -> Response {
    let Some(found) = Dist::get(name) else {
        return Problem::not_found("not_found", format!("there is no page {name}")).into_response();
    };
    let tag = found.metadata.sha256_hash().iter().take(16).fold(String::from("\""), |mut tag, byte| {
        tag.push_str(&format!("{byte:02x}"));
        tag
    }) + "\"";
    let same = headers.get(header::IF_NONE_MATCH).is_some_and(|t| t.as_bytes() == tag.as_bytes());
    let kind = mime_guess::from_path(name).first_or_octet_stream();
    let mut response = if same {
        StatusCode::NOT_MODIFIED.into_response()
    } else {
        ([(header::CONTENT_TYPE, kind.as_ref())], found.data.into_owned()).into_response()
    };
    let out = response.headers_mut();
    out.insert(header::CACHE_CONTROL, HeaderValue::from_static("no-cache"));
    if let Ok(tag) = HeaderValue::from_str(&tag) {
        out.insert(header::ETAG, tag);
    }
    response
}
