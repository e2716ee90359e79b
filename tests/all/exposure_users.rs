//! A session's exposure table at everything that scales one exposure to another: used where it holds, refused aloud
//! where it is another body's.

use crate::wall::photo_in;
use serde_json::{Value, json};
use std::path::{Path, PathBuf};
use unlit::calibration::{FlashCalibration, Plane, Target};
use unlit::pair::{Exposure, Limits, PairRecord, Plan, ReasonCode, Verdict};
use unlit::pipeline::calibrate::{colour, exposure};
use unlit::pipeline::develop::{self, DevelopError};
use unlit::pipeline::flash::{self, CardFacts, CardFiles};
use unlit::pipeline::pairs;
use unlit::progress::Progress;
use unlit::session::Session;
use unlit::units::{FNumber, Iso, Seconds};

/// A shutter whose steps are off their labels, as bodies' shutters are.
const STEPS: [(f64, f64); 4] = [(60.0, 0.0), (50.0, 0.06), (40.0, -0.05), (30.0, 0.04)];

fn at(step: usize) -> Exposure {
    Exposure { shutter: Seconds(1.0 / STEPS[step].0), aperture: FNumber(11.0), iso: Iso(100.0) }
}

/// The wall at a step of that shutter.
fn photo(step: usize, flash: f64, frame: u32) -> Vec<u8> {
    photo_in(1.0 + STEPS[step].1, flash, frame, at(step))
}

fn write(path: PathBuf, bytes: &[u8]) -> PathBuf {
    std::fs::create_dir_all(path.parent().unwrap()).unwrap();
    std::fs::write(&path, bytes).unwrap();
    path
}

/// A session, whose pairs are planned at two steps: unlit at the third, lit at the second.
fn session(folder: &Path, table: bool) -> Session {
    let session = Session::create(&folder.join("s"), "s").unwrap();
    session.set_plan(Plan { off: at(2), on: at(1) }).unwrap();
    if table {
        let shots =
            (0..STEPS.len()).map(|k| write(folder.join(format!("{k}.dng")), &photo(k, 0.0, k as u32)));
        let shots: Vec<PathBuf> = shots.collect();
        exposure::calibrate(&session, &shots, &Progress::silent()).unwrap();
    }
    session
}

/// Makes the session's table that of another body.
fn of_another_body(session: &Session) {
    let path = session.calibration_dir().join("exposure.json");
    let mut record: Value = serde_json::from_slice(&std::fs::read(&path).unwrap()).unwrap();
    record["rig"]["model"] = json!("Fake 2");
    std::fs::write(&path, serde_json::to_vec(&record).unwrap()).unwrap();
}

fn imported(folder: &Path, session: &Session, flash: f64) -> PairRecord {
    let (off, on) = (folder.join("off"), folder.join("on"));
    write(off.join("p.dng"), &photo(2, 0.0, 10));
    write(on.join("p.dng"), &photo(1, flash, 11));
    let summary = pairs::import(session, &off, &on, &Limits::default(), &Progress::silent(), |_| {}).unwrap();
    summary.imported[0].record.clone()
}

fn codes(pair: &PairRecord) -> Vec<ReasonCode> {
    pair.reasons.iter().map(|reason| reason.code).collect()
}

fn calibration() -> FlashCalibration {
    serde_json::from_value(json!({
        "ring": { "inner_radius_m": 0.035, "outer_radius_m": 0.085 },
        "radiance_dn": [1.0, 1.0, 1.0],
        "field": { "coefficients": [0.0, 0.0, 0.0] },
        "noise": { "gain_dn": 0.3, "floor_dn2": 10.0 },
        "target_reflectance": 0.94,
        "iso": 100.0,
        "aperture": 11.0,
        "cards": [],
        "residual_rms": 0.0, "misfit_rms": 0.0,
    }))
    .unwrap()
}

/// Mean of the flash's light in a pair over what the wall's own is with the flash alone.
fn flash_light(session: &Session, pair: &PairRecord) -> Result<f64, DevelopError> {
    let known = develop::known_sites(session, pair, &calibration())?;
    let mean = |values: &mut dyn Iterator<Item = f64>| {
        let (sum, n) = values.fold((0.0, 0.0), |(sum, n), v| (sum + v, n + 1.0));
        sum / n
    };
    let found = mean(&mut known.value.pixels().iter().flatten().map(|v| f64::from(*v)));
    let dark = unlit::codec::raw::decode(&photo_in(0.0, 1.0, 11, at(1)), "flash alone").unwrap().mosaic;
    Ok(found / mean(&mut dark.dn.pixels().iter().map(|v| f64::from(*v) - 2048.0)))
}

#[test]
fn a_pair_at_two_exposures_is_judged_and_developed_by_the_measured_steps() {
    let folder = tempfile::tempdir().unwrap();
    let measured = session(folder.path(), true);
    let pair = imported(folder.path(), &measured, 1.0);
    assert_eq!((pair.verdict, codes(&pair)), (Verdict::Accepted, vec![]), "{:?}", pair.reasons);
    let with_table = flash_light(&measured, &pair).unwrap();
    assert!((with_table - 1.0).abs() < 0.002, "{with_table}");

    // Without the table the room's light, a quarter of the frame, is off by the shutter's 11 %.
    let bare = tempfile::tempdir().unwrap();
    let by_labels = session(bare.path(), false);
    let pair = imported(bare.path(), &by_labels, 1.0);
    let without = flash_light(&by_labels, &pair).unwrap();
    assert!((without - 1.0).abs() > 0.015, "{without}");

    // A flash that did not fire is known by the steps as they are.
    let dark = tempfile::tempdir().unwrap();
    let pair = imported(dark.path(), &session(dark.path(), true), 0.0);
    assert_eq!(codes(&pair), [ReasonCode::Misfire], "{:?}", pair.reasons);
}

#[test]
fn a_table_of_another_body_is_refused_by_everything_that_scales_and_not_where_nothing_differs() {
    let folder = tempfile::tempdir().unwrap();
    let session = session(folder.path(), true);
    of_another_body(&session);
    let says = |words: String| {
        assert!(words.contains("\"Fake 1\"") && words.contains("\"Fake 2\""), "{words}");
        assert!(words.contains("unlit calibrate exposure"), "{words}");
    };
    // The check of a pair.
    let pair = imported(folder.path(), &session, 1.0);
    assert_eq!((pair.verdict, codes(&pair)), (Verdict::Rejected, vec![ReasonCode::SettingsChanged]));
    says(pair.reasons[0].sentence.clone());
    // Developing.
    says(flash_light(&session, &pair).unwrap_err().to_string());
    let mut same = pair.clone();
    same.off.settings = same.on.settings.clone();
    assert!(flash_light(&session, &same).is_ok(), "nothing to be scaled");
    // A pair and the flash calibration's settings.
    let scale = unlit::pipeline::scale::SessionScale::load(&session).unwrap();
    let lamp = |iso| develop::lamp(&pair, &FlashCalibration { iso: Some(iso), ..calibration() }, &scale);
    assert!(lamp(100.0).is_ok());
    says(lamp(200.0).unwrap_err().to_string());
    // Card shots with an unlit frame of another exposure.
    let (off, on) = (folder.path().join("off/p.dng"), folder.path().join("on/p.dng"));
    let card = CardFiles {
        plane: Some(Plane { point: glam::DVec3::Z, normal: -glam::DVec3::Z }),
        on: on.clone(),
        off: Some(off.clone()),
        held_out: false,
    };
    let facts = CardFacts {
        target: Target { reflectance: 0.94, curve: vec![] },
        paper: true,
        vignetting: None,
        ring_radii: [0.035, 0.085],
        focal_px: Some(200.0),
        free_radii: false,
        lighting: None,
        tags: None,
    };
    let error = flash::calibrate(&session, &[card], &facts, &Progress::silent()).unwrap_err();
    says(error.to_string());
    // A colour chart with an unlit frame of another exposure.
    let chart = colour::ChartShot { on, off: Some(off), chart: None, corners: None };
    says(colour::calibrate(&session, &chart, &Progress::silent()).unwrap_err().to_string());
}

#[test]
fn earlier_pairs_are_held_against_later_ones_by_the_table_of_the_day() {
    let folder = tempfile::tempdir().unwrap();
    let session = session(folder.path(), false);
    imported(folder.path(), &session, 1.0);
    let kept = || -> Value {
        let path = session.derived_dir().join("stops/0001.json");
        serde_json::from_slice(&std::fs::read(path).unwrap()).unwrap()
    };
    let before = kept();
    assert!(before.get("scale").is_none(), "{before}");
    let shots = (0..STEPS.len())
        .map(|k| write(folder.path().join(format!("{k}.dng")), &photo(k, 0.0, k as u32)))
        .collect::<Vec<_>>();
    exposure::calibrate(&session, &shots, &Progress::silent()).unwrap();
    unlit::pipeline::stops::Earlier::load(&session, &Progress::silent()).unwrap();
    assert!(kept()["scale"].is_string() && kept()["stop"] != before["stop"], "the signature was made again");
}
