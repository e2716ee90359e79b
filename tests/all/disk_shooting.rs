//! A disk that fills up, refuses, fails or is slow while the daemon shoots: the pair's job says which file and why, nothing
//! that was acknowledged is lost, the gate is closed, others are answered, and the next pair is stored once the disk is well.
//!
//! The same library as in [`crate::disk`], told by a file what the disk does from now on.

use crate::daemon::{Answer, Client, Daemon, PATIENCE, is_open};
use crate::disk::{EACCES, EIO, ENOSPC, EROFS, faults};
use serde_json::{Value, json};
use std::io::{BufRead, BufReader};
use std::path::PathBuf;
use std::sync::mpsc;
use std::time::{Duration, Instant};
use tempfile::TempDir;
use unlit::pair::Attempt;
use unlit::progress::Progress;
use unlit::session::Session;

/// A daemon, and the disk on which its sessions lie.
struct House {
    client: Client,
    daemon: Daemon,
    orders: PathBuf,
    home: TempDir,
}

impl House {
    fn open() -> Self {
        let home = tempfile::tempdir().unwrap();
        let orders = home.path().join("orders");
        let daemon = Daemon::launch(home.path(), |serve| {
            serve
                .arg("--studio")
                .env("LD_PRELOAD", faults())
                .env("UNLIT_TEST_DISK_FOLDER", home.path().join("sessions"))
                .env("UNLIT_TEST_DISK_ORDERS", &orders)
        });
        let client = daemon.client();
        client.post("/sessions", json!({ "name": "vase" })).unwrap();
        Self { client, daemon, orders, home }
    }

    /// From now on every operation takes so long and fails with this errno, if it is not 0.
    fn disk(&self, delay: Duration, errno: i32) {
        self.order(&format!("{} {errno}", delay.as_micros()));
    }

    fn order(&self, words: &str) {
        let aside = self.orders.with_extension("aside");
        std::fs::write(&aside, words).unwrap();
        std::fs::rename(aside, &self.orders).unwrap();
    }

    /// The sequence, once it is as wanted.
    fn sequence(&self, wanted: impl Fn(&Value) -> bool) -> Value {
        let deadline = Instant::now() + PATIENCE;
        loop {
            let now = self.client.get("/sessions/vase/sequence").unwrap();
            if wanted(&now) {
                return now;
            }
            assert!(Instant::now() < deadline, "{now}");
            std::thread::sleep(Duration::from_millis(10));
        }
    }

    fn disk_is_well(&self) {
        std::fs::remove_file(&self.orders).unwrap();
    }

    /// A pair that must be stored under this number.
    fn pair(&self, number: usize) -> Duration {
        let begun = Instant::now();
        let pair = self.client.done(self.client.post("/pairs", json!({})).unwrap());
        assert_eq!((&pair["number"], &pair["verdict"]), (&json!(number), &json!("accepted")), "{pair}");
        let took = begun.elapsed();
        self.gate_is_closed();
        took
    }

    fn gate_is_closed(&self) {
        let flash = self.client.get("/devices").unwrap()["flash"].clone();
        assert!(flash["ready"] == true && !flash["words"].to_string().contains("armed"), "{flash}");
    }

    /// Waits until a job is at a stage that begins so, and gives the stage; `None` if it ended unseen.
    fn at_stage(&self, job: &Value, stage: &str) -> Option<String> {
        let deadline = Instant::now() + PATIENCE;
        loop {
            let now = self.client.get(&format!("/jobs/{}", job["id"])).unwrap();
            let words = now["stage"].as_str().unwrap();
            if words.starts_with(stage) {
                return Some(words.to_owned());
            }
            if !is_open(&now) {
                return None;
            }
            assert!(Instant::now() < deadline, "it never came to {stage:?}: {now}");
            std::thread::yield_now();
        }
    }

    /// A pair that the disk fails, before it or from the frame with flash on; and how many were faster than that.
    fn failing(&self, errno: i32, in_the_middle: bool) -> (Value, usize) {
        for faster in 0..5 {
            if !in_the_middle {
                self.disk(Duration::ZERO, errno);
            }
            let job = self.client.post("/pairs", json!({})).unwrap();
            if in_the_middle {
                let _seen = self.at_stage(&job, "Taking the frame with flash");
                self.disk(Duration::ZERO, errno);
            }
            let job = self.client.ended(job).unwrap();
            if !in_the_middle || job["state"] != "done" {
                return (job, faster);
            }
            self.disk_is_well();
        }
        panic!("every pair was stored before its frame with flash was seen");
    }

    /// Ends the daemon: the session has these pairs and no other, all whole, and nothing was interrupted.
    fn has(self, pairs: usize) {
        self.daemon.stop();
        let session = Session::open(&self.home.path().join("sessions/vase")).unwrap();
        let numbers: Vec<u32> = session.pairs().unwrap().iter().map(|pair| pair.number).collect();
        assert!(numbers.iter().copied().eq(1..=pairs as u32), "{numbers:?}");
        let found = session.verify(&Progress::silent()).unwrap();
        assert!(found.findings.is_empty(), "{:?}", found.findings);
        assert_eq!(session.recovery(), &Default::default(), "what failed was written down");
    }
}

#[test]
fn a_disk_that_fails_while_a_pair_is_shot_is_named_and_the_next_pair_is_stored() {
    let house = House::open();
    house.pair(1);
    let mut pairs = 1;
    for errno in [ENOSPC, EROFS, EACCES, EIO] {
        // In the middle of a pair, then before one.
        for in_the_middle in [true, false] {
            let (job, faster) = house.failing(errno, in_the_middle);
            pairs += faster;
            let what = format!("errno {errno}, in the middle: {in_the_middle}: {}", job["problem"]);
            println!("{what}");
            assert_eq!(job["state"], "failed", "{what}");
            let words = job["problem"]["words"].as_str().unwrap();
            assert!(
                words.contains("/sessions/vase/") && words.contains(&format!("os error {errno}")),
                "{what}"
            );
            house.gate_is_closed();
            house.disk_is_well();
            pairs += 1;
            house.pair(pairs);
        }
    }
    house.has(pairs);
}

#[test]
fn a_pair_that_had_its_place_when_the_disk_failed_counts_for_its_position() {
    let house = House::open();
    let folder = house.home.path().join("sessions/vase/pairs");
    let plan = json!({ "positions": 2, "between": { "kind": "hook" } });
    let ask = |method: &str, path: &str, body: Option<Value>| {
        let (status, answer) =
            house.client.ask(method, &format!("/sessions/vase/sequence{path}"), body).unwrap();
        assert!((200..300).contains(&status), "{method} {path}: {answer}");
    };
    ask("PUT", "", Some(plan));
    ask("POST", "/start", None);
    // The pair's folder gets its name; that this is on the disk cannot be said.
    house.order(&format!("0 {EIO} {}", folder.display()));
    ask("POST", "/next", None);
    house.sequence(|now| now["position"] == 2 && now["positions"][0]["pairs"] == json!([1]));
    house.disk_is_well();
    house.gate_is_closed();
    ask("POST", "/next", None);
    let done = house.sequence(|now| now["state"] == "done");
    assert_eq!(done["positions"][1]["pairs"], json!([2]), "{done}");
    // Whoever asked for the first pair was not told that it is safe.
    let jobs = house.client.at_rest();
    let mut of_pairs: Vec<&Value> = jobs.iter().filter(|job| job["kind"] == "pair").collect();
    of_pairs.sort_by_key(|job| job["id"].as_u64());
    let states: Vec<&Value> = of_pairs.iter().map(|job| &job["state"]).collect();
    assert_eq!(states, ["failed", "done"], "{jobs:?}");
    assert!(of_pairs[0]["problem"]["words"].to_string().contains(&format!("os error {EIO}")), "{jobs:?}");

    house.daemon.stop();
    let session = Session::open(&house.home.path().join("sessions/vase")).unwrap();
    assert_eq!(session.recovery().completed, [Attempt::first(1)], "it is told to be whole");
    assert_eq!(session.pairs().unwrap().len(), 2);
    let found = session.verify(&Progress::silent()).unwrap();
    assert!(found.findings.is_empty(), "{:?}", found.findings);
}

const ASKED: [&str; 4] = ["/status", "/jobs", "/sessions/vase", "/sessions/vase/pairs"];

/// Asks how all stands until told to stop; gives the longest time that each answer took.
fn keep_asking(client: &Client, stop: mpsc::Receiver<()>) -> Answer<[Duration; 4]> {
    let mut longest = [Duration::ZERO; 4];
    while stop.try_recv() == Err(mpsc::TryRecvError::Empty) {
        for (path, longest) in ASKED.into_iter().zip(&mut longest) {
            let begun = Instant::now();
            client.get(path)?;
            *longest = begun.elapsed().max(*longest);
        }
    }
    Ok(longest)
}

#[test]
fn a_slow_disk_slows_pairs_loses_none_keeps_nobody_waiting_and_is_told() {
    let house = House::open();
    house.pair(1);
    let quick = house.pair(2);
    let stream = ureq::get(house.client.path("/events")).call().unwrap();
    let mut heard = BufReader::new(stream.into_body().into_reader()).lines();
    house.disk(Duration::from_millis(300), 0);
    let (stop, stopped) = mpsc::channel();
    let (slow, longest) = std::thread::scope(|scope| {
        let client = &house.client;
        let asking = scope.spawn(move || keep_asking(client, stopped));
        let job = house.client.post("/pairs", json!({})).unwrap();
        let stage = house.at_stage(&job, "Storing the pair: the disk").unwrap();
        assert!(stage.contains("has taken more than"), "{stage}");
        house.client.done(job);
        let slow = house.pair(4);
        drop(stop);
        (slow, asking.join().unwrap().unwrap())
    });
    println!(
        "a pair took {quick:.2?}, on the slow disk {slow:.2?}; longest answers of {ASKED:?}: {longest:.2?}"
    );
    assert!(slow > quick + Duration::from_secs(3), "the disk was not slow");
    assert!(longest.iter().all(|took| *took < Duration::from_secs(2)), "an answer waited for the disk");
    let told = heard.find(|line| line.as_ref().unwrap().contains("disk_slow")).unwrap().unwrap();
    assert!(told.contains("The pair is safe once its job is done"), "{told}");
    house.disk_is_well();
    house.pair(5);
    house.has(5);
}
