//! What a pair of 55 MB frames costs from the wish to the disk, part by part: the camera's own time, the driver's,
//! the gate's, checks that could not be hidden behind the next shot, and storing.
//!
//! Everything is real but the body and its light: libgphoto2 in its host over PTP/IP on loopback, the serial driver on
//! a pty, the firmware's core, the session on the disk.
//!
//!     cargo bench --profile dev --bench pair

#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    reason = "a benchmark stops at the first thing that is wrong"
)]

#[path = "shared/frames.rs"]
mod frames;
#[path = "../tests/all/processes.rs"]
#[allow(dead_code, reason = "shared with tests that use more of it")]
mod processes;

use processes::{cpu_seconds, forget_peak, peak_kilobytes};
use std::sync::atomic::{AtomicU32, Ordering};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};
use unlit::capture::{Engine, Events, FlashKind, RigSource};
use unlit::pair::{Dial, Exposure, Limits, Offered, Settings};
use unlit::progress::Progress;
use unlit::rig::camera::{Deadlines, HostedCamera, Launch, Target};
use unlit::rig::flash::SerialFlash;
use unlit::rig::{Camera, CameraError, CameraInfo, LockReport, Shot, ShotTimes};
use unlit::session::Session;
use unlit::studio::camera::CameraServer;
use unlit::studio::{Board, BoardOptions, SyncContact, View};

const PAIRS: usize = 4;

/// Gives one of two large files, each time with another second in its EXIF, so that no two are the same.
struct Large {
    board: Arc<Board>,
    dark: Vec<u8>,
    lit: Vec<u8>,
    shots: AtomicU32,
}

impl View for Large {
    fn expose(&self, _: &Exposure) -> Vec<u8> {
        let lit = self.board.close() > 0.0;
        let mut bytes = if lit { self.lit.clone() } else { self.dark.clone() };
        let stamp = b"2026:05:04 10:00:";
        let at =
            bytes.windows(stamp.len()).position(|w| w == stamp).expect("a date in the EXIF") + stamp.len();
        let second = format!("{:02}", self.shots.fetch_add(1, Ordering::Relaxed) % 60);
        bytes[at..at + 2].copy_from_slice(second.as_bytes());
        bytes
    }

    fn preview(&self) -> Vec<u8> {
        Vec::new()
    }
}

/// Remembers where each shot's time went.
struct Timed {
    camera: HostedCamera,
    shots: Arc<Mutex<Vec<ShotTimes>>>,
}

impl Camera for Timed {
    fn info(&mut self) -> Result<CameraInfo, CameraError> {
        self.camera.info()
    }

    fn settings(&mut self) -> Result<Settings, CameraError> {
        self.camera.settings()
    }

    fn offered(&mut self) -> Result<Offered, CameraError> {
        self.camera.offered()
    }

    fn set(&mut self, dial: Dial) -> Result<(), CameraError> {
        self.camera.set(dial)
    }

    fn lock(&mut self) -> Result<LockReport, CameraError> {
        self.camera.lock()
    }

    fn preview(&mut self) -> Result<Vec<u8>, CameraError> {
        self.camera.preview()
    }

    fn shoot(&mut self) -> Result<Shot, CameraError> {
        let shot = self.camera.shoot()?;
        self.shots.lock().unwrap().push(shot.times);
        Ok(shot)
    }
}

fn milliseconds(time: Duration) -> f64 {
    1000.0 * time.as_secs_f64()
}

fn main() {
    let board = Board::start(BoardOptions { recycle: Duration::from_millis(5), ..BoardOptions::default() });
    let board = Arc::new(board.unwrap());
    let (dark, lit) = (frames::frame(0.3), frames::frame(1.0));
    println!("frames of {:.1} and {:.1} MB", dark.len() as f64 / 1e6, lit.len() as f64 / 1e6);
    let view = Arc::new(Large { board: board.clone(), dark, lit, shots: AtomicU32::new(0) });
    let server = CameraServer::start(view).unwrap();
    let shots = Arc::new(Mutex::new(Vec::new()));
    let rig = RigSource {
        camera: {
            let (port, shots) = (server.port(), shots.clone());
            Box::new(move |_| {
                let launch = Launch::new(env!("CARGO_BIN_EXE_unlit"));
                let camera =
                    HostedCamera::open_with(&launch, Some(&port), Deadlines::default(), Target::default())?;
                Ok(Box::new(Timed { camera, shots: shots.clone() }))
            })
        },
        cameras: Box::new(|| Ok(Vec::new())),
        flash: {
            let device = board.device().to_owned();
            Box::new(move || Ok(FlashKind::Controller(Box::new(SerialFlash::open(&device)?))))
        },
    };
    let folder = tempfile::tempdir().unwrap();
    let session = Session::create(&folder.path().join("large"), "large").unwrap();
    let engine = Engine::new(rig, Limits::default(), Events::default());
    println!("first pair: opens the devices and goes through the lock");
    for number in 1..=PAIRS {
        shots.lock().unwrap().clear();
        let stages = Arc::new(Mutex::new(Vec::<(Instant, String)>::new()));
        let noted = stages.clone();
        let progress = Progress::new(move |report| {
            noted.lock().unwrap().push((Instant::now(), report.stage.clone()));
        });
        forget_peak();
        let (cpu, begun) = (cpu_seconds(), Instant::now());
        let pair = engine.shoot_pair(&session, None, &progress).unwrap();
        let whole = begun.elapsed();
        println!(
            "pair {number}: {:?} {:?}, {:.0} ms in all",
            pair.verdict,
            pair.reasons,
            milliseconds(whole)
        );
        let stages = stages.lock().unwrap();
        for (i, (from, stage)) in stages.iter().enumerate() {
            let to = stages.get(i + 1).map_or(begun + whole, |next| next.0);
            println!("    {:>8.1} ms  {stage}", milliseconds(to - *from));
        }
        let mut cameras_own = Duration::ZERO;
        for (name, t) in ["unlit", "lit"].iter().zip(shots.lock().unwrap().iter()) {
            let own = t.exposing + t.transfer + t.until_ready;
            cameras_own += own;
            println!(
                "    {name} shot: {:.1} exposing + {:.1} transfer + {:.1} until ready; driver {:.1} ms",
                milliseconds(t.exposing),
                milliseconds(t.transfer),
                milliseconds(t.until_ready),
                milliseconds(t.total.saturating_sub(own)),
            );
        }
        let took = |words: &str| {
            let at = stages.iter().position(|(_, stage)| stage.starts_with(words)).unwrap();
            stages[at + 1].0 - stages[at].0
        };
        let (checks, storing) = (took("Checking"), took("Storing"));
        let over = whole.saturating_sub(cameras_own + checks);
        println!(
            "    camera's own {:.0} ms; checks not hidden {:.0} ms; the rest {:.0} ms, of which storing {:.0} ms; \
             {:.2} CPU-s here, peak {:.0} MB",
            milliseconds(cameras_own),
            milliseconds(checks),
            milliseconds(over),
            milliseconds(storing),
            cpu_seconds() - cpu,
            peak_kilobytes("self").unwrap_or(0) as f64 / 1024.0,
        );
    }
}
