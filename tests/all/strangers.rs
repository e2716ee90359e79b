//! Who has no business here: other hosts' names, other sites' pages, paths that lead out of a session. Each is refused
//! in words.

use crate::raw_http::{ask, connect, listen, read_answer};
use crate::yard::Yard;
use serde_json::json;
use std::io::Write;
use unlit::http::Patience;

pub(crate) const JSON: &str = "Content-Type: application/json";
pub(crate) const FORM: &str = "Content-Type: application/x-www-form-urlencoded";
pub(crate) const EVIL: &str = "Origin: http://evil.example";
/// Routes that change, stream, read, and show the page.
pub(crate) const ROUTES: &[&str] = &[
    "POST /api/v1/pairs",
    "DELETE /api/v1/jobs/1",
    "PUT /api/v1/camera",
    "GET /api/v1/events",
    "GET /api/v1/live.mjpg",
    "GET /api/v1/live.jpg",
    "GET /api/v1/jobs",
    "GET /api/v1/sessions",
    "POST /api/v1/pairing",
    "POST /api/v1/tickets",
    "GET /assets/page.js",
    "GET /nothing",
    "GET /",
];

fn open() -> Yard {
    Yard::open(Patience::default())
}

pub(crate) fn nothing_was_taken(yard: &Yard) {
    assert_eq!(ask(yard.port, "GET /api/v1/jobs", &[], "").body, "[]");
}

#[test]
fn a_foreign_host_is_misdirected() {
    let yard = open();
    for route in ROUTES {
        for host in ["Host: evil.example", "Host: 192.0.2.1:80", "Host:", "Host: localhost.evil.example"] {
            let answer = ask(yard.port, route, &[host], "");
            assert_eq!((answer.status, answer.code()), (421, "host_refused".into()), "{route}, {host}");
        }
    }
    let here = format!("Host: 127.0.0.1:{}", yard.port);
    assert_eq!(ask(yard.port, "GET /", &[&here, "Host: evil.example"], "").status, 421, "two of them");
    assert_eq!(ask(yard.port, "GET http://evil.example/", &[&here], "").status, 421, "one in the first line");
    let stream = connect(yard.port);
    (&stream).write_all(b"GET / HTTP/1.0\r\n\r\n").unwrap();
    assert_eq!(read_answer(&stream).status, 421, "none at all");
    nothing_was_taken(&yard);
}

#[test]
fn a_foreign_origin_is_refused_on_every_route() {
    let yard = open();
    for route in ROUTES {
        for origin in [EVIL, "Origin: null", "Origin: http://127.0.0.1:1", "Origin: file://"] {
            let answer = ask(yard.port, route, &[origin], "");
            assert_eq!((answer.status, answer.code()), (403, "origin_refused".into()), "{route}, {origin}");
        }
    }
    nothing_was_taken(&yard);
    let own = format!("Origin: http://127.0.0.1:{}", yard.port);
    assert_eq!(ask(yard.port, "POST /api/v1/pairs", &[&own], "").status, 202);
}

#[test]
fn a_request_that_a_browser_calls_cross_site_is_refused() {
    let yard = open();
    for site in ["Sec-Fetch-Site: cross-site", "Sec-Fetch-Site: same-site"] {
        for route in ROUTES {
            let image = [site, "Sec-Fetch-Mode: no-cors", "Sec-Fetch-Dest: image"];
            let answer = ask(yard.port, route, &image, "");
            assert_eq!((answer.status, answer.code()), (403, "cross_site_refused".into()), "{route}, {site}");
        }
        let link = [site, "Sec-Fetch-Mode: navigate", "Sec-Fetch-Dest: document"];
        assert_eq!(ask(yard.port, "GET /", &link, "").status, 200, "a link to the page");
        assert_eq!(ask(yard.port, "GET /api/v1/jobs", &link, "").status, 403, "a link past the page");
    }
    nothing_was_taken(&yard);
}

#[test]
fn a_form_of_another_site_is_refused() {
    let yard = open();
    for kind in [FORM, "Content-Type: text/plain", "Content-Type: multipart/form-data; boundary=x"] {
        for body in ["", "{}", r#"{"name":"vase"}"#] {
            let answer = ask(yard.port, "POST /api/v1/sessions", &[kind, EVIL], body);
            assert_eq!(answer.status, 403, "{kind}");
            // A browser so old that it does not say where it comes from.
            let answer = ask(yard.port, "POST /api/v1/sessions", &[kind], body);
            assert_eq!(
                (answer.status, answer.code()),
                (415, "content_type_unsupported".into()),
                "{kind}, {body:?}"
            );
            assert_eq!(ask(yard.port, "POST /api/v1/pairs", &[kind], body).status, 415, "{kind}, {body:?}");
        }
    }
    let multipart = "Content-Type: multipart/form-data; boundary=x";
    let upload = "POST /api/v1/sessions/vase/scene";
    assert_eq!(ask(yard.port, upload, &[multipart, "Origin: null"], "--x--\r\n").status, 403);
    assert_eq!(ask(yard.port, upload, &[FORM], "a=b").status, 415);
    nothing_was_taken(&yard);
    assert_eq!(ask(yard.port, "GET /api/v1/sessions", &[], "").body, "[]");
}

#[test]
fn websockets_and_streams_of_elsewhere_are_refused() {
    let yard = open();
    let socket = [
        "Connection: Upgrade",
        "Upgrade: websocket",
        "Sec-WebSocket-Version: 13",
        "Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==",
    ];
    for route in ["GET /api/v1/events", "GET /api/v1/live.mjpg", "GET /"] {
        let foreign: Vec<_> = socket.iter().copied().chain([EVIL]).collect();
        assert_eq!(ask(yard.port, route, &foreign, "").status, 403, "{route}");
        let answer = ask(yard.port, route, &socket, "");
        assert_eq!((answer.status, answer.code()), (400, "websocket_refused".into()), "{route}");
        for accept in ["Accept: text/event-stream", "Accept: */*"] {
            assert_eq!(ask(yard.port, route, &[accept, EVIL], "").status, 403, "{route}, {accept}");
        }
    }
    listen(yard.port, "/api/v1/events", &["Accept: text/event-stream"]);
}

#[test]
fn no_path_leads_out_of_a_session() {
    let yard = open();
    assert_eq!(ask(yard.port, "POST /api/v1/sessions", &[JSON], r#"{"name":"vase"}"#).status, 201);
    std::fs::write(yard.folder.path().join("secret"), "secret").unwrap();
    let vase = yard.session("vase");
    std::os::unix::fs::symlink(yard.folder.path().join("secret"), vase.join("link")).unwrap();
    std::os::unix::fs::symlink(yard.folder.path(), vase.join("folder")).unwrap();
    std::os::unix::fs::symlink("/etc/passwd", vase.join("passwd.json")).unwrap();
    let outside = yard.folder.path().join("secret").to_str().unwrap().replace('/', "%2F");
    let tricks = [
        "link",
        "folder/secret",
        "passwd.json",
        "../../secret",
        "%2e%2e/%2e%2e/secret",
        "..%2f..%2fsecret",
        "..%252f..%252fsecret",
        "%2e%2e%5c%2e%2e%5csecret",
        "..;/..;/secret",
        "//etc/passwd",
        "%2fetc%2fpasswd",
        "/%2e%2e/%2e%2e/secret",
        "pairs/../../../secret",
        "pairs//..//../../secret",
        "session.json%00.png",
        "%00",
        "%",
        "%ff%fe",
        ".",
        "",
        ".lock",
        outside.as_str(),
    ];
    for trick in tricks {
        for root in ["/api/v1/sessions/vase/files/", "/api/v1/sessions/", "/assets/", "/pairing/", "/"] {
            let answer = ask(yard.port, &format!("GET {root}{trick}"), &[], "");
            let body = &answer.body;
            assert!(
                !body.contains("secret\n") && body != "secret" && !body.contains("root:"),
                "{root}{trick}"
            );
            let page = root == "/" && matches!(trick, "" | "." | "%00");
            let list = root == "/api/v1/sessions/" && trick.is_empty();
            let refused = matches!(answer.status, 400 | 404);
            assert!(refused || page || list, "{root}{trick}: {} {body}", answer.status);
        }
    }
    for name in ["..", "../x", "/etc", "a/b", "a\0b", ".hidden"] {
        let answer = ask(yard.port, "POST /api/v1/sessions", &[JSON], &json!({ "name": name }).to_string());
        assert_eq!(answer.status, 400, "{name:?}");
    }
}
