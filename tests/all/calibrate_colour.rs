//! Colour from a real raw file of a real chart, by the program itself.

use crate::raw::sample;
use crate::samples::shared;
use serde_json::{Value, json};
use std::path::Path;
use std::process::{Command, Output};
use unlit::codec::dng::{self, DngContent};
use unlit::codec::raw;
use unlit::pair::{Lighting, PairRecord, Polariser};
use unlit::photometry::Mosaic;
use unlit::pipeline::calibrate::colour::{self, ChartShot};
use unlit::pipeline::colour::SessionColours;
use unlit::progress::Progress;
use unlit::raster::Image;
use unlit::session::Session;

fn unlit(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_unlit")).args(arguments).output().unwrap()
}

fn said(output: &Output) -> String {
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    String::from_utf8(output.stdout.clone()).unwrap()
}

fn rows(value: &Value) -> [[f64; 3]; 3] {
    serde_json::from_value(value.clone()).unwrap()
}

#[test]
fn a_real_chart_is_found_without_help_and_its_colours_are_right() {
    let folder = tempfile::tempdir().unwrap();
    let session = folder.path().join("s");
    let path = session.to_str().unwrap();
    let file = sample("tinydng_colorchart.dng").display().to_string();
    said(&unlit(&["new", path]));
    let text = said(&unlit(&["calibrate", "colour", path, &file, "--json"]));
    let json: Value = serde_json::from_str(&text).unwrap();
    assert_eq!(json["found_without_help"], true);
    assert!(json["chart"].as_str().unwrap().starts_with("colorchecker24"), "{}", json["chart"]);
    let number = |what: &str, which: &str| json[what][which].as_f64().unwrap();
    assert!(number("fit", "mean") <= 3.0, "{}", json["fit"]);
    assert!(number("leave_one_out", "mean") <= 3.3, "{}", json["leave_one_out"]);
    assert!(number("half_held_out", "mean") < 5.0, "{}", json["half_held_out"]);
    assert!(
        json["patches"].as_array().unwrap().iter().all(|p| p["left_out"].is_null()),
        "{}",
        json["patches"]
    );
    // White stays white.
    for name in ["linear_srgb_from_camera", "acescg_from_camera"] {
        for row in rows(&json[name]) {
            assert!((row.iter().sum::<f64>() - 1.0).abs() < 2e-3, "{name} {row:?}");
        }
    }
    let kept: Value =
        serde_json::from_slice(&std::fs::read(session.join("calibration/colour.json")).unwrap()).unwrap();
    assert_eq!(kept, json);
    assert!(std::fs::read_to_string(session.join("calibration/colour.svg")).unwrap().contains("CIEDE2000"));
    let picture = std::fs::read(session.join("calibration/colour.png")).unwrap();
    assert!(image::load_from_memory(&picture).unwrap().width() >= 800);

    // With the corners of its patches given by hand, roughly, the figures are about the same.
    let corners = ["657,571", "1306,568", "1307,965", "653,975"];
    let mut arguments =
        vec!["calibrate", "colour", path, &file, "--chart", "colorchecker24-before-2014", "--corners"];
    arguments.extend(corners);
    arguments.push("--json");
    let by_hand: Value = serde_json::from_str(&said(&unlit(&arguments))).unwrap();
    assert_eq!(by_hand["found_without_help"], false);
    assert!(by_hand["fit"]["mean"].as_f64().unwrap() < 3.3, "{}", by_hand["fit"]);
    let text = said(&unlit(&["calibrate", "colour", path, &file]));
    assert!(text.starts_with("Colours differ by") && text.contains("neutral 6.5"), "{text}");
}

#[test]
fn a_frame_without_a_chart_is_refused_and_nothing_is_kept() {
    let folder = tempfile::tempdir().unwrap();
    let session = folder.path().join("s");
    let path = session.to_str().unwrap();
    said(&unlit(&["new", path]));
    let file = shared("scenes/birdbath/calibration/white/d1000_0.dng").display().to_string();
    let output = unlit(&["calibrate", "colour", path, &file]);
    let why = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(!output.status.success() && why.contains("no colour chart is seen in d1000_0.dng"), "{why}");
    assert!(
        !session.join("calibration/colour.json").exists() && !session.join("calibration/colour.png").exists()
    );
    let wrong = unlit(&["calibrate", "colour", path, &file, "--chart", "it8"]);
    assert_eq!(wrong.status.code(), Some(2));
    assert!(String::from_utf8_lossy(&wrong.stderr).contains("spydercheckr24"));
}

/// The chart's frame as a DNG with some light of a room added, and the room's alone.
fn with_room_light(folder: &Path) -> [String; 2] {
    let photo = raw::read(&sample("tinydng_colorchart.dng")).unwrap();
    let Mosaic { dn, cfa, levels } = photo.mosaic;
    let (width, height) = (dn.width(), dn.height());
    // Warmer and brighter to the right, far below saturation.
    let room = |x: usize, y: usize| {
        let colour = [0.9, 0.6, 0.3][cfa.colour(x, y)];
        (400.0 * colour * (0.5 + x as f64 / width as f64)).round() as u16
    };
    let lit = Image::from_fn(width, height, |x, y| {
        let value = *dn.at(x, y);
        let room = if f32::from(value) >= levels.saturation[y & 1][x & 1] { 0 } else { room(x, y) };
        value.saturating_add(room)
    });
    let unlit = Image::from_fn(width, height, |x, y| levels.black[y & 1][x & 1].round() as u16 + room(x, y));
    [("on.dng", lit), ("off.dng", unlit)].map(|(name, dn)| {
        let mosaic = Mosaic { dn, cfa, levels };
        let content = DngContent { mosaic: &mosaic, settings: &photo.settings, masked_left: None };
        let path = folder.join(name);
        std::fs::write(&path, dng::encode(&content).unwrap()).unwrap();
        path.display().to_string()
    })
}

#[test]
fn the_rooms_light_is_taken_off_by_a_second_raw_file() {
    let folder = tempfile::tempdir().unwrap();
    let session = folder.path().join("s");
    let path = session.to_str().unwrap();
    said(&unlit(&["new", path]));
    let [on, off] = with_room_light(folder.path());
    let plain = sample("tinydng_colorchart.dng").display().to_string();
    let record = |arguments: &[&str]| -> Value {
        let all = [&["calibrate", "colour", path], arguments, &["--json"]].concat();
        serde_json::from_str(&said(&unlit(&all))).unwrap()
    };
    let chart = ["--chart", "colorchecker24-before-2014"];
    let dark = record(&[&[plain.as_str()], &chart[..]].concat());
    let taken_off = record(&[&[on.as_str(), "--off", &off], &chart[..]].concat());
    let left_on = record(&[&[on.as_str()], &chart[..]].concat());
    assert_eq!(
        (&taken_off["room_light_taken_off"], &left_on["room_light_taken_off"]),
        (&true.into(), &false.into())
    );
    assert_eq!(taken_off["shots"].as_array().unwrap().len(), 2);
    let mean = |record: &Value| record["leave_one_out"]["mean"].as_f64().unwrap();
    println!("dark {}, room taken off {}, left on {}", mean(&dark), mean(&taken_off), mean(&left_on));
    assert!((mean(&taken_off) - mean(&dark)).abs() < 0.1 && mean(&left_on) > mean(&dark) + 0.5);
    let white = |record: &Value| rows(&Value::Array(vec![record["white_dn"].clone(); 3]))[0];
    for (a, b) in white(&taken_off).into_iter().zip(white(&dark)) {
        assert!((a / b - 1.0).abs() < 0.005, "{a} for {b}");
    }
}

#[test]
fn colours_of_another_polariser_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let session = Session::create(&folder.path().join("s"), "s").unwrap();
    let through = |angle: f64| Lighting {
        polariser: Some(Polariser { angle_degrees: Some(angle) }),
        ..Lighting::default()
    };
    session.set_lighting(through(30.0)).unwrap();
    let on = sample("tinydng_colorchart.dng");
    let shot = ChartShot { on, off: None, chart: None, corners: None };
    let record = colour::calibrate(&session, &shot, &Progress::silent()).unwrap();
    assert_eq!(record.rig.lighting, through(30.0));
    let pair = |lighting: Lighting| -> PairRecord {
        let settings = json!({ "model": record.rig.model, "serial": record.rig.serial });
        let frame =
            json!({ "file": "f", "original_name": "f", "bytes": 1, "blake3": "00", "settings": settings });
        let told = json!({
            "number": 1, "name": "0001", "verdict": "accepted", "reasons": [], "off": frame, "on": frame,
            "lighting": lighting,
        });
        serde_json::from_value(told).unwrap()
    };
    let known = |lighting| SessionColours::measured(&session, &[&pair(lighting)]);
    assert!(known(through(210.0)).unwrap().matrix.is_some());
    for (other, words) in [(through(120.0), "at 120 degrees"), (Lighting::default(), "none")] {
        let refused = known(other).unwrap_err().to_string();
        assert!(refused.contains("colour.json") && refused.contains(words), "{refused}");
        assert!(refused.contains("at 30 degrees") && refused.contains("polariser of the pairs"), "{refused}");
    }
}
