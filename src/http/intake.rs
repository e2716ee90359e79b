//! What bodies may be like: how large, of which kind, and how slow.
//!
//! A form of another site can be sent here without that site's asking, but not as JSON: so JSON is asked for
//! wherever there is a body, and a form only where files are handed in. A body that is too large is refused before
//! it is read; one that comes too slowly is given up.

use super::door::Patience;
use super::listen::Arrival;
use super::problem::Problem;
use axum::Extension;
use axum::body::{Body, Bytes};
use axum::extract::Request;
use axum::http::{HeaderMap, Method, StatusCode, header};
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};
use hyper::body::{Body as HttpBody, Frame, SizeHint};
use std::pin::Pin;
use std::sync::{Arc, OnceLock};
use std::task::{Context, Poll};
use std::time::Duration;
use tokio::time::{Instant, Sleep};

/// Largest body of JSON in bytes; the largest that makes sense has some hundreds.
const JSON_LIMIT: u64 = 64 * 1024;
/// How files are sent.
const FORM: &str = "multipart/form-data";
/// Largest upload in bytes.
pub(super) const UPLOAD_LIMIT: u64 = 1 << 30;

/// Middleware of the routes that take JSON or nothing.
pub(super) async fn json(Extension(arrival): Extension<Arrival>, request: Request, next: Next) -> Response {
    taken(arrival.patience, request, next, JSON_LIMIT, "application/json").await
}

/// Middleware of the routes that take files.
pub(super) async fn upload(Extension(arrival): Extension<Arrival>, request: Request, next: Next) -> Response {
    taken(arrival.patience, request, next, UPLOAD_LIMIT, FORM).await
}

/// Middleware of the routes that take either.
pub(super) async fn either(arrival: Extension<Arrival>, request: Request, next: Next) -> Response {
    match is_form(request.headers()) {
        true => upload(arrival, request, next).await,
        false => json(arrival, request, next).await,
    }
}

/// Whether the body is a form with files.
pub(super) fn is_form(headers: &HeaderMap) -> bool {
    let given = headers.get(header::CONTENT_TYPE).and_then(|kind| kind.to_str().ok()).unwrap_or_default();
    given.split(';').next().unwrap_or_default().trim().eq_ignore_ascii_case(FORM)
}

async fn taken(patience: Patience, request: Request, next: Next, limit: u64, kind: &str) -> Response {
    if let Err(problem) = check(request.method(), request.headers(), limit, kind) {
        return problem.into_response();
    }
    let fault = Arc::new(OnceLock::new());
    let (body, rate) = (fault.clone(), patience.body_rate);
    let begun = Instant::now();
    let request = request.map(|inner| {
        Body::new(Metered {
            inner,
            left: limit,
            read: 0,
            begun,
            grace: patience.body,
            rate,
            alarm: Box::pin(tokio::time::sleep(patience.body)),
            fault: body,
        })
    });
    let response = next.run(request).await;
    match fault.get() {
        None => response,
        Some(Fault::TooLarge) => too_large(limit).into_response(),
        Some(Fault::TooSlow) => {
            let words = format!("the body came too slowly: it must bring {rate} bytes a second");
            Problem::new(StatusCode::REQUEST_TIMEOUT, "body_too_slow", words).into_response()
        }
    }
}

fn too_large(limit: u64) -> Problem {
    let words = format!("the body is larger than the {limit} bytes that are taken here");
    Problem::new(StatusCode::PAYLOAD_TOO_LARGE, "body_too_large", words)
}

/// What the head of the request tells already.
fn check(method: &Method, headers: &HeaderMap, limit: u64, kind: &str) -> Result<(), Problem> {
    let length = headers.get(header::CONTENT_LENGTH).and_then(|l| l.to_str().ok()?.parse::<u64>().ok());
    if length.is_some_and(|length| length > limit) {
        return Err(too_large(limit));
    }
    let given = headers.get(header::CONTENT_TYPE).map(|k| k.to_str().unwrap_or("unreadable"));
    let has_body = length.is_some_and(|l| l > 0) || headers.contains_key(header::TRANSFER_ENCODING);
    if matches!(*method, Method::GET | Method::HEAD) || (given.is_none() && !has_body) {
        return Ok(());
    }
    let essence = given.unwrap_or("none").split(';').next().unwrap_or("").trim();
    if essence.eq_ignore_ascii_case(kind) {
        return Ok(());
    }
    let words = format!("the body's Content-Type is {essence:?}, but must be {kind}");
    Err(Problem::new(StatusCode::UNSUPPORTED_MEDIA_TYPE, "content_type_unsupported", words))
}

/// What became wrong while a body was read.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Fault {
    TooLarge,
    TooSlow,
}

/// A body that is counted while it is read.
struct Metered {
    inner: Body,
    /// Bytes that may still come.
    left: u64,
    read: u64,
    begun: Instant,
    grace: Duration,
    /// Bytes a second, once the grace is over.
    rate: u64,
    alarm: Pin<Box<Sleep>>,
    /// Told to the middleware: the handler sees only that the body broke off.
    fault: Arc<OnceLock<Fault>>,
}

impl Metered {
    fn broken(&self, fault: Fault) -> Poll<Option<Result<Frame<Bytes>, axum::Error>>> {
        // Whoever reads on after an error hears of the first one.
        let _first = self.fault.get_or_init(|| fault);
        Poll::Ready(Some(Err(axum::Error::new(std::io::Error::other("the body broke off")))))
    }
}

impl HttpBody for Metered {
    type Data = Bytes;
    type Error = axum::Error;

    fn poll_frame(
        mut self: Pin<&mut Self>,
        context: &mut Context<'_>,
    ) -> Poll<Option<Result<Frame<Bytes>, axum::Error>>> {
        match Pin::new(&mut self.inner).poll_frame(context) {
            Poll::Ready(Some(Ok(frame))) => {
                let length = frame.data_ref().map_or(0, |data| data.len() as u64);
                let Some(left) = self.left.checked_sub(length) else {
                    return self.broken(Fault::TooLarge);
                };
                self.left = left;
                self.read += length;
                Poll::Ready(Some(Ok(frame)))
            }
            Poll::Pending => {
                // What came has earned its time.
                let earned = Duration::from_secs_f64(self.read as f64 / self.rate.max(1) as f64);
                let until = self.begun + self.grace + earned;
                self.alarm.as_mut().reset(until);
                match self.alarm.as_mut().poll(context) {
                    Poll::Ready(()) => self.broken(Fault::TooSlow),
                    Poll::Pending => Poll::Pending,
                }
            }
            other => other,
        }
    }

    fn is_end_stream(&self) -> bool {
        self.inner.is_end_stream()
    }

    fn size_hint(&self) -> SizeHint {
        self.inner.size_hint()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use axum::http::HeaderValue;

    fn asked(method: Method, pairs: &[(header::HeaderName, &'static str)]) -> Result<(), u16> {
        let headers = pairs.iter().map(|(n, v)| (n.clone(), HeaderValue::from_static(v))).collect();
        check(&method, &headers, JSON_LIMIT, "application/json")
            .map_err(|p| p.into_response().status().as_u16())
    }

    #[test]
    fn json_and_nothing_pass_and_what_forms_send_does_not() {
        let length = (header::CONTENT_LENGTH, "2");
        for kind in ["application/json", "Application/JSON; charset=utf-8"] {
            assert_eq!(asked(Method::POST, &[(header::CONTENT_TYPE, kind), length.clone()]), Ok(()));
        }
        for kind in ["text/plain", "application/x-www-form-urlencoded", "multipart/form-data; boundary=x", ""]
        {
            assert_eq!(
                asked(Method::POST, &[(header::CONTENT_TYPE, kind)]),
                Err(415),
                "{kind}, without a body"
            );
        }
        assert_eq!(asked(Method::POST, &[]), Ok(()));
        assert_eq!(asked(Method::POST, &[(header::CONTENT_LENGTH, "0")]), Ok(()));
        assert_eq!(asked(Method::POST, &[length]), Err(415), "a body of no kind");
        assert_eq!(asked(Method::PUT, &[(header::TRANSFER_ENCODING, "chunked")]), Err(415));
    }

    #[test]
    fn what_says_itself_that_it_is_too_large_is_refused() {
        let of = |length| {
            asked(
                Method::POST,
                &[(header::CONTENT_TYPE, "application/json"), (header::CONTENT_LENGTH, length)],
            )
        };
        assert_eq!(of("65536"), Ok(()));
        assert_eq!(of("65537"), Err(413));
    }
}
