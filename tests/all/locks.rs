//! Two programs and one folder: the second is told who has it.

use crate::fake_rig::Room;
use serde_json::json;
use std::io::{BufRead, BufReader, Write};
use std::path::Path;
use std::process::{Command, Stdio};
use std::sync::Arc;
use unlit::capture::{Desk, Engine, Events, Works};
use unlit::pair::Limits;
use unlit::session::{Session, SessionError};

pub(crate) fn desk(folder: &Path) -> std::io::Result<Desk> {
    let events = Events::default();
    let engine = Arc::new(Engine::new(Room::default().rig(), Limits::default(), events.clone()));
    let works = Works {
        process: Arc::new(|_, (), _| Ok(json!({}))),
        calibrate_flash: Arc::new(|_, _, _| Ok(json!({}))),
        calibrate: Arc::new(|_, _, _| Ok(json!({}))),
        import_scene: Arc::new(|_, _, _| Ok(json!({}))),
        has_scene: Arc::new(|_| false),
        has_flash_calibration: Arc::new(|_| false),
        needs_processing: Arc::new(|_| false),
    };
    Desk::open(engine, events, folder, works, None)
}

#[test]
fn a_command_on_a_session_that_is_open_elsewhere_names_the_process_that_has_it() {
    let home = tempfile::tempdir().unwrap();
    let session = Session::create(&home.path().join("bath"), "bath").unwrap();
    let verify = || {
        let run = Command::new(env!("CARGO_BIN_EXE_unlit"))
            .args(["session", "verify", session.path().to_str().unwrap()])
            .output()
            .unwrap();
        (run.status.code(), String::from_utf8(run.stderr).unwrap())
    };
    let (code, said) = verify();
    assert_eq!(code, Some(1), "{said}");
    let own = format!("(process {} on ", std::process::id());
    assert!(said.contains(&own) && said.contains("end it first"), "{said}");
}

#[test]
fn two_daemons_do_not_share_a_sessions_folder() {
    let home = tempfile::tempdir().unwrap();
    let first = desk(home.path()).unwrap();
    first.enter("bath").unwrap();
    let refused = desk(home.path()).err().unwrap().to_string();
    let own = format!("(process {} on ", std::process::id());
    assert!(refused.contains(&own) && refused.contains("--sessions"), "{refused}");
    assert_eq!(first.summaries().unwrap().len(), 1, "the lock is no session");
}

#[test]
fn a_session_that_is_slow_to_open_is_opened_once_and_holds_up_nobody_who_wants_another() {
    let home = tempfile::tempdir().unwrap();
    let slow = home.path().join("slow");
    drop(Session::create(&slow, "slow").unwrap());
    // Its journal comes when this test writes it, as from a disk that sleeps.
    let (journal, kept, pipe) =
        (slow.join("journal.jsonl"), home.path().join("kept"), home.path().join("pipe"));
    std::fs::rename(&journal, &kept).unwrap();
    assert!(Command::new("mkfifo").arg(&pipe).status().unwrap().success());
    std::fs::hard_link(&pipe, &journal).unwrap();
    let desk = desk(home.path()).unwrap();
    std::thread::scope(|scope| {
        let wanted = [(); 2].map(|()| scope.spawn(|| desk.session("slow").unwrap()));
        // Opens once somebody reads: the session is being opened from here on.
        let mut disk = std::fs::OpenOptions::new().write(true).open(&pipe).unwrap();
        assert_eq!(desk.glance().session, None);
        desk.enter("other").unwrap();
        assert_eq!(
            (desk.glance().session.as_deref(), desk.summary("other").unwrap().pairs),
            (Some("other"), 0)
        );
        assert!(wanted.iter().all(|opening| !opening.is_finished()));
        let text = std::fs::read(&kept).unwrap();
        std::fs::rename(&kept, &journal).unwrap();
        disk.write_all(&text).unwrap();
        drop(disk);
        let [first, second] = wanted.map(|opening| opening.join().unwrap());
        assert!(Arc::ptr_eq(&first, &second));
    });
}

const CHILD_FOLDER: &str = "UNLIT_TEST_HOLD_UNTIL_KILLED";

/// Run by the test below in a process of its own: opens a session and holds it.
#[test]
fn holds_until_killed() {
    let Some(folder) = std::env::var_os(CHILD_FOLDER) else { return };
    let _session = Session::open(Path::new(&folder)).unwrap();
    println!("\nopen");
    // Ends with its parent, whose pipe this is.
    std::io::stdin().read_line(&mut String::new()).unwrap();
}

#[test]
fn what_a_killed_program_wrote_into_the_lock_misleads_nobody() {
    let home = tempfile::tempdir().unwrap();
    drop(Session::create(home.path(), "bath").unwrap());
    let mut child = Command::new(std::env::current_exe().unwrap())
        .args(["--exact", "locks::holds_until_killed", "--nocapture"])
        .env(CHILD_FOLDER, home.path())
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .spawn()
        .unwrap();
    let mut lines = BufReader::new(child.stdout.take().unwrap()).lines();
    assert!(lines.any(|line| line.unwrap() == "open"));
    let Err(SessionError::Locked { holder: Some(holder), .. }) = Session::open(home.path()) else {
        panic!("nobody has it");
    };
    assert_eq!(holder.pid, child.id());
    child.kill().unwrap();
    child.wait().unwrap();
    assert!(std::fs::metadata(home.path().join(".lock")).unwrap().len() > 0, "it had no time to tidy up");

    let reader = Session::open_shared(home.path()).unwrap();
    let error = Session::open(home.path()).unwrap_err();
    assert!(matches!(error, SessionError::Locked { holder: None, .. }), "{error}");
    drop(reader);
    drop(Session::open(home.path()).unwrap());
    assert_eq!(std::fs::metadata(home.path().join(".lock")).unwrap().len(), 0);
}
