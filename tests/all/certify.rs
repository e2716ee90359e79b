//! A model's certificate, and the colours of the session's own chart, on a scene that another renderer made.

use crate::raw::sample;
use crate::samples::shared;
use serde_json::{Value, json};
use std::path::{Path, PathBuf};
use std::process::{Command, Output};
use unlit::codec::tiff16;

const VIEWS: [&str; 8] = ["000", "003", "006", "009", "012", "015", "018", "021"];

fn file(path: &str) -> String {
    shared(&format!("scenes/birdbath/{path}")).display().to_string()
}

fn run(arguments: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_unlit")).args(arguments).output().unwrap()
}

fn unlit(arguments: &[&str]) -> String {
    let output = run(arguments);
    let said = String::from_utf8_lossy(&output.stdout).into_owned();
    let complained = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "unlit {arguments:?} ended with {}: {said}{complained}", output.status);
    said
}

fn refused(arguments: &[&str]) -> String {
    let output = run(arguments);
    assert_eq!(output.status.code(), Some(1), "unlit {arguments:?} did not fail");
    String::from_utf8_lossy(&output.stderr).into_owned()
}

/// A session of some of the views, up to its calibration.
fn prepared(folder: &Path) -> PathBuf {
    let (off, on) = (folder.join("off"), folder.join("on"));
    for (side, to) in [("off", &off), ("on", &on)] {
        std::fs::create_dir(to).unwrap();
        for name in VIEWS.map(|stem| format!("{stem}.dng")) {
            std::fs::copy(file(&format!("photos/{side}/{name}")), to.join(&name)).unwrap();
        }
    }
    let session = folder.join("session");
    let name = session.to_str().unwrap();
    unlit(&["new", name]);
    unlit(&["import", "pairs", name, "--off", off.to_str().unwrap(), "--on", on.to_str().unwrap()]);
    let [cameras, object, floor] =
        ["cameras.xml", "object.obj", "floor.obj"].map(|f| file(&format!("geometry/{f}")));
    unlit(&["import", "scene", name, "--cameras", &cameras, "--mesh", &object, "--mesh", &floor]);
    let shots = ["0.8=d0800", "1.0=d1000", "1.3=d1300"].map(|shot| {
        let (metres, stem) = shot.split_once('=').unwrap();
        format!("{metres}={}", file(&format!("calibration/white/{stem}_0.dng")))
    });
    let mut calibrate = vec!["calibrate", "flash", name, "--target-reflectance", "0.94"];
    calibrate.extend(["--ring-radii", "0.035,0.085", "--shots"]);
    calibrate.extend(shots.iter().map(String::as_str));
    unlit(&calibrate);
    session
}

/// Mean and spread of the three channels over some values.
fn statistics(values: &[[f32; 3]]) -> ([f64; 3], f64) {
    let n = values.len() as f64;
    let mean: [f64; 3] = std::array::from_fn(|c| values.iter().map(|v| f64::from(v[c])).sum::<f64>() / n);
    let square = |c: usize| values.iter().map(|v| (f64::from(v[c]) - mean[c]).powi(2)).sum::<f64>() / n;
    (mean, (0..3).map(|c| square(c).sqrt() / mean[c]).fold(0.0, f64::max))
}

/// The evenest parts of the true texture stand for known patches: at most one of each part of it.
fn patches_of_the_texture() -> Vec<Value> {
    const CELL: usize = 24;
    let truth = tiff16::read_rgb(&shared("scenes/birdbath/truth/texture.tif")).unwrap();
    let covered = tiff16::read_grey8(&shared("scenes/birdbath/truth/texture_coverage.tif")).unwrap();
    let (side, cells) = (truth.width(), truth.width() / CELL);
    let mut found: Vec<(f64, usize, usize, [f64; 3])> = vec![];
    for (i, j) in (1..cells - 1).flat_map(|j| (1..cells - 1).map(move |i| (i, j))) {
        let square = |more: usize| {
            let span = move |k: usize| (k * CELL - more)..((k + 1) * CELL + more);
            span(j).flat_map(move |y| span(i).map(move |x| (x, y)))
        };
        if square(4).all(|(x, y)| *covered.at(x, y) > 0) {
            let values: Vec<[f32; 3]> = square(4).map(|(x, y)| *truth.at(x, y)).collect();
            let (mean, spread) = statistics(&values);
            if mean.iter().all(|m| *m > 0.1) {
                found.push((spread, i, j, mean));
            }
        }
    }
    assert!(found.len() > 5, "{} squares of the texture lie on the object", found.len());
    found.sort_by(|a, b| a.0.total_cmp(&b.0));
    let mut taken: Vec<(usize, usize)> = vec![];
    let uv = |i: usize, j: usize| [(i * CELL) as f64 / side as f64, 1.0 - (j * CELL) as f64 / side as f64];
    let mut patches = vec![];
    for (_, i, j, mean) in found {
        if patches.len() < 16 && taken.iter().all(|t| t.0.abs_diff(i) + t.1.abs_diff(j) > 3) {
            taken.push((i, j));
            let place = json!({ "texture": { "from_uv": uv(i, j), "to_uv": uv(i + 1, j + 1) } });
            let name = format!("texture {i} {j}");
            patches.push(json!({ "name": name, "known": { "camera_rgb": mean }, "place": place }));
        }
    }
    patches
}

/// The evenest squares of a view, of the object or of the floor.
fn patches_of_a_view(view: &str, object: bool, count: usize) -> Vec<Value> {
    const CELL: usize = 20;
    let albedo = tiff16::read_rgb(&shared(&format!("scenes/birdbath/truth/albedo/{view}.tif"))).unwrap();
    let mask = tiff16::read_grey8(&shared(&format!("scenes/birdbath/truth/mask/{view}.tif"))).unwrap();
    let mut found: Vec<(f64, usize, usize, [f64; 3])> = vec![];
    for (i, j) in (1..19).flat_map(|j| (1..29).map(move |i| (i, j))) {
        let pixels =
            || (j * CELL..(j + 1) * CELL).flat_map(move |y| (i * CELL..(i + 1) * CELL).map(move |x| (x, y)));
        let values: Vec<[f32; 3]> = pixels().map(|(x, y)| *albedo.at(x, y)).collect();
        let right = pixels().all(|(x, y)| *mask.at(x, y) == if object { 255 } else { 0 });
        let (mean, spread) = statistics(&values);
        if right && mean.iter().all(|m| *m > 0.05) {
            found.push((spread, i * CELL, j * CELL, mean));
        }
    }
    found.sort_by(|a, b| a.0.total_cmp(&b.0));
    let patch = |(_, x, y, mean): (f64, usize, usize, [f64; 3])| {
        let (a, b) = (x + CELL, y + CELL);
        let place = json!({ "view": { "name": view, "polygon_px": [[x, y], [a, y], [a, b], [x, b]] } });
        json!({ "name": format!("view {view} {x} {y}"), "known": { "camera_rgb": mean }, "place": place })
    };
    found.into_iter().take(count).map(patch).collect()
}

fn json_file(path: &Path) -> Value {
    serde_json::from_slice(&std::fs::read(path).unwrap()).unwrap()
}

fn extras(session: &Path) -> Value {
    let (document, _, _) = gltf::import(session.join("model/model.glb")).unwrap();
    serde_json::from_str(document.as_json().asset.extras.as_ref().unwrap().get()).unwrap()
}

fn report(session: &Path) -> String {
    std::fs::read_to_string(session.join("model/report.html")).unwrap()
}

#[test]
fn a_model_carries_a_certificate_and_the_colours_of_its_own_chart() {
    let folder = tempfile::tempdir().unwrap();
    let session = prepared(folder.path());
    let name = session.to_str().unwrap();
    let list = folder.path().join("patches.json");
    let mut patches = patches_of_the_texture();
    ["006", "012", "018"].into_iter().for_each(|view| patches.extend(patches_of_a_view(view, true, 4)));
    patches.extend(patches_of_a_view("006", false, 4));
    let somewhere =
        |name: &str, place: Value| json!({ "name": name, "known": { "grey": 0.5 }, "place": place });
    patches.push(somewhere("in the air", json!({ "point": { "at_m": [0.0, 0.0, 2.0], "radius_m": 0.02 } })));
    let given = patches.len();
    std::fs::write(&list, json!({ "patches": patches }).to_string()).unwrap();
    let certify = ["certify", name, list.to_str().unwrap(), "--json"];
    assert!(refused(&certify).contains("unlit process"));

    unlit(&["process", name, "--texture-size", "1024"]);
    assert!(report(&session).contains("no patch of known reflectance"));
    let certificate: Value = serde_json::from_slice(&run(&certify).stdout).unwrap();
    println!("{:#}", certificate["summary"]);
    certificate["verdict"]["sentences"].as_array().unwrap().iter().for_each(|s| println!("{s}"));
    the_certificate_is_right(&certificate, given);
    assert_eq!(certificate, json_file(&session.join("model/certificate.json")));
    let carried = &extras(&session)["provenance"]["certificate"];
    assert_eq!(
        (&carried["made"], &carried["summary"]["seen"]),
        (&certificate["made"], &certificate["summary"]["seen"])
    );
    assert!(
        report(&session).contains("2 % cannot be told for sure") || report(&session).contains("limit of 2 %")
    );
    assert!(report(&session).contains("in the air") && report(&session).contains("not seen"));
    assert!(unlit(&["process", name, "--texture-size", "1024"]).contains("nothing had changed"));
    let words = String::from_utf8(run(&certify[..3]).stdout).unwrap();
    assert!(words.contains("not seen") && words.contains("beside the model"), "{words}");
    println!("{words}");

    // A grey alone that is known to be what it is: it passes, and the exit code says so.
    let seen =
        certificate["patches"].as_array().unwrap().iter().find(|p| p["comparison"].is_object()).unwrap();
    let own = json!({ "patches": [{
        "name": "itself",
        "known": { "camera_rgb": seen["comparison"]["found_reflectance"] },
        "place": seen["place"],
    }] });
    std::fs::write(&list, own.to_string()).unwrap();
    let passed: Value = serde_json::from_str(&unlit(&certify)).unwrap();
    assert_eq!(passed["summary"]["within_2_percent"], true);
    assert!(passed["summary"]["delta_e_2000_max"].as_f64().unwrap() < 1e-6, "{passed}");

    colours_are_the_charts(&session, folder.path());

    // Another texture: the certificate is not of it.
    unlit(&["process", name, "--texture-size", "512"]);
    assert!(report(&session).contains("STALE"));
    let told = &extras(&session)["provenance"]["certificate"];
    assert_eq!((&told["stale"], &told["patches"]), (&json!(true), &Value::Null));
}

fn the_certificate_is_right(certificate: &Value, given: usize) {
    let patches = certificate["patches"].as_array().unwrap();
    assert_eq!((patches.len(), &certificate["summary"]["patches"]), (given, &json!(given)));
    assert_eq!(certificate["verdict"]["good"], certificate["summary"]["within_5_percent"]);
    let last = patches.last().unwrap();
    assert!(last["not_seen"].is_string() && last["comparison"].is_null(), "{last}");
    let seen: Vec<&Value> = patches.iter().filter(|p| p["comparison"].is_object()).collect();
    assert_eq!(certificate["summary"]["seen"], json!(seen.len()));
    let from = |what: &str| seen.iter().filter(|p| p["read"]["from"] == what).count();
    assert!(from("texture") >= 10 && from("views") >= 3, "{} and {}", from("texture"), from("views"));
    // Squares of some photo pixels, with the photographs' own coarseness in their colours: right on average.
    let of_texture = |patch: &Value| patch["name"].as_str().unwrap().starts_with("texture");
    let mut of_squares = vec![];
    let (mut inside, mut told, mut errors) = (0, 0, vec![]);
    for patch in &seen {
        let of = |what: &str, c: usize| patch["comparison"][what][c].as_f64();
        for c in 0..3 {
            let error = of("found_reflectance", c).unwrap() - of("known_reflectance", c).unwrap();
            assert!((error - of("error", c).unwrap()).abs() < 1e-9, "{patch:#}");
            of_squares.extend(of_texture(patch).then_some(error));
            if of_texture(patch) {
                continue;
            }
            errors.push(error);
            if let Some(deviation) = of("standard_deviation", c) {
                told += 1_u32;
                inside += usize::from(error.abs() <= 1.96 * deviation);
            }
        }
        let limit = if of_texture(patch) { 12.0 } else { 6.0 };
        assert!(patch["comparison"]["delta_e_2000"].as_f64().unwrap() < limit, "{patch:#}");
    }
    let n = errors.len() as f64;
    let of_all = of_squares.iter().sum::<f64>() / of_squares.len() as f64;
    assert!(of_squares.len() >= 9 && of_all.abs() < 0.03, "{of_all} over {of_squares:?}");
    let (mean, far) = (errors.iter().sum::<f64>() / n, errors.iter().filter(|e| e.abs() > 0.04).count());
    println!("{inside} of {told} within 1.96 standard deviations, mean error {mean}, {far} above 0.04");
    assert!(mean.abs() < 0.01 && far as f64 <= 0.1 * n && inside as f64 >= 0.7 * f64::from(told));
}

/// A chart of another body is refused, one of this body is used, and one that is no good is said to be none.
fn colours_are_the_charts(session: &Path, folder: &Path) {
    let (name, out) = (session.to_str().unwrap(), folder.join("out"));
    let to = out.to_str().unwrap();
    let export = ["export", name, "--to", to, "--format", "glb", "--colour", "srgb"];
    unlit(&export);
    assert_eq!(json_file(&out.join("export.json"))["colour"]["basis"]["from"], "maker");
    assert_eq!(extras(session)["reflectance"], "camera RGB, uncalibrated");

    let chart = sample("tinydng_colorchart.dng").display().to_string();
    unlit(&["calibrate", "colour", name, &chart]);
    for arguments in [&export[..], &["process", name, "--texture-size", "1024"]] {
        let why = refused(arguments);
        assert!(why.contains("Kiss X4") && why.contains("Bayer 14") && why.contains("colour.json"), "{why}");
    }
    let record = session.join("calibration/colour.json");
    let mut kept = json_file(&record);
    let pair = json_file(&session.join("pairs/0001/pair.json"));
    for fact in ["make", "model", "serial"] {
        kept["rig"][fact] = pair["on"]["settings"][fact].clone();
    }
    std::fs::write(&record, kept.to_string()).unwrap();
    unlit(&export);
    let colour = json_file(&out.join("export.json"))["colour"].clone();
    assert_eq!(
        (&colour["basis"]["from"], &colour["from_camera"]),
        (&json!("chart"), &kept["linear_srgb_from_camera"])
    );
    let again = unlit(&["process", name, "--texture-size", "1024"]);
    assert!(!again.contains("nothing had changed"), "{again}");
    assert_eq!(extras(session)["reflectance"], "camera RGB, taken to linear sRGB by calibration");
    assert_eq!(extras(session)["provenance"]["certificate"]["summary"]["seen"], 1, "the texture is the same");
    assert!(report(session).contains("measured with a chart"));

    kept["verdict"]["good"] = json!(false);
    std::fs::write(&record, kept.to_string()).unwrap();
    assert!(unlit(&export).contains("not good enough and was not used"));
    assert_eq!(json_file(&out.join("export.json"))["colour"]["basis"]["from"], "maker");
}
