//! The flash and its steadiness from raw files that another renderer made, by the program itself.

use crate::samples::shared;
use serde_json::Value;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};
use unlit::pipeline::standing::is_due;
use unlit::session::Session;

const DISTANCES: [(&str, &str); 5] =
    [("0.5", "d0500"), ("0.8", "d0800"), ("1.0", "d1000"), ("1.3", "d1300"), ("1.7", "d1700")];

fn file(path: &str) -> String {
    shared(&format!("scenes/birdbath/{path}")).display().to_string()
}

fn truth() -> Value {
    serde_json::from_slice(&std::fs::read(file("truth/scene.json")).unwrap()).unwrap()
}

fn run(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_unlit")).args(arguments).output().unwrap()
}

/// Runs the program; gives what it printed.
fn unlit(arguments: &[&str]) -> String {
    let output = run(arguments);
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
    let record = calibrated_in(&session, shots, &[&["--ring-radii", "0.035,0.085"], more].concat());
    (folder, record)
}

/// The same in a session that is there.
fn calibrated_in(session: &Path, shots: &[String], more: &[&str]) -> Value {
    let arguments = arguments(session, shots, more);
    serde_json::from_str(&unlit(&arguments.iter().map(String::as_str).collect::<Vec<_>>())).unwrap()
}

fn arguments(session: &Path, shots: &[String], more: &[&str]) -> Vec<String> {
    let mut arguments = vec!["calibrate", "flash", session.to_str().unwrap(), "--json"];
    arguments.extend(["--focal-px", "758.3333333"]);
    if !more.contains(&"--target-reflectance") {
        arguments.extend(["--target-reflectance", "0.94"]);
    }
    arguments.extend(more);
    arguments.push("--shots");
    arguments.iter().map(|s| s.to_string()).chain(shots.iter().cloned()).collect()
}

/// Copies of card shots whose EXIF tells another value of a tag (a rational).
fn relabelled(shots: &[String], folder: &Path, tag: u16, value: [u32; 2]) -> Vec<String> {
    let entry: Vec<u8> =
        [tag.to_le_bytes(), 5u16.to_le_bytes()].concat().into_iter().chain(1u32.to_le_bytes()).collect();
    let copy = |shot: &String| {
        let (distance, path) = shot.split_once('=').unwrap();
        let mut bytes = std::fs::read(path).unwrap();
        let at = bytes.windows(8).position(|w| w == entry).unwrap() + 8;
        let place = u32::from_le_bytes(bytes[at..at + 4].try_into().unwrap()) as usize;
        bytes[place..place + 8].copy_from_slice(&value.map(u32::to_le_bytes).concat());
        std::fs::create_dir_all(folder).unwrap();
        let to = folder.join(Path::new(path).file_name().unwrap());
        std::fs::write(&to, bytes).unwrap();
        format!("{distance}={}", to.display())
    };
    shots.iter().map(copy).collect()
}

const EXPOSURE_TIME: u16 = 0x829A;
const F_NUMBER: u16 = 0x829D;

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
    interval[0].as_f64().unwrap() <= truth && truth <= interval[1].as_f64().unwrap()
}

#[test]
fn energy_offset_and_law_of_the_birdbaths_flash_are_found_and_overexposed_shots_left_out() {
    let (folder, record) = calibrated(&card_shots(), &[]);
    println!("{record:#}");
    for (c, wanted) in true_radiance().into_iter().enumerate() {
        let got = record["radiance_dn"][c].as_f64().unwrap();
        println!("radiance {got} of {wanted}: {:+.4} %", 100.0 * (got / wanted - 1.0));
        assert!((got / wanted - 1.0).abs() < 0.002);
        assert!(holds(&record["radiance_dn_interval_95"][c], wanted));
    }
    let found = &record["findings"];
    assert!(holds(&found["offset_m_interval_95"], 0.0), "{}", found["offset_m_interval_95"]);
    assert!(
        holds(&found["distance_exponent_interval_95"], 2.0),
        "{}",
        found["distance_exponent_interval_95"]
    );
    assert!(found["lobe_exponent"].is_null() && !found["vignetting_given"].as_bool().unwrap());
    assert!(found["left_one_out_error"].as_f64().unwrap() < 0.004);
    for (shot, card) in record["shots"].as_array().unwrap().iter().zip(record["cards"].as_array().unwrap()) {
        let near = card["distance_m"].as_f64().unwrap() < 0.6;
        assert_eq!(card["used"].as_bool().unwrap(), !near, "{card}");
        if near {
            assert!(shot["left_out"].as_str().unwrap().starts_with("over-exposed"), "{shot}");
            assert!(card["gain"].is_null() && card["residual_rms"].is_null(), "{card}");
        }
    }
    assert!(folder.path().join("session/calibration/flash.svg").is_file());
}

#[test]
fn with_the_vignetting_given_the_lobe_is_found_to_be_none() {
    let (_folder, record) = calibrated(&card_shots(), &["--vignetting", "-0.11,-0.02,0"]);
    let found = &record["findings"];
    println!("{found:#}");
    assert!(holds(&found["lobe_exponent_interval_95"], 0.0), "{}", found["lobe_exponent_interval_95"]);
    assert!(holds(&found["offset_m_interval_95"], 0.0), "{}", found["offset_m_interval_95"]);
}

/// Fits the session's flat field to evenly lit frames.
fn flat_field(session: &Path, frames: &[&str]) {
    let frames: Vec<String> =
        frames.iter().map(|name| file(&format!("calibration/exposure/{name}.dng"))).collect();
    let mut arguments = vec!["calibrate", "flat", session.to_str().unwrap()];
    arguments.extend(frames.iter().map(String::as_str));
    unlit(&arguments);
}

#[test]
fn the_sessions_flat_field_is_taken_as_the_vignetting_so_that_the_lobe_is_told() {
    let folder = tempfile::tempdir().unwrap();
    let session = session(folder.path());
    // The one that was shot at the card shots' aperture.
    flat_field(&session, &["aperture_12"]);
    let ring = ["--ring-radii", "0.035,0.085"];
    let record = calibrated_in(&session, &card_shots(), &ring);
    let found = &record["findings"];
    println!("{found:#}");
    assert_eq!(found["vignetting_given"], true);
    assert!(holds(&found["lobe_exponent_interval_95"], 0.0), "{}", found["lobe_exponent_interval_95"]);
    assert!(holds(&found["offset_m_interval_95"], 0.0), "{}", found["offset_m_interval_95"]);
    for (c, wanted) in true_radiance().into_iter().enumerate() {
        let got = record["radiance_dn"][c].as_f64().unwrap();
        println!("radiance {got} of {wanted}: {:+.4} %", 100.0 * (got / wanted - 1.0));
        assert!((got / wanted - 1.0).abs() < 0.002 && holds(&record["radiance_dn_interval_95"][c], wanted));
    }
    assert_eq!(found["flat_field"]["blake3"].as_str().unwrap().len(), 64);
    assert!(
        record["verdict"].to_string().contains("is that of the session's flat field"),
        "{}",
        record["verdict"]
    );
    // Those of another aperture are not; then the product is told, and that it is.
    flat_field(&session, &["iso_06", "iso_09", "iso_12"]);
    let record = calibrated_in(&session, &card_shots(), &ring);
    let said = record["verdict"].to_string();
    assert!(record["findings"]["lobe_exponent"].is_null() && record["findings"]["flat_field"].is_null());
    assert!(said.contains("flat field is not used") && said.contains("f/16"), "{said}");
    assert!(said.contains("only the product of vignetting and lobe is known"), "{said}");
}

#[test]
fn the_shutter_is_nowhere_in_the_calibration() {
    let folder = tempfile::tempdir().unwrap();
    let ring = ["--ring-radii", "0.035,0.085"];
    let mut shots = card_shots();
    let told = |shots: &[String]| {
        let record = calibrated(shots, &[]).1;
        let shutters: Vec<f64> =
            record["shots"].as_array().unwrap().iter().map(|s| s["shutter"].as_f64().unwrap()).collect();
        let parts =
            ["radiance_dn", "radiance_dn_standard_error", "ring", "field", "findings", "noise", "verdict"];
        (parts.map(|part| record[part].clone()), shutters)
    };
    let (plain, _) = told(&shots);
    let slow = relabelled(&shots, &folder.path().join("slow"), EXPOSURE_TIME, [1, 15]);
    let (other, shutters) = told(&slow);
    assert!(shutters.iter().all(|s| (s - 1.0 / 15.0).abs() < 1e-9), "{shutters:?}");
    assert_eq!(other, plain);
    // Nor when it differs within a series.
    shots[4..].clone_from_slice(&slow[4..]);
    let (mixed, shutters) = told(&shots);
    assert!(shutters[0] < 0.01 && shutters[14] > 0.06);
    assert_eq!(mixed, plain);
    // The aperture is: it must be one.
    let wider = relabelled(&card_shots(), &folder.path().join("wider"), F_NUMBER, [8, 1]);
    shots[4..].clone_from_slice(&wider[4..]);
    let arguments = arguments(&session(folder.path()), &shots, &ring);
    let output = run(&arguments.iter().map(String::as_str).collect::<Vec<_>>());
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(!output.status.success() && said.contains("aperture"), "{said}");
}

#[test]
fn one_shot_brings_a_calibration_to_the_flashs_new_energy() {
    let truth = truth();
    let shots = card_shots();
    // A card taken for darker than it is: as if the flash had given twice the energy then.
    let folder = tempfile::tempdir().unwrap();
    let session = session(folder.path());
    let base = [shots[3..6].to_vec(), shots[9..].to_vec()].concat();
    calibrated_in(&session, &base, &["--ring-radii", "0.035,0.085", "--target-reflectance", "0.47"]);
    let before = std::fs::read(session.join("calibration/flash.json")).unwrap();
    let record = calibrated_in(&session, &shots[7..8], &["--one-shot"]);
    println!("{:#}", record["findings"]);
    let jitter = truth["calibration"]["white"][7]["jitter"].as_f64().unwrap();
    let found = &record["findings"];
    for (c, wanted) in true_radiance().into_iter().enumerate() {
        let got = record["radiance_dn"][c].as_f64().unwrap();
        println!("radiance {got} of {}: {:+.4} %", wanted * jitter, 100.0 * (got / wanted / jitter - 1.0));
        assert!((got / (wanted * jitter) - 1.0).abs() < 0.002);
        assert!(holds(&record["radiance_dn_interval_95"][c], wanted));
        let factor = found["correction"]["factor"][c].as_f64().unwrap();
        assert!((factor / 0.5 - 1.0).abs() < 0.01, "{factor}");
        let second = found["second_render_ratio"][c].as_f64().unwrap();
        assert!((second - 1.0).abs() <= 2e-4, "{second}");
    }
    assert_eq!(record["verdict"]["good"], true, "{}", record["verdict"]);
    let kept = session.join(found["correction"]["base_file"].as_str().unwrap());
    assert_eq!(std::fs::read(kept).unwrap(), before, "the calibration before is kept");
    // Through another aperture the field is another one.
    let wider = relabelled(&shots[7..8], &folder.path().join("wider"), F_NUMBER, [8, 1]);
    let refused = |shots: &[String]| {
        let arguments = arguments(&session, shots, &["--one-shot"]);
        let output = run(&arguments.iter().map(String::as_str).collect::<Vec<_>>());
        assert!(!output.status.success());
        String::from_utf8_lossy(&output.stderr).into_owned()
    };
    let said = refused(&wider);
    assert!(said.contains("aperture is \"f/8\""), "{said}");
    assert!(refused(&shots[6..8]).contains("exactly one"));
}

#[test]
fn processing_refuses_pairs_that_the_calibration_does_not_hold_for() {
    let folder = tempfile::tempdir().unwrap();
    let session = session(folder.path());
    let name = session.to_str().unwrap();
    for side in ["off", "on"] {
        std::fs::create_dir(folder.path().join(side)).unwrap();
        let to = folder.path().join(format!("{side}/000.dng"));
        std::fs::copy(file(&format!("photos/{side}/000.dng")), to).unwrap();
    }
    let [off, on] = ["off", "on"].map(|side| folder.path().join(side).display().to_string());
    unlit(&[
        "import",
        "pairs",
        name,
        "--off",
        &off,
        "--on",
        &on,
        "--polariser",
        "30",
        "--flash-power",
        "1/4",
    ]);
    let (cameras, object, floor) =
        (file("geometry/cameras.xml"), file("geometry/object.obj"), file("geometry/floor.obj"));
    unlit(&["import", "scene", name, "--cameras", &cameras, "--mesh", &object, "--mesh", &floor]);
    let manifest: Value =
        serde_json::from_slice(&std::fs::read(session.join("session.json")).unwrap()).unwrap();
    assert_eq!(manifest["lighting"]["polariser"]["angle_degrees"], 30.0);
    let due = || is_due(&Session::open(&session).unwrap()).map_err(|e| e.to_string());
    let calibrate = |more: &[&str]| {
        calibrated_in(&session, &card_shots()[3..9], &[&["--ring-radii", "0.035,0.085"], more].concat())
    };
    // The session's polariser and power are the calibration's, unless it is told otherwise.
    let record = calibrate(&[]);
    assert_eq!(record["rig"]["lighting"]["flash_power"], 0.25, "{}", record["rig"]);
    assert_eq!(due(), Ok(true));
    for (more, what) in [
        (
            ["--polariser", "120"],
            "its polariser is \"at 30 degrees\", but that of the flash calibration is \"at 120 degrees\"",
        ),
        (["--polariser", "none"], "calibration is \"none\""),
        (["--flash-power", "1/2"], "at 0.25 of its full power"),
    ] {
        calibrate(&more);
        let said = due().unwrap_err();
        assert!(said.contains("pair 000") && said.contains(what), "{said}");
        let output = run(&["process", name]);
        assert!(!output.status.success() && String::from_utf8_lossy(&output.stderr).contains(what));
    }
    calibrate(&[]);
    let path = session.join("calibration/flash.json");
    let kept: Value = serde_json::from_slice(&std::fs::read(&path).unwrap()).unwrap();
    for (part, key, value, what) in [
        ("rig", "serial", "SIM0002".into(), "body serial number"),
        ("rig", "model", "Bayer 16".into(), "camera model"),
        ("", "focal_length_mm", 50.0.into(), "focal length"),
    ] {
        let mut other = kept.clone();
        let place = if part.is_empty() { &mut other } else { &mut other[part] };
        place[key] = value;
        std::fs::write(&path, serde_json::to_vec(&other).unwrap()).unwrap();
        let said = due().unwrap_err();
        assert!(said.contains(what) && said.contains("pair 000"), "{said}");
    }
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
