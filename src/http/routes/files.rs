//! A session's files, to be read: all of one, a part of it, or nothing where the client has it already.

use super::blocking;
use crate::http::App;
use crate::http::extract::Path;
use crate::http::file_bodies::FileBody;
use crate::http::guard::FILE_POLICY;
use crate::http::problem::{Problem, ProblemBody};
use crate::http::ranges::{self, Answer};
use crate::session::SessionFile;
use axum::Json;
use axum::body::Body;
use axum::extract::State;
use axum::http::{HeaderMap, HeaderName, HeaderValue, Method, StatusCode, header};
use axum::response::{IntoResponse, Response};
use std::io::SeekFrom;
use std::ops::Range;
use std::time::UNIX_EPOCH;
use tokio::fs::File;
use tokio::io::{AsyncReadExt, AsyncSeekExt};
use tokio_util::io::ReaderStream;

/// Bytes read at a time. Nothing is read before the client has taken what was read before, and no thread waits for it.
const PIECE: usize = 256 * 1024;

/// The session's files, by name: originals, records, calibration, scene, results.
#[utoipa::path(get, path = "/api/v1/sessions/{session}/files", tag = "capture",
    params(("session" = String, Path, description = "Name of the session", example = "birdbath")),
    responses((status = 200, body = Vec<FileBody>)))]
pub(super) async fn list(
    State(app): State<App>,
    Path(session): Path<String>,
) -> Result<Json<Vec<FileBody>>, Problem> {
    blocking(move || {
        let files = app.desk.files(&session)?;
        Ok(Json(files.into_iter().map(|file| FileBody::new(&session, file)).collect()))
    })
    .await
}

/// A file of a session, by the id that its listing, its pair or the session's `results` give.
#[utoipa::path(get, path = "/api/v1/sessions/{session}/files/{id}", tag = "capture",
    params(("session" = String, Path, description = "Name of the session", example = "birdbath"),
        ("id" = String, Path, description = "Id of the file", example = "42c32f4604e022021d62e539359532cb"),
        ("If-None-Match" = Option<String>, Header, description = "Entity tags that the client has"),
        ("If-Match" = Option<String>, Header, description = "The entity tag that it must have"),
        ("If-Range" = Option<String>, Header, description = "The entity tag for which `Range` is meant"),
        ("Range" = Option<String>, Header, description = "One range of bytes", example = "bytes=0-99")),
    responses(
        (status = 200, description = "all of it, whatever it is", body = serde_json::Value, content_type = "*/*",
            headers(("ETag" = String), ("Accept-Ranges" = String), ("Content-Disposition" = String))),
        (status = 206, description = "the part that was asked for",
            headers(("ETag" = String), ("Content-Range" = String))),
        (status = 304, description = "the client has it", headers(("ETag" = String))),
        (status = 412, description = "`file_changed`", body = ProblemBody,
            content_type = "application/problem+json"),
        (status = 416, description = "`range_not_satisfiable`", body = ProblemBody,
            content_type = "application/problem+json", headers(("Content-Range" = String)))))]
pub(super) async fn fetch(
    State(app): State<App>,
    Path((session, id)): Path<(String, String)>,
    method: Method,
    headers: HeaderMap,
) -> Result<Response, Problem> {
    let (file, about) = blocking(move || app.desk.open_file(&session, &id)).await?;
    let tag = tag(&about);
    let answer = match ranges::answer(&headers, &tag, about.bytes) {
        // A range is a matter of GET alone.
        Answer::Part(_) | Answer::NoSuchPart if method == Method::HEAD => Answer::Whole,
        other => other,
    };
    let range_header = |range: String| (header::CONTENT_RANGE, range);
    let file = File::from_std(file);
    let mut response = match answer {
        Answer::Whole => part_of(file, 0..about.bytes).await?,
        Answer::Part(part) => {
            let range = range_header(format!("bytes {}-{}/{}", part.start, part.end - 1, about.bytes));
            (StatusCode::PARTIAL_CONTENT, [range], part_of(file, part).await?).into_response()
        }
        Answer::NotModified => StatusCode::NOT_MODIFIED.into_response(),
        Answer::Changed => {
            let words = format!("{} is not the file any more that If-Match names", about.path);
            return Err(Problem::new(StatusCode::PRECONDITION_FAILED, "file_changed", words));
        }
        Answer::NoSuchPart => {
            let words = format!("{} has {} bytes; ask for some of these", about.path, about.bytes);
            let problem = Problem::new(StatusCode::RANGE_NOT_SATISFIABLE, "range_not_satisfiable", words);
            return Ok(([range_header(format!("bytes */{}", about.bytes))], problem).into_response());
        }
    };
    let kind = mime_guess::from_path(&about.path).first_or_octet_stream();
    describe(response.headers_mut(), &about, &tag, kind.as_ref());
    Ok(response)
}

/// A tag that changes with the file: its digest where one was written down, else when it was written and its length.
fn tag(about: &SessionFile) -> String {
    let written = || about.modified.duration_since(UNIX_EPOCH).map_or(0, |since| since.as_nanos());
    about
        .blake3
        .as_ref()
        .map_or_else(|| format!("\"{:x}-{:x}\"", written(), about.bytes), |b| format!("\"{b}\""))
}

async fn part_of(mut file: File, part: Range<u64>) -> Result<Response, Problem> {
    if part.start > 0 {
        file.seek(SeekFrom::Start(part.start)).await.map_err(Problem::internal)?;
    }
    let bytes = part.end - part.start;
    let stream = ReaderStream::with_capacity(file.take(bytes), PIECE);
    Ok(([(header::CONTENT_LENGTH, bytes)], Body::from_stream(stream)).into_response())
}

fn describe(headers: &mut HeaderMap, about: &SessionFile, tag: &str, kind: &str) {
    let disposition = format!("inline; filename=\"{}\"", plain_name(&about.path));
    let values: [(HeaderName, &str); 6] = [
        (header::CONTENT_TYPE, kind),
        (header::ETAG, tag),
        (header::ACCEPT_RANGES, "bytes"),
        (header::CONTENT_DISPOSITION, &disposition),
        // The same id may hold another file tomorrow; asking again costs little.
        (header::CACHE_CONTROL, "private, no-cache"),
        (header::CONTENT_SECURITY_POLICY, FILE_POLICY),
    ];
    for (name, value) in values {
        if let Ok(value) = HeaderValue::from_str(value) {
            headers.insert(name, value);
        }
    }
}

/// The name under which a browser keeps the file: that of a frame with its pair's number, for they are all called alike.
fn plain_name(path: &str) -> String {
    let mut steps = path.rsplit('/');
    let name = steps.next().unwrap_or(path);
    let name = match steps.next() {
        Some(folder) if path.matches('/').count() > 1 => format!("{folder}_{name}"),
        _ => name.to_owned(),
    };
    name.replace(|c: char| !c.is_ascii() || c.is_ascii_control() || matches!(c, '"' | '\\'), "_")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn frames_are_kept_under_their_pairs_number_and_no_name_breaks_the_header() {
        assert_eq!(plain_name("pairs/0007/off.cr2"), "0007_off.cr2");
        assert_eq!(plain_name("model/report.html"), "report.html");
        assert_eq!(plain_name("scene/m\"\u{e4}\\\n.obj"), "m____.obj");
    }
}
