//! Who may ask: only this machine, and only pages that this program served.
//!
//! The daemon listens on loopback, but any web page that the photographer's browser has open can send
//! requests there. Two checks stop it: the `Host` must be a loopback name, or else a foreign name was made to
//! point at us (DNS rebinding); and where a browser names an `Origin`, it must be our own.

use super::problem::Problem;
use axum::extract::Request;
use axum::http::{HeaderMap, HeaderValue, Method, StatusCode, header};
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};
use std::net::SocketAddr;

/// The address is none of this machine's own.
#[derive(Debug, thiserror::Error)]
#[error(
    "{0} could be reached from other machines, and `unlit serve` has no lock for that door: \
     listen on 127.0.0.1 or [::1] and use `ssh -L` from elsewhere"
)]
pub struct NotLoopback(pub SocketAddr);

/// Refuses addresses that others can reach.
pub fn loopback_only(address: SocketAddr) -> Result<SocketAddr, NotLoopback> {
    if address.ip().is_loopback() { Ok(address) } else { Err(NotLoopback(address)) }
}

/// Middleware: refuses strangers, and gives each answer the headers that keep the page to itself.
pub(super) async fn guard(request: Request, next: Next) -> Response {
    let mut response = match check(request.method(), request.headers()) {
        Ok(()) => next.run(request).await,
        Err(problem) => problem.into_response(),
    };
    let headers = response.headers_mut();
    for (name, value) in [
        (header::CONTENT_SECURITY_POLICY, PAGE_POLICY),
        (header::X_CONTENT_TYPE_OPTIONS, "nosniff"),
        (header::REFERRER_POLICY, "no-referrer"),
        (header::HeaderName::from_static("cross-origin-resource-policy"), "same-origin"),
    ] {
        headers.entry(name).or_insert(HeaderValue::from_static(value));
    }
    response
}

/// The page loads nothing but itself.
const PAGE_POLICY: &str =
    "default-src 'self'; img-src 'self' blob:; base-uri 'none'; form-action 'none'; frame-ancestors 'none'";

/// What a session's own HTML (the report) may do: show itself, and nothing else.
pub(super) const FILE_POLICY: &str =
    "default-src 'none'; style-src 'unsafe-inline'; img-src 'self' data:; sandbox; frame-ancestors 'none'";

fn check(method: &Method, headers: &HeaderMap) -> Result<(), Problem> {
    let host = headers.get(header::HOST).and_then(|h| h.to_str().ok()).unwrap_or("");
    if !is_loopback_authority(host) {
        return Err(Problem::new(
            StatusCode::MISDIRECTED_REQUEST,
            "host_refused",
            format!("requests for host {host:?} are not answered; ask for localhost or 127.0.0.1"),
        ));
    }
    let streams = headers.get(header::ACCEPT).is_some_and(|a| a.as_bytes() == b"text/event-stream");
    let reads = matches!(*method, Method::GET | Method::HEAD) && !streams;
    match headers.get(header::ORIGIN).map(HeaderValue::to_str) {
        None => Ok(()),
        Some(Ok(origin)) if origin.strip_prefix("http://") == Some(host) => Ok(()),
        Some(_) if reads => Ok(()),
        Some(origin) => Err(Problem::new(
            StatusCode::FORBIDDEN,
            "origin_refused",
            format!(
                "a page from {} asked; only the page served from http://{host} may do that",
                origin.unwrap_or("an unreadable origin")
            ),
        )),
    }
}

/// Whether `host[:port]` names this machine and nothing else.
fn is_loopback_authority(authority: &str) -> bool {
    let (name, port) = match authority.rsplit_once(':') {
        Some((name, port)) if !port.ends_with(']') => (name, Some(port)),
        _ => (authority, None),
    };
    matches!(name, "localhost" | "127.0.0.1" | "[::1]") && port.is_none_or(|p| p.parse::<u16>().is_ok())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ask(method: Method, pairs: &[(header::HeaderName, &'static str)]) -> Result<(), StatusCode> {
        let headers = pairs.iter().map(|(n, v)| (n.clone(), HeaderValue::from_static(v))).collect();
        check(&method, &headers).map_err(|p| p.into_response().status())
    }

    #[test]
    fn loopback_hosts_pass_and_others_do_not() {
        for host in ["localhost", "localhost:8710", "127.0.0.1:1", "[::1]:8710", "[::1]"] {
            assert!(is_loopback_authority(host), "{host}");
        }
        for host in ["", "evil.example", "127.0.0.1.evil.example:80", "localhost:", "localhost:x", "[::2]:1"]
        {
            assert!(!is_loopback_authority(host), "{host}");
        }
    }

    #[test]
    fn a_foreign_host_is_misdirected_even_when_it_only_reads() {
        let foreign = [(header::HOST, "evil.example:8710")];
        assert_eq!(ask(Method::GET, &foreign), Err(StatusCode::MISDIRECTED_REQUEST));
    }

    #[test]
    fn a_foreign_page_may_neither_change_nor_listen() {
        let host = (header::HOST, "127.0.0.1:8710");
        let foreign = (header::ORIGIN, "https://evil.example");
        let null = (header::ORIGIN, "null");
        let sse = (header::ACCEPT, "text/event-stream");
        let own = (header::ORIGIN, "http://127.0.0.1:8710");
        let neighbour = (header::ORIGIN, "http://127.0.0.1:9999");
        assert_eq!(ask(Method::POST, &[host.clone(), foreign.clone()]), Err(StatusCode::FORBIDDEN));
        assert_eq!(ask(Method::POST, &[host.clone(), null]), Err(StatusCode::FORBIDDEN));
        assert_eq!(ask(Method::DELETE, &[host.clone(), neighbour]), Err(StatusCode::FORBIDDEN));
        assert_eq!(ask(Method::GET, &[host.clone(), foreign, sse.clone()]), Err(StatusCode::FORBIDDEN));
        assert_eq!(ask(Method::GET, &[host.clone(), own.clone(), sse]), Ok(()));
        assert_eq!(ask(Method::POST, &[host.clone(), own]), Ok(()));
        assert_eq!(ask(Method::POST, &[host]), Ok(()), "scripts send no origin");
    }

    #[test]
    fn addresses_that_others_can_reach_are_refused_with_a_sentence() {
        assert!(loopback_only("127.0.0.1:0".parse().unwrap()).is_ok());
        assert!(loopback_only("[::1]:8710".parse().unwrap()).is_ok());
        let refused = loopback_only("0.0.0.0:8710".parse().unwrap()).unwrap_err().to_string();
        assert!(refused.contains("127.0.0.1"), "{refused}");
    }
}
