//! Whose request a line of the log and a problem belong to: every request has an id, in the log, in the header of its answer
//! and in its problem. Paths are logged as the routes write them, and queries and bodies never are.

use super::App;
use axum::extract::{MatchedPath, Request, State};
use axum::http::{HeaderMap, HeaderName, HeaderValue, Method};
use axum::middleware::Next;
use axum::response::Response;
use std::time::Instant;
use tracing::Instrument;

/// Where clients give an id and read it.
const HEADER: HeaderName = HeaderName::from_static("x-request-id");
/// Longest id that a client may give.
const LONGEST: usize = 64;

tokio::task_local! {
    static ID: HeaderValue;
}

/// The id of the request that is being answered on this task.
pub(super) fn request_id() -> Option<String> {
    ID.try_with(|id| id.to_str().map(str::to_owned)).ok()?.ok()
}

/// Middleware: gives the request its id, has everything logged under it, and logs how it was answered.
pub(super) async fn trace(State(app): State<App>, request: Request, next: Next) -> Response {
    let began = Instant::now();
    let id = given(request.headers()).unwrap_or_else(fresh);
    let method = request.method().clone();
    let path = request.extensions().get::<MatchedPath>().cloned();
    let path = path.as_ref().map_or("none", MatchedPath::as_str);
    let span = tracing::error_span!("request", id = id.to_str().unwrap_or_default(), %method, path);
    let mut response = ID.scope(id.clone(), next.run(request)).instrument(span.clone()).await;
    response.headers_mut().insert(HEADER, id);
    let (status, ms) = (response.status().as_u16(), began.elapsed().as_secs_f64() * 1e3);
    span.in_scope(|| match method {
        Method::GET | Method::HEAD => tracing::debug!(status, ms, "answered"),
        _ => tracing::info!(status, ms, "answered"),
    });
    app.vitals.counted(response)
}

/// The client's own id, if it can stand in a log.
fn given(headers: &HeaderMap) -> Option<HeaderValue> {
    let id = headers.get(HEADER)?;
    let sane = |byte: &u8| byte.is_ascii_alphanumeric() || b"-_.:".contains(byte);
    (1..=LONGEST).contains(&id.len()).then_some(id).filter(|id| id.as_bytes().iter().all(sane)).cloned()
}

fn fresh() -> HeaderValue {
    HeaderValue::try_from(format!("{:016x}", rand::random::<u64>()))
        .unwrap_or(HeaderValue::from_static("none"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ids_that_could_spoil_a_log_are_not_taken() {
        let taken = |id: &[u8]| {
            given(&HeaderMap::from_iter([(HEADER, HeaderValue::from_bytes(id).unwrap())])).is_some()
        };
        assert!(taken(b"shoot-7.a_B:9") && taken(&[b'a'; 64]));
        for id in
            [b"".as_slice(), &[b'a'; 65], b"a b", b"a\"b", b"\x1b[31m".get(1..).unwrap(), "ä".as_bytes()]
        {
            assert!(!taken(id), "{id:?}");
        }
        assert_eq!(fresh().len(), 16);
        assert_ne!(fresh(), fresh());
    }
}
