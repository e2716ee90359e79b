use super::*;
use crate::calibration::{FlashFindings, Rig, SCHEMA};
use crate::light::Ring;
use crate::pair::{FlashSync, Polariser, SyncSource};
use crate::photometry::NoiseModel;
use crate::units::Seconds;

fn settings() -> Settings {
    Settings {
        model: Some("EOS 5D".into()),
        serial: Some("17".into()),
        lens: Some("EF 50mm".into()),
        shutter: Some(Seconds(1.0 / 125.0)),
        aperture: Some(FNumber(11.0)),
        iso: Some(Iso(100.0)),
        focal_length_mm: Some(50.0),
        ..Settings::default()
    }
}

fn calibrated(lighting: Lighting, energy_counts: Option<f64>) -> Record<FlashCalibration> {
    Record {
        schema: SCHEMA,
        measured: String::new(),
        software: String::new(),
        rig: Rig { lighting, ..Rig::of(&settings()) },
        shots: vec![],
        verdict: Verdict { good: true, sentences: vec![] },
        fit: FlashCalibration {
            ring: Ring::new(0.035, 0.085).unwrap(),
            radiance_dn: [5e4; 3],
            radiance_dn_interval_95: None,
            radiance_dn_standard_error: None,
            field: crate::calibration::FieldFactor { coefficients: [0.0; 3] },
            colour_vignetting: None,
            noise: NoiseModel { gain: 0.3, floor: 4.0 },
            target_reflectance: 0.94,
            iso: Some(100.0),
            aperture: Some(11.0),
            focal_length_mm: Some(50.0),
            energy_counts,
            cards: vec![],
            residual_rms: 0.0,
            misfit_rms: 0.0,
            findings: FlashFindings::default(),
        },
    }
}

fn pair(name: &str, settings: Settings, lighting: Lighting, energy: Option<f64>) -> PairRecord {
    let frame = |file: &str| serde_json::json!({ "file": file, "original_name": file, "bytes": 1, "blake3": file, "settings": settings });
    let pair = serde_json::json!({
        "number": 1, "name": name, "verdict": "accepted", "reasons": [], "off": frame("a"), "on": frame("b"),
        "lighting": lighting
    });
    let sync = |energy_counts| FlashSync {
        number: 1,
        source: SyncSource::Contact,
        triggered: true,
        tag: 1,
        at: None,
        energy_counts,
        peak_counts: 500.0,
        dark_counts: 10.0,
        lit_samples: 200,
        clipped_samples: 0,
        bounces: 0,
    };
    let flash = energy.map(|energy| FlashRecord { off: vec![], on: vec![sync(energy)] });
    PairRecord { flash, ..serde_json::from_value(pair).unwrap() }
}

fn at_power(power: f64) -> Lighting {
    Lighting { flash_power: Some(power), ..Lighting::default() }
}

fn through(angle: Option<f64>) -> Lighting {
    Lighting { polariser: Some(Polariser { angle_degrees: angle }), ..Lighting::default() }
}

fn judged(calibrated: &Record<FlashCalibration>, pairs: &[PairRecord]) -> Result<Vec<String>, String> {
    scaled_for(calibrated, pairs, &SessionScale::default()).map_err(|e| e.to_string())
}

#[test]
fn a_pair_of_the_same_rig_is_taken_and_what_its_files_do_not_tell_is_not_held_against_it() {
    let calibration = calibrated(Lighting::default(), None);
    assert_eq!(judged(&calibration, &[pair("1", settings(), Lighting::default(), None)]), Ok(vec![]));
    let untold = Settings { model: None, serial: None, lens: None, focal_length_mm: None, ..settings() };
    assert_eq!(judged(&calibration, &[pair("1", untold, Lighting::default(), None)]), Ok(vec![]));
    let longer = Settings { shutter: Some(Seconds(0.5)), ..settings() };
    assert_eq!(
        judged(&calibration, &[pair("1", longer, Lighting::default(), None)]),
        Ok(vec![]),
        "an energy"
    );
}

#[test]
fn another_body_lens_or_focal_length_is_refused() {
    let calibration = calibrated(Lighting::default(), None);
    let text = |t: &str| Some(t.to_owned());
    for (other, what) in [
        (Settings { model: text("EOS 6D"), ..settings() }, "camera model is \"EOS 6D\""),
        (Settings { serial: text("18"), ..settings() }, "serial number is \"18\""),
        (Settings { lens: text("EF 35mm"), ..settings() }, "lens is \"EF 35mm\""),
        (Settings { focal_length_mm: Some(70.0), ..settings() }, "focal length is \"70 mm\""),
    ] {
        let refused = judged(&calibration, &[pair("0007", other, Lighting::default(), None)]).unwrap_err();
        assert!(
            refused.starts_with("pair 0007 does not fit the flash calibration") && refused.contains(what),
            "{refused}"
        );
    }
}

#[test]
fn another_polariser_is_refused_by_presence_and_by_angle() {
    let at = |lighting| pair("0007", settings(), lighting, None);
    let (with, without) = (calibrated(through(Some(30.0)), None), calibrated(Lighting::default(), None));
    assert_eq!(
        judged(&with, &[at(through(Some(30.0))), at(through(Some(-150.0))), at(through(None))]),
        Ok(vec![])
    );
    for (calibration, lighting, what) in [
        (&with, through(Some(120.0)), "\"at 120 degrees\""),
        (&with, Lighting::default(), "polariser is \"none\""),
        (&without, through(None), "calibration is \"none\""),
    ] {
        let refused = judged(calibration, &[at(lighting)]).unwrap_err();
        assert!(refused.contains("polariser") && refused.contains(what), "{refused}");
    }
}

#[test]
fn another_power_of_the_flash_is_scaled_where_energies_are_measured_and_else_refused() {
    let at = |power: f64, energy| pair("0007", settings(), at_power(power), energy);
    let measured = calibrated(at_power(0.25), Some(1e5));
    assert_eq!(judged(&measured, &[at(0.25, Some(1.01e5)), at(0.25, None)]), Ok(vec![]));
    let scaled = judged(&measured, &[at(0.5, Some(2e5))]).unwrap();
    assert!(
        scaled.len() == 1 && scaled[0].starts_with("Scaled, pair 0007: the flash stood at 0.5"),
        "{scaled:?}"
    );
    for (calibration, energy) in [(&measured, None), (&calibrated(at_power(0.25), None), Some(2e5))] {
        let refused = judged(calibration, &[at(0.5, energy)]).unwrap_err();
        assert!(refused.contains("at 0.5 of its full power") && refused.contains("--one-shot"), "{refused}");
    }
    // Nobody told the power, but the photodiode did.
    let untold = calibrated(Lighting::default(), Some(1e5));
    let scaled = judged(&untold, &[pair("0007", settings(), Lighting::default(), Some(5e4))]).unwrap();
    assert!(scaled[0].contains("scaled by the energies"), "{scaled:?}");
}

#[test]
fn another_iso_or_aperture_is_scaled_aloud_and_one_not_told_refused() {
    let calibration = calibrated(Lighting::default(), None);
    let at = |name: &str, settings| pair(name, settings, Lighting::default(), None);
    let faster = Settings { iso: Some(Iso(200.0)), ..settings() };
    let names = ["1", "2", "3", "4", "5", "6"];
    let scaled = judged(&calibration, &names.map(|name| at(name, faster.clone()))).unwrap();
    assert_eq!(
        scaled,
        [
            "Scaled, pairs 1, 2, 3, 4 and 2 more: shot at f/11, ISO 200, the flash was calibrated at f/11, ISO 100: its light is \
          taken to be 2.000 times as much, by the nominal steps."
        ]
    );
    let wider = Settings { aperture: Some(FNumber(8.0)), ..settings() };
    let scaled = judged(&calibration, &[at("1", wider)]).unwrap();
    assert!(scaled[0].contains("2.000 times") && scaled[0].contains("; vignetting is taken"), "{scaled:?}");
    let untold = Settings { iso: None, ..settings() };
    assert!(judged(&calibration, &[at("1", untold)]).unwrap_err().contains("ISO"));
}

#[test]
fn a_calibration_that_is_bad_by_its_own_verdict_is_said_to_be() {
    let mut record = calibrated(Lighting::default(), None);
    assert_eq!(doubt(&record), None);
    record.verdict = Verdict { good: false, sentences: vec!["One distance only.".into()] };
    assert!(doubt(&record).unwrap().ends_with(": One distance only."));
}
