//! The flash controller's port is pulled in the middle of pairs, and plugged in again. Everything is real but the body, the
//! wall before it and the flash: the engine, libgphoto2 in its host, the serial driver on a pty that hangs up, the
//! firmware's core. What truly happened is read from the studio's own books: the board's of its trigger, the wall's of
//! its exposures.

use crate::camera::{program, rig};
use crate::wall::{Exposures, Wall};
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::{Rng, SeedableRng};
use std::collections::BTreeMap;
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};
use tempfile::TempDir;
use unlit::capture::{CaptureError, Engine, Events, Topic};
use unlit::pair::{Limits, PairRecord, Verdict};
use unlit::progress::Progress;
use unlit::rig::Flash;
use unlit::rig::flash::SerialFlash;
use unlit::session::Session;
use unlit::studio::camera::CameraServer;
use unlit::studio::{Board, BoardOptions, SyncContact};

/// Rigs that are troubled at the same time.
const HOUSES: u64 = 4;

/// How often the port of each is pulled; `UNLIT_SOAK=1` (script/soak) is the long form.
fn pulls() -> u32 {
    if std::env::var_os("UNLIT_SOAK").is_some() { 250 } else { 25 }
}

struct House {
    _folder: TempDir,
    session: Session,
    engine: Engine,
    events: Events,
    board: Arc<Board>,
    taken: Exposures,
    _server: CameraServer,
}

impl House {
    fn new() -> Self {
        assert!(program().is_file());
        let recycle = Duration::from_millis(20);
        let board = Arc::new(Board::start(BoardOptions { recycle, ..BoardOptions::default() }).unwrap());
        let taken = Exposures::default();
        let server =
            CameraServer::start(Arc::new(Wall { flash: board.clone(), taken: taken.clone() })).unwrap();
        let rig = rig(server.port(), board.device(), Duration::from_secs(10));
        let folder = tempfile::tempdir().unwrap();
        let session = Session::create(&folder.path().join("wall"), "wall").unwrap();
        let events = Events::default();
        let engine = Engine::new(rig, Limits::default(), events.clone());
        Self { _folder: folder, session, engine, events, board, taken, _server: server }
    }

    fn pair(&self) -> Result<PairRecord, CaptureError> {
        self.pair_telling(&Progress::silent())
    }

    fn pair_telling(&self, progress: &Progress) -> Result<PairRecord, CaptureError> {
        self.engine.shoot_pair(&self.session, None, progress)
    }

    fn undisturbed(&self) -> Duration {
        let began = Instant::now();
        let pair = self.pair().unwrap();
        assert_eq!(pair.verdict, Verdict::Accepted, "{:?}", pair.reasons);
        began.elapsed()
    }

    /// What the studio knows must agree with what the session says.
    fn check(&self) {
        let rises = self.board.rises();
        let unordered: Vec<_> = rises.iter().filter(|rise| !rise.ordered).collect();
        assert!(unordered.is_empty(), "the trigger rose while disarmed: {unordered:?}");
        let taken = self.taken.lock().unwrap();
        let lit = taken.values().filter(|(_, lit)| *lit).count();
        assert_eq!(rises.len(), lit, "every pulse belongs to one exposure");
        for pair in self.session.pairs().unwrap() {
            assert!(self.session.verify_pair(pair.number).is_empty());
            if pair.verdict == Verdict::Rejected {
                continue;
            }
            let ((off, dark), (on, lit)) = (taken[&pair.off.blake3], taken[&pair.on.blake3]);
            assert!(!dark && lit, "pair {} was accepted in a wrong light", pair.number);
            assert_eq!(on, off + 1, "pair {} is made of exposures {off} and {on}", pair.number);
            let flash = pair.flash.as_ref().unwrap();
            assert_eq!((flash.pulses_off(), flash.pulses_on()), (0, 1), "pair {}", pair.number);
        }
    }
}

/// When the port is pulled and plugged in again.
#[derive(Debug)]
struct Pull {
    after: Duration,
    power: bool,
    /// `None`: only when the pair has ended.
    back: Option<Duration>,
}

impl Pull {
    fn draw(random: &mut ChaCha8Rng, pair: Duration) -> Self {
        let mut share = || f64::from(random.next_u32()) / f64::from(u32::MAX);
        let back = match share() {
            kind if kind < 0.08 => None,
            kind if kind < 0.70 => Some(Duration::from_secs_f64(0.3 * share())),
            _ => Some(Duration::from_secs_f64(2.5 * share())),
        };
        Self { after: pair.mul_f64(share()), power: share() < 0.5, back }
    }
}

/// What became of the pairs.
#[derive(Debug, Default)]
struct Tally {
    accepted_at_once: u32,
    accepted_after_recovery: u32,
    rejected: BTreeMap<String, u32>,
    failed: BTreeMap<String, u32>,
    longest: Duration,
    /// What the pair was at when the port was pulled.
    hit: BTreeMap<String, u32>,
}

impl Tally {
    fn pulls(&self) -> u32 {
        self.accepted_at_once
            + self.accepted_after_recovery
            + self.rejected.values().sum::<u32>()
            + self.failed.values().sum::<u32>()
    }

    fn add(&mut self, other: Tally) {
        self.accepted_at_once += other.accepted_at_once;
        self.accepted_after_recovery += other.accepted_after_recovery;
        self.longest = self.longest.max(other.longest);
        for (sum, more) in [
            (&mut self.rejected, other.rejected),
            (&mut self.failed, other.failed),
            (&mut self.hit, other.hit),
        ] {
            for (key, count) in more {
                *sum.entry(key).or_default() += count;
            }
        }
    }
}

/// Pulls the port of one rig again and again at moments picked by `seed`.
fn trouble(seed: u64) -> Tally {
    let house = House::new();
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    house.undisturbed(); // the first one opens the devices
    let mut usual = (0..3).map(|_| house.undisturbed()).sum::<Duration>() / 3;
    let mut tally = Tally::default();
    while tally.pulls() < pulls() {
        let pull = Pull::draw(&mut random, usual);
        let (_, mut heard) = house.events.listen();
        let began = Instant::now();
        let stage = Arc::new(Mutex::new("nothing yet".to_owned()));
        let progress = {
            let stage = stage.clone();
            Progress::new(move |report| stage.lock().unwrap().clone_from(&report.stage))
        };
        let (outcome, took, hit) = std::thread::scope(|scope| {
            let puller = scope.spawn(|| {
                std::thread::sleep(pull.after);
                let at = stage.lock().unwrap().clone();
                if at == "Stored" {
                    return None;
                }
                house.board.unplug(pull.power).unwrap();
                if let Some(back) = pull.back {
                    std::thread::sleep(back);
                    house.board.plug_in().unwrap();
                }
                Some(at)
            });
            let outcome = house.pair_telling(&progress);
            let took = began.elapsed();
            (outcome, took, puller.join().unwrap())
        });
        let Some(hit) = hit else {
            // Over before its moment came: other work on the machine comes and goes, and the moments follow.
            usual = (usual * 3 + took) / 4;
            assert_eq!(outcome.unwrap().verdict, Verdict::Accepted);
            continue;
        };
        *tally.hit.entry(hit).or_default() += 1;
        tally.longest = tally.longest.max(took);
        if pull.back.is_none() {
            house.board.plug_in().unwrap();
        }
        let recovered =
            std::iter::from_fn(|| heard.try_recv().ok()).any(|told| told.topic == Topic::Recovery);
        match outcome {
            Ok(pair) if pair.verdict == Verdict::Rejected => {
                let codes: Vec<String> = pair.reasons.iter().map(|r| format!("{:?}", r.code)).collect();
                *tally.rejected.entry(codes.join("+")).or_default() += 1;
            }
            Ok(_) if recovered => tally.accepted_after_recovery += 1,
            Ok(_) => tally.accepted_at_once += 1,
            Err(error @ (CaptureError::Flash(_) | CaptureError::NoFlash)) => {
                let words = error.to_string();
                assert!(words.contains("plug it in"), "{words:?} does not say what to do");
                *tally.failed.entry(error.code().into()).or_default() += 1;
                // The port is back, and the session goes on.
                house.undisturbed();
            }
            Err(error) => panic!("{error} after {pull:?}"),
        }
        house.check();
    }
    house.undisturbed();
    house.check();
    tally
}

#[test]
fn pulling_the_port_in_a_hundred_pairs_never_fires_a_disarmed_flash_nor_passes_a_pair_in_a_wrong_light() {
    let seed: u64 = std::env::var("UNLIT_SEED").ok().and_then(|s| s.parse().ok()).unwrap_or(1);
    let began = Instant::now();
    let mut all = Tally::default();
    std::thread::scope(|scope| {
        let houses: Vec<_> = (0..HOUSES).map(|k| scope.spawn(move || trouble(HOUSES * seed + k))).collect();
        houses.into_iter().for_each(|house| all.add(house.join().unwrap()));
    });
    println!("seed {seed}, {} pulls in {:.1?}: {all:?}", all.pulls(), began.elapsed());
    assert_eq!(u64::from(all.pulls()), HOUSES * u64::from(pulls()));
    // Were the pulls without effect, nothing would have been tested.
    assert!(all.accepted_at_once < 3 * all.pulls() / 4, "{all:?}");
    for stage in ["Taking the frame without flash", "Taking the frame with flash"] {
        assert!(all.hit.get(stage).is_some_and(|hits| *hits >= 5), "{stage} was hardly hit: {all:?}");
    }
}

const TTL: Duration = Duration::from_secs(10);

/// A board, greeted and armed.
fn armed() -> (Board, SerialFlash) {
    let board =
        Board::start(BoardOptions { recycle: Duration::from_millis(20), ..BoardOptions::default() }).unwrap();
    let mut flash = SerialFlash::open(board.device()).unwrap();
    flash.arm(1, TTL).unwrap();
    (board, flash)
}

/// Polls until the driver has found the board again.
fn found_again(flash: &mut SerialFlash) {
    let deadline = Instant::now() + Duration::from_secs(10);
    while !flash.status().ready {
        assert!(Instant::now() < deadline, "{:?}", flash.status());
        std::thread::yield_now();
    }
}

#[test]
fn a_board_that_loses_its_power_with_the_port_forgets_that_it_was_armed() {
    let (board, mut flash) = armed();
    board.unplug(true).unwrap();
    assert!(!board.device().exists(), "the port's name goes with the port");
    assert_eq!(board.close(), 0.0, "without power nothing fires");
    board.plug_in().unwrap();
    assert_eq!(board.close(), 0.0, "a board that has just started has a closed gate");
    found_again(&mut flash);
    let error = flash.syncs(Duration::from_secs(2)).unwrap_err();
    assert!(error.to_string().contains("restarted"), "{error}");
    flash.arm(2, TTL).unwrap();
    assert!(board.close() > 0.9);
    assert_eq!(board.rises().iter().map(|rise| (rise.ordered, rise.tag)).collect::<Vec<_>>(), [(true, 2)]);
}

#[test]
fn a_board_with_power_of_its_own_fires_while_its_order_holds_and_goes_safe_by_the_hosts_silence() {
    let (board, flash) = armed();
    board.unplug(false).unwrap();
    assert!(board.close() > 0.9, "armed a moment ago");
    drop(flash);

    let (board, mut flash) = armed();
    let silent_since = Instant::now();
    board.unplug(false).unwrap();
    // The last word of the host was a ping at most.
    while silent_since.elapsed() < Duration::from_millis(1600) {
        std::thread::sleep(Duration::from_millis(10));
    }
    assert_eq!(board.close(), 0.0, "nobody has spoken for longer than the board waits");
    board.plug_in().unwrap();
    found_again(&mut flash);
    assert_eq!(board.close(), 0.0, "its host greets it, and that closes the gate too");
    flash.arm(2, TTL).unwrap();
    assert!(board.close() > 0.9);
    assert!(board.rises().iter().all(|rise| rise.ordered));
}

#[test]
fn a_pair_that_finds_no_controller_says_so_and_the_next_one_finds_it_again() {
    let house = House::new();
    house.undisturbed();
    house.board.unplug(true).unwrap();
    let error = house.pair().unwrap_err();
    assert_eq!(error.code(), "flash_not_opened");
    let words = error.to_string();
    assert!(words.contains("plugged in") && words.contains("usb-unlit"), "{words}");
    assert!(!house.engine.devices().flash.ready);
    house.board.plug_in().unwrap();
    house.undisturbed();
    house.check();
}
