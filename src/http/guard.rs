//! Who may ask, request by request.
//!
//! Any web page that the photographer's browser has open can send requests here. Four checks stop it: the `Host`
//! must be a name of ours, or else a foreign name was made to point at us (DNS rebinding); where a browser names
//! an `Origin`, it must be our own; where it says with `Sec-Fetch-Site` whose page asks, that must be ours, too,
//! except that the page itself may be opened from anywhere; and where a token is in force, every request must show
//! that it is let in (see `door`). They hold for every route alike, for reading as for changing.

use super::door::{Credentials, Door, Refusal};
use super::listen::Arrival;
use super::pairing;
use super::problem::Problem;
use axum::extract::{Request, State};
use axum::http::{HeaderMap, HeaderName, HeaderValue, Method, StatusCode, Uri, header};
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};
use std::net::IpAddr;
use std::sync::Arc;

/// Middleware: refuses strangers, and gives each answer the headers that keep the page to itself.
pub(super) async fn guard(State(door): State<Arc<Door>>, mut request: Request, next: Next) -> Response {
    let local = request.extensions().get::<Arrival>().map(|arrival| arrival.local.ip());
    let checked = check(&door, request.method(), request.uri(), request.headers(), local);
    let mut response = match checked.and_then(|()| let_in(&door, &mut request)) {
        Ok(Entry::Free) => next.run(request).await,
        Ok(Entry::Pairing) => pairing::page(&door),
        Err(problem) => problem.into_response(),
    };
    if response.status() == StatusCode::UNAUTHORIZED {
        let challenge = HeaderValue::from_static("Bearer realm=\"unlit\"");
        response.headers_mut().insert(header::WWW_AUTHENTICATE, challenge);
    }
    furnish(response.headers_mut());
    response
}

/// The headers of every answer; what a handler has set stays.
fn furnish(headers: &mut HeaderMap) {
    for (name, value) in [
        (header::CONTENT_SECURITY_POLICY, PAGE_POLICY),
        (header::X_CONTENT_TYPE_OPTIONS, "nosniff"),
        (header::X_FRAME_OPTIONS, "DENY"),
        (header::REFERRER_POLICY, "no-referrer"),
        (HeaderName::from_static("cross-origin-resource-policy"), "same-origin"),
        (HeaderName::from_static("cross-origin-opener-policy"), "same-origin"),
        (HeaderName::from_static("permissions-policy"), NO_SENSORS),
    ] {
        headers.entry(name).or_insert(HeaderValue::from_static(value));
    }
    let kind = headers.get(header::CONTENT_TYPE).map_or(&b""[..], HeaderValue::as_bytes);
    if kind.starts_with(b"application/json") || kind.starts_with(b"application/problem+json") {
        headers.entry(header::CACHE_CONTROL).or_insert(HeaderValue::from_static("no-store"));
    }
}

/// The page loads nothing but itself.
const PAGE_POLICY: &str =
    "default-src 'self'; img-src 'self' blob:; base-uri 'none'; form-action 'none'; frame-ancestors 'none'";

/// The page has no use for the browser's own devices.
const NO_SENSORS: &str = "camera=(), microphone=(), geolocation=(), usb=(), serial=(), payment=()";

/// What a session's own HTML (the report) may do: show itself, and nothing else.
pub(super) const FILE_POLICY: &str =
    "default-src 'none'; style-src 'unsafe-inline'; img-src 'self' data:; sandbox; frame-ancestors 'none'";

/// Whether request and browser agree that this is ours to answer.
fn check(
    door: &Door,
    method: &Method,
    uri: &Uri,
    headers: &HeaderMap,
    local: Option<IpAddr>,
) -> Result<(), Problem> {
    let hosts: Vec<_> = headers.get_all(header::HOST).iter().collect();
    let host = match hosts.as_slice() {
        [host] => host.to_str().unwrap_or(""),
        _ => "",
    };
    // A request may name its host in its first line, too; then it must not say two things.
    let agrees = uri.authority().is_none_or(|named| named.as_str().eq_ignore_ascii_case(host));
    if !agrees || !door.answers_to(host, local) {
        let words = format!(
            "requests for host {host:?} are not answered; ask for localhost, for 127.0.0.1, or for a name given \
             with --allow-host"
        );
        return Err(Problem::new(StatusCode::MISDIRECTED_REQUEST, "host_refused", words));
    }
    if let Some(origin) = headers.get(header::ORIGIN) {
        let origin = origin.to_str().unwrap_or("an unreadable origin");
        let authority = origin.strip_prefix("http://").or_else(|| origin.strip_prefix("https://"));
        if !authority.is_some_and(|authority| authority.eq_ignore_ascii_case(host)) {
            let words = format!("a page from {origin} asked; only the page served from {host} may do that");
            return Err(Problem::new(StatusCode::FORBIDDEN, "origin_refused", words));
        }
    }
    let fetch = |name: &str| headers.get(name).map_or("", |value| value.to_str().unwrap_or("unreadable"));
    if !matches!(fetch("sec-fetch-site"), "" | "none" | "same-origin") {
        let opens_page = matches!(*method, Method::GET | Method::HEAD)
            && uri.path() == "/"
            && fetch("sec-fetch-mode") == "navigate"
            && fetch("sec-fetch-dest") == "document";
        if !opens_page {
            let words = format!("a page of another site asked for {}; only our own page may", uri.path());
            return Err(Problem::new(StatusCode::FORBIDDEN, "cross_site_refused", words));
        }
    }
    let upgrade = headers.get(header::UPGRADE).map_or(&b""[..], HeaderValue::as_bytes);
    if upgrade.eq_ignore_ascii_case(b"websocket") {
        let words = "there are no WebSockets here; events come from GET /api/v1/events as server-sent events";
        return Err(Problem::bad_request("websocket_refused", words));
    }
    Ok(())
}

/// How a request goes on.
#[derive(Debug, PartialEq, Eq)]
enum Entry {
    /// To its handler.
    Free,
    /// Nobody knows who asks for the page: the pairing page instead.
    Pairing,
}

/// Whether the request is let in. A ticket is taken out of the address, so that nothing writes it down.
fn let_in(door: &Door, request: &mut Request) -> Result<Entry, Problem> {
    let reads = matches!(*request.method(), Method::GET | Method::HEAD);
    let ticket = if reads { take_ticket(request.uri_mut()) } else { None };
    let path = request.uri().path();
    if pairing::is_open_to_all(path) {
        return Ok(Entry::Free);
    }
    let brought = credentials(request.headers(), ticket.as_deref());
    let refused = |status, code, words: &str| Err(Problem::new(status, code, words));
    match door.admit(brought, path) {
        Ok(()) => Ok(Entry::Free),
        Err(Refusal::Unknown) if path == "/" && reads => Ok(Entry::Pairing),
        Err(Refusal::Unknown) => refused(
            StatusCode::UNAUTHORIZED,
            "not_paired",
            "who asks is not known: open the page at / and enter the code that the daemon shows, or send the \
             token as `Authorization: Bearer`",
        ),
        Err(Refusal::WrongToken) => refused(
            StatusCode::FORBIDDEN,
            "token_refused",
            "this is not the daemon's token; it stands in the file given with --token-file",
        ),
        Err(Refusal::DeadTicket) => refused(
            StatusCode::FORBIDDEN,
            "ticket_refused",
            "the ticket was used, is too old, or is for another path; get a new one from POST /api/v1/tickets",
        ),
    }
}

/// What a request brings to be let in.
pub(super) fn credentials<'a>(headers: &'a HeaderMap, ticket: Option<&'a str>) -> Credentials<'a> {
    Credentials { bearer: bearer(headers), ticket, cookie: pairing::cookie(headers) }
}

/// The token of an `Authorization: Bearer` header; other schemes are a proxy's business.
fn bearer(headers: &HeaderMap) -> Option<&str> {
    let (scheme, token) = headers.get(header::AUTHORIZATION)?.to_str().ok()?.split_once(' ')?;
    scheme.eq_ignore_ascii_case("bearer").then(|| token.trim())
}

/// Takes `ticket=...` out of the query.
fn take_ticket(uri: &mut Uri) -> Option<String> {
    let query = uri.query()?;
    let ticket = query.split('&').find_map(|pair| pair.strip_prefix("ticket="))?.to_owned();
    let rest: Vec<_> = query.split('&').filter(|pair| !pair.starts_with("ticket=")).collect();
    let without = match rest.as_slice() {
        [] => uri.path().to_owned(),
        rest => format!("{}?{}", uri.path(), rest.join("&")),
    };
    let mut parts = uri.clone().into_parts();
    // It came out of an address, and so it goes into one.
    parts.path_and_query = Some(without.parse().ok()?);
    *uri = Uri::from_parts(parts).ok()?;
    Some(ticket)
}

#[cfg(test)]
mod tests {
    use super::*;

    const OWN: &str = "127.0.0.1:8710";

    fn ask(method: Method, path: &str, pairs: &[(&'static str, &str)]) -> Result<(), u16> {
        let named =
            |(n, v): &(&'static str, &str)| (HeaderName::from_static(n), HeaderValue::from_str(v).unwrap());
        let headers = pairs.iter().map(named).collect();
        check(&Door::default(), &method, &path.parse().unwrap(), &headers, None)
            .map_err(|p| p.into_response().status().as_u16())
    }

    #[test]
    fn a_foreign_host_is_misdirected_even_when_it_only_reads() {
        assert_eq!(ask(Method::GET, "/", &[("host", "evil.example:8710")]), Err(421));
        assert_eq!(ask(Method::GET, "/", &[]), Err(421));
        assert_eq!(ask(Method::GET, "http://evil.example/", &[("host", OWN)]), Err(421));
        assert_eq!(ask(Method::GET, "http://127.0.0.1:8710/", &[("host", OWN)]), Ok(()));
    }

    #[test]
    fn two_hosts_are_none() {
        let mut headers = HeaderMap::new();
        for host in [OWN, OWN] {
            headers.append(header::HOST, HeaderValue::from_static(host));
        }
        assert!(check(&Door::default(), &Method::GET, &"/".parse().unwrap(), &headers, None).is_err());
    }

    #[test]
    fn a_foreign_page_may_neither_change_nor_read_nor_listen() {
        for origin in ["https://evil.example", "null", "http://127.0.0.1:9999", "http://127.0.0.1", ""] {
            for (method, path) in [
                (Method::POST, "/api/v1/pairs"),
                (Method::DELETE, "/api/v1/jobs/1"),
                (Method::GET, "/api/v1/events"),
                (Method::GET, "/api/v1/live.mjpg"),
                (Method::GET, "/"),
            ] {
                assert_eq!(
                    ask(method, path, &[("host", OWN), ("origin", origin)]),
                    Err(403),
                    "{origin} {path}"
                );
            }
        }
        let own = [("host", OWN), ("origin", "http://127.0.0.1:8710")];
        assert_eq!(ask(Method::POST, "/api/v1/pairs", &own), Ok(()));
        assert_eq!(ask(Method::POST, "/api/v1/pairs", &[("host", OWN)]), Ok(()), "scripts send no origin");
    }

    #[test]
    fn another_sites_page_may_open_the_page_and_nothing_else() {
        let from = |site, mode, dest| {
            [("host", OWN), ("sec-fetch-site", site), ("sec-fetch-mode", mode), ("sec-fetch-dest", dest)]
        };
        for site in ["cross-site", "same-site", "news"] {
            assert_eq!(ask(Method::GET, "/", &from(site, "navigate", "document")), Ok(()), "{site}");
            assert_eq!(ask(Method::GET, "/", &from(site, "navigate", "iframe")), Err(403), "{site}");
            assert_eq!(ask(Method::POST, "/", &from(site, "navigate", "document")), Err(403), "{site}");
            for path in ["/api/v1/live.mjpg", "/api/v1/events", "/api/v1/sessions", "/assets/page.js"] {
                assert_eq!(
                    ask(Method::GET, path, &from(site, "no-cors", "image")),
                    Err(403),
                    "{site} {path}"
                );
                assert_eq!(ask(Method::GET, path, &from(site, "navigate", "document")), Err(403), "{path}");
            }
        }
        for site in ["same-origin", "none"] {
            assert_eq!(ask(Method::GET, "/api/v1/live.mjpg", &from(site, "no-cors", "image")), Ok(()));
        }
    }

    #[test]
    fn a_ticket_leaves_the_address() {
        let taken = |text: &str| {
            let mut uri: Uri = text.parse().unwrap();
            let ticket = take_ticket(&mut uri);
            (ticket, uri.to_string())
        };
        assert_eq!(taken("/a?ticket=t"), (Some("t".into()), "/a".into()));
        assert_eq!(taken("/a?x=1&ticket=t&wait=true"), (Some("t".into()), "/a?x=1&wait=true".into()));
        assert_eq!(taken("/a?wait=true"), (None, "/a?wait=true".into()));
    }

    #[test]
    fn bearer_is_read_and_a_proxys_password_is_not() {
        let of = |value: &'static str| {
            let headers = HeaderMap::from_iter([(header::AUTHORIZATION, HeaderValue::from_static(value))]);
            bearer(&headers).map(str::to_owned)
        };
        assert_eq!(of("Bearer abc"), Some("abc".into()));
        assert_eq!(of("bearer  abc"), Some("abc".into()));
        assert_eq!(of("Basic abc"), None);
    }
}
