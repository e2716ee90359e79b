//! One pair from arming to commit, with rigs that misbehave.

use crate::fake_rig::{DIALS, Room, Trouble};
use std::path::Path;
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};
use tempfile::TempDir;
use unlit::capture::{
    CaptureError, Engine, Events, FlashKind, LivePicture, RigSource, calibration_frames, calibration_shots,
};
use unlit::pair::{Exposure, Limits, PairRecord, Plan, ReasonCode, Verdict};
use unlit::progress::Progress;
use unlit::session::Session;
use unlit::units::{FNumber, Iso, Seconds};

struct Shoot {
    folder: TempDir,
    session: Session,
    engine: Engine,
    events: Events,
}

fn shoot_with(rig: RigSource) -> Shoot {
    let folder = tempfile::tempdir().unwrap();
    let session = Session::create(&folder.path().join("vase"), "vase").unwrap();
    let events = Events::default();
    let engine = Engine::new(rig, Limits::default(), events.clone());
    Shoot { folder, session, engine, events }
}

impl Shoot {
    fn pair(&self) -> Result<PairRecord, CaptureError> {
        self.engine.shoot_pair(&self.session, None, &Progress::silent())
    }

    fn journal(&self) -> String {
        std::fs::read_to_string(self.folder.path().join("vase/journal.jsonl")).unwrap()
    }

    /// Every file of the session that is not one of its few standing ones.
    fn pair_files(&self) -> Vec<String> {
        fn walk(folder: &Path, out: &mut Vec<String>) {
            for entry in std::fs::read_dir(folder).unwrap() {
                let path = entry.unwrap().path();
                if path.is_dir() { walk(&path, out) } else { out.push(path.display().to_string()) }
            }
        }
        let mut files = Vec::new();
        walk(&self.session.pairs_dir(), &mut files);
        walk(&self.session.calibration_dir(), &mut files);
        files
    }
}

fn codes(pair: &PairRecord) -> Vec<ReasonCode> {
    pair.reasons.iter().map(|r| r.code).collect()
}

#[test]
fn a_good_pair_is_accepted_whole_and_announced() {
    let room = Room::default();
    let shoot = shoot_with(room.rig());
    let (_, mut heard) = shoot.events.listen();
    let pair = shoot.pair().unwrap();
    assert_eq!(pair.verdict, Verdict::Accepted, "{:?}", pair.reasons);
    assert_eq!(pair.number, 1);
    let flash = pair.flash.clone().unwrap();
    assert_eq!((flash.pulses_off(), flash.pulses_on(), flash.energy_counts()), (0, 1, Some(1000.0)));
    assert!(shoot.session.verify_pair(pair.number).is_empty());
    assert_eq!(shoot.session.pairs().unwrap(), [Arc::new(pair)]);
    assert_eq!(room.log(), ["disarm", "shoot", "arm", "shoot", "disarm"]);
    let told = heard.try_recv().unwrap();
    assert_eq!((told.topic.name(), &told.data["number"]), ("pair", &1.into()));
}

#[test]
fn the_hook_sees_an_accepted_pair_before_anybody_hears_of_it() {
    let shoot = shoot_with(Room::default().rig());
    let (_, heard) = shoot.events.listen();
    let heard = Mutex::new(heard);
    let seen = Arc::new(Mutex::new(Vec::new()));
    let hook: unlit::capture::AfterPair = {
        let seen = seen.clone();
        Arc::new(move |pair: &PairRecord| {
            let silent = heard.lock().unwrap().try_recv().is_err();
            seen.lock().unwrap().push((pair.number, silent));
        })
    };
    shoot.engine.shoot_pair(&shoot.session, Some(&hook), &Progress::silent()).unwrap();
    assert_eq!(*seen.lock().unwrap(), [(1, true)]);
}

#[test]
fn a_rejected_pair_is_stored_with_its_reasons_and_moves_nobody_on() {
    for (trouble, code) in [
        (Trouble::Misfire, ReasonCode::Misfire),
        (Trouble::NoContact, ReasonCode::Misfire),
        (Trouble::FiresInTheDark, ReasonCode::NotDark),
        (Trouble::Overexposed, ReasonCode::Overexposed),
        (Trouble::CutsFile(0), ReasonCode::Truncated),
        (Trouble::CutsFile(1), ReasonCode::Truncated),
    ] {
        let shoot = shoot_with(Room::with(trouble).rig());
        let hook: unlit::capture::AfterPair =
            Arc::new(|_: &PairRecord| panic!("moved on after a rejected pair"));
        let pair = shoot.engine.shoot_pair(&shoot.session, Some(&hook), &Progress::silent()).unwrap();
        assert_eq!(pair.verdict, Verdict::Rejected, "{trouble:?}");
        assert!(codes(&pair).contains(&code), "{trouble:?} gave {:?}", pair.reasons);
        assert!(pair.reasons.iter().all(|r| r.sentence.len() > 5));
        assert!(shoot.session.verify_pair(pair.number).is_empty(), "{trouble:?}");
    }
}

#[test]
fn a_camera_error_leaves_a_line_in_the_journal_and_nothing_half() {
    for release in [0, 1] {
        let room = Room::with(Trouble::Refuses(release));
        let shoot = shoot_with(room.rig());
        let error = shoot.pair().unwrap_err();
        assert_eq!(error.code(), "camera_refused");
        assert!(error.to_string().contains("mirror up"), "{error}");
        assert!(shoot.session.pairs().unwrap().is_empty());
        assert_eq!(shoot.pair_files(), Vec::<String>::new());
        assert!(shoot.journal().contains("pair_abandoned") && shoot.journal().contains("mirror up"));
        assert!(!room.is_armed(), "the gate was left open after release {release}");

        room.set(Trouble::None);
        let pair = shoot.pair().unwrap();
        assert_eq!(pair.verdict, Verdict::Accepted);
    }
}

#[test]
fn a_panic_in_the_middle_closes_the_gate_and_the_next_pair_is_good() {
    for release in [0, 1] {
        let room = Room::with(Trouble::PanicsAt(release));
        let shoot = shoot_with(room.rig());
        let outcome = std::panic::catch_unwind(std::panic::AssertUnwindSafe(|| shoot.pair()));
        assert!(outcome.is_err(), "{outcome:?}");
        assert!(!room.is_armed(), "the gate was left open after release {release}");
        room.set(Trouble::None);
        let pair = shoot.pair().unwrap();
        assert_eq!((pair.number, pair.verdict), (1, Verdict::Accepted));
    }
}

#[test]
fn the_gate_is_closed_past_a_camera_that_does_not_come_back() {
    let room = Room::with(Trouble::HoldsAt(1));
    let shoot = shoot_with(room.rig());
    std::thread::scope(|scope| {
        let pair = scope.spawn(|| shoot.pair());
        let end = Instant::now() + Duration::from_secs(10);
        while room.log().last() != Some(&"shoot") || !room.is_armed() {
            assert!(Instant::now() < end, "{:?}", room.log());
            std::thread::yield_now();
        }
        shoot.engine.close_gate();
        assert!(!room.is_armed());
        room.set(Trouble::None);
        // The flash stayed dark, and the pair says so.
        assert_eq!(pair.join().unwrap().unwrap().verdict, Verdict::Rejected);
    });
}

#[test]
fn cancelling_between_the_frames_stores_nothing_and_closes_the_gate() {
    let room = Room::default();
    let shoot = shoot_with(room.rig());
    let progress = {
        let handle: Arc<Mutex<Option<Progress>>> = Arc::default();
        let own = handle.clone();
        let progress = Progress::new(move |report| {
            if report.stage.contains("Getting the flash ready") {
                own.lock().unwrap().as_ref().unwrap().cancel();
            }
        });
        *handle.lock().unwrap() = Some(progress.clone());
        progress
    };
    let outcome = shoot.engine.shoot_pair(&shoot.session, None, &progress);
    assert!(matches!(outcome, Err(CaptureError::Cancelled(_))), "{outcome:?}");
    assert_eq!(room.log(), ["disarm", "shoot", "arm", "disarm"]);
    assert_eq!(shoot.pair_files(), Vec::<String>::new());
    assert!(shoot.journal().contains("cancelled on request"));
}

#[test]
fn a_missing_camera_is_told_in_words_and_found_when_it_comes() {
    let room = Room::with(Trouble::NoCamera);
    let shoot = shoot_with(room.rig());
    let devices = shoot.engine.look();
    assert!(!devices.camera.ready && devices.flash.ready);
    assert!(devices.camera.words.contains("plugged in"), "{}", devices.camera.words);
    assert_eq!(shoot.pair().unwrap_err().code(), "camera_not_found");
    room.set(Trouble::None);
    assert!(shoot.engine.look().ready());
    assert_eq!(shoot.pair().unwrap().verdict, Verdict::Accepted);
}

#[test]
fn without_any_flash_pairs_are_refused_with_a_sentence() {
    let shoot = shoot_with(Room::default().rig_with(|| FlashKind::None));
    let error = shoot.pair().unwrap_err();
    assert_eq!(error.code(), "flash_missing");
    assert!(error.to_string().contains("--flash manual"), "{error}");
    assert!(shoot.session.pairs().unwrap().is_empty());
}

/// A pair whose operator is asked to switch the flash off and on, and switches it as given.
fn by_hand(room: &Room, shoot: &Shoot, switched: [bool; 2]) -> PairRecord {
    std::thread::scope(|scope| {
        let shooting = scope.spawn(|| shoot.pair());
        for (word, on) in ["off", "on"].into_iter().zip(switched) {
            let end = Instant::now() + Duration::from_secs(10);
            while !shoot.engine.prompt().is_some_and(|p| p.contains(&format!("flash {word}"))) {
                assert!(Instant::now() < end, "was not asked to switch the flash {word}");
                std::thread::yield_now();
            }
            room.switch_flash(on);
            assert!(shoot.engine.confirm());
        }
        shooting.join().unwrap().unwrap()
    })
}

#[test]
fn a_flash_switched_by_hand_is_asked_for_twice() {
    let room = Room::default();
    let shoot = shoot_with(room.rig_with(|| FlashKind::Manual));
    let pair = by_hand(&room, &shoot, [false, true]);
    assert_eq!(pair.verdict, Verdict::Accepted, "{:?}", pair.reasons);
    assert_eq!(pair.flash, None);
    assert!(!shoot.engine.confirm(), "nothing is asked any more");
}

#[test]
fn an_operator_who_forgets_a_switch_is_found_out_by_the_images_alone() {
    for (switched, words) in
        [([false, false], "did not fire"), ([true, true], "did not fire"), ([true, false], "look swapped")]
    {
        let room = Room::default();
        let shoot = shoot_with(room.rig_with(|| FlashKind::Manual));
        let pair = by_hand(&room, &shoot, switched);
        assert_eq!(codes(&pair), [ReasonCode::Misfire], "{switched:?}: {:?}", pair.reasons);
        assert!(pair.reasons[0].sentence.contains(words), "{switched:?}: {}", pair.reasons[0].sentence);
    }
}

#[test]
fn card_shots_are_numbered_by_distance_and_kept_beside_the_pairs() {
    let shoot = shoot_with(Room::default().rig());
    for distance in [1.0, 1.0, 0.75] {
        shoot.engine.shoot_card(&shoot.session, distance, &Progress::silent()).unwrap();
    }
    let shots = calibration_shots(&shoot.session).unwrap();
    let names: Vec<_> = shots.iter().map(|s| s.name.as_str()).collect();
    assert_eq!(names, ["d00750_1", "d01000_1", "d01000_2"]);
    for shot in &shots {
        let (off, on) = calibration_frames(&shoot.session, shot);
        assert_eq!(unlit::session::store::digest_file(&off).unwrap(), shot.off.blake3);
        assert_eq!(unlit::session::store::digest_file(&on).unwrap(), shot.on.blake3);
    }
    assert!(shoot.session.pairs().unwrap().is_empty());
}

#[test]
fn a_camera_that_hangs_is_brought_back_and_both_frames_are_shot_again() {
    for release in [0, 1] {
        let room = Room::with(Trouble::HangsAt(release));
        let shoot = shoot_with(room.rig());
        let (_, mut heard) = shoot.events.listen();
        let pair = shoot.pair().unwrap();
        assert_eq!((pair.number, pair.verdict), (1, Verdict::Accepted), "{:?}", pair.reasons);
        let log = room.log();
        let brought_back = log.iter().position(|l| *l == "recover").unwrap();
        assert_eq!(log[brought_back + 1..], ["disarm", "shoot", "arm", "shoot", "disarm"]);
        assert_eq!(shoot.session.pairs().unwrap().len(), 1, "no pair is lost or doubled");
        let told: Vec<_> = std::iter::from_fn(|| heard.try_recv().ok()).collect();
        let words: Vec<_> = told.iter().map(|e| (e.topic.name(), e.words.as_str())).collect();
        assert!(words[0].0 == "recovery" && words[0].1.contains("take a picture"), "{words:?}");
        assert_eq!(words[1], ("recovery", "The camera is back (opened anew)."));
        assert!(shoot.journal().contains("pair_abandoned"));
    }
}

#[test]
fn the_first_pair_sets_the_plan_and_later_ones_keep_to_it() {
    let room = Room::default();
    let shoot = shoot_with(room.rig());
    shoot.pair().unwrap();
    let plan = shoot.session.manifest().plan.unwrap();
    assert_eq!(plan, Plan { off: DIALS, on: DIALS });
    room.turn(Exposure { iso: Iso(400.0), ..DIALS });
    let pair = shoot.pair().unwrap();
    assert_eq!(pair.verdict, Verdict::Accepted, "{:?}", pair.reasons);
    assert_eq!((pair.off.settings.iso, pair.on.settings.iso), (Some(Iso(100.0)), Some(Iso(100.0))));
    let reopened = Session::open_shared(shoot.session.path());
    assert!(reopened.is_err(), "locked while it is in use");
    let path = shoot.session.path().to_owned();
    drop(shoot.session);
    assert_eq!(Session::open(&path).unwrap().manifest().plan, Some(plan));
}

#[test]
fn a_rejected_first_pair_leaves_the_operator_free_to_set_the_camera_otherwise() {
    let room = Room::with(Trouble::Overexposed);
    let shoot = shoot_with(room.rig());
    assert_eq!(shoot.pair().unwrap().verdict, Verdict::Rejected);
    assert_eq!(shoot.session.manifest().plan, None);
    room.set(Trouble::None);
    let closed = Exposure { aperture: FNumber(16.0), ..DIALS };
    room.turn(closed);
    assert_eq!(shoot.pair().unwrap().verdict, Verdict::Accepted);
    assert_eq!(shoot.session.manifest().plan, Some(Plan { off: closed, on: closed }));
    let (_, mut heard) = shoot.events.listen();
    room.turn(DIALS);
    assert_eq!(shoot.pair().unwrap().on.settings.aperture, Some(FNumber(16.0)));
    let told = heard.try_recv().unwrap();
    assert!(told.topic.name() == "recovery" && told.words.contains("turned back"), "{}", told.words);
}

#[test]
fn frames_of_different_exposures_follow_the_plan_each() {
    let room = Room::default();
    let shoot = shoot_with(room.rig());
    let slow = Exposure { shutter: Seconds(1.0 / 30.0), ..DIALS };
    shoot.session.set_plan(Plan { off: slow, on: DIALS }).unwrap();
    for _ in 0..2 {
        let pair = shoot.pair().unwrap();
        assert_eq!(pair.verdict, Verdict::Accepted, "{:?}", pair.reasons);
        assert_eq!(pair.off.settings.shutter, Some(slow.shutter));
        assert_eq!(pair.on.settings.shutter, Some(DIALS.shutter));
    }
}

#[test]
fn a_camera_that_does_not_obey_shoots_no_pair() {
    let room = Room::default();
    let shoot = shoot_with(room.rig());
    shoot.pair().unwrap();
    room.turn(Exposure { iso: Iso(400.0), ..DIALS });
    room.set(Trouble::Disobeys);
    let error = shoot.pair().unwrap_err();
    assert_eq!(error.code(), "exposure_not_set");
    assert!(error.to_string().contains("ISO 400") && error.to_string().contains("ISO 100"), "{error}");
    assert_eq!(shoot.session.pairs().unwrap().len(), 1);
}

#[test]
fn a_setting_that_would_spoil_every_pair_refuses_them_until_it_is_mended() {
    let room = Room::with(Trouble::Autofocus);
    let shoot = shoot_with(room.rig());
    let error = shoot.pair().unwrap_err();
    assert_eq!(error.code(), "camera_not_locked");
    assert!(error.to_string().contains("switch the lens to MF"), "{error}");
    assert!(!room.log().contains(&"shoot"));
    room.set(Trouble::None);
    assert_eq!(shoot.pair().unwrap().verdict, Verdict::Accepted);
}

#[test]
fn the_newest_live_picture_wins_and_pairs_go_first() {
    let room = Room::default();
    let shoot = shoot_with(room.rig());
    let engine = Arc::new(shoot.engine);
    let mut watcher = engine.watch_live().unwrap();
    let end = Instant::now() + Duration::from_secs(10);
    while !matches!(&*watcher.borrow_and_update(), LivePicture::Jpeg(_)) {
        assert!(Instant::now() < end, "no picture");
        std::thread::yield_now();
    }
    let pair = engine.shoot_pair(&shoot.session, None, &Progress::silent()).unwrap();
    assert_eq!(pair.verdict, Verdict::Accepted);
    drop(watcher);
    while !room.log().contains(&"end preview") {
        assert!(Instant::now() < end, "live view was not ended with its last watcher");
        std::thread::yield_now();
    }
    drop(engine.watch_live().unwrap());
}
