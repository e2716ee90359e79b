//! A disk that fills up, refuses, fails or is slow at any moment: what was acknowledged is there, and people are told.
//!
//! The real program runs with a small library loaded before libc (`disk/faults.c`) that makes the n-th file operation
//! below the session's folder fail, for every n: open for writing, write, fsync, fdatasync, rename, mkdir. What only
//! cleans up (unlink, ftruncate, rmdir) does not fail here.

use crate::samples::shared;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};
use std::sync::OnceLock;
use unlit::pair::Settings;
use unlit::progress::Progress;
use unlit::session::{Commit, More, NewFrame, NewPair, Session};

pub(crate) const ENOSPC: i32 = 28;
pub(crate) const EROFS: i32 = 30;
pub(crate) const EACCES: i32 = 13;
pub(crate) const EIO: i32 = 5;

/// The library, compiled once.
pub(crate) fn faults() -> &'static Path {
    static LIBRARY: OnceLock<(tempfile::TempDir, PathBuf)> = OnceLock::new();
    let (_, library) = LIBRARY.get_or_init(|| {
        let folder = tempfile::tempdir().unwrap();
        let library = folder.path().join("faults.so");
        let source = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/all/disk/faults.c");
        let compiled = Command::new("cc")
            .args(["-std=gnu11", "-Wall", "-Werror", "-O1", "-shared", "-fPIC", "-o"])
            .args([&library, &source])
            .arg("-ldl")
            .status()
            .unwrap();
        assert!(compiled.success());
        (folder, library)
    });
    library
}

/// What the disk does.
#[derive(Clone, Copy, Debug)]
struct Fault {
    first: u32,
    last: u32,
    errno: i32,
    delay_us: u32,
}

/// `unlit` in a home of its own, on a disk that does so below `session`.
fn unlit_on(session: &Path, fault: Fault, arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_unlit"))
        .args(arguments)
        .env("HOME", session.parent().unwrap())
        .env("LD_PRELOAD", faults())
        .env("UNLIT_TEST_DISK_FOLDER", session)
        .env("UNLIT_TEST_DISK_FIRST", fault.first.to_string())
        .env("UNLIT_TEST_DISK_LAST", fault.last.to_string())
        .env("UNLIT_TEST_DISK_ERRNO", fault.errno.to_string())
        .env("UNLIT_TEST_DISK_DELAY", fault.delay_us.to_string())
        .output()
        .unwrap()
}

fn unlit(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_unlit")).args(arguments).output().unwrap()
}

/// Imports one view of the birdbath, from folders beside the session.
fn import(session: &Path, view: &str) -> Vec<String> {
    let folder = session.parent().unwrap().join(view);
    let mut arguments: Vec<String> =
        ["import".into(), "pairs".into(), session.to_str().unwrap().into()].into();
    for side in ["off", "on"] {
        let (own, name) = (folder.join(side), format!("{view}.dng"));
        std::fs::create_dir_all(&own).unwrap();
        let photo = shared("scenes/birdbath").join(format!("photos/{side}/{name}"));
        std::fs::copy(photo, own.join(name)).unwrap();
        arguments.extend([format!("--{side}"), own.to_str().unwrap().to_owned()]);
    }
    arguments
}

fn texts(arguments: &[String]) -> Vec<&str> {
    arguments.iter().map(String::as_str).collect()
}

/// A session with one acknowledged pair.
fn with_one_pair(folder: &Path) -> PathBuf {
    let path = folder.join("bath");
    drop(Session::create(&path, "bath").unwrap());
    let done = unlit(&texts(&import(&path, "000")));
    assert!(done.status.success(), "{done:?}");
    path
}

/// After a run that may have failed: everything acknowledged is whole, nothing half-done stands under a name that
/// counts, and the next run finishes the work.
fn is_sound_and_goes_on(path: &Path, acknowledged: usize, what: &str) {
    {
        let session = Session::open(path).unwrap_or_else(|e| panic!("{what}: {e}"));
        let verification = session.verify(&Progress::silent()).unwrap();
        assert!(verification.is_whole(), "{what}: {:?}", verification.findings);
        assert!(verification.findings.is_empty(), "{what}: {:?}", verification.findings);
        assert!(session.pairs().unwrap().len() >= acknowledged, "{what}: an acknowledged pair is lost");
    }
    let done = unlit(&texts(&import(path, "001")));
    assert!(done.status.success(), "{what}: {done:?}");
    let session = Session::open(path).unwrap();
    let pairs = session.pairs().unwrap();
    let numbers: Vec<(u32, &str)> = pairs.iter().map(|p| (p.number, p.name.as_str())).collect();
    assert_eq!(numbers, [(1, "000"), (2, "001")], "{what}");
    assert!(session.verify(&Progress::silent()).unwrap().findings.is_empty(), "{what}");
}

/// The n-th operation fails, for every n until a run meets none; how many runs failed.
fn every_moment(errno: i32, stays: bool) -> u32 {
    let mut failed = 0;
    for n in 1..200 {
        let folder = tempfile::tempdir().unwrap();
        let path = with_one_pair(folder.path());
        let fault = Fault { first: n, last: if stays { u32::MAX } else { n }, errno, delay_us: 0 };
        let arguments = import(&path, "001");
        let run = unlit_on(&path, fault, &texts(&arguments));
        let (said, told) = (String::from_utf8_lossy(&run.stderr), String::from_utf8_lossy(&run.stdout));
        let what = format!("errno {errno} at operation {n}: {said}{told}");
        let struck = said.contains("disk: ");
        assert!(!said.contains("panicked"), "{what}");
        let acknowledged = run.status.success();
        if !acknowledged {
            failed += 1;
            assert!(struck, "{what}");
            let words = format!("(os error {errno})");
            let named = said.lines().any(|l| !l.starts_with("disk: ") && l.contains(path.to_str().unwrap()));
            assert!(said.contains(&words) && named, "neither cause nor file is named: {what}");
        }
        is_sound_and_goes_on(&path, if acknowledged { 2 } else { 1 }, &what);
        if !struck {
            return failed;
        }
    }
    panic!("there is no end to it");
}

#[test]
fn a_disk_that_fills_up_at_any_moment_of_an_import_loses_nothing_and_is_named() {
    let failed = every_moment(ENOSPC, true);
    assert!(failed >= 6, "{failed}");
}

#[test]
fn a_disk_that_fails_once_at_any_moment_of_an_import_loses_nothing_and_is_named() {
    let failed = every_moment(EIO, false);
    assert!(failed >= 10, "{failed}");
}

#[test]
fn a_disk_that_refuses_from_the_start_or_from_the_middle_is_named() {
    for errno in [EROFS, EACCES] {
        for n in [1, 6, 12] {
            let folder = tempfile::tempdir().unwrap();
            let path = with_one_pair(folder.path());
            let fault = Fault { first: n, last: u32::MAX, errno, delay_us: 0 };
            let run = unlit_on(&path, fault, &texts(&import(&path, "001")));
            let what = format!("errno {errno} from operation {n}: {}", String::from_utf8_lossy(&run.stderr));
            assert_eq!(run.status.code(), Some(1), "{what}");
            assert!(what.contains(&format!("(os error {errno})")), "{what}");
            is_sound_and_goes_on(&path, 1, &what);
        }
    }
}

#[test]
fn a_slow_disk_is_waited_for() {
    let folder = tempfile::tempdir().unwrap();
    let path = with_one_pair(folder.path());
    let fault = Fault { first: u32::MAX, last: u32::MAX, errno: EIO, delay_us: 30_000 };
    let began = std::time::Instant::now();
    let run = unlit_on(&path, fault, &texts(&import(&path, "001")));
    assert!(run.status.success(), "{run:?}");
    assert!(began.elapsed().as_millis() > 300, "the disk was not slow");
    is_sound_and_goes_on(&path, 2, "slow");
}

/// Pairs that are shot: through the real libgphoto2, controller and studio, raws written beside the next shot.
#[test]
fn a_disk_that_fills_up_while_pairs_are_shot_loses_nothing_and_is_named() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("shot");
    let shoot = ["shoot", path.to_str().unwrap(), "--studio"];
    let run = |fault| unlit_on(&path, fault, &shoot);
    let no_fault = Fault { first: u32::MAX, last: u32::MAX, errno: ENOSPC, delay_us: 0 };
    let first = run(no_fault);
    assert!(matches!(first.status.code(), Some(0 | 3)), "{first:?}");
    let mut acknowledged = 1;
    for n in [1, 3, 5, 8] {
        let run = run(Fault { first: n, ..no_fault });
        let said = String::from_utf8_lossy(&run.stderr);
        assert!(said.contains("disk: ") && !said.contains("panicked"), "{n}: {said}");
        let stored = matches!(run.status.code(), Some(0 | 3));
        assert!(!stored || n > 1, "{said}");
        acknowledged += usize::from(stored);
        let session = Session::open(&path).unwrap();
        let verification = session.verify(&Progress::silent()).unwrap();
        assert!(verification.findings.is_empty(), "{n}: {:?}", verification.findings);
        if !stored {
            assert!(said.contains("(os error 28)"), "{n}: {said}");
        }
        let numbers: Vec<u32> = session.pairs().unwrap().iter().map(|p| p.number).collect();
        assert!(numbers.iter().copied().eq(1..=numbers.len() as u32), "{n}: {numbers:?}");
        assert!(numbers.len() >= acknowledged, "{n}: an acknowledged pair is lost: {numbers:?}");
    }
    let last = run(no_fault);
    assert!(matches!(last.status.code(), Some(0 | 3)), "{last:?}");
}

const CHILD_FOLDER: &str = "UNLIT_TEST_COMMIT_ON_A_BAD_DISK";

/// Run by the test below in a process of its own: goes on whatever fails, as a daemon does.
#[test]
fn commits_on_a_bad_disk() {
    let Some(folder) = std::env::var_os(CHILD_FOLDER) else { return };
    let session = match Session::open(Path::new(&folder)) {
        Ok(session) => session,
        Err(error) => return println!("\nnot opened: {error}"),
    };
    for turn in 0..5u8 {
        let frame = |bytes| NewFrame {
            bytes,
            original_name: "a.dng",
            settings: Settings::default(),
            prepared: None,
            jpeg: None,
        };
        let (off, on) = ([turn; 3000], [turn + 100; 2000]);
        let (off, on) = (frame(off.as_slice()), frame(on.as_slice()));
        let pair = NewPair { name: None, off, on, reasons: vec![], flash: None, more: More::default() };
        let commit = session.intend_pair().and_then(|_| session.commit_pair(pair));
        match commit {
            Ok(Commit::Stored(record)) => println!("\ncommitted {}", record.number),
            other => {
                session.abandon_pair("it failed").unwrap();
                println!("\nfailed {other:?}");
            }
        }
    }
}

#[test]
fn a_program_that_goes_on_after_a_disk_error_stores_the_next_pair_and_loses_none() {
    for n in 1..200 {
        let home = tempfile::tempdir().unwrap();
        let path = home.path().join("bath");
        drop(Session::create(&path, "bath").unwrap());
        let run = Command::new(std::env::current_exe().unwrap())
            .args(["--exact", "disk::commits_on_a_bad_disk", "--nocapture"])
            .env(CHILD_FOLDER, &path)
            .env("LD_PRELOAD", faults())
            .env("UNLIT_TEST_DISK_FOLDER", &path)
            .env("UNLIT_TEST_DISK_FIRST", n.to_string())
            .env("UNLIT_TEST_DISK_LAST", n.to_string())
            .env("UNLIT_TEST_DISK_ERRNO", EIO.to_string())
            .output()
            .unwrap();
        let (said, told) = (String::from_utf8_lossy(&run.stderr), String::from_utf8_lossy(&run.stdout));
        let what = format!("operation {n}: {said}{told}");
        assert!(run.status.success(), "{what}");
        let committed: Vec<u32> =
            told.lines().filter_map(|l| l.strip_prefix("committed ")?.parse().ok()).collect();
        let opened = !told.contains("not opened: ");
        let enough = !opened || committed.len() >= 4;
        assert!(enough && committed.is_sorted(), "one error costs one pair at the most: {what}");
        let session = Session::open(&path).unwrap();
        let pairs: Vec<u32> = session.pairs().unwrap().iter().map(|p| p.number).collect();
        assert!(committed.iter().all(|number| pairs.contains(number)), "{pairs:?} {what}");
        assert!(pairs.iter().copied().eq(1..=pairs.len() as u32), "{pairs:?} {what}");
        let verification = session.verify(&Progress::silent()).unwrap();
        assert!(verification.findings.is_empty(), "{what}: {:?}", verification.findings);
        assert!(session.recovery().interrupted.is_empty(), "what failed was written down: {what}");
        if !said.contains("disk: ") {
            assert!(n > 30, "{what}");
            return;
        }
    }
    panic!("there is no end to it");
}

#[test]
fn a_pair_for_which_there_is_no_room_is_refused_before_anything_is_written() {
    let folder = tempfile::tempdir().unwrap();
    let disk = folder.path().join("disk");
    std::fs::create_dir(&disk).unwrap();
    // The photographs lie beside the disk, the session on it.
    let arguments = import(&folder.path().join("bath"), "001");
    let arguments = arguments.join(" ").replacen("/bath", "/disk/bath", 1);
    let (unlit, disk) = (env!("CARGO_BIN_EXE_unlit"), disk.display());
    let script = format!(
        "mount -t tmpfs -o size=60m tmpfs {disk} || exit 77
         {unlit} new {disk}/bath >&2 || exit 78
         {unlit} {arguments}; echo exit $?; ls {disk}/bath/pairs; cat {disk}/bath/journal.jsonl"
    );
    let run = Command::new("unshare").args(["-rm", "sh", "-c", &script]).output().unwrap();
    let (said, told) = (String::from_utf8_lossy(&run.stderr), String::from_utf8_lossy(&run.stdout));
    // A disk of its own needs a name space of its own, which not every machine grants.
    if run.status.code() == Some(77)
        || said.contains("unshare failed")
        || said.contains("Operation not permitted")
    {
        println!("not run: this machine grants no name space: {said}");
        return;
    }
    assert!(said.contains("must be free before a pair"), "{said}{told}");
    assert!(told.contains("exit 1") && !told.contains("pair_intended") && !told.contains("0001"), "{told}");
}
