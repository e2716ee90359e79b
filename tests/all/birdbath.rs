//! The main job from files alone, by the program itself, on a scene that another renderer made.

use crate::samples::shared;
use serde_json::Value;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, OnceLock};
use unlit::codec::exr_image;
use unlit::pipeline::process::{ProcessError, ProcessOptions, process};
use unlit::progress::Progress;
use unlit::session::Session;

const DISTANCES: [(&str, &str); 5] =
    [("0.5", "d0500"), ("0.8", "d0800"), ("1.0", "d1000"), ("1.3", "d1300"), ("1.7", "d1700")];

fn file(path: &str) -> String {
    shared(&format!("scenes/birdbath/{path}")).display().to_string()
}

/// Runs the program; gives what it printed.
fn unlit(arguments: &[&str]) -> String {
    let output = Command::new(env!("CARGO_BIN_EXE_unlit")).args(arguments).output().unwrap();
    let said = String::from_utf8_lossy(&output.stdout).into_owned();
    let complained = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "unlit {arguments:?} ended with {}: {said}{complained}", output.status);
    said
}

/// A session from raws, cameras and meshes up to its calibration.
fn prepared(folder: &Path, name: &str, cameras: &str) -> PathBuf {
    let path = folder.join(name);
    let session = path.to_str().unwrap();
    unlit(&["new", session]);
    let imported =
        unlit(&["import", "pairs", session, "--off", &file("photos/off"), "--on", &file("photos/on")]);
    assert!(imported.contains("24 pairs stored") && imported.contains(" 0 rejected"), "{imported}");
    let (object, floor) = (file("geometry/object.obj"), file("geometry/floor.obj"));
    unlit(&["import", "scene", session, "--cameras", &file(cameras), "--mesh", &object, "--mesh", &floor]);
    let shots: Vec<String> = DISTANCES
        .iter()
        .flat_map(|(metres, stem)| {
            (0..3).map(move |i| format!("{metres}={}", file(&format!("calibration/white/{stem}_{i}.dng"))))
        })
        .collect();
    let mut calibrate = vec!["calibrate", "flash", session, "--target-reflectance", "0.94"];
    calibrate.extend(["--ring-radii", "0.035,0.085", "--shots"]);
    calibrate.extend(shots.iter().map(String::as_str));
    unlit(&calibrate);
    path
}

fn texture(session: &Path) -> Vec<[f32; 3]> {
    let image = exr_image::read(&session.join("model/reflectance.exr")).unwrap();
    image.rgb().unwrap().pixels().to_vec()
}

#[test]
fn raws_become_a_texture_that_the_cameras_see_within_the_tolerances() {
    let folder = tempfile::tempdir().unwrap();
    let session = prepared(folder.path(), "xml", "geometry/cameras.xml");
    let name = session.to_str().unwrap();
    let first = unlit(&["process", name]);
    assert!(!first.contains("nothing had changed"), "{first}");

    let evaluated: Value =
        serde_json::from_str(&unlit(&["evaluate", name, "--truth", &file("truth"), "--json"])).unwrap();
    println!("{evaluated:#}");
    let figure = |estimate: &str, scale: &str, what: &str| {
        evaluated[estimate][scale][what].as_f64().unwrap_or_else(|| panic!("no {estimate} {scale} {what}"))
    };
    assert!(figure("texture", "full", "mean").abs() <= 0.003);
    assert!(figure("texture", "full", "standard_deviation") <= 0.030);
    assert!(figure("texture", "blocks", "standard_deviation") <= 0.012);
    assert!(figure("views", "full", "mean").abs() <= 0.003);
    assert!(figure("views", "full", "standard_deviation") <= 0.04);
    assert!(figure("views", "blocks", "standard_deviation") <= 0.015);
    assert!(evaluated["views"]["known"].as_f64().unwrap() >= 0.97);
    for estimate in ["texture", "views"] {
        assert_eq!(evaluated[estimate]["bright_spots"], 0, "{estimate}");
    }
    let covered = evaluated["texture"]["covered"].as_f64().unwrap();
    assert!((0.90..=0.98).contains(&covered), "{covered}");

    for (image, channels) in [("known", 3), ("irradiance", 3), ("reflectance", 4)] {
        let file = session.join(format!("derived/views/007/{image}.exr"));
        assert_eq!(exr_image::read(&file).unwrap().channels.len(), channels, "{image}");
    }
    let before = texture(&session);
    let second = unlit(&["process", name, "--views"]);
    assert!(second.contains("nothing had changed"), "{second}");

    // The same cameras by way of COLMAP's text files.
    let colmap = prepared(folder.path(), "colmap", "geometry/colmap");
    unlit(&["process", colmap.to_str().unwrap()]);
    let other = texture(&colmap);
    assert_eq!(before.len(), other.len());
    let apart = before.iter().flatten().zip(other.iter().flatten()).map(|(a, b)| f64::from((a - b).abs()));
    let mean = apart.sum::<f64>() / (3 * before.len()) as f64;
    println!("XML and COLMAP text differ by {mean} on average");
    assert!(mean < 0.001);
}

/// A session of a few pairs.
fn of_pairs(folder: &Path, name: &str, numbers: &[&str]) -> PathBuf {
    let session = prepared(folder, name, "geometry/cameras.xml");
    for pair in std::fs::read_dir(session.join("pairs")).unwrap() {
        let pair = pair.unwrap();
        if !numbers.contains(&pair.file_name().to_string_lossy().as_ref()) {
            std::fs::remove_dir_all(pair.path()).unwrap();
        }
    }
    session
}

#[test]
fn a_run_that_may_not_take_enough_memory_is_told_how_much_suffices() {
    let folder = tempfile::tempdir().unwrap();
    let session = of_pairs(folder.path(), "small", &["0001"]);
    let arguments = ["process", session.to_str().unwrap(), "--texture-size", "256", "--memory"];
    let run = |memory: &str| Command::new(env!("CARGO_BIN_EXE_unlit")).args(arguments).arg(memory).output();
    let refused = run("0.02").unwrap();
    let said = String::from_utf8_lossy(&refused.stderr).into_owned();
    assert!(!refused.status.success() && said.contains("--memory"), "{said}");
    let (_, rest) = said.split_once("needs ").unwrap();
    let suffices: f64 = rest.split_once(" GB").unwrap().0.parse().unwrap();
    let done = run(&format!("{}", suffices + 0.01)).unwrap();
    assert!(done.status.success(), "{}", String::from_utf8_lossy(&done.stderr));
}

#[test]
fn a_texture_solved_in_pieces_is_the_same_and_a_run_that_was_stopped_goes_on() {
    let folder = tempfile::tempdir().unwrap();
    let pairs = ["0001", "0010", "0015"];
    let whole = of_pairs(folder.path(), "whole", &pairs);
    unlit(&["process", whole.to_str().unwrap(), "--texture-size", "256"]);
    let pieces = of_pairs(folder.path(), "pieces", &pairs);
    let stopped = of_pairs(folder.path(), "stopped", &pairs);
    let options = ProcessOptions { texture_size: Some(256), piece: Some(0.008), ..ProcessOptions::default() };
    let summary = process(&Session::open(&pieces).unwrap(), &options, &Progress::silent()).unwrap();
    assert!(summary.pieces > 3, "{}", summary.pieces);

    // Stopped when the third piece is looked at.
    let stop: Arc<OnceLock<Progress>> = Arc::default();
    let watched = stop.clone();
    let progress = Progress::new(move |report| {
        if report.stage.starts_with("looking again") && report.done >= 2 * 3 {
            watched.get().unwrap().cancel();
        }
    });
    stop.set(progress.clone()).unwrap();
    let session = Session::open(&stopped).unwrap();
    assert!(matches!(process(&session, &options, &progress), Err(ProcessError::Cancelled(_))));
    let parts = || std::fs::read_dir(stopped.join("derived/parts")).map_or(0, Iterator::count);
    assert_eq!(parts(), 2);
    let looked = Arc::new(AtomicUsize::new(0));
    let count = looked.clone();
    let progress = Progress::new(move |report| {
        if report.stage.starts_with("looking again") {
            count.fetch_max(1000 - report.done as usize, Ordering::Relaxed);
        }
    });
    process(&session, &options, &progress).unwrap();
    assert_eq!((parts(), 1000 - looked.load(Ordering::Relaxed)), (0, 2 * 3), "it went on at the third piece");
    assert!(texture(&stopped) == texture(&pieces), "stopped or not, the bits are the same");

    // A single texel of three views' photographs is hardly told: patches of 4x4 are what the pieces must agree on.
    let seen = exr_image::read(&whole.join("model/views.exr")).unwrap();
    let views = &seen.channels.iter().find(|(name, _)| name == "Y").unwrap().1;
    let (one, many) = (texture(&whole), texture(&pieces));
    let mut apart: Vec<f64> = vec![];
    for (x, y) in (0..64).flat_map(|y| (0..64).map(move |x| (x, y))) {
        let block: Vec<usize> = (0..16).map(|i| (4 * y + i / 4) * 256 + 4 * x + i % 4).collect();
        if block.iter().all(|&i| views[i] >= 2.0) {
            let mean =
                |c: usize| block.iter().map(|&i| f64::from(many[i][c] - one[i][c])).sum::<f64>() / 16.0;
            apart.extend((0..3).map(mean));
        }
    }
    let n = apart.len() as f64;
    let (mean, typical) = (apart.iter().sum::<f64>() / n, apart.iter().map(|d| d.abs()).sum::<f64>() / n);
    println!("whole and in pieces differ by {mean} on average, {typical} in size, over {n} values");
    assert!(n > 1000.0 && mean.abs() < 0.002 && typical < 0.02, "{mean} {typical}");
}

#[test]
fn a_pair_that_is_rejected_or_without_a_camera_is_left_out_with_the_reason() {
    let folder = tempfile::tempdir().unwrap();
    let (off, on) = (folder.path().join("off"), folder.path().join("on"));
    for (side, to) in [("off", &off), ("on", &on)] {
        std::fs::create_dir(to).unwrap();
        for stem in ["000", "009", "014"] {
            let from = if (side, stem) == ("on", "014") {
                "photos/off/014.dng".to_owned()
            } else {
                format!("photos/{side}/{stem}.dng")
            };
            std::fs::copy(file(&from), to.join(format!("{stem}.dng"))).unwrap();
        }
        std::fs::copy(file(&format!("photos/{side}/003.dng")), to.join("stranger.dng")).unwrap();
    }
    let session = prepared(folder.path(), "some", "geometry/cameras.xml");
    std::fs::remove_dir_all(session.join("pairs")).unwrap();
    std::fs::create_dir(session.join("pairs")).unwrap();
    let name = session.to_str().unwrap();
    let import = Command::new(env!("CARGO_BIN_EXE_unlit"))
        .args(["import", "pairs", name, "--off", off.to_str().unwrap(), "--on", on.to_str().unwrap()])
        .output()
        .unwrap();
    assert_eq!(import.status.code(), Some(3), "{}", String::from_utf8_lossy(&import.stdout));
    let said = unlit(&["process", name, "--texture-size", "64"]);
    assert!(said.contains("left out 014: rejected"), "{said}");
    assert!(said.contains("left out stranger: the scene has no camera"), "{said}");
    assert!(said.contains("2 views"), "{said}");
}
