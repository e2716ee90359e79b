//! The second copy: whole by itself, never in the way, and told of when it fails.

use serde_json::json;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};
use unlit::pair::Settings;
use unlit::progress::Progress;
use unlit::session::{
    Between, Event, FRAME_REMOVED, FRAME_STORED, MirrorPatience, MirrorState, MirrorStatus, More, NewFrame,
    NewPair, PositionRecord, SHOT_STORED, SequencePlan, SequenceRecord, Session, SessionError, Stage,
};

const PATIENCE: Duration = Duration::from_secs(20);

/// A session, a folder for its copy, and what was told of it.
struct Place {
    home: tempfile::TempDir,
    session: Session,
    told: Arc<Mutex<Vec<MirrorStatus>>>,
}

fn quick() -> MirrorPatience {
    let [silence, first_retry, longest_retry] = [300, 1, 20].map(Duration::from_millis);
    MirrorPatience { silence, first_retry, longest_retry }
}

impl Place {
    fn new() -> Self {
        let home = tempfile::tempdir().unwrap();
        std::fs::create_dir(home.path().join("other")).unwrap();
        let session = Session::create(&home.path().join("sessions/bath"), "bath").unwrap();
        Self { home, session, told: Arc::default() }
    }

    fn mirrors(&self) -> PathBuf {
        self.home.path().join("other")
    }

    fn copy(&self) -> PathBuf {
        self.mirrors().join("bath")
    }

    fn start(&self) {
        let told = self.told.clone();
        let tell = move |status: &MirrorStatus| told.lock().unwrap().push(status.clone());
        self.session.mirror_to(&self.mirrors(), quick(), tell).unwrap();
    }

    fn commit(&self, fill: u8) {
        let frame = |bytes| NewFrame {
            bytes,
            original_name: "a.dng",
            settings: Settings::default(),
            prepared: None,
            jpeg: Some((b"small".as_slice(), "a.jpg")),
        };
        // Longer than the piece in which files are copied.
        let (off, on) = (vec![fill; 3_000_000], [fill; 5]);
        let (off, on) = (frame(off.as_slice()), frame(on.as_slice()));
        self.session
            .commit_pair(NewPair { name: None, off, on, reasons: vec![], flash: None, more: More::default() })
            .unwrap();
    }

    fn until(&self, what: &str, holds: impl Fn(&MirrorState) -> bool) -> MirrorStatus {
        let end = Instant::now() + PATIENCE;
        loop {
            let status = self.session.mirror().unwrap();
            if holds(&status.state) {
                return status;
            }
            assert!(Instant::now() < end, "{what}: {status:?}");
            std::thread::yield_now();
        }
    }

    fn until_in_step(&self) {
        self.until("in step", |state| *state == MirrorState::InStep);
    }

    fn until_failing(&self, word: &str) -> String {
        let status =
            self.until(word, |state| matches!(state, MirrorState::Failing { why } if why.contains(word)));
        status.words()
    }

    /// How often a failure was told.
    fn failures_told(&self) -> usize {
        let told = self.told.lock().unwrap();
        told.iter().filter(|status| matches!(status.state, MirrorState::Failing { .. })).count()
    }

    /// The copy is a session by itself, and the same.
    fn check(self) {
        let status = self.session.finish_mirror(PATIENCE).unwrap();
        assert_eq!(status.state, MirrorState::InStep, "{}", status.words());
        let (copy, pairs) = (self.copy(), self.session.pairs().unwrap());
        drop(self.session);
        let end = Instant::now() + PATIENCE;
        let copied = loop {
            // The thread gives the copy's lock back when it ends.
            match Session::open(&copy) {
                Err(SessionError::Locked { .. }) if Instant::now() < end => std::thread::yield_now(),
                other => break other.unwrap(),
            }
        };
        assert_eq!(copied.recovery(), &Default::default());
        assert_eq!(copied.pairs().unwrap(), pairs);
        let found = copied.verify(&Progress::silent()).unwrap();
        assert!(found.findings.is_empty(), "{:?}", found.findings);
        assert_eq!(found.originals, 4 * pairs.len());
    }
}

#[test]
fn the_copy_is_a_session_that_holds_everything_that_cannot_be_made_again() {
    let place = Place::new();
    place.commit(1);
    let session = &place.session;
    let result = session.calibration_dir().join("flash.json");
    session.keep(&result, b"first").unwrap();
    place.start();
    place.commit(2);
    place.until_in_step();
    let shot = session.calibration_dir().join("flash/d01000_1");
    std::fs::create_dir_all(&shot).unwrap();
    for (file, bytes) in [("on.dng", b"on".as_slice()), ("off.dng", b"off")] {
        std::fs::write(shot.join(file), bytes).unwrap();
    }
    let frame = |file: &str, bytes: &[u8]| {
        json!({ "file": file, "original_name": file, "bytes": bytes.len(), "settings": {},
            "blake3": unlit::session::store::digest(bytes) })
    };
    let record = json!({ "off": frame("off.dng", b"off"), "on": frame("on.dng", b"on") });
    std::fs::write(shot.join("shot.json"), record.to_string()).unwrap();
    let stored = Event::Note { what: SHOT_STORED.into(), detail: json!({ "name": "d01000_1" }) };
    session.record(stored).unwrap();
    session.keep(&result, b"second").unwrap();
    session.keep(&session.scene_dir().join("originals/0123_a.obj"), b"v 0 0 0").unwrap();
    let dark = format!("calibration/levels/{}_dark.dng", &unlit::session::store::digest(b"dark")[..8]);
    session.keep(&session.path().join(&dark), b"dark").unwrap();
    session.set_region(None).unwrap();
    session.confirm(&["mirror_lock_up".into()]).unwrap();
    std::fs::write(session.derived_dir().join("large.f32"), b"can be made again").unwrap();

    let status = session.finish_mirror(PATIENCE).unwrap();
    assert_eq!(status.state, MirrorState::InStep);
    let warning = status.warning.unwrap();
    assert!(warning.contains("same disk"), "{warning}");
    for file in [
        "session.json",
        "journal.jsonl",
        "calibration/flash.json",
        "calibration/flash/d01000_1/on.dng",
        &dark,
    ] {
        let same = std::fs::read(session.path().join(file)).unwrap();
        assert_eq!(std::fs::read(place.copy().join(file)).unwrap(), same, "{file}");
    }
    assert!(!place.copy().join("derived/large.f32").exists());
    assert_eq!(place.failures_told(), 0);
}

#[test]
fn what_is_missing_is_caught_up_at_the_next_opening() {
    let place = Place::new();
    place.commit(1);
    place.commit(2);
    place.start();
    place.until_in_step();
    assert!(matches!(Session::open(&place.copy()), Err(SessionError::Locked { holder: Some(_), .. })));
    let Place { home, session, told } = place;
    let path = session.path().to_owned();
    session.finish_mirror(PATIENCE);
    drop(session);
    // As a machine leaves it that stopped in the middle.
    let copy = home.path().join("other/bath");
    std::fs::remove_file(copy.join("pairs/0001/on.dng")).unwrap();
    std::fs::create_dir(copy.join("pairs/.tmp-1-1")).unwrap();
    std::fs::write(copy.join("pairs/.tmp-1-1/off.dng"), b"half").unwrap();
    std::fs::remove_file(copy.join("journal.jsonl")).unwrap();
    let place = Place { home, session: Session::open(&path).unwrap(), told };
    place.commit(3);
    place.start();
    place.check();
}

#[test]
fn what_differs_is_named_and_left_as_it_is_and_the_rest_is_copied() {
    let place = Place::new();
    place.commit(1);
    let theirs = place.copy().join("pairs/0001");
    place.start();
    place.until_in_step();
    let Place { home, session, told } = place;
    let path = session.path().to_owned();
    session.finish_mirror(PATIENCE);
    drop(session);
    std::fs::write(theirs.join("on.dng"), b"other").unwrap();
    std::fs::write(theirs.join("off.dng"), b"shorter").unwrap();
    let place = Place { home, session: Session::open(&path).unwrap(), told };
    place.commit(2);
    place.start();
    let words = place.until_failing("off.dng");
    assert!(words.contains("left as it is") && words.contains("Pairs go on"), "{words}");
    assert_eq!(std::fs::read(theirs.join("off.dng")).unwrap(), b"shorter");
    assert!(place.copy().join("pairs/0002/pair.json").is_file());
    assert_eq!(place.failures_told(), 1);
    std::fs::rename(&theirs, place.home.path().join("away")).unwrap();
    place.until_in_step();
    place.check();
}

#[test]
fn a_damaged_original_is_not_copied() {
    let place = Place::new();
    place.commit(1);
    std::fs::write(place.session.pair_dir(1).join("on.dng"), [9; 5]).unwrap();
    place.start();
    let words = place.until_failing("not what was stored");
    assert!(words.contains("pairs/0001/on.dng") && words.contains("verify"), "{words}");
    assert!(!place.copy().join("pairs/0001").exists());
}

#[test]
fn a_mirror_that_is_gone_is_told_once_and_taken_up_when_it_is_back() {
    let place = Place::new();
    std::fs::remove_dir(place.mirrors()).unwrap();
    place.start();
    let words = place.until_failing("plugged in");
    assert!(words.contains("other"), "{words}");
    for fill in 0..3 {
        place.commit(fill);
    }
    assert_eq!(place.failures_told(), 1);
    std::fs::create_dir(place.mirrors()).unwrap();
    place.until_in_step();
    place.check();
}

#[test]
fn a_mirror_that_hangs_slows_no_pair_and_is_not_waited_for() {
    let place = Place::new();
    std::fs::create_dir(place.copy()).unwrap();
    // Whoever opens it to read waits for ever, as with a server that is gone.
    assert!(Command::new("mkfifo").arg(place.copy().join("session.json")).status().unwrap().success());
    place.start();
    for fill in 0..3 {
        place.commit(fill);
    }
    place.until_failing("not answered");
    place.commit(4);
    place.commit(5);
    assert_eq!(place.failures_told(), 1);
    let began = Instant::now();
    let status = place.session.finish_mirror(Duration::from_millis(50)).unwrap();
    assert!(matches!(status.state, MirrorState::Failing { .. }), "{status:?}");
    assert!(began.elapsed() < Duration::from_secs(5));
    assert_eq!(place.session.pairs().unwrap().len(), 5);
    // Lets the thread go.
    drop(std::fs::OpenOptions::new().write(true).open(place.copy().join("session.json")).unwrap());
}

#[test]
fn another_sessions_copy_and_other_folders_are_not_touched() {
    let place = Place::new();
    let other = Session::create(&place.copy(), "bath").unwrap();
    place.start();
    place.until_failing("another session");
    drop(other);
    // At one stroke: the mirror fills an empty folder.
    let album = place.copy().with_file_name("album");
    std::fs::create_dir(&album).unwrap();
    std::fs::write(album.join("holiday.jpg"), b"x").unwrap();
    let here = rustix::fs::CWD;
    rustix::fs::renameat_with(here, &album, here, place.copy(), rustix::fs::RenameFlags::EXCHANGE).unwrap();
    place.until_failing("no copy of a session");
    assert_eq!(std::fs::read_dir(place.copy()).unwrap().count(), 1);
}

#[test]
fn a_mirror_inside_the_sessions_folder_is_refused_by_name_and_through_links() {
    let place = Place::new();
    let start = |mirrors: &Path| place.session.mirror_to(mirrors, quick(), |_| {});
    let sessions = place.home.path().join("sessions");
    for inside in [sessions.clone(), sessions.join("bath/pairs"), sessions.join("mirrors")] {
        let error = start(&inside).unwrap_err();
        assert!(matches!(error, SessionError::MirrorInside { .. }), "{error}");
    }
    std::os::unix::fs::symlink(&sessions, place.home.path().join("link")).unwrap();
    start(&place.home.path().join("link")).unwrap();
    place.until_failing("inside the sessions folder");
    assert_eq!(std::fs::read_dir(&sessions).unwrap().count(), 1);
}

const CHILD_FOLDER: &str = "UNLIT_TEST_MIRROR_ON_A_BAD_DISK";

/// Run by the test below in a process of its own: stores pairs while the mirror's disk fails.
#[test]
fn stores_with_a_mirror_on_a_bad_disk() {
    let Some(folder) = std::env::var_os(CHILD_FOLDER) else { return };
    let place = Place::new();
    let mirrors = PathBuf::from(folder);
    let (told, session) = (place.told.clone(), &place.session);
    let tell = move |status: &MirrorStatus| told.lock().unwrap().push(status.clone());
    session.mirror_to(&mirrors, quick(), tell).unwrap();
    for fill in 0..2 {
        place.commit(fill);
    }
    place.until_in_step();
    let told = place.told.lock().unwrap().iter().map(MirrorStatus::words).collect::<Vec<_>>().join("\n");
    println!("\n{told}");
    let found = {
        session.finish_mirror(PATIENCE);
        let end = Instant::now() + PATIENCE;
        loop {
            match Session::open_shared(&mirrors.join("bath")) {
                Err(SessionError::Locked { .. }) if Instant::now() < end => std::thread::yield_now(),
                other => break other.unwrap().verify(&Progress::silent()).unwrap(),
            }
        }
    };
    assert!(found.findings.is_empty() && found.pairs == 2, "{:?}", found.findings);
}

#[test]
fn a_disk_that_fails_at_any_moment_of_mirroring_is_told_and_caught_up() {
    let mut failed = 0;
    for n in (1..200).step_by(3) {
        let home = tempfile::tempdir().unwrap();
        let run = Command::new(std::env::current_exe().unwrap())
            .args(["--exact", "mirror::stores_with_a_mirror_on_a_bad_disk", "--nocapture"])
            .env(CHILD_FOLDER, home.path())
            .env("LD_PRELOAD", crate::disk::faults())
            .env("UNLIT_TEST_DISK_FOLDER", home.path())
            .env("UNLIT_TEST_DISK_FIRST", n.to_string())
            .env("UNLIT_TEST_DISK_LAST", (n + 2).to_string())
            .env("UNLIT_TEST_DISK_ERRNO", "28")
            .env("UNLIT_TEST_DISK_DELAY", "0")
            .output()
            .unwrap();
        let (said, told) = (String::from_utf8_lossy(&run.stderr), String::from_utf8_lossy(&run.stdout));
        assert!(run.status.success(), "operation {n}: {said}{told}");
        if told.contains("the disk is full") {
            failed += 1;
        }
        if !said.contains("disk: ") {
            assert!(failed >= 5, "{failed}");
            return;
        }
    }
    panic!("there is no end to it");
}

#[test]
fn the_copy_has_the_sequence_as_it_stands_and_none_once_it_is_forgotten() {
    let place = Place::new();
    place.commit(1);
    let plan = SequencePlan::new(2, Between::Hook);
    let positions = vec![PositionRecord { pairs: vec![1], skipped: false }, PositionRecord::default()];
    let mut record = SequenceRecord { stage: Stage::Begun, positions, ..SequenceRecord::planned(plan) };
    place.session.set_sequence(&record).unwrap();
    place.start();
    place.until_in_step();
    let read = || std::fs::read(place.copy().join("sequence.json")).ok();
    let copied = || read().map(|bytes| serde_json::from_slice::<SequenceRecord>(&bytes).unwrap());
    assert_eq!(copied().as_ref(), Some(&record));
    record.positions[1].skipped = true;
    place.session.set_sequence(&record).unwrap();
    place.until_in_step();
    assert_eq!(copied(), Some(record));
    place.session.forget_sequence().unwrap();
    place.until_in_step();
    assert_eq!(copied(), None);
    place.check();
}

#[test]
fn the_desk_mirrors_every_session_that_is_opened_and_tells_how_it_stands() {
    let home = tempfile::tempdir().unwrap();
    let (sessions, mirrors) = (home.path().join("sessions"), home.path().join("other"));
    std::fs::create_dir(&mirrors).unwrap();
    let desk = crate::locks::desk(&sessions).unwrap();
    let refused = desk.mirror_to(&sessions.join("copies")).unwrap_err().to_string();
    assert!(refused.contains("another disk"), "{refused}");
    desk.enter("before").unwrap();
    assert_eq!(desk.summary("before").unwrap().mirror, None);
    desk.mirror_to(&mirrors).unwrap();
    let (_, mut heard) = desk.events().listen();
    desk.enter("vase").unwrap();
    let end = Instant::now() + PATIENCE;
    let event = loop {
        match heard.try_recv() {
            Ok(event) if event.topic == unlit::capture::Topic::Mirror => break event,
            _ => assert!(Instant::now() < end, "nothing was told"),
        }
        std::thread::yield_now();
    };
    assert_eq!((&event.data["session"], &event.data["mirror"]["state"]), (&json!("vase"), &json!("in_step")));
    let stand = desk.finish_mirrors(PATIENCE);
    assert_eq!(stand.len(), 1, "{stand:?}");
    assert_eq!(stand[0].folder, mirrors.join("vase"));
    assert_eq!(desk.summary("vase").unwrap().mirror.unwrap().state, MirrorState::InStep);
}

/// A shot that waits for its calibration, of which only the bytes matter here.
fn waits(session: &Session, kind: &str, number: u32, bytes: &[u8]) {
    let own = session.path().join(format!("calibration/waiting/{kind}/{number:04}"));
    std::fs::create_dir_all(&own).unwrap();
    let blake3 = unlit::session::store::digest(bytes);
    let frame =
        json!({ "file": "dark.dng", "original_name": "dark.dng", "bytes": bytes.len(), "blake3": blake3 });
    std::fs::write(own.join("dark.dng"), bytes).unwrap();
    std::fs::write(own.join("shot.json"), json!({ "number": number, "frame": frame }).to_string()).unwrap();
    noted(session, FRAME_STORED, kind, number);
}

fn noted(session: &Session, what: &str, kind: &str, number: u32) {
    let detail = json!({ "kind": kind, "shot": number });
    session.record(Event::Note { what: what.into(), detail }).unwrap();
}

fn no_more(session: &Session, kind: &str, number: u32) {
    std::fs::remove_dir_all(session.path().join(format!("calibration/waiting/{kind}/{number:04}"))).unwrap();
    noted(session, FRAME_REMOVED, kind, number);
}

#[test]
fn shots_that_wait_for_their_calibration_are_copied_and_go_when_they_wait_no_more() {
    let place = Place::new();
    let session = &place.session;
    let copied = |kind: &str, number: u32| {
        std::fs::read(place.copy().join(format!("calibration/waiting/{kind}/{number:04}/dark.dng"))).ok()
    };
    // A pair of the same number has a record of its own.
    place.commit(1);
    waits(session, "levels", 1, b"before");
    place.start();
    place.until_in_step();
    assert_eq!(copied("levels", 1).unwrap(), b"before");
    waits(session, "levels", 2, b"second");
    waits(session, "noise", 1, b"other kind");
    place.until_in_step();
    assert_eq!(copied("levels", 2).unwrap(), b"second");
    assert_eq!(copied("noise", 1).unwrap(), b"other kind");

    // Thrown away, and another has its number before and after the mirror has seen that.
    no_more(session, "levels", 2);
    place.until_in_step();
    assert_eq!(copied("levels", 2), None);
    waits(session, "levels", 2, b"third");
    no_more(session, "noise", 1);
    waits(session, "noise", 1, b"again");
    place.until_in_step();
    assert_eq!(
        (copied("levels", 2).unwrap(), copied("noise", 1).unwrap()),
        (b"third".into(), b"again".into())
    );
    assert_eq!(copied("levels", 1).unwrap(), b"before");

    // What nobody removed is not taken away from the copy.
    let lost = session.path().join("calibration/waiting/levels/0001");
    std::fs::remove_dir_all(&lost).unwrap();
    noted(session, FRAME_STORED, "levels", 3);
    place.until_in_step();
    assert_eq!(copied("levels", 1).unwrap(), b"before");
    assert_eq!(place.failures_told(), 0);
    place.check();
}
