//! The daemon is told to stop: in the middle of a pair, with a camera that hangs, and twice.

use crate::api::House;
use crate::daemon::{Daemon, is_open};
use crate::fake_rig::{Room, Trouble};
use serde_json::{Value, json};
use std::io::{Read, Write};
use std::net::TcpStream;
use std::path::Path;
use std::time::{Duration, Instant};
use unlit::session::{Entry, Event, Session};

const PATIENCE: Duration = Duration::from_secs(60);

/// Asks for a pair and waits until it is at a stage that begins so.
fn pair_at(client: &crate::daemon::Client, stage: &str) -> Value {
    let job = client.post("/pairs", json!({})).unwrap();
    let path = format!("/jobs/{}", job["id"]);
    let end = Instant::now() + PATIENCE;
    loop {
        let job = client.get(&path).unwrap();
        if job["stage"].as_str().unwrap().starts_with(stage) {
            return job;
        }
        assert!(Instant::now() < end && is_open(&job), "it never came to {stage:?}: {job}");
        std::thread::yield_now();
    }
}

fn ledger(home: &Path) -> Vec<Value> {
    let text = std::fs::read_to_string(home.join("sessions/.unlit/jobs.jsonl")).unwrap();
    text.lines().map(|line| serde_json::from_str(line).unwrap()).collect()
}

#[test]
fn a_signal_ends_the_running_pair_every_stream_and_the_program_and_nothing_is_called_interrupted() {
    let home = tempfile::tempdir().unwrap();
    let daemon = Daemon::start(home.path());
    let client = daemon.client();
    client.post("/sessions", json!({ "name": "vase" })).unwrap();
    let mut stream = ureq::get(client.path("/events")).call().unwrap().into_body().into_reader();
    let job = pair_at(&client, "Taking the frame with flash");
    daemon.signal("TERM");
    let asked = Instant::now();
    let mut heard = String::new();
    stream.read_to_string(&mut heard).unwrap();
    assert!(heard.starts_with("event: state"), "{heard}");
    assert_eq!(daemon.ended(Duration::from_secs(20)).code(), Some(0));
    assert!(asked.elapsed() < Duration::from_secs(9), "{:?}: the answers were waited for", asked.elapsed());
    let ends: Vec<Value> = ledger(home.path())
        .into_iter()
        .filter(|line| line["event"] == "ended" && line["job"] == job["id"])
        .collect();
    assert_eq!((ends.len(), &ends[0]["state"]), (1, &json!("cancelled")), "{ends:?}");
    let session = Session::open(&home.path().join("sessions/vase")).unwrap();
    assert_eq!(session.recovery(), &Default::default(), "what is given up is written down");
    assert!(session.pairs().unwrap().is_empty());
    drop(session);

    // The next one knows what was asked for, and does it again.
    let daemon = Daemon::start(home.path());
    let client = daemon.client();
    let before = client.get(&format!("/jobs/{}", job["id"])).unwrap();
    assert_eq!(before["state"], "cancelled");
    let again = client.post(&format!("/jobs/{}/retry", job["id"]), json!({})).unwrap();
    assert!(again["id"].as_u64() > job["id"].as_u64());
    assert_eq!(again["retry_of"], job["id"]);
    assert_eq!(client.done(again)["number"], 1);
    daemon.stop();
}

/// The process that drives the camera, stopped in its tracks.
struct Hanging(u32);

impl Hanging {
    fn camera_of(daemon: &Daemon) -> Self {
        let tasks = std::fs::read_dir(format!("/proc/{}/task", daemon.id())).unwrap().flatten();
        let children: Vec<u32> = tasks
            .flat_map(|task| {
                let children = std::fs::read_to_string(task.path().join("children")).unwrap_or_default();
                children.split_whitespace().map(|id| id.parse().unwrap()).collect::<Vec<_>>()
            })
            .filter(|id| {
                let line = std::fs::read_to_string(format!("/proc/{id}/cmdline")).unwrap_or_default();
                line.contains("camera-host")
            })
            .collect();
        assert_eq!(children.len(), 1, "{children:?}");
        let hanging = Self(children[0]);
        hanging.signal("STOP");
        hanging
    }

    fn signal(&self, name: &str) {
        // It may have been ended already.
        let _ = std::process::Command::new("kill")
            .arg(format!("-{name}"))
            .arg(self.0.to_string())
            .stderr(std::process::Stdio::null())
            .status();
    }
}

impl Drop for Hanging {
    fn drop(&mut self) {
        self.signal("CONT");
    }
}

/// The first signal is being seen to then.
fn until_the_door_is_shut(client: &crate::daemon::Client) {
    let end = Instant::now() + PATIENCE;
    while client.get("/status").is_ok() {
        assert!(Instant::now() < end, "it goes on answering");
        std::thread::yield_now();
    }
}

#[test]
fn a_second_signal_ends_at_once_while_a_mirror_that_hangs_is_waited_for() {
    let home = tempfile::tempdir().unwrap();
    let copy = home.path().join("other/vase");
    std::fs::create_dir_all(&copy).unwrap();
    // Whoever opens it to read waits for ever, as with a server that is gone.
    let manifest = copy.join("session.json");
    assert!(std::process::Command::new("mkfifo").arg(&manifest).status().unwrap().success());
    let mirror = home.path().join("other");
    let mut daemon = Daemon::start_with(home.path(), &["--mirror", mirror.to_str().unwrap()]);
    let client = daemon.client();
    client.post("/sessions", json!({ "name": "vase" })).unwrap();
    daemon.signal("TERM");
    until_the_door_is_shut(&client);
    let asked = Instant::now();
    daemon.signal("TERM");
    assert_eq!(daemon.over(PATIENCE).code(), Some(1));
    assert!(asked.elapsed() < Duration::from_secs(5), "{:?}", asked.elapsed());
    daemon.expect_no_orphans();
}

#[test]
fn a_camera_that_hangs_keeps_nobody_and_a_second_signal_ends_at_once() {
    for twice in [false, true] {
        let home = tempfile::tempdir().unwrap();
        let mut daemon = Daemon::start(home.path());
        let client = daemon.client();
        client.post("/sessions", json!({ "name": "vase" })).unwrap();
        pair_at(&client, "Taking the frame with flash");
        let hanging = Hanging::camera_of(&daemon);
        let asked = Instant::now();
        daemon.signal("TERM");
        if twice {
            until_the_door_is_shut(&client);
            daemon.signal("TERM");
        }
        let status = daemon.over(Duration::from_secs(30));
        let took = asked.elapsed();
        drop(hanging);
        daemon.expect_no_orphans();
        if twice {
            assert_eq!(status.code(), Some(1));
            assert!(took < Duration::from_secs(5), "{took:?}");
        } else {
            assert_eq!(status.code(), Some(0));
            assert!(took < Duration::from_secs(16), "{took:?}");
        }
        // What was cut short is named when the session is opened again; or was written down, if the camera's own
        // deadline came before the program's.
        let session = Session::open(&home.path().join("sessions/vase")).unwrap();
        assert!(session.pairs().unwrap().is_empty());
        let given_up = |entry: &Entry| matches!(entry.event, Event::PairAbandoned { number: 1, .. });
        let named = session.recovery().interrupted.len();
        let written = session.journal().unwrap().iter().filter(|entry| given_up(entry)).count();
        assert_eq!(named + written, 1, "{named} named, {written} written down");
    }
}

#[test]
fn a_live_picture_that_does_not_come_is_not_waited_for() {
    let room = Room::with(Trouble::HoldsAt(0));
    let house = House::open(room.rig());
    house.post_nothing("/api/v1/pairs");
    let end = Instant::now() + PATIENCE;
    while !room.log().contains(&"shoot") {
        assert!(Instant::now() < end, "{:?}", room.log());
        std::thread::yield_now();
    }
    let mut waiting = TcpStream::connect(("127.0.0.1", house.port)).unwrap();
    write!(waiting, "GET /api/v1/live.jpg HTTP/1.1\r\nHost: 127.0.0.1:{}\r\n\r\n", house.port).unwrap();
    // What came before is being seen to when these are answered.
    (0..10).for_each(|_| assert_eq!(house.get("/api/v1/status").0, 200));
    let asked = Instant::now();
    drop(house);
    assert!(asked.elapsed() < Duration::from_secs(5), "{:?}", asked.elapsed());
    let mut answer = String::new();
    waiting.read_to_string(&mut answer).unwrap();
    assert!(answer.starts_with("HTTP/1.1 503 ") && answer.contains("\"code\":\"closing\""), "{answer}");
    room.set(Trouble::None);
}
