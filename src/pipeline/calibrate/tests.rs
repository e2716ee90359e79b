use super::*;
use serde_json::json;

#[test]
fn what_cannot_be_compared_with_the_body_of_the_photos_is_said() {
    let folder = tempfile::tempdir().unwrap();
    let session = Session::create(&folder.path().join("s"), "s").unwrap();
    let keep = |kind: &str, rig: serde_json::Value| {
        let record = json!({
            "schema": SCHEMA, "measured": "2026-11-23T10:00:00Z", "software": "", "shots": [], "rig": rig,
            "verdict": { "good": true, "sentences": [] }, "a figure": 1,
        });
        session.keep(&file(&session, kind), record.to_string().as_bytes()).unwrap();
    };
    let pair = |name: &str, settings: serde_json::Value| -> PairRecord {
        let frame =
            json!({ "file": "f", "original_name": "f", "bytes": 1, "blake3": "00", "settings": settings });
        let told = json!({
            "number": 1, "name": name, "verdict": "accepted", "reasons": [], "off": frame, "on": frame,
        });
        serde_json::from_value(told).unwrap()
    };
    let pairs = [pair("vase", json!({ "model": "A" })), pair("bowl", json!({})), pair("cup", json!({}))];
    let said = |pairs: &[PairRecord]| unchecked(&session, &pairs.iter().collect::<Vec<_>>()).unwrap();
    assert!(said(&pairs).is_empty(), "there is no calibration");
    for kind in ["levels", "noise", "exposure", "flash"] {
        keep(kind, json!({ "model": "A" }));
    }
    assert!(said(&pairs[..1]).is_empty());
    let of_silent_pairs = said(&pairs);
    assert_eq!(of_silent_pairs.len(), 2, "{of_silent_pairs:?}");
    assert!(
        of_silent_pairs[1].contains("flash.json") && of_silent_pairs[1].contains("BODY THAT TOOK bowl, cup")
    );
    keep("levels", json!({}));
    keep("flash", json!({ "serial": "17" }));
    let of_silent_records = said(&pairs[..1]);
    assert_eq!(of_silent_records.len(), 2, "{of_silent_records:?}");
    assert!(of_silent_records[0].starts_with("calibration/levels.json IS NOT USED"));
    assert!(of_silent_records[1].contains("BODY calibration/flash.json IS"));
}

#[test]
fn a_cancelled_calibration_leaves_nothing_that_was_to_be_kept_beside_it() {
    let folder = tempfile::tempdir().unwrap();
    let session = Session::create(&folder.path().join("s"), "s").unwrap();
    let mut series = Series::new(&session, "flash").unwrap();
    series.beside("flash_12345678.json".into(), b"{}".to_vec());
    let progress = Progress::silent();
    progress.cancel();
    let points = chart::Series { name: String::new(), points: vec![(0.0, 1.0, 0.0), (1.0, 2.0, 0.0)] };
    let (caption, across, up) = Default::default();
    let figure = Chart { caption, across, up, series: vec![points] };
    let verdict = Verdict { good: true, sentences: vec![] };
    let kept = series.keep(json!({}), verdict, &figure, &progress);
    assert!(matches!(kept, Err(SeriesError::Cancelled(_))));
    assert!(!session.calibration_dir().join("flash_12345678.json").exists());
}
