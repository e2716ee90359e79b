//! The daemon over HTTP: codes, a turntable's script out of the documentation, and a kill in the middle.

use crate::daemon::{self, Client, PATIENCE};
use serde_json::{Value, json};
use std::io::{BufRead, BufReader};
use std::path::Path;
use std::process::Command;
use std::time::{Duration, Instant};
use unlit::session::Session;

/// A daemon, and a client that walks round a vase.
struct Daemon {
    _process: daemon::Daemon,
    url: String,
    client: Client,
}

impl Daemon {
    fn start(folder: &Path) -> Self {
        let process = daemon::Daemon::start(folder);
        Self { url: process.url.clone(), client: process.client(), _process: process }
    }

    fn ask(&self, method: &str, path: &str, body: Option<Value>) -> (u16, Value) {
        self.client.ask(method, path, body).unwrap()
    }

    fn good(&self, method: &str, path: &str, body: Option<Value>) -> Value {
        let (status, answer) = self.ask(method, path, body);
        assert!((200..300).contains(&status), "{method} {path}: {status} {answer}");
        answer
    }

    fn sequence(&self) -> Value {
        self.good("GET", "/sessions/vase/sequence", None)
    }

    fn wish(&self, wish: &str) -> Value {
        self.good("POST", &format!("/sessions/vase/sequence/{wish}"), None)
    }

    fn until(&self, wanted: impl Fn(&Value) -> bool) -> Value {
        let end = Instant::now() + PATIENCE;
        loop {
            let now = self.sequence();
            if wanted(&now) {
                return now;
            }
            assert!(Instant::now() < end, "{now}");
            std::thread::sleep(Duration::from_millis(10));
        }
    }
}

fn hook(positions: u32) -> Value {
    json!({ "positions": positions, "between": { "kind": "hook" } })
}

#[test]
fn what_cannot_be_is_refused_with_its_code() {
    let folder = tempfile::tempdir().unwrap();
    let daemon = Daemon::start(folder.path());
    let code = |method: &str, path: &str, body: Option<Value>| {
        let (status, problem) = daemon.ask(method, path, body);
        (status, problem["code"].as_str().unwrap_or("").to_owned())
    };
    let here = "/sessions/vase/sequence";
    assert_eq!(code("GET", here, None), (404, "session_not_found".into()));
    daemon.good("POST", "/sessions", Some(json!({ "name": "vase" })));
    assert_eq!(code("GET", here, None), (404, "sequence_not_planned".into()));
    assert_eq!(code("POST", &format!("{here}/start"), None), (404, "sequence_not_planned".into()));
    assert_eq!(code("DELETE", here, None), (404, "sequence_not_planned".into()));
    for wrong in [
        json!({ "positions": 0, "between": { "kind": "hook" } }),
        json!({ "positions": 3, "between": { "kind": "countdown", "seconds": -1 } }),
        json!({ "positions": 3, "between": { "kind": "hook" }, "interval_s": 1e9 }),
        json!({ "positions": 3, "between": { "kind": "hook" }, "off_frames": 17 }),
    ] {
        assert_eq!(code("PUT", here, Some(wrong.clone())), (400, "value_invalid".into()), "{wrong}");
    }
    for wrong in [
        json!({ "positions": 3, "between": { "kind": "trigger_file", "path": "/etc/passwd" } }),
        json!({ "positions": 3, "between": { "kind": "command", "run": "reboot" } }),
        json!({ "positions": 3 }),
        json!({ "positions": 3, "between": { "kind": "hook" }, "order": "on_on" }),
    ] {
        assert_eq!(code("PUT", here, Some(wrong.clone())), (422, "body_invalid".into()), "{wrong}");
    }
    assert_eq!(daemon.ask("PUT", here, Some(hook(3))).0, 201);
    let (status, kept) = daemon.ask("PUT", here, Some(hook(3)));
    assert_eq!(
        (status, &kept["plan"]["order"], &kept["plan"]["off_frames"]),
        (200, &json!("off_on"), &json!(1))
    );
    assert_eq!(code("POST", &format!("{here}/next"), None), (409, "sequence_state".into()));
    daemon.wish("start");
    let elsewhere = Some(json!({ "position": 2 }));
    assert_eq!(code("POST", &format!("{here}/next"), elsewhere), (409, "sequence_position".into()));
    assert_eq!(code("PUT", here, Some(hook(3))), (409, "sequence_state".into()));
    assert_eq!(daemon.wish("skip")["position"], 2);
    daemon.wish("pause");
    assert_eq!(code("PUT", here, Some(hook(4))), (409, "sequence_unfinished".into()));
    let (status, problem) = daemon.ask("POST", &format!("{here}/dance"), None);
    assert_eq!((status, &problem["code"]), (400, &json!("path_invalid")), "{problem}");
    let nonsense = Some(json!({ "positon": 1 }));
    assert_eq!(code("POST", &format!("{here}/resume"), nonsense), (422, "body_invalid".into()));
    assert_eq!(daemon.wish("cancel")["state"], "cancelled");
    assert_eq!(daemon.ask("DELETE", here, None).0, 204);
}

#[test]
fn a_killed_daemon_goes_on_at_the_first_missing_position_when_it_is_asked() {
    let folder = tempfile::tempdir().unwrap();
    let daemon = Daemon::start(folder.path());
    daemon.good("POST", "/sessions", Some(json!({ "name": "vase" })));
    daemon.good("PUT", "/sessions/vase/sequence", Some(hook(4)));
    daemon.wish("start");
    daemon.wish("next");
    daemon.until(|now| now["position"] == 2);
    daemon.wish("next");
    // SIGKILL in the middle of the second position's pair.
    daemon.until(|now| now["state"] == "shooting");
    drop(daemon);

    let daemon = Daemon::start(folder.path());
    let stream = ureq::get(format!("{}/api/v1/events", daemon.url)).call().unwrap();
    let mut heard = BufReader::new(stream.into_body().into_reader()).lines();
    daemon.good("POST", "/sessions", Some(json!({ "name": "vase" })));
    let told = loop {
        if heard.next().unwrap().unwrap() == "event: sequence" {
            break heard.find(|line| line.as_ref().unwrap().starts_with("data: ")).unwrap().unwrap();
        }
    };
    assert!(told.contains("The program was started anew") && told.contains("\"paused\""), "{told}");
    let now = daemon.sequence();
    // The pair was stored a moment before the kill, or it is missing.
    let done = u32::try_from(now["done"].as_u64().unwrap()).unwrap();
    assert!((1..=2).contains(&done) && now["position"] == json!(done + 1), "{now}");
    let (status, problem) = daemon.ask("POST", "/sessions/vase/sequence/next", None);
    assert_eq!((status, &problem["code"]), (409, &json!("sequence_state")), "it is paused: {problem}");
    daemon.good("PUT", "/studio/stage", Some(json!({ "stop": done + 1 })));
    daemon.wish("resume");
    for position in done + 1..=4 {
        daemon.until(|now| now["state"] == "waiting" && now["position"] == position);
        daemon.wish("next");
    }
    let now = daemon.until(|now| now["state"] == "done");
    assert_eq!(now["done"], 4, "{now}");
    drop(daemon);
    let session = Session::open(&folder.path().join("sessions/vase")).unwrap();
    let record = session.sequence().unwrap().unwrap();
    let pairs: Vec<u32> = record.positions.iter().flat_map(|p| p.pairs.clone()).collect();
    assert_eq!(pairs, [1, 2, 3, 4], "a pair each, none twice");
    for number in pairs {
        assert!(session.verify_pair(number).is_empty(), "pair {number}");
    }
}

#[test]
fn the_turntable_of_the_documentation_turns_until_all_is_done() {
    let folder = tempfile::tempdir().unwrap();
    let page = include_str!("../../../docs/sequences.md");
    let (_, script) = page.split_once("```python\n").unwrap();
    let file = folder.path().join("turntable.py");
    std::fs::write(&file, script.split_once("```").unwrap().0).unwrap();
    let daemon = Daemon::start(folder.path());
    let output = Command::new("python3").arg(&file).args([&daemon.url, "vase", "2"]).output().unwrap();
    let said = String::from_utf8_lossy(&output.stdout);
    assert!(output.status.success(), "{said}{}", String::from_utf8_lossy(&output.stderr));
    assert_eq!(said, "turning to 0.0 degrees\nturning to 180.0 degrees\nAll 2 positions are done.\n");
    assert_eq!(daemon.sequence()["positions"][1]["pairs"], json!([2]));
}
