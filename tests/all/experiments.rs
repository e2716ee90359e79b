//! The thesis's experiments in their quick form, through the program itself.

use serde_json::Value;
use std::process::Command;

/// Bounds of 255, as asked of the full forms, but for the standard deviations: the quick forms' photographs have noise
/// of their own, and 15 views of 168 x 112 pixels do not resolve the paint.
const POC_MEAN: f64 = 0.05;
const POC_SD: f64 = 0.7;
const SYNTHETIC_MEAN: f64 = 0.003 * 255.0;
const SYNTHETIC_SD: f64 = 0.035 * 255.0;

/// Runs one and gives its tables.
fn run(experiment: &str) -> Vec<Value> {
    let output = Command::new(env!("CARGO_BIN_EXE_unlit"))
        .args(["experiment", experiment, "--quick", "--json"])
        .output()
        .unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let outcome: Value = serde_json::from_slice(&output.stdout).unwrap();
    println!("{outcome:#}");
    outcome["tables"].as_array().unwrap().clone()
}

/// Mean and standard deviation, of 255, of a row.
fn row(table: &Value, name: &str) -> (f64, f64) {
    let rows = table["rows"].as_array().unwrap();
    let row = rows.iter().find(|r| r["name"] == name).unwrap_or_else(|| panic!("no {name} in {table:#}"));
    let figure = |of: &str| 255.0 * row["ours"][of].as_f64().unwrap();
    (figure("mean"), figure("sd"))
}

/// The table whose title holds all of the words.
fn titled<'a>(tables: &'a [Value], words: &[&str]) -> &'a Value {
    let holds = |t: &&Value| words.iter().all(|w| t["title"].as_str().unwrap().contains(w));
    tables.iter().find(holds).unwrap_or_else(|| panic!("no table on {words:?}"))
}

#[test]
fn isolating_and_dividing_gives_the_reflectance_back_and_bits_help() {
    let tables = run("poc");
    let object = |bits| row(titled(&tables, &[bits, "spot"]), "reflectance, object only");
    let (coarse, fine) = (object(" 8 bits"), object(" 14 bits"));
    assert!(fine.0.abs() < POC_MEAN && fine.1 < POC_SD, "{fine:?}");
    assert!(coarse.1 > 1.2 * fine.1 && coarse.0.abs() < 0.5, "{coarse:?} {fine:?}");
    let flash = row(titled(&tables, &[" 8 bits", "spot"]), "flash, object only");
    assert!(flash.0.abs() < 0.05 && (0.3..0.5).contains(&flash.1), "{flash:?}");
}

#[test]
fn a_stronger_flash_and_an_exposure_of_its_own_for_the_room_help() {
    let tables = run("precision");
    let sd =
        |exposure, flash| row(titled(&tables, &[" 8 bits", exposure, flash]), "reflectance, object only").1;
    for exposure in ["one exposure", "the room exposed"] {
        assert!(sd(exposure, "high flash") < 0.8 * sd(exposure, "low flash"));
    }
    for flash in ["low flash", "high flash"] {
        assert!(sd("the room exposed", flash) < sd("one exposure", flash));
    }
}

#[test]
fn bounces_with_our_estimate_beat_white_ones_and_none() {
    let tables = run("gi");
    let object = |name: &str| row(&tables[0], &format!("{name}, object only"));
    let ours = object("bounces with our estimate, all views");
    assert!(ours.0.abs() <= 1.0 && ours.1 <= 5.0, "{ours:?}");
    for other in ["bounces between white surfaces", "no bounces"] {
        let (mean, sd) = object(other);
        assert!(mean.abs() > 4.0 && sd > 13.0, "{other} {mean} {sd}");
    }
}

#[test]
fn a_walk_on_three_circles_gives_the_texture_from_raw_files() {
    let tables = run("synthetic");
    let (mean, sd) = row(titled(&tables, &["12.2"]), "texture, object only");
    assert!(mean.abs() < SYNTHETIC_MEAN && sd < SYNTHETIC_SD, "{mean} {sd}");
    let (mean, sd) = row(titled(&tables, &["12.2"]), "texture, object and floor");
    assert!(mean.abs() < SYNTHETIC_MEAN && sd < SYNTHETIC_SD, "{mean} {sd}");
}
