//! Sensor levels by the program itself, on files of a simulated camera whose truth is known.

use crate::samples::shared;
use serde_json::Value;
use std::process::Command;

/// Runs the program, which must succeed; gives what it printed.
pub(crate) fn succeed(arguments: &[String]) -> Vec<u8> {
    let output = Command::new(env!("CARGO_BIN_EXE_unlit")).args(arguments).output().unwrap();
    let complained = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "unlit {arguments:?}: {complained}");
    output.stdout
}

/// Runs the program with `--json`; gives what it printed, which must be a JSON object.
pub(crate) fn json(arguments: &[String]) -> Value {
    let printed = succeed(arguments);
    let value: Value = serde_json::from_slice(&printed)
        .unwrap_or_else(|e| panic!("unlit {arguments:?}: {e} in {}", String::from_utf8_lossy(&printed)));
    assert!(value.is_object(), "unlit {arguments:?}: {value}");
    value
}

pub(crate) fn file(path: &str) -> String {
    shared(&format!("scenes/birdbath/{path}")).display().to_string()
}

pub(crate) fn truth() -> Value {
    serde_json::from_slice(&std::fs::read(file("truth/scene.json")).unwrap()).unwrap()
}

/// A new session's path.
pub(crate) fn session(folder: &std::path::Path) -> String {
    let path = folder.join("bath").display().to_string();
    succeed(&["new".into(), path.clone()]);
    path
}

#[test]
fn black_and_saturation_of_the_bird_baths_camera_are_exact_and_what_never_clips_is_told() {
    let folder = tempfile::tempdir().unwrap();
    let session = session(folder.path());
    let mut arguments: Vec<String> =
        ["calibrate", "levels", &session, "--json", "--dark"].map(String::from).into();
    arguments.extend((0..4).map(|i| file(&format!("calibration/dark/{i}.dng"))));
    arguments.push("--blown".into());
    arguments.extend((0..2).map(|i| file(&format!("calibration/linearity/13_{i}.dng"))));
    let record = json(&arguments);
    let sensor = &truth()["sensor"];
    let levels = &record["levels"][0];
    let sites = levels["sites"].as_array().unwrap();
    assert_eq!(sites.len(), 4);
    for site in sites {
        println!("{site}");
        let of = |name: &str| site[name].as_f64().unwrap();
        let black = of("black_dn") - sensor["black_dn"].as_f64().unwrap();
        assert!(black.abs() < 0.03 && black.abs() < 4.0 * of("black_dn_standard_error"), "{site}");
        let read = of("read_noise_dn") * sensor["electrons_per_dn"].as_f64().unwrap();
        assert!((read / sensor["read_noise_e"].as_f64().unwrap() - 1.0).abs() < 0.08, "{site}");
        if site["colour"] == "green" {
            assert_eq!(of("saturation_dn"), sensor["saturation_dn"].as_f64().unwrap());
        } else {
            assert!(site.get("saturation_dn").is_none(), "{site}");
            assert!(site["not_reached"].as_str().unwrap().contains("not blown"), "{site}");
        }
    }
    let said = record["verdict"]["sentences"].to_string();
    assert!(said.contains("red and blue never clip "), "{said}");
    assert!(std::path::Path::new(&session).join("calibration/levels.svg").is_file());
    // Frames are read with it.
    let told =
        json(&["inspect".into(), file("bad/good_on.dng"), "--session".into(), session, "--json".into()]);
    assert_eq!(told["levels"]["black_source"], "measured");
    assert_eq!(told["levels"]["saturation_source"], "file_tag");
}

/// The same file as a body of another serial number would write it.
fn of_another_body(path: &str) -> Vec<u8> {
    let mut bytes = std::fs::read(file(path)).unwrap();
    let (own, other) = (b"SIM0001", b"SIM0002");
    let places: Vec<usize> =
        bytes.windows(own.len()).enumerate().filter(|(_, w)| w == own).map(|(at, _)| at).collect();
    assert!(!places.is_empty());
    places.into_iter().for_each(|at| bytes[at..at + other.len()].copy_from_slice(other));
    bytes
}

/// What the program answers: exit code, stdout, stderr.
pub(crate) fn answer(arguments: &[&str]) -> (Option<i32>, String, String) {
    let output = Command::new(env!("CARGO_BIN_EXE_unlit")).args(arguments).output().unwrap();
    let text = |bytes: &[u8]| String::from_utf8_lossy(bytes).into_owned();
    (output.status.code(), text(&output.stdout), text(&output.stderr))
}

#[test]
fn levels_of_another_body_are_refused_and_those_of_another_iso_are_said_not_to_count() {
    let folder = tempfile::tempdir().unwrap();
    let session = session(folder.path());
    let (darks, lit) = ([0, 1].map(|i| file(&format!("calibration/dark/{i}.dng"))), file("bad/good_on.dng"));
    succeed(&[
        "calibrate".into(),
        "levels".into(),
        session.clone(),
        "--dark".into(),
        darks[0].clone(),
        darks[1].clone(),
    ]);
    // Another ISO of the same body.
    let bright = file("calibration/exposure/iso_12.dng");
    let told = json(&["inspect", &bright, "--session", &session, "--json"].map(String::from));
    let why = told["levels_not_used"].as_str().unwrap();
    assert!(why.contains("not at ISO 1600"), "{why}");
    assert_eq!(told["levels"]["black_source"], "file_tag");
    let (_, said, _) = answer(&["inspect", &bright, "--session", &session]);
    assert!(said.contains("not at ISO 1600"), "{said}");
    let told = json(&["inspect", &lit, "--session", &session, "--json"].map(String::from));
    assert!(told.get("levels_not_used").is_none() && told["levels"]["black_source"] == "measured", "{told}");
    // Another body: inspect, calibrations and the checks of pairs refuse it.
    let other = folder.path().join("other.dng").display().to_string();
    std::fs::write(&other, of_another_body("bad/good_on.dng")).unwrap();
    let (code, _, said) = answer(&["inspect", &other, "--session", &session]);
    assert!(
        code == Some(1) && said.contains("(serial SIM0001)") && said.contains("(serial SIM0002)"),
        "{said}"
    );
    let (code, _, said) = answer(&["calibrate", "flat", &session, &other]);
    assert!(code == Some(1) && said.contains("(serial SIM0002)"), "{said}");
    for side in ["off", "on"] {
        std::fs::create_dir(folder.path().join(side)).unwrap();
        let bytes = of_another_body(&format!("bad/good_{side}.dng"));
        std::fs::write(folder.path().join(side).join("0001.dng"), bytes).unwrap();
    }
    let [off, on] = ["off", "on"].map(|side| folder.path().join(side).display().to_string());
    let (_, said, complained) = answer(&["import", "pairs", &session, "--off", &off, "--on", &on]);
    assert!(said.contains("rejected") && said.contains("(serial SIM0002)"), "{said}{complained}");
    // The checks of a pair at an ISO without levels say so.
    let path = std::path::Path::new(&session).join("calibration/levels.json");
    let mut record: Value = serde_json::from_slice(&std::fs::read(&path).unwrap()).unwrap();
    record["levels"][0]["iso"] = 800.0.into();
    std::fs::write(&path, record.to_string()).unwrap();
    let [off, on] = ["off", "on"].map(|side| {
        let of_own_body = folder.path().join(format!("own_{side}"));
        std::fs::create_dir(&of_own_body).unwrap();
        std::fs::copy(file(&format!("bad/good_{side}.dng")), of_own_body.join("0002.dng")).unwrap();
        of_own_body.display().to_string()
    });
    let (code, said, complained) = answer(&["import", "pairs", &session, "--off", &off, "--on", &on]);
    assert!(code == Some(0) && said.contains("measured at ISO 800, not at ISO 100"), "{said}{complained}");
}
