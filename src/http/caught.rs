//! A handler's mistake ends its own request and nothing else.

use super::problem::Problem;
use axum::extract::Request;
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};
use std::future::{Future, poll_fn};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::pin::pin;
use std::task::Poll;

/// Middleware: a panic becomes a problem with status 500.
pub(super) async fn panics(request: Request, next: Next) -> Response {
    caught(next.run(request)).await
}

async fn caught(answering: impl Future<Output = Response>) -> Response {
    let mut answering = pin!(answering);
    poll_fn(|context| {
        // Handlers share nothing that is left half-changed: what they lock is changed whole.
        catch_unwind(AssertUnwindSafe(|| answering.as_mut().poll(context))).unwrap_or_else(|_| {
            let words = "the program stumbled over its own mistake; please report it with the log";
            Poll::Ready(Problem::internal(words).into_response())
        })
    })
    .await
}

#[cfg(test)]
mod tests {
    use super::*;
    use axum::http::StatusCode;

    #[test]
    fn a_panic_becomes_a_problem_and_an_answer_stays_as_it_is() {
        let runtime = tokio::runtime::Builder::new_current_thread().build().unwrap();
        let stumbled = runtime.block_on(caught(async { panic!("boom") }));
        assert_eq!(stumbled.status(), StatusCode::INTERNAL_SERVER_ERROR);
        assert_eq!(stumbled.headers()["content-type"], "application/problem+json");
        let well = runtime.block_on(caught(async { StatusCode::NO_CONTENT.into_response() }));
        assert_eq!(well.status(), StatusCode::NO_CONTENT);
    }
}
