//! Calibrations that one session takes over from another.

use crate::calibrate_levels::{file, json, session};
use serde_json::Value;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, OnceLock};
use unlit::pipeline::calibrate::take::take;
use unlit::pipeline::calibrate::{flat, levels};
use unlit::progress::Progress;
use unlit::session::Session;

fn unlit(arguments: &[&str]) -> (bool, String, String) {
    let output = Command::new(env!("CARGO_BIN_EXE_unlit")).args(arguments).output().unwrap();
    let text = |bytes: &[u8]| String::from_utf8_lossy(bytes).into_owned();
    (output.status.success(), text(&output.stdout), text(&output.stderr))
}

/// A session in `folder` with the levels of the bird bath's camera by these dark frames.
fn measured(folder: &Path, frames: std::ops::Range<usize>) -> String {
    let session = session(folder);
    levels(&session, frames);
    session
}

fn levels(session: &str, frames: std::ops::Range<usize>) {
    let mut arguments: Vec<String> =
        ["calibrate", "levels", session, "--json", "--dark"].map(String::from).into();
    arguments.extend(frames.map(|i| file(&format!("calibration/dark/{i}.dng"))));
    assert_eq!(json(&arguments)["verdict"]["good"], true);
}

fn record(session: &str) -> Value {
    let path = Path::new(session).join("calibration/levels.json");
    serde_json::from_slice(&std::fs::read(path).unwrap()).unwrap()
}

fn former(session: &str) -> Vec<PathBuf> {
    let folder = Path::new(session).join("calibration/former");
    let files = std::fs::read_dir(folder)
        .map_or_else(|_| vec![], |list| list.map(|e| e.unwrap().path()).collect::<Vec<_>>());
    let (records, figures): (Vec<_>, Vec<_>) =
        files.into_iter().partition(|p| p.extension().is_some_and(|e| e == "json"));
    assert_eq!(records.len(), figures.len(), "each with its figure: {figures:?}");
    records
}

#[test]
fn a_calibration_comes_with_its_shots_and_replaces_none_without_keeping_it() {
    let folders = [0, 1].map(|_| tempfile::tempdir().unwrap());
    let donor = measured(folders[0].path(), 0..4);
    let own = measured(folders[1].path(), 0..3);
    let own_before = record(&own);

    let (well, said, complained) = unlit(&["calibrate", "take", &own, "--from", &donor, "levels"]);
    assert!(well, "{complained}");
    assert!(said.starts_with("levels, measured 20") && said.contains("with 4 shots"), "{said}");
    assert_eq!(record(&own), record(&donor));
    let (whole, said, complained) = unlit(&["session", "verify", &own]);
    assert!(whole, "{said}{complained}");
    let kept = former(&own);
    assert_eq!(kept.len(), 1, "{kept:?}");
    assert_eq!(serde_json::from_slice::<Value>(&std::fs::read(&kept[0]).unwrap()).unwrap(), own_before);

    // A second time there is nothing new to keep; all kinds that there are is the same one.
    assert!(unlit(&["calibrate", "take", &own, "--from", &donor]).0);
    assert_eq!(former(&own), kept);
    // It is a calibration as any other: a new measurement takes its place.
    levels(&own, 1..4);
    assert_eq!(former(&own).len(), 2);
    // What cannot be read any more is no less kept, and not called damaged.
    let path = Path::new(&own).join("calibration/levels.json");
    for older in ["{\"schema\": 1, \"levels\": []}", "{\"black\": 2048}"] {
        std::fs::write(&path, older).unwrap();
        let (well, _, complained) = unlit(&["calibrate", "take", &donor, "--from", &own]);
        assert!(!well && complained.contains("an earlier version"), "{complained}");
    }
    levels(&own, 0..4);
    assert_eq!(former(&own).len(), 3);
}

#[test]
fn what_cannot_be_taken_is_named_and_nothing_is_copied() {
    let folders = [0, 1].map(|_| tempfile::tempdir().unwrap());
    let donor = measured(folders[0].path(), 0..3);
    let own = session(folders[1].path());
    let refused = |arguments: &[&str], words: &[&str]| {
        let (well, _, complained) = unlit(&[&["calibrate", "take", &own], arguments].concat());
        assert!(!well, "{arguments:?}");
        for word in words {
            assert!(complained.contains(word), "{arguments:?}: no {word:?} in {complained}");
        }
        assert!(!Path::new(&own).join("calibration/levels.json").exists(), "{arguments:?}");
    };
    refused(&["--from", &donor, "lens"], &["\"lens\" is no calibration", "levels, noise"]);
    refused(&["--from", &donor, "levels", "flash"], &["has no calibration of flash", "it has levels"]);
    refused(&["--from", &own], &["is the session itself"]);

    let shot = record(&donor)["shots"][1]["file"].as_str().unwrap().to_owned();
    let path = Path::new(&donor).join(&shot);
    let mut bytes = std::fs::read(&path).unwrap();
    *bytes.last_mut().unwrap() ^= 1;
    std::fs::write(&path, bytes).unwrap();
    refused(&["--from", &donor], &[&shot, "missing or damaged", "verify"]);
}

/// Progress that is cancelled at its n-th report.
fn cancelled_at(n: usize) -> Progress {
    let own = Arc::new(OnceLock::<Progress>::new());
    let (heard, count) = (own.clone(), AtomicUsize::new(0));
    let progress = Progress::new(move |_| {
        if count.fetch_add(1, Ordering::Relaxed) == n {
            heard.get().into_iter().for_each(Progress::cancel);
        }
    });
    own.get_or_init(|| progress.clone());
    progress
}

/// Cancels at one report after the other until the work is through with all of them; how often it ended as cancelled,
/// and how often not.
fn at_every_moment(work: impl Fn(&Progress) -> bool) -> (usize, usize) {
    let (mut stopped, mut whole) = (0, 0);
    for n in 0..200 {
        let progress = cancelled_at(n);
        match work(&progress) {
            true => whole += 1,
            false => stopped += 1,
        }
        if !progress.is_cancelled() {
            return (stopped, whole);
        }
    }
    panic!("there is no end to it");
}

#[test]
fn what_is_cancelled_at_any_moment_is_kept_with_figure_and_report_or_not_at_all() {
    let frames: Vec<PathBuf> = (0..2).map(|i| file(&format!("calibration/dark/{i}.dng")).into()).collect();
    let is_there = |session: &Session, kind: &str| {
        let report =
            std::fs::read_to_string(session.calibration_dir().join("report.html")).unwrap_or_default();
        let there =
            [".json", ".svg"].map(|end| session.calibration_dir().join(format!("{kind}{end}")).is_file());
        assert_eq!(there[0], there[1], "{kind}");
        assert_eq!(there[0], report.contains(&format!("id=\"{kind}\"")), "{kind}");
        assert!(session.verify(&Progress::silent()).unwrap().is_whole());
        there[0]
    };
    let (stopped, whole) = at_every_moment(|progress| {
        let folder = tempfile::tempdir().unwrap();
        let session = Session::create(&folder.path().join("s"), "s").unwrap();
        let kept = levels::calibrate(&session, &frames, &[], progress).is_ok();
        assert_eq!(is_there(&session, "levels"), kept);
        kept
    });
    assert!(stopped >= 3 && whole >= 3, "{stopped} {whole}");

    let home = tempfile::tempdir().unwrap();
    let donor = home.path().join("donor");
    {
        let session = Session::create(&donor, "donor").unwrap();
        levels::calibrate(&session, &frames, &[], &Progress::silent()).unwrap();
        flat::calibrate(&session, &[file("calibration/linearity/05_0.dng").into()], &Progress::silent())
            .unwrap();
    }
    let (stopped, whole) = at_every_moment(|progress| {
        let folder = tempfile::tempdir().unwrap();
        let session = Session::create(&folder.path().join("s"), "s").unwrap();
        let kept = take(&session, &donor, &[], progress).is_ok();
        assert_eq!(["levels", "flat"].map(|kind| is_there(&session, kind)), [kept; 2]);
        kept
    });
    assert!(stopped >= 2 && whole >= 3, "{stopped} {whole}");
}
