//! The flat field from raws, against the truth of a simulated lens.

use crate::samples::shared;
use serde_json::Value;
use std::process::{Command, Output};

fn run(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_unlit")).args(arguments).output().unwrap()
}

fn unlit(arguments: &[&str]) -> String {
    let output = run(arguments);
    let complained = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "unlit {arguments:?}: {complained}");
    String::from_utf8(output.stdout).unwrap()
}

fn files(folder: &str, wanted: impl Fn(&str) -> bool) -> Vec<String> {
    let entries = std::fs::read_dir(shared(folder)).unwrap();
    let files = entries.map(|e| e.unwrap().path());
    let named = |p: &std::path::PathBuf| p.file_name().is_some_and(|n| wanted(&n.to_string_lossy()));
    let mut files: Vec<String> = files.filter(named).map(|p| p.display().to_string()).collect();
    files.sort();
    files
}

#[test]
fn evenly_lit_raws_give_the_vignetting_of_the_corner_within_three_per_mille() {
    let home = tempfile::tempdir().unwrap();
    let session = home.path().join("s").display().to_string();
    unlit(&["new", &session]);
    let linearity = files("scenes/birdbath/calibration/linearity", |_| true);
    let iso = files("scenes/birdbath/calibration/exposure", |name| name.starts_with("iso"));
    for (series, frames) in [("linearity", &linearity), ("iso", &iso)] {
        let mut arguments = vec!["calibrate", "flat", &session];
        arguments.extend(frames.iter().map(String::as_str));
        arguments.push("--json");
        let record: Value = serde_json::from_str(&unlit(&arguments)).unwrap();
        for corner in record["corner"].as_array().unwrap() {
            println!("{series}: corner {corner}, order {}", record["order"]);
            assert!((corner.as_f64().unwrap() - 0.87).abs() <= 0.003, "{corner}");
        }
        // All over the frame, not in the corner alone.
        for coefficients in record["vignetting"]["coefficients"].as_array().unwrap() {
            let c: Vec<f64> = coefficients.as_array().unwrap().iter().map(|v| v.as_f64().unwrap()).collect();
            for q in [0.1, 0.3, 0.5, 0.7, 0.9] {
                let found = 1.0 + q * (c[0] + q * (c[1] + q * c[2]));
                let truth = 1.0 - 0.11 * q - 0.02 * q * q;
                assert!((found - truth).abs() <= 0.002, "{series} at {q}: {found}, not {truth}");
            }
        }
        let chi2 = record["chi_squared"].as_f64().unwrap();
        assert!((0.8..1.3).contains(&chi2), "{chi2}");
        assert_eq!(record["verdict"]["good"], true, "{}", record["verdict"]);
        println!("{}", record["verdict"]);
    }
    // The blown pair at the end of the series says why it is not used.
    assert!(home.path().join("s/calibration/flat.svg").is_file());
    let mut arguments = vec!["calibrate", "flat", &session];
    arguments.extend(linearity.iter().map(String::as_str));
    let said = unlit(&arguments);
    println!("{said}");
    assert!(said.contains("left out") && said.contains("over-exposed in"), "{said}");
}

#[test]
fn frames_of_two_apertures_are_refused() {
    let home = tempfile::tempdir().unwrap();
    let session = home.path().join("s").display().to_string();
    unlit(&["new", &session]);
    let frames = files("scenes/birdbath/calibration/exposure", |name| name.starts_with("aperture"));
    let mut arguments = vec!["calibrate", "flat", &session];
    arguments.extend(frames.iter().map(String::as_str));
    let output = run(&arguments);
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(!output.status.success() && said.contains("aperture"), "{said}");
}
