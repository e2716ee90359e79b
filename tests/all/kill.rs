//! `kill -9` at any moment of a session that is shot and processed: what was acknowledged is there, what was not is
//! named, numbers go on, and the model becomes the one that nobody disturbed.
//!
//! The daemon is the real one with its studio; a client shoots over HTTP and notes what it was told. Moments are drawn
//! from a seed, evenly over a few seconds from the first answer on, in which pairs are shot, pauses let whole solves
//! begin, and what the last kill left is processed. `script/test` runs 6 kills; `UNLIT_SOAK=1` (script/soak) 300, or
//! as many as `UNLIT_KILLS` says. Every moment is printed, with what was found after it.

use crate::daemon::{Client, Daemon, is_open};
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};
use serde_json::{Value, json};
use std::collections::{BTreeMap, BTreeSet};
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};
use unlit::pipeline::process;
use unlit::progress::Progress;
use unlit::session::{Session, store};

/// Moments are drawn from so many milliseconds.
const SPAN_MS: u64 = 7000;
/// The way from stop to stop takes up to so many milliseconds; one in eight is a pause in which a whole solve begins, and
/// so is every other life's beginning, for what the last kill left.
const WAY_MS: u64 = 1000;
const PAUSE: Duration = Duration::from_millis(6000);
/// Pairs of a session: fewer than the studio has stops, so that each has a camera in the scene and a solve takes seconds.
const STOPS: u32 = 8;
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

/// What the client was told.
#[derive(Default)]
struct Told {
    /// Jobs that were taken.
    jobs: BTreeSet<u64>,
    /// Pairs that are stored, with their verdicts.
    pairs: BTreeMap<u32, String>,
}

/// What lies in a session's folder after a kill, read without the program.
struct Left {
    /// Pairs whose folder is there.
    pairs: BTreeSet<u32>,
    /// The pair that the journal says was begun, if nothing more was heard of it.
    begun: Option<u32>,
}

impl Left {
    fn read(session: &Path) -> Self {
        let names = std::fs::read_dir(session.join("pairs")).unwrap().flatten().map(|e| e.file_name());
        let pairs = names.filter_map(|name| name.to_str()?.parse().ok()).collect();
        let journal = std::fs::read_to_string(session.join("journal.jsonl")).unwrap();
        let mut begun = None;
        for line in journal.lines().filter_map(|line| serde_json::from_str::<Value>(line).ok()) {
            match line["event"].as_str() {
                Some("pair_intended") => begun = line["number"].as_u64(),
                Some("pair_committed" | "pair_abandoned" | "pair_interrupted") => begun = None,
                _ => {}
            }
        }
        Self { pairs, begun: begun.map(|n| u32::try_from(n).unwrap()) }
    }

    fn next(&self) -> u32 {
        self.pairs.last().map_or(1, |last| last + 1)
    }
}

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

    /// A new session that has scene and calibration already.
    fn begin_session(&mut self) {
        self.sessions += 1;
        self.told.pairs.clear();
        copy(&self.home.join("template"), &self.folder());
    }

    /// One life of the daemon: looks at what the last one left, shoots, dies.
    fn live_and_die(&mut self, kill: u32) {
        let (name, left) = (self.name(), Left::read(&self.folder()));
        let daemon = Daemon::start(&self.home);
        let client = daemon.client();
        self.look(&client, &left);
        let moment = Duration::from_millis(self.random.next_u64() % SPAN_MS);
        let way = |draw: u64| match draw % 8 {
            0 => PAUSE,
            _ => Duration::from_millis(draw / 8 % WAY_MS),
        };
        let rest = if self.random.next_u32().is_multiple_of(2) && !left.pairs.is_empty() {
            PAUSE
        } else {
            Duration::ZERO
        };
        let ways: Vec<Duration> =
            std::iter::once(rest).chain((0..STOPS).map(|_| way(self.random.next_u64()))).collect();
        let over = AtomicBool::new(false);
        let (begun, first, told) = (Instant::now(), left.next(), &mut self.told);
        std::thread::scope(|scope| {
            let shooting = scope.spawn(|| {
                // It ends with the daemon: the answer that does not come was never acknowledged.
                let _gone = shoot(&client, &name, first, &ways, &over, told);
            });
            std::thread::sleep(moment.saturating_sub(begun.elapsed()));
            over.store(true, Ordering::SeqCst);
            daemon.kill();
            shooting.join().unwrap();
        });
        let phase = phase(&self.home);
        let left = Left::read(&self.folder());
        println!(
            "kill {kill} at {:.0?}: {} ms, {phase}; {name} has {} pairs, {} told{}",
            self.begun.elapsed(),
            moment.as_millis(),
            left.pairs.len(),
            self.told.pairs.len(),
            left.begun.map(|n| format!(", {n} begun")).unwrap_or_default()
        );
        *self.phases.entry(phase).or_default() += 1;
    }

    /// After a restart: everything that was acknowledged is there and whole, what was interrupted is named.
    fn look(&mut self, client: &Client, left: &Left) {
        let name = self.name();
        let session = client.post("/sessions", json!({ "name": name })).unwrap();
        assert_eq!(session["problem"], Value::Null, "{session}");
        let pairs = client.get(&format!("/sessions/{name}/pairs")).unwrap();
        let verdicts: BTreeMap<u32, &str> = pairs
            .as_array()
            .unwrap()
            .iter()
            .map(|pair| (pair["number"].as_u64().unwrap() as u32, pair["verdict"].as_str().unwrap()))
            .collect();
        assert_eq!(verdicts.keys().copied().collect::<BTreeSet<_>>(), left.pairs, "listed and on the disk");
        for (number, verdict) in &self.told.pairs {
            assert_eq!(verdicts.get(number), Some(&verdict.as_str()), "pair {number} was acknowledged");
        }
        for pair in pairs.as_array().unwrap() {
            for frame in ["off", "on"] {
                let file = format!(
                    "pairs/{:04}/{}",
                    pair["number"].as_u64().unwrap(),
                    pair[frame]["file"].as_str().unwrap()
                );
                let digest = store::digest_file(&self.folder().join(&file)).unwrap();
                assert_eq!(pair[frame]["blake3"], digest, "{file}");
            }
        }
        let recovered = session["recovered"].to_string();
        if let Some(begun) = left.begun {
            let words = if left.pairs.contains(&begun) {
                format!("Pair {begun:04} was stored whole")
            } else {
                format!("Pair {begun:04} was interrupted")
            };
            assert!(recovered.contains(&words), "{words:?} is not in {recovered}");
        } else {
            assert!(!recovered.contains("Pair "), "{recovered}");
        }
        let jobs = client.get("/jobs").unwrap();
        let of = |id: &u64| jobs.as_array().unwrap().iter().find(|job| job["id"] == *id);
        // The list is bounded.
        for id in self.told.jobs.iter().rev().take(20) {
            let job = of(id).unwrap_or_else(|| panic!("job {id} was taken and is forgotten: {jobs}"));
            assert!(!is_open(job), "{job}");
        }
    }

    /// Lets the daemon finish what it has to do, and compares the model with that of an undisturbed run.
    fn finish_session(&mut self) {
        let left = Left::read(&self.folder());
        // Without a pair there is nothing to make a model of, and without a change none to make.
        let due = process::is_due(&Session::open_shared(&self.folder()).unwrap()).unwrap_or(false);
        let daemon = Daemon::start(&self.home);
        let client = daemon.client();
        self.look(&client, &left);
        if left.pairs.is_empty() {
            shoot_one(&client, &self.name(), 1, true, &mut self.told).unwrap();
        }
        if due || left.pairs.is_empty() {
            self.processed(&client);
        }
        daemon.stop();
        let session = Session::open_shared(&self.folder()).unwrap();
        assert!(!process::is_due(&session).unwrap(), "the daemon has left something undone");
        let found = session.verify(&Progress::silent()).unwrap();
        assert!(found.is_whole(), "{:?}", found.findings);
        self.pairs += found.pairs;
        drop(session);
        let undisturbed = self.home.join("undisturbed");
        std::fs::create_dir(&undisturbed).unwrap();
        for part in ["session.json", "journal.jsonl", "pairs", "calibration", "scene"] {
            copy(&self.folder().join(part), &undisturbed.join(part));
        }
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
            "{} at {:.0?}: {} pairs verified, model as undisturbed",
            self.name(),
            self.begun.elapsed(),
            found.pairs
        );
        std::fs::remove_dir_all(&undisturbed).unwrap();
        std::fs::remove_dir_all(self.folder()).unwrap();
    }
}

impl Campaign {
    /// Waits until the processing that begins by itself has ended.
    fn processed(&self, client: &Client) {
        let (own, before) = (self.name(), self.told.jobs.last().copied().unwrap_or(0));
        let deadline = Instant::now() + Duration::from_secs(300);
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

/// Shoots pair after pair until the daemon is gone or the session's walk is over.
fn shoot(
    client: &Client,
    session: &str,
    first: u32,
    ways: &[Duration],
    over: &AtomicBool,
    told: &mut Told,
) -> Result<(), ureq::Error> {
    for (number, way) in (first..=STOPS).zip(ways) {
        let end = Instant::now() + *way;
        while Instant::now() < end && !over.load(Ordering::SeqCst) {
            std::thread::sleep(Duration::from_millis(20));
        }
        shoot_one(client, session, number, number % 2 == 0, told)?;
    }
    Ok(())
}

/// One pair at its stop; in one request, or asked for and looked at.
fn shoot_one(
    client: &Client,
    session: &str,
    number: u32,
    wait: bool,
    told: &mut Told,
) -> Result<(), ureq::Error> {
    client.stage(json!({ "stop": number }))?;
    let order = json!({ "session": session });
    let job = if wait {
        client.post("/pairs?wait=true", order)?
    } else {
        let job = client.post("/pairs", order)?;
        let id = job["id"].as_u64().unwrap();
        assert!(told.jobs.last().is_none_or(|last| id > *last), "number {id} was given before");
        told.jobs.insert(id);
        client.ended(job)?
    };
    assert_eq!(job["state"], "done", "{job}");
    let result = &job["result"];
    assert_eq!(result["number"], number, "{job}");
    told.jobs.insert(job["id"].as_u64().unwrap());
    told.pairs.insert(number, result["verdict"].as_str().unwrap().to_owned());
    Ok(())
}

/// What ran when the daemon was killed, as its ledger has it.
fn phase(home: &Path) -> String {
    let ledger = std::fs::read_to_string(home.join("sessions/.unlit/jobs.jsonl")).unwrap_or_default();
    let mut running = BTreeMap::new();
    let mut kinds = BTreeMap::new();
    for line in ledger.lines().filter_map(|line| serde_json::from_str::<Value>(line).ok()) {
        let job = line["job"].as_u64();
        match line["event"].as_str() {
            Some("job") => {
                kinds.insert(line["id"].as_u64(), line["kind"].as_str().unwrap_or_default().to_owned());
            }
            Some("started") => {
                running.insert(job, kinds.get(&job).cloned().unwrap_or_default());
            }
            Some("ended") => {
                running.remove(&job);
            }
            _ => {}
        }
    }
    let running: BTreeSet<String> = running.into_values().collect();
    if running.is_empty() { "nothing ran".into() } else { Vec::from_iter(running).join(" and ") + " ran" }
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
    let seed = number("UNLIT_SEED").unwrap_or(3);
    println!("{kills} kills, seed {seed}");

    let home = tempfile::tempdir().unwrap();
    let studio = home.path().join("studio");
    unlit::studio::truth::export(&studio, &Progress::silent()).unwrap();
    let daemon = Daemon::start(home.path());
    daemon.client().prepare("template", &studio.join("geometry"));
    daemon.stop();
    std::fs::rename(home.path().join("sessions/template"), home.path().join("template")).unwrap();

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
