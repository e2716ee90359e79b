//! Orders of a pair's frames, their mean, and pairs that are shot again: through libgphoto2 in its host, the serial
//! driver on a pty and the firmware's core; the room's lamps and the sync cable are in the tests' hands.

use crate::camera::rig;
use crate::wall::{Exposures, photo_in};
use std::path::Path;
use std::process::{Command, Output};
use std::sync::{Arc, Mutex};
use std::time::Duration;
use tempfile::TempDir;
use unlit::calibration::{FieldFactor, FlashCalibration};
use unlit::capture::{CaptureError, Engine, Events, PairWish};
use unlit::codec::raw;
use unlit::light::Ring;
use unlit::pair::order::{Order, Slot};
use unlit::pair::{Attempt, Exposure, Limits, PairRecord, ReasonCode, Verdict};
use unlit::photometry::{KnownMosaic, NoiseModel, isolate};
use unlit::pipeline::develop::known_sites;
use unlit::progress::Progress;
use unlit::session::{Damage, Event, Session, store};
use unlit::studio::camera::CameraServer;
use unlit::studio::{Board, BoardOptions, SyncContact, View};

/// The wall's noise is even over 20 DN.
const NOISE: NoiseModel = NoiseModel { gain: 0.0, floor: 33.4 };

/// What may go wrong in the room.
#[derive(Clone, Copy, Default)]
struct Mood {
    /// Share of their light by which the lamps rise from one exposure to the next.
    slope: f64,
    /// The sync cable is pulled.
    unplugged: bool,
}

/// A wall, lamps over it, and a flash board whose sync cable can be pulled.
struct Scene {
    flash: Arc<Board>,
    taken: Exposures,
    mood: Mutex<Mood>,
}

impl View for Scene {
    fn expose(&self, exposure: &Exposure) -> Vec<u8> {
        let mood = *self.mood.lock().unwrap();
        let lit = !mood.unplugged && self.flash.close() > 0.0;
        let mut taken = self.taken.lock().unwrap();
        let number = taken.len() as u32;
        let lamps = 1.0 + mood.slope * f64::from(number);
        let bytes = photo_in(lamps, if lit { 1.0 } else { 0.0 }, number, *exposure);
        taken.insert(store::digest(&bytes), (number, lit));
        bytes
    }

    fn preview(&self) -> Vec<u8> {
        vec![0xff, 0xd8, 0xff, 0xd9]
    }
}

struct House {
    folder: TempDir,
    session: Session,
    engine: Engine,
    scene: Arc<Scene>,
    _server: CameraServer,
}

impl House {
    fn new(mood: Mood) -> Self {
        let recycle = Duration::from_millis(20);
        let flash = Arc::new(Board::start(BoardOptions { recycle, ..BoardOptions::default() }).unwrap());
        let scene =
            Arc::new(Scene { flash: flash.clone(), taken: Exposures::default(), mood: Mutex::new(mood) });
        let server = CameraServer::start(scene.clone()).unwrap();
        let rig = rig(server.port(), flash.device(), Duration::from_secs(10));
        let folder = tempfile::tempdir().unwrap();
        let session = Session::create(&folder.path().join("wall"), "wall").unwrap();
        let engine = Engine::new(rig, Limits::default(), Events::default());
        Self { folder, session, engine, scene, _server: server }
    }

    fn try_shoot(&self, wish: PairWish) -> Result<PairRecord, CaptureError> {
        self.engine.shoot_pair_as(&self.session, wish, None, &Progress::silent())
    }

    fn shoot(&self, order: Order, off_frames: u8) -> PairRecord {
        let wish = PairWish { order: Some(order), off_frames: Some(off_frames), again: None };
        self.try_shoot(wish).unwrap()
    }

    fn set(&self, mood: Mood) {
        *self.scene.mood.lock().unwrap() = mood;
    }

    /// The known light as processing isolates it.
    fn known(&self, pair: &PairRecord) -> KnownMosaic {
        let calibration = FlashCalibration {
            ring: Ring::new(0.03, 0.08).unwrap(),
            radiance_dn: [1.0; 3],
            radiance_dn_interval_95: None,
            radiance_dn_standard_error: None,
            field: FieldFactor { coefficients: [0.0; 3] },
            colour_vignetting: None,
            noise: NOISE,
            target_reflectance: 0.9,
            iso: None,
            aperture: None,
            focal_length_mm: None,
            energy_counts: None,
            cards: vec![],
            residual_rms: 0.0,
            misfit_rms: 0.0,
            findings: Default::default(),
        };
        known_sites(&self.session, pair, &calibration).unwrap()
    }
}

fn codes(pair: &PairRecord) -> Vec<ReasonCode> {
    pair.reasons.iter().map(|r| r.code).collect()
}

fn again(number: u32) -> PairWish {
    PairWish { again: Some(number), ..PairWish::default() }
}

#[test]
fn each_order_shoots_its_frames_in_turn_each_dark_or_lit_as_it_should_be() {
    let house = House::new(Mood::default());
    for (order, off_frames, names) in [
        (Order::OffOn, 1, "off on"),
        (Order::OnOff, 1, "on off"),
        (Order::OffOnOff, 1, "off on after"),
        (Order::OffOn, 3, "off off-2 off-3 on"),
        (Order::OnOff, 2, "on off off-2"),
        (Order::OffOnOff, 2, "off off-2 on after after-2"),
    ] {
        let begin = house.scene.taken.lock().unwrap().len() as u32;
        let pair = house.shoot(order, off_frames);
        assert_eq!(pair.verdict, Verdict::Accepted, "{order} {off_frames}: {:?}", pair.reasons);
        let taken = house.scene.taken.lock().unwrap();
        for (i, name) in names.split(' ').enumerate() {
            let slot: Slot = name.parse().unwrap();
            let frame = pair.frame(slot).unwrap();
            assert_eq!(
                taken[&frame.blake3],
                (begin + i as u32, slot == Slot::ON),
                "{order} {off_frames} {name}"
            );
            assert_eq!(frame.file, format!("{name}.cr2"));
        }
        assert_eq!(taken.len() as u32 - begin, names.split(' ').count() as u32, "nothing else was shot");
        assert_eq!(pair.frames().count(), names.split(' ').count());
        // Every frame is proven by the controller: one sync each, all dark but one.
        let flash = pair.flash.as_ref().unwrap();
        assert_eq!(flash.off.len(), names.split(' ').count() - 1);
        assert_eq!((flash.pulses_off(), flash.pulses_on()), (0, 1));
        assert_eq!(pair.drift.is_some(), off_frames > 1 || order == Order::OffOnOff);
        assert_eq!(house.session.pair(pair.number).unwrap(), pair, "as it is on the disk");
    }
    let found = house.session.verify(&Progress::silent()).unwrap();
    assert!(found.findings.is_empty(), "{:?}", found.findings);
    assert_eq!((found.pairs, found.originals), (6, 2 + 2 + 3 + 4 + 3 + 5));
    let manifest = std::fs::read_to_string(house.folder.path().join("wall/session.json")).unwrap();
    assert!(manifest.contains("\"schema\": 3"), "{manifest}");
    // An altered further frame is found out like any other.
    std::fs::write(house.session.pair_dir(6).join("after-2.cr2"), b"x").unwrap();
    let found = house.session.verify(&Progress::silent()).unwrap();
    let told: Vec<_> = found.findings.iter().map(|f| (f.path.to_str().unwrap(), f.damage)).collect();
    assert_eq!(told, [("pairs/0006/after-2.cr2", Damage::Altered)]);
}

#[test]
fn a_plain_pair_is_isolated_to_the_same_bits_and_recorded_as_before() {
    let house = House::new(Mood::default());
    let pair = house.engine.shoot_pair(&house.session, None, &Progress::silent()).unwrap();
    let read = |file: &str| raw::read(&house.session.pair_dir(1).join(file)).unwrap().mosaic;
    let plain = isolate(&read("on.cr2"), &read("off.cr2"), 1.0, &NOISE).unwrap();
    assert_eq!(house.known(&pair), plain);
    let record = std::fs::read_to_string(house.session.pair_dir(1).join("pair.json")).unwrap();
    for word in ["order", "off_frames", "more_off", "after", "drift", "attempt"] {
        assert!(!record.contains(&format!("\"{word}\"")), "{word}: {record}");
    }
}

#[test]
fn the_mean_of_dark_frames_lowers_the_noise_of_the_known_light_as_it_should() {
    let house = House::new(Mood::default());
    // Two pairs of one scene differ by their noise alone.
    let variance = |off_frames: u8| {
        let [a, b] = [(); 2].map(|()| house.known(&house.shoot(Order::OffOn, off_frames)));
        let told = NOISE.floor * (1.0 + 1.0 / f32::from(off_frames));
        assert!(a.variance.pixels().iter().all(|v| (v - told).abs() < 1e-3), "the variance is told");
        let both = a.value.pixels().iter().zip(b.value.pixels());
        let differences: Vec<f64> = both.map(|(a, b)| f64::from(a.unwrap() - b.unwrap())).collect();
        let n = differences.len() as f64;
        let mean = differences.iter().sum::<f64>() / n;
        differences.iter().map(|d| (d - mean).powi(2)).sum::<f64>() / n
    };
    let ratio = variance(4) / variance(1);
    // (s^2 + s^2 / 4) / (s^2 + s^2), from 24576 sites.
    assert!((ratio - 0.625).abs() < 0.03, "{ratio}");
}

#[test]
fn a_slope_of_the_rooms_light_is_told_and_cancels_between_two_dark_frames() {
    let house = House::new(Mood { slope: 0.015, unplugged: false });
    let pair = house.shoot(Order::OffOnOff, 1);
    assert_eq!(pair.verdict, Verdict::Accepted, "{:?}", pair.reasons);
    let drift = pair.drift.unwrap();
    for ratio in drift.ambient {
        assert!((ratio.unwrap() - 1.03).abs() < 0.003, "{drift:?}");
    }
    let mean = |known: KnownMosaic| {
        let n = known.value.pixels().len() as f64;
        known.value.pixels().iter().map(|v| f64::from(v.unwrap())).sum::<f64>() / n
    };
    // In steady light the same frames give the flash's light alone.
    let steady = House::new(Mood::default());
    let truth = mean(steady.known(&steady.shoot(Order::OffOn, 1)));
    let cancelled = mean(house.known(&pair)) - truth;
    assert!(cancelled.abs() < 0.3, "off by {cancelled} DN of {truth}");
    // The first frame alone leaves the step of the lamps in: 1.5 % of 1500 DN on a wall of 0.5 or so.
    let alone = PairRecord { after: vec![], ..pair };
    let left = mean(house.known(&alone)) - truth;
    assert!(left > 5.0, "{left}");
}

#[test]
fn a_room_that_changes_too_much_is_rejected_and_the_pair_is_shot_again_under_its_number() {
    let house = House::new(Mood { slope: 0.04, unplugged: false });
    let pair = house.shoot(Order::OffOnOff, 2);
    assert_eq!(codes(&pair)[0], ReasonCode::AmbientChanged, "{:?}", pair.reasons);
    let sentences: Vec<&str> = pair.reasons.iter().map(|r| r.sentence.as_str()).collect();
    assert!(
        sentences.iter().any(|s| s.contains("in the after frame") && s.contains("lamps steady")),
        "{sentences:?}"
    );
    assert!(pair.drift.unwrap().ambient[1].unwrap() > 1.04);
    house.set(Mood::default());
    let second = house.try_shoot(again(1)).unwrap();
    // The order of the first attempt, and its number of frames.
    assert_eq!((second.number, second.attempt, second.verdict), (1, 2, Verdict::Accepted));
    assert_eq!((second.order, second.frames().count()), (Order::OffOnOff, 5));
}

#[test]
fn a_misfire_is_shot_again_under_its_own_number_and_nothing_is_overwritten() {
    let house = House::new(Mood { slope: 0.0, unplugged: true });
    let first = house.shoot(Order::OffOnOff, 3);
    assert!(codes(&first).contains(&ReasonCode::Misfire), "{:?}", first.reasons);
    assert_eq!(first.frames().count(), 2, "a pair that is lost takes no further frames");
    let before = std::fs::read(house.session.pair_dir(1).join("off.cr2")).unwrap();
    let third = house.try_shoot(again(1)).unwrap();
    assert_eq!((third.attempt, third.verdict), (2, Verdict::Rejected));
    assert_eq!(house.session.pair(1).unwrap(), third, "the last counts while none is good");

    house.set(Mood::default());
    let good =
        house.try_shoot(PairWish { order: Some(Order::OffOn), off_frames: Some(1), again: Some(1) }).unwrap();
    assert_eq!((good.number, good.attempt, good.name.as_str()), (1, 3, "0001"));
    assert_eq!(good.verdict, Verdict::Accepted, "{:?}", good.reasons);
    assert_eq!(house.session.pairs().unwrap(), [Arc::new(good.clone())]);
    assert_eq!(house.session.attempts().unwrap()[&1], [first.clone(), third, good.clone()].map(Arc::new));
    assert_eq!(std::fs::read(house.session.pair_dir(&first).join("off.cr2")).unwrap(), before);
    let folders = ["0001", "0001-2", "0001-3"];
    assert!(folders.iter().all(|f| house.session.pairs_dir().join(f).is_dir()));
    let found = house.session.verify(&Progress::silent()).unwrap();
    assert!(found.findings.is_empty() && found.pairs == 3, "{found:?}");

    // It spent no number, what is good is not shot again, and what is not there cannot be.
    assert_eq!(house.session.next_pair_number().unwrap(), 2);
    assert_eq!(house.try_shoot(again(1)).unwrap_err().code(), "pair_accepted");
    assert_eq!(house.try_shoot(again(9)).unwrap_err().code(), "pair_not_found");
    let wrong = PairWish { off_frames: Some(17), ..PairWish::default() };
    assert_eq!(house.try_shoot(wrong).unwrap_err().code(), "order_invalid");
    let taken = house.scene.taken.lock().unwrap().len();
    assert_eq!(taken, 6, "what is refused releases no shutter");
    let next = house.engine.shoot_pair(&house.session, None, &Progress::silent()).unwrap();
    assert_eq!((next.number, next.attempt, next.verdict), (2, 1, Verdict::Accepted));

    let committed: Vec<(u32, u32)> = (house.session.journal().unwrap().into_iter())
        .filter_map(|entry| match entry.event {
            Event::PairCommitted { number, attempt, .. } => Some((number, attempt)),
            _ => None,
        })
        .collect();
    assert_eq!(committed, [(1, 1), (1, 2), (1, 3), (2, 1)]);
    // A program that comes later finds all of it.
    let path = house.session.path().to_owned();
    let House { session, folder, .. } = house;
    drop(session);
    let opened = Session::open(&path).unwrap();
    assert_eq!(opened.recovery(), &Default::default());
    assert_eq!(
        opened.pairs().unwrap().iter().map(|pair| Attempt::from(&**pair).to_string()).collect::<Vec<_>>(),
        ["0001-3", "0002"]
    );
    assert!(opened.rejected_pair(1).is_err());
    drop(folder);
}

fn unlit(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_unlit")).args(arguments).output().unwrap()
}

fn mean_of(session: &Path, file: &str) -> f64 {
    let mosaic = raw::read(&session.join("pairs").join(file)).unwrap().mosaic;
    mosaic.dn.pixels().iter().map(|v| f64::from(*v)).sum::<f64>() / mosaic.dn.pixels().len() as f64
}

#[test]
fn the_simulated_operator_goes_back_to_the_stop_of_the_pair_that_is_shot_again() {
    let folder = tempfile::tempdir().unwrap();
    let session = folder.path().join("walk");
    let (path, limits) = (session.to_str().unwrap(), folder.path().join("limits.json"));
    // No flash gives nine tenths of the sensor's range everywhere.
    std::fs::write(&limits, b"{ \"least_rise\": 0.99 }").unwrap();
    let strict = ["--limits", limits.to_str().unwrap()];
    let shoot = |more: &[&str]| unlit(&[&["shoot", path, "--studio"][..], more].concat());
    let run = shoot(&[&["--order", "off-on-off", "--off-frames", "2"][..], &strict[..]].concat());
    assert_eq!(run.status.code(), Some(3), "{run:?}");
    // Meanwhile he walked on.
    let run = shoot(&[]);
    assert_eq!(run.status.code(), Some(0), "{run:?}");
    let run = shoot(&["--again", "1"]);
    let said = String::from_utf8_lossy(&run.stdout);
    assert_eq!(run.status.code(), Some(0), "{run:?}");
    assert!(said.contains("Pair 1 is good"), "{said}");

    let pairs = Session::open(&session).unwrap().pairs().unwrap();
    let told: Vec<(u32, u32, Verdict)> = pairs.iter().map(|p| (p.number, p.attempt, p.verdict)).collect();
    assert_eq!(told, [(1, 2, Verdict::Accepted), (2, 1, Verdict::Accepted)]);
    assert_eq!((pairs[0].order, pairs[0].frames().count()), (Order::OffOnOff, 5));
    let [first, second, other] =
        ["0001/off.cr2", "0001-2/off.cr2", "0002/off.cr2"].map(|file| mean_of(&session, file));
    assert!((first - second).abs() < 0.2 * (first - other).abs(), "stops: {first} {second} {other}");

    let refused = shoot(&["--again", "2"]);
    assert_eq!(refused.status.code(), Some(1));
    assert!(String::from_utf8_lossy(&refused.stderr).contains("only a rejected pair can be shot again"));
    let refused = shoot(&["--order", "on-on"]);
    assert!(String::from_utf8_lossy(&refused.stderr).contains("choose off-on, on-off or off-on-off"));
    let refused = shoot(&["--off-frames", "17"]);
    assert!(String::from_utf8_lossy(&refused.stderr).contains("choose 1 to 16"));
}
