//! The exposure table from raws, against the truth of a simulated body; and `unlit apex`.

use crate::samples::shared;
use serde_json::Value;
use std::process::{Command, Output};

fn run(arguments: &[String]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_unlit")).args(arguments).output().unwrap()
}

fn unlit(arguments: &[String]) -> String {
    let output = run(arguments);
    let complained = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "unlit {arguments:?}: {complained}");
    String::from_utf8(output.stdout).unwrap()
}

fn words(text: &str) -> Vec<String> {
    text.split(' ').map(str::to_owned).collect()
}

/// Files of a folder in the order of their names.
fn files(folder: &str) -> Vec<String> {
    let entries = std::fs::read_dir(shared(folder)).unwrap();
    let mut files: Vec<String> = entries.map(|e| e.unwrap().path().display().to_string()).collect();
    files.sort();
    files
}

/// Light of one of the ladders' frames above black, all sites of it.
fn whole_frame(name: &str) -> f64 {
    let path = shared("scenes/birdbath/calibration/exposure").join(name);
    let mosaic = unlit::codec::raw::read(&path).unwrap().mosaic;
    let black = f64::from(mosaic.levels.black[0][0]);
    mosaic.dn.pixels().iter().map(|dn| f64::from(*dn) - black).sum()
}

#[test]
fn three_ladders_of_raws_give_every_deviation_within_three_per_mille() {
    let home = tempfile::tempdir().unwrap();
    let session = home.path().join("s").display().to_string();
    unlit(&["new".into(), session.clone()]);
    let shots = files("scenes/birdbath/calibration/exposure");
    let arguments = |json: bool| {
        let mut all = words("calibrate exposure");
        all.push(session.clone());
        all.extend(shots.clone());
        all.extend(json.then(|| "--json".to_owned()));
        all
    };
    let record: Value = serde_json::from_str(&unlit(&arguments(true))).unwrap();
    let light = |setting: &str, step: usize| whole_frame(&format!("{setting}_{step:02}.dng"));
    let truth = std::fs::read(shared("scenes/birdbath/truth/scene.json")).unwrap();
    let truth: Value = serde_json::from_slice(&truth).unwrap();
    let number = |v: &Value| v.as_f64().unwrap() as usize;
    let (mut worst, mut inside, mut all, mut whole) = (0.0f64, 0, 0, 0);
    for ladder in record["ladders"].as_array().unwrap() {
        let of_setting: Vec<&Value> = truth["calibration"]["exposure"]
            .as_array()
            .unwrap()
            .iter()
            .filter(|t| t["setting"] == ladder["setting"])
            .collect();
        let setting = ladder["setting"].as_str().unwrap();
        let steps = ladder["steps"].as_array().unwrap();
        assert_eq!(steps.len(), of_setting.len(), "{}", ladder["setting"]);
        let zero = of_setting[0]["deviation"].as_f64().unwrap();
        for (step, truth) in steps.iter().zip(of_setting) {
            assert_eq!(step["step_thirds"].as_f64(), truth["step_thirds"].as_f64());
            let expected = (1.0 + truth["deviation"].as_f64().unwrap()) / (1.0 + zero) - 1.0;
            let error = step["deviation"].as_f64().unwrap() - expected;
            worst = worst.max(error.abs());
            let ends: Vec<f64> = step["deviation_interval_95"]
                .as_array()
                .unwrap()
                .iter()
                .map(|v| v.as_f64().unwrap())
                .collect();
            // The whole frame, added up here anew: nothing hangs on which part of it is measured.
            if step["frame_share"] == 1.0 {
                let ratio = light(setting, number(&step["step_thirds"])) / light(setting, 0);
                let ideal = (number(&step["step_thirds"]) as f64 / 3.0).exp2();
                assert!((ratio / ideal - 1.0 - expected).abs() <= 0.003, "{setting}: {step}");
                whole += 1;
            }
            if step["step_thirds"] != 0.0 {
                inside += i32::from(ends[0] <= expected && expected <= ends[1]);
                all += 1;
            }
        }
    }
    println!("{whole} of 57 steps over the whole frame");
    assert!(whole >= 50, "{whole}");
    println!("worst error {:.4} %, {inside} of {all} truths inside their intervals", 100.0 * worst);
    assert_eq!(record["ladders"].as_array().unwrap().len(), 3);
    assert!(worst <= 0.003, "{worst}");
    // The steps of a ladder share step 00's noise, so that one number bounds all of them but loosely.
    assert!(inside * 10 >= all * 8, "{inside} of {all}");
    assert_eq!(record["verdict"]["good"], true);
    assert_eq!(record["shots"].as_array().unwrap().len(), 57);
    for kept in ["exposure.json", "exposure.svg", "exposure"] {
        assert!(home.path().join("s/calibration").join(kept).exists(), "{kept}");
    }

    let said = unlit(&arguments(false));
    println!("{said}");
    for row in ["ISO, from step 00", "aperture in the thesis", "0.0593"] {
        assert!(said.contains(row), "{row} is not in {said}");
    }
}

#[test]
fn files_without_a_ladder_are_refused_in_words() {
    let home = tempfile::tempdir().unwrap();
    let session = home.path().join("s").display().to_string();
    unlit(&["new".into(), session.clone()]);
    let shots = files("scenes/birdbath/calibration/dark");
    let mut all = words("calibrate exposure");
    all.push(session);
    all.extend(shots);
    let output = run(&all);
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(!output.status.success() && said.contains("no ladder"), "{said}");
}

#[test]
fn the_thesiss_example_of_scaling_gives_twelve() {
    let command = "apex --shutter 1/150 --aperture 8 --iso 100 --to shutter=1/100,iso=800";
    let said = unlit(&words(command));
    assert!(said.contains("12.0000") && said.contains("Tv      7.2288"), "{said}");
    let json: Value = serde_json::from_str(&unlit(&words(&format!("{command} --json")))).unwrap();
    assert!((json["factor"]["room"].as_f64().unwrap() - 12.0).abs() < 1e-9, "{json}");
    assert!((json["speed_value"].as_f64().unwrap() - 4.8939).abs() < 1e-4);
    for wrong in
        ["apex --shutter 0 --aperture 8 --iso 100", "apex --shutter 1 --aperture 8 --iso 1 --to ev=3"]
    {
        assert_eq!(run(&words(wrong)).status.code(), Some(2), "{wrong}");
    }
}
