//! The flash and its steadiness from raw files that another renderer made, by the program itself.

use crate::samples::shared;
use serde_json::Value;
use std::path::{Path, PathBuf};
use std::process::Command;

const DISTANCES: [(&str, &str); 5] =
    [("0.5", "d0500"), ("0.8", "d0800"), ("1.0", "d1000"), ("1.3", "d1300"), ("1.7", "d1700")];

fn file(path: &str) -> String {
    shared(&format!("scenes/birdbath/{path}")).display().to_string()
}

fn truth() -> Value {
    serde_json::from_slice(&std::fs::read(file("truth/scene.json")).unwrap()).unwrap()
}

/// Runs the program; gives what it printed.
fn unlit(arguments: &[&str]) -> String {
    let output = Command::new(env!("CARGO_BIN_EXE_unlit")).args(arguments).output().unwrap();
    let said = String::from_utf8_lossy(&output.stdout).into_owned();
    let complained = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "unlit {arguments:?} ended with {}: {said}{complained}", output.status);
    said
}

fn session(folder: &Path) -> PathBuf {
    let path = folder.join("session");
    unlit(&["new", path.to_str().unwrap()]);
    path
}

/// `DISTANCE=FILE` of the card shots.
fn card_shots() -> Vec<String> {
    let of = |(metres, stem): &(&str, &str)| {
        let (metres, stem) = (metres.to_string(), stem.to_string());
        (0..3).map(move |i| format!("{metres}={}", file(&format!("calibration/white/{stem}_{i}.dng"))))
    };
    DISTANCES.iter().flat_map(of).collect()
}

/// The record of a fit to card shots.
fn calibrated(shots: &[String], more: &[&str]) -> (tempfile::TempDir, Value) {
    let folder = tempfile::tempdir().unwrap();
    let session = session(folder.path());
    let mut arguments =
        vec!["calibrate", "flash", session.to_str().unwrap(), "--json", "--ring-radii", "0.035,0.085"];
    arguments.extend(["--focal-px", "758.3333333", "--target-reflectance", "0.94"]);
    arguments.extend(more);
    arguments.push("--shots");
    arguments.extend(shots.iter().map(String::as_str));
    let record = serde_json::from_str(&unlit(&arguments)).unwrap();
    (folder, record)
}

/// Radiance of the scene's flash in DN above black, red green blue.
fn true_radiance() -> [f64; 3] {
    let truth = truth();
    let (flash, sensor) = (&truth["flash"], &truth["sensor"]);
    let number = |v: &Value| v.as_f64().unwrap();
    let range = number(&sensor["saturation_dn"]) - number(&sensor["black_dn"]);
    std::array::from_fn(|c| {
        number(&flash["radiance"])
            * number(&flash["tint_rgb"][c])
            * number(&sensor["gain_rgb"][c])
            * number(&sensor["k"])
            * range
    })
}

fn holds(interval: &Value, truth: f64) -> bool {
    interval["low"].as_f64().unwrap() <= truth && truth <= interval["high"].as_f64().unwrap()
}

#[test]
fn energy_offset_and_law_of_the_birdbaths_flash_are_found_and_overexposed_shots_left_out() {
    let (folder, record) = calibrated(&card_shots(), &[]);
    println!("{record:#}");
    for (c, wanted) in true_radiance().into_iter().enumerate() {
        let got = record["radiance"][c].as_f64().unwrap();
        println!("radiance {got} of {wanted}: {:+.4} %", 100.0 * (got / wanted - 1.0));
        assert!((got / wanted - 1.0).abs() < 0.002);
        assert!(holds(&record["findings"]["radiance_dn"][c], wanted));
    }
    let found = &record["findings"];
    assert!(holds(&found["offset_m"], 0.0), "{}", found["offset_m"]);
    assert!(holds(&found["distance_exponent"], 2.0), "{}", found["distance_exponent"]);
    assert!(found["lobe_exponent"].is_null() && !found["vignetting_given"].as_bool().unwrap());
    assert!(found["left_one_out_error"].as_f64().unwrap() < 0.004);
    for (shot, card) in record["shots"].as_array().unwrap().iter().zip(record["cards"].as_array().unwrap()) {
        let near = card["distance"].as_f64().unwrap() < 0.6;
        assert_eq!(card["used"].as_bool().unwrap(), !near, "{card}");
        if near {
            assert!(shot["left_out"].as_str().unwrap().starts_with("over-exposed"), "{shot}");
        }
    }
    assert!(folder.path().join("session/calibration/flash.svg").is_file());
}

#[test]
fn with_the_vignetting_given_the_lobe_is_found_to_be_none() {
    let (_folder, record) = calibrated(&card_shots(), &["--vignetting", "-0.11,-0.02,0"]);
    let found = &record["findings"];
    println!("{found:#}");
    assert!(holds(&found["lobe_exponent"], 0.0), "{}", found["lobe_exponent"]);
    assert!(holds(&found["offset_m"], 0.0), "{}", found["offset_m"]);
}

#[test]
fn shots_kept_from_the_fit_are_predicted() {
    let (_folder, record) = calibrated(&card_shots(), &["--hold-out-every", "4"]);
    let error = record["findings"]["held_out_error"].as_f64().unwrap();
    println!("held out: {error}");
    assert!(error < 0.004);
}

#[test]
fn steadiness_from_frames_is_that_of_the_scenes_own_energies_and_goes_when_they_are_known() {
    let truth = truth();
    let shots: Vec<(String, f64)> = truth["calibration"]["repeat"]
        .as_array()
        .unwrap()
        .iter()
        .map(|shot| (file(shot["file"].as_str().unwrap()), shot["jitter"].as_f64().unwrap()))
        .collect();
    let n = shots.len() as f64;
    let mean = shots.iter().map(|s| s.1).sum::<f64>() / n;
    let wanted = (shots.iter().map(|s| (s.1 - mean).powi(2)).sum::<f64>() / (n - 1.0)).sqrt() / mean;
    let folder = tempfile::tempdir().unwrap();
    let session = session(folder.path());
    let run = |frames: Vec<String>| -> Value {
        let mut arguments =
            vec!["calibrate", "repeatability", session.to_str().unwrap(), "--json", "--frames"];
        arguments.extend(frames.iter().map(String::as_str));
        serde_json::from_str(&unlit(&arguments)).unwrap()
    };
    let plain = run(shots.iter().map(|s| s.0.clone()).collect());
    let found = plain["jitter_deviation"].as_f64().unwrap();
    println!("jitter {found}, truth {wanted}: {:+.2} %", 100.0 * (found / wanted - 1.0));
    assert!((found / wanted - 1.0).abs() < 0.03);
    assert!(plain["corrected_deviation"].is_null());
    let known = run(shots.iter().map(|(frame, energy)| format!("{frame}={}", 1e5 * energy)).collect());
    let left = known["corrected_deviation"].as_f64().unwrap();
    println!("left with energies known: {left}");
    assert!(left < 0.1 * wanted);
}
