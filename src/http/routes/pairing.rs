//! Being let in where a token is in force: pairing a browser, tickets for what can set no header. What they are
//! worth is decided in `door`.

use crate::http::App;
use crate::http::door::{Pairing, TICKET_LASTS};
use crate::http::guard::credentials;
use crate::http::listen::Arrival;
use crate::http::pairing::{cookie, set_cookie};
use crate::http::pairing_bodies::{PairingBody, PairingOrder, TicketBody, TicketOrder};
use crate::http::problem::{Problem, ProblemBody};
use axum::extract::State;
use axum::extract::rejection::JsonRejection;
use axum::http::{HeaderMap, HeaderValue, StatusCode, Uri, header};
use axum::response::{IntoResponse, Response};
use axum::{Extension, Json};

/// Whether a token is in force, and whether this request would be let in. Answered to anybody.
#[utoipa::path(get, path = "/api/v1/pairing", tag = "access",
    responses((status = 200, body = PairingBody)))]
pub(super) async fn state(State(app): State<App>, headers: HeaderMap) -> Json<PairingBody> {
    let paired = app.door.admit(credentials(&headers, None), "/api/v1/pairing").is_ok();
    Json(PairingBody { required: app.door.locked(), paired })
}

/// Pairs a browser: for the code that the daemon shows on its terminal it gets a cookie. A code is good once, for
/// ten minutes; if none is open, this shows a new one there. Answered to anybody, a few times a
/// minute.
#[utoipa::path(post, path = "/api/v1/pairing", tag = "access", request_body = PairingOrder,
    responses((status = 204, description = "paired", headers(("Set-Cookie" = String))),
        (status = 400, body = ProblemBody, content_type = "application/problem+json"),
        (status = 403, body = ProblemBody, content_type = "application/problem+json"),
        (status = 409, description = "no token is in force", body = ProblemBody,
            content_type = "application/problem+json"),
        (status = 422, body = ProblemBody, content_type = "application/problem+json"),
        (status = 429, description = "too many tries", body = ProblemBody,
            content_type = "application/problem+json", headers(("Retry-After" = u64)))))]
pub(super) async fn pair(
    State(app): State<App>,
    Extension(arrival): Extension<Arrival>,
    headers: HeaderMap,
    order: Result<Json<PairingOrder>, JsonRejection>,
) -> Result<Response, Problem> {
    let Json(order) = order?;
    match app.door.pair(&order.code, arrival.peer.ip()).map_err(Problem::internal)? {
        Pairing::Paired(badge) => {
            let cookie = set_cookie(&badge, &headers)?;
            Ok((StatusCode::NO_CONTENT, [(header::SET_COOKIE, cookie)]).into_response())
        }
        Pairing::Refused => Err(Problem::new(
            StatusCode::FORBIDDEN,
            "code_refused",
            "this is not the code, or it is too old; look at the daemon's terminal or log for the one that is good now",
        )),
        Pairing::TooOften(wait) => {
            let seconds = wait.as_secs() + 1;
            let words = format!("there were too many tries; the next may come in {seconds} s");
            let problem = Problem::new(StatusCode::TOO_MANY_REQUESTS, "too_many_tries", words);
            Ok(([(header::RETRY_AFTER, HeaderValue::from(seconds))], problem).into_response())
        }
        Pairing::NotNeeded => Err(Problem::new(
            StatusCode::CONFLICT,
            "pairing_not_needed",
            "no token is in force: there is nothing to pair with",
        )),
    }
}

/// Ends this browser's pairing: its cookie is good no more.
#[utoipa::path(delete, path = "/api/v1/pairing", tag = "access",
    responses((status = 204, description = "ended", headers(("Set-Cookie" = String)))))]
pub(super) async fn leave(State(app): State<App>, headers: HeaderMap) -> Result<Response, Problem> {
    if let Some(badge) = cookie(&headers) {
        app.door.leave(badge);
    }
    let ended = set_cookie("", &headers)?;
    Ok((StatusCode::NO_CONTENT, [(header::SET_COOKIE, ended)]).into_response())
}

/// A ticket for one GET of one path within half a minute, for what can set neither header nor cookie: an
/// `EventSource`, an `img`, another program that takes an address alone.
#[utoipa::path(post, path = "/api/v1/tickets", tag = "access", request_body = TicketOrder,
    responses((status = 201, body = TicketBody),
        (status = 400, body = ProblemBody, content_type = "application/problem+json"),
        (status = 422, body = ProblemBody, content_type = "application/problem+json"),
        (status = 429, description = "too many are open", body = ProblemBody,
            content_type = "application/problem+json", headers(("Retry-After" = u64)))))]
pub(super) async fn ticket(
    State(app): State<App>,
    order: Result<Json<TicketOrder>, JsonRejection>,
) -> Result<Response, Problem> {
    let Json(order) = order?;
    let wanted = order.path.parse::<Uri>().ok().filter(|uri| uri.authority().is_none());
    let Some(wanted) = wanted.filter(|uri| uri.path().starts_with("/api/v1/")) else {
        let words = format!("path is {:?}, but must be one of this API, such as /api/v1/events", order.path);
        return Err(Problem::bad_request("value_invalid", words));
    };
    let seconds = TICKET_LASTS.as_secs();
    let Some(ticket) = app.door.ticket(wanted.path()).map_err(Problem::internal)? else {
        let problem = Problem::new(
            StatusCode::TOO_MANY_REQUESTS,
            "too_many_tickets",
            "too many tickets are open; use some",
        );
        return Ok(([(header::RETRY_AFTER, HeaderValue::from(seconds))], problem).into_response());
    };
    let join = if wanted.query().is_some() { '&' } else { '?' };
    let url = format!("{wanted}{join}ticket={ticket}");
    Ok((StatusCode::CREATED, Json(TicketBody { ticket, url, expires_in_s: seconds })).into_response())
}
