//! `kill -9` at any moment of a session that is shot and processed: what was acknowledged is there, what was not is
//! named, numbers go on, a sequence goes on, the second copy is whole, and the model becomes the one that nobody disturbed.
//!
//! The daemon is the real one with its studio and a mirror; a client ([`walk`]) shoots over HTTP and notes what it was
//! told. What it does and when it is killed is drawn from a seed: moments lie evenly over a few seconds from the first
//! answer on, in which pairs are shot, pauses let whole solves begin, and what the last kill left is processed.
//! `script/test` runs 6 kills; `UNLIT_SOAK=1` (script/soak) 300, or as many as `UNLIT_KILLS` says. Every moment is
//! printed, with what was under way and what was found after it.

mod left;
mod walk;

use crate::daemon::{Client, Daemon, PATIENCE, is_open};
use left::{Attempt, Left, jobs_that_ran, last_job};
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};
use serde_json::{Value, json};
use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};
use unlit::pipeline::standing;
use unlit::progress::Progress;
use unlit::session::{Session, store};
use walk::{Told, Walk};

/// Moments are drawn from so many milliseconds.
const SPAN_MS: u64 = 7000;
/// Kills of one session.
const KILLS: u32 = 10;
/// What a model is, beside what tells of the time that it took.
const MODEL: [&str; 5] = [
    "model/model.glb",
    "model/reflectance.exr",
    "model/stddev.exr",
    "model/views.exr",
    "derived/patches.f32",
];
/// What cannot be made again, and what a mirror holds.
const ORIGINALS: [&str; 5] = ["session.json", "journal.jsonl", "pairs", "calibration", "scene"];

struct Campaign {
    home: PathBuf,
    random: ChaCha8Rng,
    /// Sessions begun.
    sessions: u32,
    told: Told,
    /// How often what ran when it was killed.
    phases: BTreeMap<String, u32>,
    models: u32,
    pairs: usize,
    begun: Instant,
}

impl Campaign {
    fn name(&self) -> String {
        format!("walk-{}", self.sessions)
    }

    fn folder(&self) -> PathBuf {
        self.home.join("sessions").join(self.name())
    }

    fn mirror(&self) -> PathBuf {
        self.home.join("mirror")
    }

    fn start(&self) -> Daemon {
        Daemon::start_with(&self.home, &["--mirror", self.mirror().to_str().unwrap()])
    }

    /// A new session that has scene and calibration already.
    fn begin_session(&mut self) {
        self.sessions += 1;
        self.told.begin_session();
        copy(&self.home.join("template"), &self.folder());
    }

    /// One life of the daemon: looks at what the last one left, shoots, dies.
    fn live_and_die(&mut self, kill: u32) {
        let (name, left) = (self.name(), Left::read(&self.folder()));
        let daemon = self.start();
        let client = daemon.client();
        self.look(&client, &left);
        let seed = self.random.next_u64();
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        let moment = Duration::from_millis(random.next_u64() % SPAN_MS);
        let rested = random.next_u32().is_multiple_of(2) && !left.pairs.is_empty();
        let (over, doing) = (AtomicBool::new(false), Mutex::new(String::new()));
        let begun = Instant::now();
        std::thread::scope(|scope| {
            let (told, doing, over) = (&mut self.told, &doing, &over);
            let (client, session) = (&client, name.as_str());
            let mut walk = Walk { client, session, told, random, doing, over };
            let walking = scope.spawn(move || match walk.go(rested) {
                // It ends with the daemon: the answer that does not come was never acknowledged.
                Err(ureq::Error::StatusCode(status)) => {
                    panic!("answered {status}: {}", doing.lock().unwrap())
                }
                Err(error) => assert!(over.load(Ordering::SeqCst), "{error}"),
                Ok(()) => {}
            });
            std::thread::sleep(moment.saturating_sub(begun.elapsed()));
            over.store(true, Ordering::SeqCst);
            daemon.kill();
            walking.join().unwrap();
        });
        let (ran, doing) = (jobs_that_ran(&self.home), doing.into_inner().unwrap());
        let left = Left::read(&self.folder());
        println!(
            "kill {kill} at {:.0?}: seed {seed}, {} ms, {ran} ({doing}); {name} has {} pairs, {} told{}",
            self.begun.elapsed(),
            moment.as_millis(),
            left.pairs.len(),
            self.told.pairs.len(),
            left.begun.map(|begun| format!(", {} begun", left::folder(begun))).unwrap_or_default()
        );
        *self.phases.entry(ran).or_default() += 1;
    }

    /// After a restart: everything that was acknowledged is there and whole, what was interrupted is named.
    fn look(&mut self, client: &Client, left: &Left) {
        let name = self.name();
        let session = client.post("/sessions", json!({ "name": name })).unwrap();
        assert_eq!(session["problem"], Value::Null, "{session}");
        let recovered = session["recovered"].to_string();
        match left.words() {
            Some(words) => assert!(recovered.contains(&words), "{words:?} is not in {recovered}"),
            None => assert!(!recovered.contains("Pair "), "{recovered}"),
        }
        // The daemon has the session open; a job would wait for the solve that is to be killed.
        let copy = self.originals("looked-at");
        is_whole(&copy, left.pairs.len());
        std::fs::remove_dir_all(copy).unwrap();

        let pairs = client.get(&format!("/sessions/{name}/pairs")).unwrap();
        let number = |of: &Value, key: &str| u32::try_from(of[key].as_u64().unwrap()).unwrap();
        let mut listed: BTreeMap<Attempt, &Value> = BTreeMap::new();
        for pair in pairs.as_array().unwrap() {
            for attempt in pair["attempts"].as_array().unwrap() {
                listed.insert((number(pair, "number"), number(attempt, "attempt")), attempt);
            }
        }
        assert_eq!(listed.keys().copied().collect::<BTreeSet<_>>(), left.pairs, "listed and on the disk");
        for (attempt, told) in &self.told.pairs {
            let verdict = listed.get(attempt).map(|found| &found["verdict"]);
            assert_eq!(verdict, Some(&json!(told.verdict)), "{attempt:?} was acknowledged: {pairs}");
            let mut current = pairs.as_array().unwrap().iter();
            let current = current.find(|pair| pair["number"] == attempt.0 && pair["attempt"] == attempt.1);
            assert!(current.is_none_or(|pair| pair["order"] == told.order), "{told:?}: {current:?}");
        }

        let (status, sequence) = client.ask("GET", &format!("/sessions/{name}/sequence"), None).unwrap();
        assert!(status == 200 || !self.told.planned, "the sequence is lost: {sequence}");
        if status == 200 {
            self.told.planned = true;
            self.told.expect_of_sequence(&sequence);
        }

        // The newest hundred are remembered by the next program.
        let newest = client.get("/jobs?limit=1").unwrap()[0]["id"].as_u64().unwrap_or(0);
        for id in self.told.jobs.iter().rev().take_while(|id| **id + 100 > newest) {
            let (status, job) = client.ask("GET", &format!("/jobs/{id}"), None).unwrap();
            assert!(status == 200 && !is_open(&job), "job {id} was taken: {job}");
        }
    }

    /// Lets the daemon finish what it has to do, and compares the model with that of an undisturbed run.
    fn finish_session(&mut self) {
        let left = Left::read(&self.folder());
        // Without a good pair there is nothing to make a model of, and without a change none to make.
        let due = standing::is_due(&Session::open_shared(&self.folder()).unwrap()).unwrap_or(false);
        let before = last_job(&self.home);
        let daemon = self.start();
        let client = daemon.client();
        self.look(&client, &left);
        let about = client.get(&format!("/sessions/{}", self.name())).unwrap();
        let none_is_good = about["accepted"] == 0;
        if none_is_good {
            self.shoot_a_good_one(&client);
        }
        if due || none_is_good {
            self.processed(&client, before);
        }
        self.mirrored(&client);
        daemon.stop();
        let session = Session::open_shared(&self.folder()).unwrap();
        assert!(!standing::is_due(&session).unwrap(), "the daemon has left something undone");
        drop(session);
        let pairs = Left::read(&self.folder()).pairs.len();
        is_whole(&self.folder(), pairs);
        is_whole(&self.mirror().join(self.name()), pairs);
        for part in ORIGINALS {
            let [ours, theirs] = [self.folder(), self.mirror().join(self.name())].map(|at| at.join(part));
            let differ = Command::new("diff").arg("-r").args([&ours, &theirs]).output().unwrap();
            assert!(differ.status.success(), "the mirror: {}", String::from_utf8_lossy(&differ.stdout));
        }
        // Not every session has one.
        let sequence = |at: PathBuf| std::fs::read(at.join("sequence.json")).ok();
        assert_eq!(
            sequence(self.folder()),
            sequence(self.mirror().join(self.name())),
            "the mirror's sequence"
        );
        self.pairs += pairs;
        let undisturbed = self.originals("undisturbed");
        for part in ["derived", "model"] {
            std::fs::create_dir(undisturbed.join(part)).unwrap();
        }
        let run =
            Command::new(env!("CARGO_BIN_EXE_unlit")).arg("process").arg(&undisturbed).output().unwrap();
        assert!(run.status.success(), "{}", String::from_utf8_lossy(&run.stderr));
        for file in MODEL {
            let [ours, theirs] =
                [self.folder(), undisturbed.clone()].map(|at| store::digest_file(&at.join(file)).unwrap());
            assert_eq!(ours, theirs, "{file} of {} is not that of an undisturbed run", self.name());
        }
        self.models += 1;
        println!(
            "{} at {:.0?}: {pairs} pairs verified, here and in the mirror; model as undisturbed",
            self.name(),
            self.begun.elapsed(),
        );
        std::fs::remove_dir_all(&undisturbed).unwrap();
        std::fs::remove_dir_all(self.folder()).unwrap();
        std::fs::remove_dir_all(self.mirror().join(self.name())).unwrap();
    }

    /// A copy of what cannot be made again.
    fn originals(&self, name: &str) -> PathBuf {
        let to = self.home.join(name);
        std::fs::create_dir(&to).unwrap();
        for part in ORIGINALS {
            copy(&self.folder().join(part), &to.join(part));
        }
        to
    }

    fn shoot_a_good_one(&mut self, client: &Client) {
        let pairs = client.get(&format!("/sessions/{}/pairs", self.name())).unwrap();
        let rejected = pairs[0]["number"].as_u64().map(|number| u32::try_from(number).unwrap());
        let (over, doing) = (AtomicBool::new(false), Mutex::new(String::new()));
        let random = ChaCha8Rng::seed_from_u64(self.random.next_u64());
        let (session, told) = (&self.name(), &mut self.told);
        let mut walk = Walk { client, session, told, random, doing: &doing, over: &over };
        walk.shoot(rejected.unwrap_or(1), rejected, false).unwrap();
    }

    /// Waits until the second copy holds everything.
    fn mirrored(&self, client: &Client) {
        let deadline = Instant::now() + PATIENCE;
        loop {
            client.at_rest();
            let mirror = client.get(&format!("/sessions/{}", self.name())).unwrap()["mirror"].clone();
            if mirror["state"] == "in_step" {
                return;
            }
            assert!(mirror["state"] == "behind" && Instant::now() < deadline, "{mirror}");
            std::thread::sleep(Duration::from_millis(50));
        }
    }

    /// Waits until processing that has begun by itself, and is no job of this number or before, has ended.
    fn processed(&self, client: &Client, before: u64) {
        let own = self.name();
        let deadline = Instant::now() + PATIENCE;
        loop {
            let jobs = client.at_rest();
            assert!(jobs.iter().all(|job| job["state"] != "failed"), "{jobs:?}");
            let fresh = |job: &&Value| job["kind"] == "process" && job["session"] == *own;
            let fresh = jobs.iter().find(fresh).filter(|job| job["id"].as_u64() > Some(before));
            if fresh.is_some_and(|job| job["state"] == "done") {
                return;
            }
            assert!(Instant::now() < deadline, "nothing was processed: {jobs:?}");
            std::thread::sleep(Duration::from_millis(50));
        }
    }
}

/// What `unlit session verify` says of a session with so many attempts at pairs.
fn is_whole(session: &Path, pairs: usize) {
    let verify = ["session", "verify", "--json"];
    let run = Command::new(env!("CARGO_BIN_EXE_unlit")).args(verify).arg(session).output().unwrap();
    let found: Value = serde_json::from_slice(&run.stdout).unwrap_or_else(|_| panic!("{run:?}"));
    assert!(run.status.success() && found["findings"] == json!([]), "{}: {found}", session.display());
    assert_eq!(found["pairs"], pairs, "{found}");
}

fn copy(from: &Path, to: &Path) {
    let copied = Command::new("cp").arg("-a").args([from, to]).status().unwrap();
    assert!(copied.success());
}

#[test]
fn a_session_survives_kill_9_at_any_moment_and_its_model_is_as_undisturbed() {
    let number = |name: &str| std::env::var(name).ok().and_then(|text| text.parse().ok());
    let soak = std::env::var_os("UNLIT_SOAK").is_some();
    let kills = number("UNLIT_KILLS").unwrap_or(if soak { 300 } else { 6 });
    let seed = number("UNLIT_SEED").unwrap_or(11);
    println!("{kills} kills, seed {seed}");

    let home = tempfile::tempdir().unwrap();
    let studio = home.path().join("studio");
    unlit::studio::truth::export(&studio, &Progress::silent()).unwrap();
    let daemon = Daemon::start(home.path());
    daemon.client().prepare("template", &studio.join("geometry"));
    daemon.stop();
    std::fs::rename(home.path().join("sessions/template"), home.path().join("template")).unwrap();
    std::fs::create_dir(home.path().join("mirror")).unwrap();

    let mut campaign = Campaign {
        home: home.path().to_owned(),
        random: ChaCha8Rng::seed_from_u64(seed),
        sessions: 0,
        told: Told::default(),
        phases: BTreeMap::new(),
        models: 0,
        pairs: 0,
        begun: Instant::now(),
    };
    campaign.begin_session();
    for kill in 1..=kills as u32 {
        campaign.live_and_die(kill);
        if kill % KILLS == 0 || kill == kills as u32 {
            campaign.finish_session();
            campaign.begin_session();
        }
    }
    println!(
        "{kills} kills: {} pairs verified in {} sessions, {} models as undisturbed; {:?}",
        campaign.pairs,
        campaign.sessions - 1,
        campaign.models,
        campaign.phases
    );
}
