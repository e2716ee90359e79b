//! The daemon with a token: who shows it, or a cookie, or a ticket, is let in, and nobody else.

use crate::daemon::{Daemon, hear};
use crate::raw_http::{ask, listen};
use crate::strangers::{EVIL, FORM, JSON, ROUTES};
use crate::yard::Yard;
use serde_json::{Value, json};

/// A yard with a token, and the header that shows it.
fn locked(folder: &tempfile::TempDir) -> (Yard, String) {
    let file = folder.path().join("token");
    let yard = Yard::locked(&file);
    let token = std::fs::read_to_string(file).unwrap();
    (yard, format!("Authorization: Bearer {}", token.trim()))
}

#[test]
fn a_wrong_token_is_refused_and_none_at_all_too() {
    let folder = tempfile::tempdir().unwrap();
    let (yard, right) = locked(&folder);
    let wrong = right.replace(|c: char| c.is_ascii_digit(), "e");
    for route in ROUTES.iter().filter(|route| !route.ends_with("/pairing") && **route != "GET /") {
        let answer = ask(yard.port, route, &[], "");
        assert_eq!((answer.status, answer.code()), (401, "not_paired".into()), "{route}");
        for token in
            [wrong.as_str(), "Authorization: Bearer", "Authorization: Bearer ", "Authorization: Basic eDp5"]
        {
            let answer = ask(yard.port, route, &[token], "");
            assert!(matches!(answer.status, 401 | 403), "{route} {token}: {}", answer.status);
        }
        let answer = ask(yard.port, route, &[&wrong], "");
        assert_eq!((answer.status, answer.code()), (403, "token_refused".into()), "{route}");
        let answer = ask(yard.port, route, &["Cookie: unlit_session=0.9999999999.0"], "");
        assert_eq!(answer.status, 401, "{route}");
    }
    assert_eq!(ask(yard.port, "GET /api/v1/jobs", &[&right], "").body, "[]", "nothing was taken");
    let page = ask(yard.port, "GET /", &[], "");
    assert!(page.status == 200 && page.body.contains("Pair this browser") && !page.body.contains("page.js"));
    for part in ["pairing.js", "pairing.css", "icon.svg"] {
        assert_eq!(ask(yard.port, &format!("GET /pairing/{part}"), &[], "").status, 200);
    }
    assert!(ask(yard.port, "GET /", &[&right], "").body.contains("page.js"));
}

#[test]
fn a_ticket_is_good_once_and_for_its_path_alone() {
    let folder = tempfile::tempdir().unwrap();
    let (yard, token) = locked(&folder);
    let ticket = |path: &str| {
        let body = json!({ "path": path }).to_string();
        let answer = ask(yard.port, "POST /api/v1/tickets", &[&token, JSON], &body);
        assert_eq!(answer.status, 201, "{}", answer.body);
        serde_json::from_str::<Value>(&answer.body).unwrap()["url"].as_str().unwrap().to_owned()
    };
    let url = ticket("/api/v1/events");
    listen(yard.port, &url, &[]);
    let replayed = ask(yard.port, &format!("GET {url}"), &[], "");
    assert_eq!((replayed.status, replayed.code()), (403, "ticket_refused".into()));
    let elsewhere = ticket("/api/v1/events").replace("/events", "/jobs");
    assert_eq!(ask(yard.port, &format!("GET {elsewhere}"), &[], "").status, 403, "for another path");
    let changing = ticket("/api/v1/pairs");
    assert_eq!(
        ask(yard.port, &format!("POST {changing}"), &[], "").status,
        401,
        "tickets read and change nothing"
    );
    let from_elsewhere = ticket("/api/v1/events");
    assert_eq!(ask(yard.port, &format!("GET {from_elsewhere}"), &[EVIL], "").status, 403);
    for path in ["http://evil.example/api/v1/events", "//evil.example/api/v1/x", "/", "api", ""] {
        let body = json!({ "path": path }).to_string();
        assert_eq!(ask(yard.port, "POST /api/v1/tickets", &[&token, JSON], &body).status, 400, "{path:?}");
    }
}

#[test]
fn a_browser_is_paired_stays_so_through_a_restart_and_leaves() {
    let folder = tempfile::tempdir().unwrap();
    let (mut yard, _) = locked(&folder);
    let pair = |yard: &Yard, code: &str| {
        ask(yard.port, "POST /api/v1/pairing", &[JSON], &json!({ "code": code }).to_string())
    };
    assert!(yard.shown.lock().unwrap().is_empty(), "nobody has knocked");
    ask(yard.port, "GET /", &[], "");
    let code = yard.shown.lock().unwrap().concat();
    assert_eq!(pair(&yard, "1234").code(), "code_refused");
    let answer = pair(&yard, &code);
    assert_eq!(answer.status, 204, "{}", answer.body);
    let cookie = answer.header("set-cookie").unwrap().to_owned();
    for attribute in ["HttpOnly", "SameSite=Strict", "Path=/", "Max-Age="] {
        assert!(cookie.contains(attribute), "{cookie}");
    }
    assert_eq!(pair(&yard, &code).status, 403, "a code is good once");

    let cookie = format!("Cookie: {}", cookie.split(';').next().unwrap());
    let state = |yard: &Yard| {
        let answer = ask(yard.port, "GET /api/v1/pairing", &[&cookie], "");
        serde_json::from_str::<Value>(&answer.body).unwrap()
    };
    assert_eq!(state(&yard), json!({ "required": true, "paired": true }));
    yard.close();
    let (yard, _) = locked(&folder);
    assert_eq!(ask(yard.port, "GET /api/v1/jobs", &[&cookie], "").status, 200, "after a restart");
    assert_eq!(
        ask(yard.port, "POST /api/v1/pairs", &[&cookie, EVIL], "").status,
        403,
        "a cookie alone is not enough"
    );
    let answer = ask(yard.port, "DELETE /api/v1/pairing", &[&cookie], "");
    assert!(answer.status == 204 && answer.header("set-cookie").unwrap().contains("Max-Age=0"));
    assert_eq!(state(&yard), json!({ "required": true, "paired": false }));
    assert_eq!(ask(yard.port, "GET /api/v1/jobs", &[&cookie], "").status, 401);
}

#[test]
fn guessing_codes_is_slowed() {
    let folder = tempfile::tempdir().unwrap();
    let (yard, _) = locked(&folder);
    let answers: Vec<_> = (0..8)
        .map(|n| ask(yard.port, "POST /api/v1/pairing", &[JSON], &format!(r#"{{"code":"{n:08}"}}"#)))
        .collect();
    assert!(answers.iter().all(|a| matches!(a.status, 403 | 429)), "{answers:?}");
    let slowed = answers.iter().find(|a| a.status == 429).expect("none was slowed");
    let wait: u64 = slowed.header("retry-after").unwrap().parse().unwrap();
    assert!((1..=11).contains(&wait) && slowed.code() == "too_many_tries", "{slowed:?}");
}

#[test]
fn the_daemon_shows_codes_and_wants_a_token_for_other_addresses() {
    let folder = tempfile::tempdir().unwrap();
    let token = folder.path().join("token");
    let token = token.to_str().unwrap();
    let mut daemon =
        Daemon::launch(folder.path(), |serve| serve.args(["--flash", "none", "--token-file", token]));
    assert_eq!(ask(daemon.port, "GET /api/v1/devices", &[], "").status, 401);
    assert_eq!(ask(daemon.port, "GET /", &[], "").status, 200);
    let said = hear(&mut daemon.says, "pairing code");
    let code: String = said.chars().filter(char::is_ascii_digit).collect();
    let answer = ask(daemon.port, "POST /api/v1/pairing", &[JSON], &json!({ "code": code }).to_string());
    assert_eq!(answer.status, 204, "{said} {}", answer.body);

    let refused = |options: &[&str]| {
        let mut serve = std::process::Command::new(env!("CARGO_BIN_EXE_unlit"));
        let output = serve.arg("serve").args(options).current_dir(&folder).output().unwrap();
        assert!(!output.status.success(), "{options:?}");
        String::from_utf8_lossy(&output.stderr).into_owned()
    };
    assert!(refused(&["--listen", "0.0.0.0:0"]).contains("--token-file"));
    assert!(refused(&["--listen", "127.0.0.1:0", "--allow-host", "studio.example"]).contains("--token-file"));
    let bad = ["--listen", "127.0.0.1:0", "--allow-host", "http://studio", "--token-file", token];
    assert!(refused(&bad).contains("--allow-host"));
    std::fs::set_permissions(token, std::os::unix::fs::PermissionsExt::from_mode(0o644)).unwrap();
    assert!(refused(&["--listen", "127.0.0.1:0", "--token-file", token]).contains("chmod 600"));
}

#[test]
fn every_answer_keeps_to_itself() {
    let folder = tempfile::tempdir().unwrap();
    let (yard, token) = locked(&folder);
    for (route, headers) in [
        ("GET /", vec![]),
        ("GET /", vec![token.as_str()]),
        ("GET /api/v1/jobs", vec![token.as_str()]),
        ("GET /api/v1/jobs", vec![]),
        ("GET /api/v1/jobs", vec![EVIL]),
        ("GET /nothing", vec![token.as_str()]),
        ("POST /api/v1/pairs", vec![token.as_str(), FORM]),
    ] {
        let answer = ask(yard.port, route, &headers, "");
        for (name, part) in [
            ("content-security-policy", "frame-ancestors 'none'"),
            ("x-frame-options", "DENY"),
            ("x-content-type-options", "nosniff"),
            ("referrer-policy", "no-referrer"),
            ("cross-origin-resource-policy", "same-origin"),
            ("cross-origin-opener-policy", "same-origin"),
            ("permissions-policy", "camera=()"),
        ] {
            let given = answer.header(name).unwrap_or("nothing");
            assert!(given.contains(part), "{route} {headers:?}: {name} is {given}");
        }
        if answer.header("content-type").is_some_and(|kind| kind.contains("json")) {
            assert_eq!(answer.header("cache-control"), Some("no-store"), "{route} {headers:?}");
        }
        assert!(answer.header("access-control-allow-origin").is_none());
        assert_eq!(answer.header("www-authenticate").is_some(), answer.status == 401);
    }
}
