//! Jobs at the desk: what a restart finds, what is done again, what waits for a pause. The rig has no wires, and the
//! processing leaves marks.

use crate::api::marking_works;
use crate::fake_rig::{Room, Trouble};
use serde_json::json;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicU32, Ordering};
use std::time::{Duration, Instant};
use tempfile::TempDir;
use unlit::calibration::guide::{Kind, Role};
use unlit::capture::{Desk, DeskError, Engine, Events, PairWish, SceneFiles, ShotWish, Works};
use unlit::jobs::{Job, JobState, JobsError};
use unlit::pair::Limits;
use unlit::progress::Progress;
use unlit::session::{Session, SessionError};

const PATIENCE: Duration = Duration::from_secs(20);

struct Bureau {
    desk: Desk,
    events: Events,
    processed: Arc<AtomicU32>,
}

fn bureau(sessions: &Path, room: &Room) -> Bureau {
    let processed = Arc::default();
    let works = marking_works(&processed);
    with_works(sessions, room, works, processed)
}

fn with_works(sessions: &Path, room: &Room, works: Works, processed: Arc<AtomicU32>) -> Bureau {
    let events = Events::default();
    let engine = Arc::new(Engine::new(room.rig(), Limits::default(), events.clone()));
    let desk = Desk::open(engine, events.clone(), sessions, works, None).unwrap();
    Bureau { desk, events, processed }
}

impl Bureau {
    fn ended(&self, job: &Job) -> Job {
        let end = Instant::now() + PATIENCE;
        loop {
            let job = self.desk.queue().get(job.id).unwrap();
            if job.state.is_final() {
                return job;
            }
            assert!(Instant::now() < end, "{job:?}");
            std::thread::yield_now();
        }
    }

    fn of_kind(&self, kind: &str) -> Vec<Job> {
        self.desk.queue().list().into_iter().filter(|job| job.kind == kind).collect()
    }

    /// The first event of this code from now on.
    fn told(&self, code: &str, act: impl FnOnce()) -> String {
        let (_, mut heard) = self.events.listen();
        act();
        loop {
            let event = heard.try_recv().unwrap_or_else(|_| panic!("nobody told {code}"));
            if event.data["code"] == code {
                return event.words.clone();
            }
        }
    }
}

/// A session with a pair and everything that processing needs, which nobody has processed.
fn shot_and_left(sessions: &Path, name: &str, room: &Room) -> PathBuf {
    let path = sessions.join(name);
    let session = Session::create(&path, name).unwrap();
    let engine = Engine::new(room.rig(), Limits::default(), Events::default());
    engine.shoot_pair(&session, None, &Progress::silent()).unwrap();
    std::fs::write(session.scene_dir().join("scene.json"), b"{}").unwrap();
    std::fs::write(session.calibration_dir().join("flash.json"), b"{}").unwrap();
    path
}

fn folder() -> (TempDir, PathBuf) {
    let folder = tempfile::tempdir().unwrap();
    let sessions = folder.path().join("sessions");
    std::fs::create_dir(&sessions).unwrap();
    (folder, sessions)
}

#[test]
fn a_start_processes_what_is_due_names_what_was_cut_short_and_leaves_others_alone() {
    let (_folder, sessions) = folder();
    let due = shot_and_left(&sessions, "due", &Room::default());
    let done = shot_and_left(&sessions, "done", &Room::default());
    std::fs::write(done.join("model/model.glb"), b"glTF").unwrap();
    let held = Session::open(&shot_and_left(&sessions, "held", &Room::default())).unwrap();
    let cut = sessions.join("cut");
    Session::create(&cut, "cut").unwrap().intend_pair().unwrap();

    let bureau = bureau(&sessions, &Room::default());
    let words = bureau.told("session_locked", || bureau.desk.resume());
    assert!(words.contains("held") && words.contains("another program"), "{words}");
    let process = bureau.of_kind("process");
    assert_eq!(process.len(), 1, "{process:?}");
    assert_eq!(process[0].subject, "due");
    assert_eq!(bureau.ended(&process[0]).state, JobState::Done);
    assert_eq!(bureau.processed.load(Ordering::SeqCst), 1);
    // Nobody asked for these sessions: others may have them.
    for path in [&due, &done, &cut] {
        drop(Session::open(path).unwrap());
    }
    drop(held);
    // Opening it above put it right and told nobody; a desk that looks first tells.
    Session::open(&cut).unwrap().intend_pair().unwrap();
    let words = bureau.told("session_recovered", || bureau.desk.resume());
    assert!(words.contains("cut: Pair 0001 was interrupted"), "{words}");
    assert!(
        bureau.desk.summary("cut").unwrap().recovered[0].contains("Pair 0001"),
        "told as long as it is so"
    );
}

#[test]
fn a_session_that_was_opened_for_its_processing_is_mirrored_and_goes_with_the_job_unless_somebody_wants_it() {
    let (folder, sessions) = folder();
    let mirrors = folder.path().join("other");
    std::fs::create_dir(&mirrors).unwrap();
    let names = ["cancelled", "done", "wanted"];
    let paths = names.map(|name| shot_and_left(&sessions, name, &Room::default()));
    // As long as a pair is shot, no processing begins by itself.
    let room = Room::with(Trouble::HoldsAt(0));
    let bureau = bureau(&sessions, &room);
    bureau.desk.mirror_to(&mirrors).unwrap();
    bureau.desk.enter("other").unwrap();
    let pair = bureau.desk.take_pair(None, PairWish::default()).unwrap();
    bureau.desk.resume();
    let process = bureau.of_kind("process");
    assert_eq!(process.len(), 3, "{process:?}");
    let of = |name: &str| process.iter().find(|job| job.subject == name).unwrap();
    let is_open = |path: &Path| matches!(Session::open(path), Err(SessionError::Locked { .. }));
    assert_eq!(paths.each_ref().map(|path| is_open(path)), [true, true, true]);

    bureau.desk.queue().cancel(of("cancelled").id).unwrap();
    assert!(!is_open(&paths[0]), "nobody has it any more");
    let wanted = bureau.desk.session("wanted").unwrap();
    room.set(Trouble::None);
    bureau.ended(&pair);
    drop(wanted);
    for name in ["done", "wanted"] {
        assert_eq!(bureau.ended(of(name)).state, JobState::Done);
    }
    assert_eq!([is_open(&paths[1]), is_open(&paths[2])], [false, true]);
    // What is let go has been taken in by its mirror before.
    for name in ["cancelled", "done"] {
        let copy = Session::open(&mirrors.join(name)).unwrap();
        assert_eq!(copy.pairs().unwrap().len(), 1, "{name}");
    }
}

#[test]
fn a_failed_pair_is_taken_again_on_request_and_a_scene_must_be_sent_again() {
    let (_folder, sessions) = folder();
    let room = Room::with(Trouble::Refuses(0));
    let processed = Arc::default();
    let works = Works {
        import_scene: Arc::new(|_, _, _| Err(unlit::jobs::WorkError::failed("scene_failed", "no scene"))),
        ..marking_works(&processed)
    };
    let bureau = with_works(&sessions, &room, works, processed);
    bureau.desk.enter("vase").unwrap();
    let failed = bureau.ended(&bureau.desk.take_pair(None, PairWish::default()).unwrap());
    assert_eq!(failed.state, JobState::Failed);
    assert!(failed.enqueued <= failed.started.clone().unwrap() && failed.started <= failed.ended);
    room.set(Trouble::None);
    let again = bureau.ended(&bureau.desk.retry(failed.id).unwrap());
    assert_eq!((again.state, again.retry_of), (JobState::Done, Some(failed.id)));
    assert_eq!(again.result.unwrap()["number"], 1);
    assert!(bureau.of_kind("develop").iter().all(|job| job.retry_of.is_none()));
    let refused = bureau.desk.retry(again.id).unwrap_err();
    assert!(matches!(refused, DeskError::Jobs(JobsError::NotRetryable(id)) if id == again.id), "{refused}");

    let files = SceneFiles {
        folder: tempfile::tempdir().unwrap(),
        cameras: "cameras.xml".into(),
        meshes: Vec::new(),
        unit: "m".into(),
        scale: 1.0,
    };
    let failed = bureau.ended(&bureau.desk.import_scene("vase", files).unwrap());
    let refused = bureau.desk.retry(failed.id).unwrap_err();
    assert!(refused.to_string().contains("send it again"), "{refused}");
    assert!(matches!(bureau.desk.retry(999), Err(DeskError::Jobs(JobsError::Unknown(999)))));
}

#[test]
fn every_kind_of_wish_can_be_repeated_from_what_was_written_down() {
    let (_folder, sessions) = folder();
    shot_and_left(&sessions, "vase", &Room::default());
    let bureau = bureau(&sessions, &Room::with(Trouble::NoCamera));
    let desk = &bureau.desk;
    let dark =
        ShotWish { kind: Kind::Levels, role: Some(Role::Dark), distance_m: None, exposure: None, count: 1 };
    let failed = [
        desk.take_card_shot("vase", (1.25, 1)).unwrap(),
        desk.take_calibration_shot("vase", dark).unwrap(),
        desk.find_exposure("vase", Default::default()).unwrap(),
        desk.take_repeatability("vase", 40).unwrap(),
    ];
    for job in failed {
        let job = bureau.ended(&job);
        assert_eq!(job.state, JobState::Failed, "{job:?}");
        let again = desk.retry(job.id).unwrap();
        assert_eq!((&again.kind, &again.order, again.retry_of), (&job.kind, &job.order, Some(job.id)));
        assert!(again.order.is_some_and(|order| order != json!(null)));
    }
}

#[test]
fn each_pair_is_developed_at_once_and_a_whole_solve_waits_for_a_pause() {
    let (_folder, sessions) = folder();
    let room = Room::default();
    let path = shot_and_left(&sessions, "vase", &room);
    let bureau = bureau(&sessions, &room);
    bureau.desk.enter("vase").unwrap();
    for number in 2..=4 {
        let pair = bureau.ended(&bureau.desk.take_pair(None, PairWish::default()).unwrap());
        assert_eq!(pair.result.unwrap()["number"], number);
        let developed = bureau.ended(&bureau.of_kind("develop")[0]);
        assert_eq!(developed.result.unwrap(), json!({ "session": "vase", "number": number }));
        assert_eq!(bureau.processed.load(Ordering::SeqCst), 0, "the photographer is at it");
    }
    assert_eq!(std::fs::read_dir(path.join("derived/known")).unwrap().count(), 3);
    let known = std::fs::read(bureau.desk.known_light("vase", 4).unwrap().0).unwrap();
    assert!(known.starts_with(&[0xff, 0xd8]));
    let waiting = bureau.of_kind("process");
    assert_eq!((waiting.len(), waiting[0].state), (1, JobState::Queued), "one solve for all of them");
    assert_eq!(bureau.ended(&waiting[0]).state, JobState::Done);
    assert_eq!(bureau.processed.load(Ordering::SeqCst), 1);

    // Who asks for it does not wait for a pause.
    bureau.ended(&bureau.desk.take_pair(None, PairWish::default()).unwrap());
    let asked = Instant::now();
    assert_eq!(bureau.ended(&bureau.desk.process("vase").unwrap()).state, JobState::Done);
    assert!(asked.elapsed() < Duration::from_secs(4), "{:?}", asked.elapsed());
}

#[test]
fn the_end_cancels_what_can_be_cancelled_and_closes_the_gate_past_what_cannot() {
    let (_folder, sessions) = folder();
    let room = Room::with(Trouble::HoldsAt(1));
    let bureau = bureau(&sessions, &room);
    let stuck = bureau.desk.take_pair(None, PairWish::default()).unwrap();
    let waiting = bureau.desk.take_pair(None, PairWish::default()).unwrap();
    let end = Instant::now() + PATIENCE;
    while !room.is_armed() {
        assert!(Instant::now() < end, "{:?}", room.log());
        std::thread::yield_now();
    }
    assert!(!bureau.desk.close(Duration::from_millis(50)), "the camera does not come back");
    assert!(!room.is_armed(), "the gate was left open");
    assert_eq!(bureau.desk.queue().get(waiting.id).unwrap().state, JobState::Cancelled);
    assert!(matches!(
        bureau.desk.take_pair(None, PairWish::default()),
        Err(DeskError::Jobs(JobsError::Closed))
    ));
    room.set(Trouble::None);
    assert_eq!(bureau.ended(&stuck).state, JobState::Cancelled);
    assert!(bureau.desk.close(PATIENCE));
}

const CHILD_FOLDER: &str = "UNLIT_TEST_END_ON_A_HANGING_DISK";

/// Run by the test below in a process of its own, whose disk hangs while the file `hangs` is there.
#[test]
fn ends_on_a_disk_that_hangs() {
    let Some(folder) = std::env::var_os(CHILD_FOLDER).map(PathBuf::from) else { return };
    let room = Room::with(Trouble::HoldsAt(1));
    let bureau = bureau(&folder.join("sessions"), &room);
    let stuck = bureau.desk.take_pair(None, PairWish::default()).unwrap();
    let waiting = bureau.desk.take_pair(None, PairWish::default()).unwrap();
    let until = |what: &str, holds: &dyn Fn() -> bool| {
        let end = Instant::now() + PATIENCE;
        while !holds() {
            assert!(Instant::now() < end, "{what}: {:?}", room.log());
            std::thread::yield_now();
        }
    };
    until("armed", &|| room.is_armed());
    let hangs = folder.join("hangs");
    std::fs::write(&hangs, b"").unwrap();
    let patience = Duration::from_secs(3);
    let asked = Instant::now();
    std::thread::scope(|scope| {
        let closing = scope.spawn(|| bureau.desk.close(patience));
        until("the gate is closed", &|| !room.is_armed());
        assert!(asked.elapsed() < patience / 2, "{:?}: the disk was waited for", asked.elapsed());
        assert_eq!(bureau.desk.queue().get(waiting.id).unwrap().state, JobState::Cancelled);
        assert!(!closing.join().unwrap(), "nothing came to rest");
        assert!(asked.elapsed() < patience * 2, "{:?}", asked.elapsed());
    });
    std::fs::remove_file(&hangs).unwrap();
    room.set(Trouble::None);
    assert_eq!(bureau.ended(&stuck).state, JobState::Cancelled);
    assert!(bureau.desk.close(PATIENCE));
    let ledger = std::fs::read_to_string(folder.join("sessions/.unlit/jobs.jsonl")).unwrap();
    assert_eq!(ledger.matches("\"cancelled\"").count(), 2, "{ledger}");
}

#[test]
fn a_disk_that_hangs_neither_keeps_the_gate_open_nor_the_program() {
    let home = tempfile::tempdir().unwrap();
    let run = std::process::Command::new(std::env::current_exe().unwrap())
        .args(["--exact", "jobs::ends_on_a_disk_that_hangs", "--nocapture"])
        .env(CHILD_FOLDER, home.path())
        .env("LD_PRELOAD", crate::disk::faults())
        .env("UNLIT_TEST_DISK_FOLDER", home.path().join("sessions"))
        .env("UNLIT_TEST_DISK_HANGS", home.path().join("hangs"))
        .output()
        .unwrap();
    assert!(run.status.success(), "{run:?}");
}

#[test]
fn a_summary_reads_again_what_others_wrote() {
    let (_folder, sessions) = folder();
    let path = shot_and_left(&sessions, "vase", &Room::default());
    let bureau = bureau(&sessions, &Room::default());
    let counted = || {
        let summary = bureau.desk.summary("vase").unwrap();
        (summary.pairs, summary.accepted)
    };
    assert_eq!((counted(), counted()), ((1, 1), (1, 1)));
    let record = path.join("pairs/0001/pair.json");
    let text = std::fs::read_to_string(&record).unwrap().replace("\"accepted\"", "\"rejected\"");
    unlit::session::store::write_atomic(&record, text.as_bytes()).unwrap();
    assert_eq!(counted(), (1, 0));
    std::fs::remove_dir_all(path.join("pairs/0001")).unwrap();
    assert_eq!(counted(), (0, 0));
    // A look locks nobody out.
    drop(Session::open(&path).unwrap());
}
