//! A disk that fills up, refuses, fails or is slow at any moment: what was acknowledged is there, and people are told.
//!
//! The real program runs with a small library loaded before libc (`disk/faults.c`) that makes the n-th file operation
//! below the session's folder fail, for every n.

use crate::samples::shared;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};
use std::sync::OnceLock;
use unlit::progress::Progress;
use unlit::session::Session;

const ENOSPC: i32 = 28;
const EROFS: i32 = 30;
const EACCES: i32 = 13;
const EIO: i32 = 5;

/// The library, compiled once.
fn faults() -> &'static Path {
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
    let run = unlit_on(&path, fault, &texts(&import(&path, "001")));
    assert!(run.status.success(), "{run:?}");
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
    for n in [1, 3, 5, 8] {
        let run = run(Fault { first: n, ..no_fault });
        let said = String::from_utf8_lossy(&run.stderr);
        assert!(!said.contains("panicked"), "{n}: {said}");
        let session = Session::open(&path).unwrap();
        let verification = session.verify(&Progress::silent()).unwrap();
        assert!(verification.findings.is_empty(), "{n}: {:?}", verification.findings);
        if !matches!(run.status.code(), Some(0 | 3)) {
            assert!(said.contains("(os error 28)"), "{n}: {said}");
        }
        let numbers: Vec<u32> = session.pairs().unwrap().iter().map(|p| p.number).collect();
        assert!(numbers.iter().copied().eq(1..=numbers.len() as u32), "{n}: {numbers:?}");
    }
    let last = run(no_fault);
    assert!(matches!(last.status.code(), Some(0 | 3)), "{last:?}");
}
