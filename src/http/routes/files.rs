//! A session's files, to be read.

use super::blocking;
use crate::capture::Desk;
use crate::http::App;
use crate::http::guard::FILE_POLICY;
use crate::http::problem::{Problem, ProblemBody};
use axum::body::Body;
use axum::extract::rejection::PathRejection;
use axum::extract::{Path, State};
use axum::http::{HeaderValue, header};
use axum::response::{IntoResponse, Response};
use std::fs::File;
use std::io::Read;
use std::path::PathBuf;
use tokio::sync::mpsc;
use tokio_stream::wrappers::ReceiverStream;

/// Bytes read at a time.
const PIECE: usize = 256 * 1024;

/// A file of a session: originals, results, derived images.
#[utoipa::path(get, path = "/api/v1/sessions/{session}/files/{*path}", tag = "capture",
    params(("session" = String, Path, description = "Name of the session"),
        ("path" = String, Path, description = "Path inside the session, with its slashes")),
    responses((status = 200, body = Vec<u8>, content_type = "application/octet-stream"),
        (status = 404, body = ProblemBody, content_type = "application/problem+json")))]
pub(super) async fn fetch(
    State(app): State<App>,
    path: Result<Path<(String, String)>, PathRejection>,
) -> Result<Response, Problem> {
    let Path((session, path)) = path?;
    let missing =
        || Problem::not_found("file_not_found", format!("session {session:?} has no file {path:?}"));
    let (desk, name, inside) = (app.desk.clone(), session.clone(), path.clone());
    let file = blocking(move || locate(&desk, &name, &inside)).await?.ok_or_else(missing)?;
    let kind = mime_guess::from_path(&file).first_or_octet_stream();
    let file = File::open(&file).map_err(|_| missing())?;
    let length = file.metadata().map_err(Problem::internal)?.len();

    let (sender, receiver) = mpsc::channel(2);
    tokio::task::spawn_blocking(move || send(file, &sender));
    let mut response = Body::from_stream(ReceiverStream::new(receiver)).into_response();
    let headers = response.headers_mut();
    headers.insert(header::CONTENT_LENGTH, HeaderValue::from(length));
    if let Ok(kind) = HeaderValue::from_str(kind.as_ref()) {
        headers.insert(header::CONTENT_TYPE, kind);
    }
    headers.insert(header::CONTENT_SECURITY_POLICY, HeaderValue::from_static(FILE_POLICY));
    Ok(response)
}

/// Reads the file to its end, no faster than the client takes it; stops when the client leaves.
fn send(mut file: File, sender: &mpsc::Sender<std::io::Result<Vec<u8>>>) {
    loop {
        let mut piece = Vec::with_capacity(PIECE);
        let read = (&mut file).take(PIECE as u64).read_to_end(&mut piece);
        let more = matches!(read, Ok(n) if n > 0);
        if matches!(read, Ok(0)) || sender.blocking_send(read.map(|_| piece)).is_err() || !more {
            return;
        }
    }
}

/// The file if it lies inside the session after every link was followed. Hidden files are nobody's business.
fn locate(desk: &Desk, session: &str, path: &str) -> Result<Option<PathBuf>, crate::capture::DeskError> {
    let session = desk.session(session)?;
    if path.split('/').any(|part| part.is_empty() || part.starts_with('.')) {
        return Ok(None);
    }
    let (Ok(root), Ok(file)) = (session.path().canonicalize(), session.path().join(path).canonicalize())
    else {
        return Ok(None);
    };
    Ok((file.starts_with(&root) && file.is_file()).then_some(file))
}
