//! Levels and noise of bodies that raws are not written for: cut off at black, or of which one ISO's frames are no good.

use crate::calibrate_levels::{answer, json, session};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, Normal, Poisson};
use serde_json::Value;
use std::path::Path;
use unlit::codec::dng::{self, DngContent};
use unlit::codec::raw;
use unlit::pair::Settings;
use unlit::photometry::{Cfa, LevelSource, Levels, Mosaic};
use unlit::raster::Image;
use unlit::units::{Iso, Seconds};

const GAIN: f64 = 0.3;
const READ: f64 = 4.0;
const TOP: f64 = 4000.0;

/// A frame of a body that takes black off and cuts off at 0 DN; `light` in DN. Gives its path.
fn frame(folder: &Path, iso: f64, light: f64, random: &mut ChaCha8Rng) -> String {
    written(folder, iso, light, None, random)
}

fn written(
    folder: &Path,
    iso: f64,
    light: f64,
    masked: Option<&Image<u16>>,
    random: &mut ChaCha8Rng,
) -> String {
    let noise = Normal::new(0.0, READ).unwrap();
    let dn = Image::from_fn(128, 96, |_, _| {
        let shot = if light > 0.0 { GAIN * Poisson::new(light / GAIN).unwrap().sample(random) } else { 0.0 };
        (shot + noise.sample(random)).round().clamp(0.0, TOP) as u16
    });
    let levels = Levels {
        black: [[0.0; 2]; 2],
        saturation: [[TOP as f32; 2]; 2],
        black_source: LevelSource::FileTag,
        saturation_source: LevelSource::FileTag,
    };
    let settings = Settings {
        make: Some("Nikon".into()),
        model: Some("D1".into()),
        shutter: Some(Seconds(0.01)),
        iso: Some(Iso(iso)),
        ..Settings::default()
    };
    let mosaic = Mosaic { dn, cfa: Cfa::RGGB, levels };
    let content = DngContent { mosaic: &mosaic, settings: &settings, masked_left: masked };
    let number = std::fs::read_dir(folder).unwrap().count();
    let path = folder.join(format!("{number:03}.dng"));
    std::fs::write(&path, dng::encode(&content).unwrap()).unwrap();
    path.display().to_string()
}

/// Arguments of a calibration, with two frames of each light beside each other.
fn arguments(kind: &str, session: &str, files: &[String], dark: &[String]) -> Vec<String> {
    let head = ["calibrate", kind, session].map(String::from);
    let dark = std::iter::once("--dark".to_owned()).chain(dark.iter().cloned());
    head.into_iter().chain(files.iter().cloned()).chain(dark).chain(["--json".to_owned()]).collect()
}

fn said(record: &Value) -> String {
    record["verdict"]["sentences"].to_string()
}

#[test]
fn a_body_cut_off_at_black_is_told_so_and_an_iso_that_is_not_dark_costs_no_other() {
    let folder = tempfile::tempdir().unwrap();
    let session = session(folder.path());
    let shots = folder.path().join("shots");
    std::fs::create_dir(&shots).unwrap();
    let mut random = ChaCha8Rng::seed_from_u64(3);
    let mut of = |iso: f64, light: f64| frame(&shots, iso, light, &mut random);
    // In an order that mixes the ISOs.
    let lit = [of(400.0, 900.0), of(400.0, 900.0)];
    let dark =
        [lit[0].clone(), of(100.0, 0.0), of(200.0, 0.0), lit[1].clone(), of(200.0, 0.0), of(100.0, 0.0)];
    let blown = vec!["--blown".to_owned(), of(100.0, 20_000.0)];
    let record = json(&arguments("levels", &session, &blown, &dark));
    let levels = record["levels"].as_array().unwrap();
    assert_eq!(levels.iter().map(|l| l["iso"].as_f64()).collect::<Vec<_>>(), [Some(100.0), Some(200.0)]);
    for iso in levels {
        assert_eq!(iso["dark_frames"], 2);
        let sites = iso["sites"].as_array().unwrap();
        assert_eq!(sites.len(), 4);
        for site in sites {
            assert_eq!(
                (&site["black_dn"], &site["cut_off_dn"]),
                (&Value::from(0.0), &Value::from(0.0)),
                "{site}"
            );
            for untold in ["black_dn_standard_error", "read_noise_dn", "read_noise_below_dn"] {
                assert!(site.get(untold).is_none(), "{untold} in {site}");
            }
            let saturation = if iso["iso"] == 100.0 { Value::from(TOP) } else { Value::Null };
            assert_eq!(site["saturation_dn"], saturation, "{site}");
        }
    }
    assert_eq!(record["not_measured"][0]["iso"], 400.0);
    let why = record["not_measured"][0]["why"].as_str().unwrap();
    assert!(why.contains("none of its 2 dark frames") && why.contains("not dark"), "{why}");
    let words = said(&record);
    assert!(words.contains("cut off at 0 DN") && words.contains("At ISO 400 LEVELS ARE MISSING"), "{words}");
    assert_eq!(record["verdict"]["good"], true);
    let left_out = |shot: &&Value| shot.get("left_out").is_some();
    assert_eq!(record["shots"].as_array().unwrap().iter().filter(left_out).count(), 2);

    // Nothing is left where no ISO tells anything.
    let (code, _, complained) = answer(&["calibrate", "levels", &session, "--dark", &lit[0], &lit[1]]);
    assert!(code == Some(1) && complained.contains("not dark"), "{complained}");
}

#[test]
fn noise_of_a_body_cut_off_at_black_is_from_lit_frames_and_an_iso_of_one_light_costs_no_other() {
    let folder = tempfile::tempdir().unwrap();
    let session = session(folder.path());
    let shots = folder.path().join("shots");
    std::fs::create_dir(&shots).unwrap();
    let mut random = ChaCha8Rng::seed_from_u64(5);
    let mut two = |iso: f64, light: f64| [(); 2].map(|()| frame(&shots, iso, light, &mut random));
    let ladder: Vec<String> = (0..7).flat_map(|k| two(100.0, 40.0 * f64::from(k).exp2())).collect();
    let (one, dark) = (two(800.0, 1.0).to_vec(), two(100.0, 0.0));
    let given = [ladder.clone(), one.clone(), vec!["--stops".into(), "1".into()]].concat();
    let record = json(&arguments("noise", &session, &given, &dark));
    let [noise] = &record["noise"].as_array().unwrap()[..] else { panic!("{record}") };
    assert_eq!((&noise["dark_pairs"], &noise["cut_off_dn"]), (&Value::from(0), &Value::from(0.0)));
    let interval = |name: &str| {
        let ends = noise[name].as_array().unwrap_or_else(|| panic!("{name} in {noise}"));
        [ends[0].as_f64().unwrap(), ends[1].as_f64().unwrap()]
    };
    let electrons = noise["electrons_per_dn"].as_f64().unwrap();
    assert!((electrons * GAIN - 1.0).abs() < 0.05, "{electrons}");
    let [low, high] = interval("read_noise_e_interval_95");
    assert!(low < READ / GAIN && READ / GAIN < high, "{low} to {high}");
    assert_eq!(record["not_measured"][0]["iso"], 800.0, "{}", record["not_measured"]);
    let words = said(&record);
    println!("{words}");
    for part in ["cut off at 0 DN", "At ISO 800 NOISE WAS NOT MEASURED", "(--stops)"] {
        assert!(words.contains(part), "{part}: {words}");
    }
    let left_out = record["shots"].as_array().unwrap().iter().filter(|s| s.get("left_out").is_some());
    assert_eq!(left_out.count(), 4, "the other ISO's and the dark ones");

    let (code, _, complained) = answer(&["calibrate", "noise", &session, &one[0], &one[1]]);
    assert!(code == Some(1) && complained.contains("two light levels"), "{complained}");
}

#[test]
fn a_masked_border_that_is_cut_off_at_nought_is_no_black() {
    let folder = tempfile::tempdir().unwrap();
    let mut random = ChaCha8Rng::seed_from_u64(7);
    let noise = Normal::new(0.0, READ).unwrap();
    let border = |black: f64, random: &mut ChaCha8Rng| {
        Image::from_fn(16, 96, |_, _| (black + noise.sample(random)).round().max(0.0) as u16)
    };
    for (black, source) in [(0.0, LevelSource::FileTag), (60.0, LevelSource::MaskedPixels)] {
        let masked = border(black, &mut random);
        let path = written(folder.path(), 100.0, 300.0, Some(&masked), &mut random);
        let levels = raw::read(Path::new(&path)).unwrap().mosaic.levels;
        assert_eq!(levels.black_source, source, "{levels:?}");
        assert!((f64::from(levels.black[0][0]) - black).abs() < 1.0, "{levels:?}");
    }
}
