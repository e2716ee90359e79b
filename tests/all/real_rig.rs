//! Pairs through everything that is real: the engine, libgphoto2 in its host, the serial driver on a pty, the firmware's
//! core; only the body is simulated, and misbehaves.

use crate::camera::{program, rig};
use crate::wall::{Exposures, Wall};
use serde_json::json;
use std::sync::Arc;
use std::time::Duration;
use tempfile::TempDir;
use unlit::capture::{CaptureError, Engine, Events, ExposureWish};
use unlit::pair::{Limits, PairRecord, ReasonCode, Verdict};
use unlit::progress::Progress;
use unlit::session::Session;
use unlit::studio::camera::{BodyOptions, CameraServer, Fault, Files, Focus};
use unlit::studio::{Board, BoardOptions};

struct House {
    _folder: TempDir,
    session: Session,
    engine: Engine,
    server: Arc<CameraServer>,
    taken: Exposures,
}

impl House {
    fn with(body: &BodyOptions) -> Self {
        assert!(program().is_file());
        let recycle = Duration::from_millis(20);
        let board = Arc::new(Board::start(BoardOptions { recycle, ..BoardOptions::default() }).unwrap());
        let taken = Exposures::default();
        let view = Arc::new(Wall { flash: board.clone(), taken: taken.clone() });
        let server = Arc::new(CameraServer::start_with(view, body).unwrap());
        let rig = rig(server.port(), board.device(), Duration::from_secs(4));
        let folder = tempfile::tempdir().unwrap();
        let session = Session::create(&folder.path().join("wall"), "wall").unwrap();
        let engine = Engine::new(rig, Limits::default(), Events::default());
        Self { _folder: folder, session, engine, server, taken }
    }

    fn pair(&self) -> Result<PairRecord, CaptureError> {
        self.engine.shoot_pair(&self.session, None, &Progress::silent())
    }

    /// Numbers of the exposures that a pair is made of.
    fn exposures(&self, pair: &PairRecord) -> (u32, u32) {
        let taken = self.taken.lock().unwrap();
        (taken[&pair.off.blake3].0, taken[&pair.on.blake3].0)
    }
}

fn codes(pair: &PairRecord) -> Vec<ReasonCode> {
    pair.reasons.iter().map(|r| r.code).collect()
}

#[test]
fn a_frame_shot_at_other_settings_than_the_dials_show_is_caught_by_its_exif() {
    let house = House::with(&BodyOptions::default());
    assert_eq!(house.pair().unwrap().verdict, Verdict::Accepted);
    house.server.fault(Fault::WrongExif);
    let pair = house.pair().unwrap();
    assert!(codes(&pair).contains(&ReasonCode::SettingsChanged), "{:?}", pair.reasons);
    assert_eq!(house.pair().unwrap().verdict, Verdict::Accepted);
}

#[test]
fn a_file_that_the_camera_itself_wrote_short_is_stored_as_truncated() {
    let house = House::with(&BodyOptions::default());
    house.server.fault(Fault::ShortFile { missing: 5000 });
    let pair = house.pair().unwrap();
    assert_eq!(codes(&pair), [ReasonCode::Truncated], "{:?}", pair.reasons);
    assert!(house.session.verify_pair(pair.number).is_empty());
}

#[test]
fn a_camera_that_falls_silent_in_the_middle_costs_time_and_no_pair() {
    let house = House::with(&BodyOptions::default());
    assert_eq!(house.exposures(&house.pair().unwrap()), (0, 1));
    house.server.fault(Fault::NeverAnnounced);
    let pair = house.pair().unwrap();
    assert_eq!((pair.number, pair.verdict), (2, Verdict::Accepted), "{:?}", pair.reasons);
    let (off, on) = house.exposures(&pair);
    assert!(off > 1 && on == off + 1, "exposures {off} and {on}");
    assert_eq!(house.server.frames_waiting(), 0);
    assert_eq!(house.session.pairs().unwrap().len(), 2);
}

#[test]
fn raw_and_jpeg_of_one_release_stay_under_one_pair() {
    for jpeg_first in [false, true] {
        let house =
            House::with(&BodyOptions { files: Files::RawAndJpeg, jpeg_first, ..BodyOptions::default() });
        let pair = house.pair().unwrap();
        assert_eq!(pair.verdict, Verdict::Accepted, "{:?}", pair.reasons);
        assert_eq!(house.exposures(&pair), (0, 1));
        for frame in [&pair.off, &pair.on] {
            let jpeg = frame.jpeg.as_ref().expect("a JPEG beside the raw");
            let stored = std::fs::read(house.session.pair_dir(1).join(&jpeg.file)).unwrap();
            assert!(stored.starts_with(&[0xff, 0xd8]) && stored.len() as u64 == jpeg.bytes);
        }
        assert_eq!(
            (pair.off.jpeg.unwrap().file.as_str(), pair.on.file.ends_with(".jpg")),
            ("off.jpg", false)
        );
        assert_eq!(house.server.frames_waiting(), 0, "the camera's memory is empty");
    }
}

#[test]
fn autofocus_refuses_pairs_until_the_switch_is_moved() {
    let house = House::with(&BodyOptions { focus: Focus::OneShot, ..BodyOptions::default() });
    let error = house.pair().unwrap_err();
    assert_eq!(error.code(), "camera_not_locked", "{error}");
    house.server.switch_focus(Focus::Manual);
    assert_eq!(house.pair().unwrap().verdict, Verdict::Accepted);
}

#[test]
fn a_search_by_the_exposure_table_of_another_body_is_refused_and_leaves_the_plan() {
    let house = House::with(&BodyOptions::default());
    let table = json!({
        "schema": unlit::calibration::SCHEMA, "measured": "2026-11-23T10:00:00Z", "software": "unlit", "rig": { "model": "Fake 2" },
        "shots": [], "verdict": { "good": true, "sentences": [] }, "ladders": [],
    });
    let path = house.session.path().join("calibration/exposure.json");
    std::fs::create_dir_all(path.parent().unwrap()).unwrap();
    std::fs::write(path, table.to_string()).unwrap();
    let search = house.engine.find_exposure(&house.session, ExposureWish::default(), &Progress::silent());
    let error = search.unwrap_err();
    assert_eq!(error.code(), "exposure_table_of_another_body", "{error}");
    assert!(error.to_string().contains("\"Fake 2\"") && house.session.manifest().plan.is_none(), "{error}");
    // Pairs of one exposure need no table.
    assert_eq!(house.pair().unwrap().verdict, Verdict::Accepted);
}

#[test]
fn the_exposure_is_found_in_at_most_four_test_shots_and_the_next_pair_ends_there() {
    let house = House::with(&BodyOptions::default());
    let wish = ExposureWish { target_share: 0.8, ..ExposureWish::default() };
    let found = house.engine.find_exposure(&house.session, wish, &Progress::silent()).unwrap();
    assert!(found.shots <= 4 && house.taken.lock().unwrap().len() == found.shots, "{found:?}");
    assert!(house.session.pairs().unwrap().is_empty(), "test shots are no pairs");
    assert_eq!(house.session.manifest().plan, Some(found.plan));
    let pair = house.pair().unwrap();
    assert_eq!(pair.verdict, Verdict::Accepted, "{:?}", pair.reasons);
    assert_eq!(
        (pair.on.settings.aperture, pair.on.settings.iso),
        (Some(found.plan.on.aperture), Some(found.plan.on.iso))
    );
    let photo = unlit::codec::raw::read(&house.session.pair_dir(1).join(&pair.on.file)).unwrap();
    let mut dn: Vec<u16> = photo.mosaic.dn.pixels().to_vec();
    dn.sort_unstable();
    let top = f64::from(dn[dn.len() * 999 / 1000]);
    let share = (top - 2048.0) / (15300.0 - 2048.0);
    assert!((share / 0.8).log2().abs() < 1.0 / 3.0, "ends at {share:.3} for 0.8: {found:?}");
}
