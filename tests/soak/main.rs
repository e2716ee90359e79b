//! Pair after pair, with a camera that keeps failing: nothing acknowledged may be missing, doubled or swapped, and
//! neither memory nor processes may grow.
//!
//! Everything is real but the body: libgphoto2 in its camera host, the serial driver on a pty, the firmware's core, the
//! session on the disk. A fault is set before every 20th operation of the driver (lock, read, shoot), picked by a
//! seed. `script/test` runs the short form; `UNLIT_SOAK=1` (script/soak) runs 500 pairs. A test binary of its own, so
//! that its memory is nobody else's.

#![allow(clippy::unwrap_used, clippy::expect_used, reason = "a test's helpers may fail as its body may")]

#[path = "../all/wall.rs"]
mod wall;

use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};
use std::collections::BTreeMap;
use std::path::Path;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};
use unlit::capture::{CaptureError, Engine, Events, FlashKind, RigSource};
use unlit::pair::{Dial, Limits, Offered, PairRecord, Settings, Verdict};
use unlit::progress::Progress;
use unlit::rig::camera::{Deadlines, HostedCamera, Launch, Target};
use unlit::rig::flash::SerialFlash;
use unlit::rig::{Camera, CameraError, CameraInfo, LockReport, Shot};
use unlit::session::{Session, store};
use unlit::studio::camera::{CameraServer, Fault, Late};
use unlit::studio::{Board, BoardOptions};
use wall::{Exposures, Wall};

/// Operations of the driver from one fault to the next.
const EVERY: u64 = 20;
/// Pairs after which memory and processes are first counted.
const SETTLED: u32 = 50;

/// The real driver, with a fault set at the body before every [`EVERY`]th call.
struct Troubled {
    camera: HostedCamera,
    server: Arc<CameraServer>,
    calls: Arc<AtomicU64>,
    random: Arc<Mutex<ChaCha8Rng>>,
}

/// Faults that the driver or the engine must get over alone.
fn faults() -> Vec<Fault> {
    vec![
        Fault::BusyOnce,
        Fault::BusyFor(3),
        Fault::StallOnce,
        Fault::NoFocus,
        Fault::NeverAnnounced,
        Fault::LateObject(Late::NextClient),
        Fault::LateObject(Late::NextRelease),
        Fault::LateObject(Late::After(Duration::from_millis(300))),
        Fault::DoubledObject,
        Fault::CutDownload { missing: 1000 },
        Fault::ShortFile { missing: 1000 },
        Fault::HollowObject { missing: 1000 },
        Fault::DropInDownload,
        Fault::RepeatedFrame,
        Fault::WrongExif,
        Fault::SlowReady(Duration::from_millis(700)),
    ]
}

impl Troubled {
    fn camera(&mut self) -> &mut HostedCamera {
        if self.calls.fetch_add(1, Ordering::SeqCst) % EVERY == EVERY - 1 {
            let faults = faults();
            let pick = self.random.lock().unwrap().next_u32() as usize % faults.len();
            self.server.fault(faults[pick]);
        }
        &mut self.camera
    }
}

impl Camera for Troubled {
    fn info(&mut self) -> Result<CameraInfo, CameraError> {
        self.camera().info()
    }

    fn settings(&mut self) -> Result<Settings, CameraError> {
        self.camera().settings()
    }

    fn offered(&mut self) -> Result<Offered, CameraError> {
        self.camera().offered()
    }

    fn set(&mut self, dial: Dial) -> Result<(), CameraError> {
        self.camera().set(dial)
    }

    fn lock(&mut self) -> Result<LockReport, CameraError> {
        self.camera().lock()
    }

    fn preview(&mut self) -> Result<Vec<u8>, CameraError> {
        self.camera().preview()
    }

    fn recover(&mut self) -> Result<Vec<String>, CameraError> {
        self.camera.recover()
    }

    fn shoot(&mut self) -> Result<Shot, CameraError> {
        self.camera().shoot()
    }
}

/// Resident memory of this process, kB.
fn resident_kb() -> u64 {
    let status = std::fs::read_to_string("/proc/self/status").unwrap();
    let line = status.lines().find(|l| l.starts_with("VmRSS:")).unwrap();
    line.split_whitespace().nth(1).unwrap().parse().unwrap()
}

/// Processes whose parent is this one, zombies too.
fn children() -> usize {
    let own = std::process::id().to_string();
    let parent = |pid: &Path| {
        let stat = std::fs::read_to_string(pid.join("stat")).ok()?;
        // The name in parentheses may hold anything; state and parent follow the last of them.
        stat.rsplit(')').next()?.split_whitespace().nth(1).map(str::to_owned)
    };
    std::fs::read_dir("/proc")
        .unwrap()
        .filter(|e| parent(&e.as_ref().unwrap().path()).as_ref() == Some(&own))
        .count()
}

/// Digest of a pair's whole record: the test itself must not grow with what it remembers.
fn digest(pair: &PairRecord) -> String {
    store::digest(&serde_json::to_vec(pair).unwrap())
}

/// Every acknowledged pair is there, once, whole, and made of one dark and one lit exposure that followed it.
/// Gives how many were accepted (`false`) and rejected (`true`).
fn check_pairs(session: &Session, acknowledged: &[String], taken: &Exposures) -> BTreeMap<bool, usize> {
    let stored = session.pairs().unwrap();
    let found: Vec<String> = stored.iter().map(|pair| digest(pair)).collect();
    assert!(found == acknowledged, "what is on the disk is not what was acknowledged");
    let taken = taken.lock().unwrap();
    let mut verdicts = BTreeMap::new();
    let mut last = None;
    for pair in &stored {
        assert!(session.verify_pair(pair.number).is_empty(), "pair {} is damaged", pair.number);
        let rejected = pair.verdict == Verdict::Rejected;
        *verdicts.entry(rejected).or_default() += 1;
        if rejected {
            continue;
        }
        let (off, dark) = taken.get(&pair.off.blake3).expect("an unlit frame that no sensor gave");
        let (on, lit) = taken.get(&pair.on.blake3).expect("a lit frame that no sensor gave");
        assert!(!dark && *lit, "pair {} is swapped", pair.number);
        assert_eq!(*on, off + 1, "pair {} is made of exposures {off} and {on}", pair.number);
        assert!(last.is_none_or(|last| last < *off), "pair {} has a frame of an earlier one", pair.number);
        last = Some(*on);
    }
    verdicts
}

#[test]
fn pairs_in_a_row_with_a_fault_every_20th_operation_are_all_there_and_nothing_grows() {
    let long = std::env::var_os("UNLIT_SOAK").is_some();
    let pairs = if long { 500 } else { 60 };
    let seed: u64 = std::env::var("UNLIT_SEED").ok().and_then(|s| s.parse().ok()).unwrap_or(3);
    eprintln!("{pairs} pairs, seed {seed}");

    let board = Arc::new(
        Board::start(BoardOptions { recycle: Duration::from_millis(20), ..BoardOptions::default() }).unwrap(),
    );
    let taken = Exposures::default();
    let view = Arc::new(Wall { flash: board.clone(), taken: taken.clone() });
    let server = Arc::new(CameraServer::start(view).unwrap());
    let calls = Arc::new(AtomicU64::new(0));
    let random = Arc::new(Mutex::new(ChaCha8Rng::seed_from_u64(seed)));
    let deadlines = Deadlines {
        open: Duration::from_secs(10),
        shot: Duration::from_secs(2),
        other: Duration::from_secs(2),
    };
    let rig = RigSource {
        camera: {
            let (server, calls, random) = (server.clone(), calls.clone(), random.clone());
            Box::new(move |_| {
                let launch = Launch::new(env!("CARGO_BIN_EXE_unlit"));
                let camera =
                    HostedCamera::open_with(&launch, Some(&server.port()), deadlines, Target::default())?;
                Ok(Box::new(Troubled {
                    camera,
                    server: server.clone(),
                    calls: calls.clone(),
                    random: random.clone(),
                }))
            })
        },
        cameras: Box::new(|| Ok(Vec::new())),
        flash: {
            let device = board.device().to_owned();
            Box::new(move || Ok(FlashKind::Controller(Box::new(SerialFlash::open(&device)?))))
        },
    };
    let folder = tempfile::tempdir().unwrap();
    let session = Session::create(&folder.path().join("wall"), "wall").unwrap();
    let engine = Engine::new(rig, Limits::default(), Events::default());

    let mut acknowledged = Vec::new();
    let mut failures = BTreeMap::<&str, u32>::new();
    let mut settled = None;
    let mut longest = Duration::ZERO;
    while acknowledged.len() < pairs {
        let began = Instant::now();
        match engine.shoot_pair(&session, None, &Progress::silent()) {
            Ok(pair) => acknowledged.push(digest(&pair)),
            Err(error @ (CaptureError::Camera(_) | CaptureError::Flash(_))) => {
                // Told, not acknowledged: the operator takes the pair again.
                *failures.entry(error.code()).or_default() += 1;
                let failed: u32 = failures.values().sum();
                assert!(failed < pairs as u32, "the rig does not come back: {failures:?}, last {error}");
            }
            Err(error) => panic!("{error}"),
        }
        longest = longest.max(began.elapsed());
        if settled.is_none() && acknowledged.len() as u32 >= SETTLED.min(pairs as u32 / 2) {
            settled = Some((resident_kb(), children()));
        }
    }
    let (before_kb, before) = settled.unwrap();
    let (after_kb, after) = (resident_kb(), children());
    let verdicts = check_pairs(&session, &acknowledged, &taken);
    let struck = server.struck();
    println!(
        "{} operations, {} faults struck, failures told {failures:?}",
        calls.load(Ordering::SeqCst),
        struck.len()
    );
    println!(
        "{} pairs accepted, {} rejected; longest pair {longest:.1?}; resident {before_kb} kB, then {after_kb} kB; \
         child processes {before}, then {after}; frames left in the camera {}",
        verdicts.get(&false).unwrap_or(&0),
        verdicts.get(&true).unwrap_or(&0),
        server.frames_waiting(),
    );
    let spoils = |fault: &&Fault| {
        matches!(
            fault,
            Fault::WrongExif | Fault::ShortFile { .. } | Fault::HollowObject { .. } | Fault::RepeatedFrame
        )
    };
    let spoilt = struck.iter().filter(spoils).count();
    assert!(verdicts.get(&true).is_none_or(|rejected| *rejected <= spoilt), "{verdicts:?} for {struck:?}");
    assert!(failures.values().sum::<u32>() as usize <= struck.len(), "{failures:?} for {struck:?}");
    assert!(
        struck.len() as u64 >= calls.load(Ordering::SeqCst) / EVERY / 2,
        "faults did not strike: {struck:?}"
    );
    assert!(after_kb as f64 <= 1.1 * before_kb as f64, "memory grew from {before_kb} to {after_kb} kB");
    assert_eq!(before, after, "child processes");
}
