//! `--json` of every calibration: the record, nothing else, with the fields that scripts go by.

use crate::calibrate_levels::file;
use crate::raw::sample;
use serde_json::Value;
use std::path::{Path, PathBuf};
use std::process::Command;

/// What `unlit calibrate KIND SESSION ... --json` printed, and what it keeps.
fn calibrated(session: &Path, kind: &str, kept: &str, arguments: &[String]) -> Value {
    let mut command = Command::new(env!("CARGO_BIN_EXE_unlit"));
    command.args(["calibrate", kind]).arg(session).args(arguments).arg("--json");
    let output = command.output().unwrap();
    assert!(output.status.success(), "{kind}: {}", String::from_utf8_lossy(&output.stderr));
    let text = String::from_utf8(output.stdout).unwrap();
    let record: Value = serde_json::from_str(&text).unwrap_or_else(|e| panic!("{kind}: {e} in {text}"));
    let file = std::fs::read(session.join(format!("calibration/{kept}.json"))).unwrap();
    assert_eq!(record, serde_json::from_slice::<Value>(&file).unwrap(), "{kind}");
    for field in ["schema", "measured", "software", "rig", "shots", "verdict"] {
        assert!(!record[field].is_null(), "{kind} has no {field}");
    }
    for shot in record["shots"].as_array().unwrap() {
        let path = session.join(shot["file"].as_str().unwrap());
        let digest = unlit::session::store::digest(&std::fs::read(path).unwrap());
        assert_eq!(shot["blake3"], digest, "{kind}");
    }
    assert!(!record["verdict"]["sentences"].as_array().unwrap().is_empty(), "{kind}");
    assert!(session.join(format!("calibration/{kept}.svg")).is_file(), "{kind}");
    record
}

fn new(session: &Path) -> PathBuf {
    let made = Command::new(env!("CARGO_BIN_EXE_unlit")).arg("new").arg(session).output().unwrap();
    assert!(made.status.success(), "{}", String::from_utf8_lossy(&made.stderr));
    session.to_owned()
}

fn birdbath(names: impl IntoIterator<Item = String>) -> Vec<String> {
    names.into_iter().map(|name| file(&format!("calibration/{name}"))).collect()
}

#[test]
fn every_calibration_prints_its_record_alone_with_names_that_say_quantity_and_unit() {
    let folder = tempfile::tempdir().unwrap();
    let session = new(&folder.path().join("s"));
    let all = |kind: &str, arguments: Vec<String>| calibrated(&session, kind, kind, &arguments);
    let number = |value: &Value, field: &str| {
        value[field].as_f64().unwrap_or_else(|| panic!("{field} is no number in {value}"))
    };
    let dark = || birdbath((0..4).map(|i| format!("dark/{i}.dng")));

    let mut frames = vec!["--dark".to_owned()];
    frames.extend(dark());
    frames.push("--blown".into());
    frames.extend(birdbath((0..2).map(|i| format!("linearity/13_{i}.dng"))));
    let levels = all("levels", frames);
    for site in levels["levels"][0]["sites"].as_array().unwrap() {
        number(site, "black_dn");
        if site["colour"] == "green" {
            number(site, "saturation_dn");
        }
    }

    let mut frames = birdbath((0..14).flat_map(|k| (0..2).map(move |i| format!("linearity/{k:02}_{i}.dng"))));
    frames.extend(["--stops".to_owned(), "0.75".into(), "--dark".into()]);
    frames.extend(dark());
    let noise = all("noise", frames);
    number(&noise["noise"][0], "electrons_per_dn");
    number(&noise["noise"][0], "read_noise_e");

    let ladders = ["iso", "shutter", "aperture"];
    let ladders = ladders.into_iter().flat_map(|s| (0..19).map(move |k| format!("exposure/{s}_{k:02}.dng")));
    let exposure = all("exposure", birdbath(ladders));
    for (ladder, setting) in
        exposure["ladders"].as_array().unwrap().iter().zip(["iso", "shutter", "aperture"])
    {
        assert_eq!(ladder["setting"], setting);
        for step in ladder["steps"].as_array().unwrap() {
            for field in ["label", "step_thirds", "factor", "deviation"] {
                number(step, field);
            }
        }
        for field in ["mean", "max", "min", "sd"] {
            number(&ladder["summary"], field);
        }
    }

    let flat = all("flat", birdbath((0..9).map(|k| format!("linearity/{k:02}_0.dng"))));
    assert_eq!(flat["corner"].as_array().unwrap().len(), 3);

    let mut cards: Vec<String> =
        ["--ring-radii", "0.035,0.085", "--focal-px", "758.3333333", "--shots"].map(String::from).into();
    for (metres, stem) in [("0.8", "d0800"), ("1.0", "d1000"), ("1.7", "d1700")] {
        cards.extend(birdbath([format!("white/{stem}_0.dng")]).into_iter().map(|f| format!("{metres}={f}")));
    }
    let flash = all("flash", cards);
    assert_eq!(flash["radiance_dn"].as_array().unwrap().len(), 3);

    let mut frames = vec!["--frames".to_owned()];
    frames.extend(birdbath((0..12).map(|k| format!("repeat/{k:02}.dng"))));
    let record = calibrated(&session, "repeatability", "steadiness", &frames);
    assert!(record["frames"].is_array(), "{record}");

    // Of another body: a session of its own.
    let session = new(&folder.path().join("chart"));
    let chart = vec![sample("tinydng_colorchart.dng").display().to_string()];
    let colour = calibrated(&session, "colour", "colour", &chart);
    number(&colour["fit"], "mean");
}
