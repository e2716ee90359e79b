//! The page that asks for a pairing code, and the cookie that comes of it.
//!
//! It stands alone: nothing of the control page is shown to who is not known.

use super::door::{BADGE_LASTS, Door};
use super::extract::Path;
use super::problem::Problem;
use axum::http::{HeaderMap, HeaderValue, header};
use axum::response::{IntoResponse, Response};

/// The cookie's name.
pub(super) const COOKIE: &str = "unlit_session";

/// Whether a path is answered to anybody: what it takes to be let in.
pub(super) fn is_open_to_all(path: &str) -> bool {
    path == "/api/v1/pairing" || path.starts_with("/pairing/")
}

/// The pairing page instead of the control page. That somebody asks for it shows a code on the terminal.
pub(super) fn page(door: &Door) -> Response {
    if let Err(error) = door.knock() {
        return Problem::internal(format!("no pairing code can be made: {error}")).into_response();
    }
    sent("text/html; charset=utf-8", include_str!("pairing/pairing.html"))
}

/// `GET /pairing/...`: what the page is made of.
pub(super) async fn file(Path(name): Path<String>) -> Response {
    match name.as_str() {
        "pairing.js" => sent("text/javascript; charset=utf-8", include_str!("pairing/pairing.js")),
        "pairing.css" => sent("text/css; charset=utf-8", include_str!("pairing/pairing.css")),
        "icon.svg" => sent("image/svg+xml", include_str!("../../web/dist/assets/icon.svg")),
        _ => Problem::not_found("not_found", format!("there is no page {name}")).into_response(),
    }
}

fn sent(kind: &'static str, text: &'static str) -> Response {
    ([(header::CONTENT_TYPE, kind), (header::CACHE_CONTROL, "no-store")], text).into_response()
}

/// The value of our cookie.
pub(super) fn cookie(headers: &HeaderMap) -> Option<&str> {
    let all = headers.get_all(header::COOKIE).iter().filter_map(|value| value.to_str().ok());
    all.flat_map(|value| value.split(';')).find_map(|pair| {
        let (name, value) = pair.trim().split_once('=')?;
        (name == COOKIE).then_some(value)
    })
}

/// `Set-Cookie` with this value, for the browser alone and for our own page alone; an empty one ends it. A page
/// that came by TLS keeps its cookie to TLS.
pub(super) fn set_cookie(value: &str, asked: &HeaderMap) -> Result<HeaderValue, Problem> {
    let lasts = if value.is_empty() { 0 } else { BADGE_LASTS.as_secs() };
    let by_tls = asked.get(header::ORIGIN).is_some_and(|origin| origin.as_bytes().starts_with(b"https://"));
    let secure = if by_tls { "; Secure" } else { "" };
    let text = format!("{COOKIE}={value}; HttpOnly; SameSite=Strict; Path=/; Max-Age={lasts}{secure}");
    HeaderValue::from_str(&text).map_err(Problem::internal)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn our_cookie_is_found_among_others() {
        let of = |values: &[&'static str]| {
            let headers: HeaderMap =
                values.iter().map(|v| (header::COOKIE, HeaderValue::from_static(v))).collect();
            cookie(&headers).map(str::to_owned)
        };
        assert_eq!(of(&["a=b; unlit_session=x.y; c=d"]), Some("x.y".into()));
        assert_eq!(of(&["a=b", "unlit_session=x"]), Some("x".into()));
        assert_eq!(of(&["not_unlit_session=x"]), None);
    }

    #[test]
    fn the_cookie_is_for_the_browser_and_our_page_alone() {
        let mut asked = HeaderMap::new();
        let plain = set_cookie("x", &asked).unwrap();
        let plain = plain.to_str().unwrap();
        assert!(
            plain.starts_with("unlit_session=x; HttpOnly; SameSite=Strict; Path=/; Max-Age=2592000"),
            "{plain}"
        );
        assert!(!plain.contains("Secure"), "a browser would not keep it over plain HTTP");
        asked.insert(header::ORIGIN, HeaderValue::from_static("https://studio.example"));
        assert!(set_cookie("x", &asked).unwrap().to_str().unwrap().ends_with("; Secure"));
        assert!(set_cookie("", &asked).unwrap().to_str().unwrap().contains("Max-Age=0"));
    }
}
