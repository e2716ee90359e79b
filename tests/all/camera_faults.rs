//! Every fault of the camera, through the real library: what the operator sees, how long until the rig is usable
//! again, and that no frame is lost, doubled or taken for another. `docs/camera-faults.md` is generated from the
//! table that is proved here.

use crate::camera::{Studio, blob, launch, open};
use std::fmt::Write;
use std::time::{Duration, Instant};
use unlit::rig::camera::{Deadlines, HostedCamera, Target};
use unlit::rig::{Camera, CameraError, Shot};
use unlit::studio::camera::{BodyOptions, Fault, Files, Late};

/// One fault and what it may cost.
struct Row {
    what: &'static str,
    fault: Fault,
    /// Codes that the shot may fail with; none: the operator sees nothing.
    codes: &'static [&'static str],
    /// Seconds until a new frame is in, the fault's own time included.
    usable_within: u64,
}

const fn row(what: &'static str, fault: Fault, codes: &'static [&'static str], usable_within: u64) -> Row {
    Row { what, fault, codes, usable_within }
}

/// A frame cut in the camera's memory: the library tells it in one way or the other.
const CUT: &[&str] = &["camera_lost", "camera_refused", "camera_frame_incomplete"];
const HOLLOW: Fault = Fault::HollowObject { missing: 4096 };

const ROWS: &[Row] = &[
    row("release answered \"busy\" once", Fault::BusyOnce, &[], 3),
    row("release answered \"busy\" four times", Fault::BusyFor(4), &[], 4),
    row("lens hunts for a second and finds no focus", Fault::FocusHunt(Duration::from_secs(1)), &[], 4),
    row("release refused, lens finds no focus", Fault::NoFocus, &["camera_no_focus", "camera_refused"], 3),
    row("frame exposed, never announced", Fault::NeverAnnounced, &["camera_deadline"], 18),
    row("frame announced to the next host", Fault::LateObject(Late::NextClient), &["camera_deadline"], 18),
    row(
        "frame announced seconds after its shot was given up",
        Fault::LateObject(Late::After(Duration::from_secs(12))),
        &["camera_deadline", "camera_frame_untrusted"],
        20,
    ),
    row(
        "frame announced with the next release, as if it were the new one",
        Fault::LateObject(Late::NextRelease),
        &["camera_deadline", "camera_frame_untrusted"],
        22,
    ),
    row("frame announced twice", Fault::DoubledObject, &[], 3),
    row("frame shorter than announced", Fault::CutObject { missing: 4096 }, CUT, 10),
    row("frame shorter than announced, library asks for the rest for ever", HOLLOW, &["camera_deadline"], 18),
    row("download cut short", Fault::CutDownload { missing: 4096 }, CUT, 10),
    row("link lost in the download", Fault::DropInDownload, &["camera_lost"], 10),
    row("one operation never answered", Fault::StallOnce, &[], 8),
    row("frame of the release before once more", Fault::RepeatedFrame, &["camera_frame_untrusted"], 3),
    row("body busy for 1.5 s after the frame", Fault::SlowReady(Duration::from_millis(1500)), &[], 4),
];

/// Faults that need another bench than a camera and its driver: what, what is seen, how long, and the test that proves it.
const ELSEWHERE: &[[&str; 4]] = &[
    [
        "no room for frames, library asks for ever without a pause",
        "`camera_deadline`",
        "the loop is ended within the deadline + 2 s; once there is room, as opening anew",
        "camera_faults::an_endless_loop_in_the_library_is_ended_at_the_deadline_and_the_camera_comes_back",
    ],
    [
        "every operation stalls, USB",
        "`camera_deadline` after 10 s",
        "once it answers again: opening anew",
        "camera_usb::a_stall_of_twenty_seconds_ends_at_our_deadline_and_the_camera_comes_back",
    ],
    [
        "unplugged",
        "`camera_lost`, then `camera_stuck` or `camera_unplugged`, with what to do",
        "once it is plugged in: opening anew",
        "camera_faults::an_unplugged_camera_asks_for_hands_in_words",
    ],
    [
        "plugged in again under another address, beside another body of its model",
        "nothing more",
        "found by its serial number at the next try",
        "camera_usb::a_camera_unplugged_and_plugged_in_again_is_found_at_its_new_address_by_its_serial_number",
    ],
    [
        "plug pulled in a download",
        "`camera_lost`",
        "once it is plugged in: opening anew",
        "camera_usb::a_plug_pulled_in_the_middle_of_a_download_costs_that_frame_alone",
    ],
    [
        "camera host killed",
        "nothing",
        "opening anew",
        "camera::a_killed_host_is_started_again_by_the_next_shot",
    ],
    [
        "battery low",
        "`camera_battery_low`",
        "once it is charged",
        "camera_faults::a_low_battery_is_told_by_its_name",
    ],
    [
        "card full",
        "`camera_card_full`",
        "once there is room",
        "camera_faults::a_full_card_is_told_by_its_name",
    ],
    [
        "a set silently ignored",
        "`camera_refused`",
        "at once",
        "camera_faults::a_dial_that_does_not_obey_is_an_error",
    ],
    [
        "autofocus on",
        "`camera_not_locked`: pairs are refused before the first release",
        "once the switch stands at MF",
        "real_rig::autofocus_refuses_pairs_until_the_switch_is_moved",
    ],
    [
        "a frame shot at other settings than the dials show",
        "pair rejected: `settings_changed`",
        "the next pair",
        "real_rig::a_frame_shot_at_other_settings_than_the_dials_show_is_caught_by_its_exif",
    ],
    [
        "a file that the camera itself wrote short",
        "pair rejected: `truncated`",
        "the next pair",
        "real_rig::a_file_that_the_camera_itself_wrote_short_is_stored_as_truncated",
    ],
];

/// Shoots until a frame comes, as the capture engine does; gives it with the codes of the errors before.
fn shoot_through(camera: &mut HostedCamera) -> (Shot, Vec<&'static str>) {
    let mut codes = Vec::new();
    for _ in 0..4 {
        match camera.shoot() {
            Ok(shot) => return (shot, codes),
            Err(error) => {
                eprintln!("  {error}");
                codes.push(error.code());
                match camera.recover() {
                    Ok(steps) => eprintln!("  recovered: {}", steps.join(", ")),
                    Err(error) => eprintln!("  {error}"),
                }
            }
        }
    }
    panic!("no frame after {codes:?}");
}

/// Strikes once between two good frames; gives how long it took until a new frame was in.
fn prove(row: &Row) -> Duration {
    let studio = Studio::new();
    let mut camera = studio.camera();
    assert!(camera.shoot().unwrap().raw.bytes == blob(0), "{}", row.what);
    studio.server.fault(row.fault);
    let began = Instant::now();
    let (shot, codes) = shoot_through(&mut camera);
    let took = began.elapsed();
    eprintln!("{}: {codes:?}, usable after {took:.1?}", row.what);
    assert!(!studio.server.struck().is_empty(), "{} never struck", row.what);
    assert!(codes.iter().all(|code| row.codes.contains(code)), "{}: {codes:?}", row.what);
    assert_eq!(codes.is_empty(), row.codes.is_empty(), "{}: {codes:?}", row.what);
    assert!(took < Duration::from_secs(row.usable_within), "{} took {took:?}", row.what);
    let last = blob(studio.frames() - 1);
    assert!(shot.raw.bytes == last, "{}: not the frame of the last release", row.what);
    for _ in 0..2 {
        let shot = camera.shoot().unwrap();
        assert!(shot.raw.bytes == blob(studio.frames() - 1), "{}: a later frame is another's", row.what);
        assert_eq!(studio.server.frames_waiting(), 0, "{}: the camera's memory fills up", row.what);
    }
    took
}

fn document() -> String {
    let mut text = String::from(
        "# Faults of the camera\n\nGenerated by `cargo test --test all camera_faults`, which proves each row through the \
         real libgphoto2 against the simulated\ncamera, with the deadlines that the product uses. A frame counts as \
         acknowledged when the shot returned it.\n\n| fault | what the operator sees | a new frame is in within | \
         acknowledged frames lost |\n|---|---|---|---|\n",
    );
    for Row { what, codes, usable_within, .. } in ROWS {
        let seen = match codes {
            [] => "nothing".to_owned(),
            codes => codes.iter().map(|code| format!("`{code}`")).collect::<Vec<_>>().join(" or "),
        };
        writeln!(text, "| {what} | {seen} | {usable_within} s | 0 |").unwrap();
    }
    text += "\nProved on other benches, each by the test named:\n\n| fault | what the operator sees | usable again | \
             acknowledged frames lost | test |\n|---|---|---|---|---|\n";
    for [what, seen, usable, test] in ELSEWHERE {
        writeln!(text, "| {what} | {seen} | {usable} | 0 | `{test}` |").unwrap();
    }
    text
}

#[test]
fn no_fault_costs_an_acknowledged_frame_and_each_is_over_in_time() {
    std::thread::scope(|scope| {
        let proofs: Vec<_> = ROWS.iter().map(|row| (row, scope.spawn(move || prove(row)))).collect();
        let failed: Vec<&str> =
            proofs.into_iter().filter_map(|(row, proof)| proof.join().is_err().then_some(row.what)).collect();
        assert!(failed.is_empty(), "not as the table says: {failed:?}");
    });
}

#[test]
fn the_table_in_the_docs_is_the_one_that_is_proved() {
    let file = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("docs/camera-faults.md");
    let text = document();
    if std::env::var_os("UNLIT_UPDATE").is_some() {
        std::fs::write(&file, &text).unwrap();
    }
    let found = std::fs::read_to_string(&file).unwrap_or_default();
    for [.., test] in ELSEWHERE {
        let (module, name) = test.split_once("::").unwrap();
        let source = file.parent().unwrap().join(format!("../tests/all/{module}.rs"));
        let source = std::fs::read_to_string(&source).unwrap();
        assert!(source.contains(&format!("#[test]\nfn {name}()")), "there is no test {test}");
    }
    assert!(found == text, "run UNLIT_UPDATE=1 cargo test --test all camera_faults::the_table");
}

#[test]
fn an_endless_loop_in_the_library_is_ended_at_the_deadline_and_the_camera_comes_back() {
    let studio = Studio::new();
    let mut camera = studio.camera();
    // The loop runs when the library prepares a fresh connection.
    studio.server.fault(Fault::NoRoom);
    let short = Deadlines { open: Duration::from_secs(3), ..Deadlines::default() };
    let began = Instant::now();
    let error = open(&studio.server.port(), short).err().unwrap();
    assert!(matches!(error, CameraError::Deadline { .. }), "{error}");
    assert!(began.elapsed() < short.open + Duration::from_secs(2), "took {:?}", began.elapsed());
    studio.server.mend();
    shoot_through(&mut camera);
}

#[test]
fn a_dial_that_does_not_obey_is_an_error() {
    let studio = Studio::new();
    let mut camera = studio.camera();
    studio.server.fault(Fault::SetIgnored);
    let shutter = unlit::units::Seconds(1.0 / 60.0);
    let error = camera.set(unlit::pair::Dial::Shutter(shutter)).unwrap_err();
    assert!(matches!(error, CameraError::Refused { .. }), "{error}");
    camera.set(unlit::pair::Dial::Shutter(shutter)).unwrap();
}

#[test]
fn a_low_battery_is_told_by_its_name() {
    let studio = Studio::new();
    let mut camera = studio.camera();
    studio.server.fault(Fault::LowBattery);
    let error = camera.shoot().unwrap_err();
    assert!(matches!(error, CameraError::BatteryLow(_)), "{error}");
    studio.server.mend();
    assert!(camera.shoot().unwrap().raw.bytes == blob(0), "the camera stays open");
}

#[test]
fn a_full_card_is_told_by_its_name() {
    let studio = Studio::new();
    let port = studio.server.port();
    let mut camera =
        HostedCamera::open_with(&launch(), Some(&port), Deadlines::default(), Target::Card).unwrap();
    studio.server.fault(Fault::CardFull);
    let error = camera.shoot().unwrap_err();
    assert!(matches!(error, CameraError::CardFull(_)), "{error}");
}

#[test]
fn an_unplugged_camera_asks_for_hands_in_words() {
    let studio = Studio::new();
    let mut camera = studio.camera();
    studio.server.unplug();
    let error = camera.shoot().unwrap_err();
    assert!(error.may_pass(), "{error}");
    let error = camera.recover().unwrap_err();
    assert!(matches!(error, CameraError::Stuck { .. }), "{error}");
    assert!(error.to_string().contains("switch it off and on"), "{error}");
}

#[test]
fn late_files_of_raw_and_jpeg_are_never_mixed_with_those_of_the_next_release() {
    for jpeg_first in [false, true] {
        for late in [Late::NextClient, Late::NextRelease, Late::After(Duration::from_secs(12))] {
            let options = BodyOptions { files: Files::RawAndJpeg, jpeg_first, ..BodyOptions::default() };
            let studio = Studio::with(&options);
            let mut camera = studio.camera();
            camera.shoot().unwrap();
            studio.server.fault(Fault::LateObject(late));
            for _ in 0..3 {
                let (shot, codes) = shoot_through(&mut camera);
                eprintln!("jpeg first {jpeg_first}, {late:?}: {codes:?}");
                let last = blob(studio.frames() - 1);
                assert!(shot.raw.bytes == last, "{late:?}: the raw is of another release");
                assert!(shot.jpeg.is_some(), "{late:?}: a release makes two files");
            }
            assert_eq!(studio.server.frames_waiting(), 0);
        }
    }
}

#[test]
fn live_view_of_a_lost_camera_fails_at_once_and_recovering_brings_it_back() {
    let studio = Studio::new();
    let short = Deadlines { other: Duration::from_secs(1), ..Deadlines::default() };
    let mut camera = studio.camera_with(short);
    studio.server.fault(Fault::Stall);
    camera.preview().unwrap_err();
    assert_eq!(camera.host_id(), None);
    let began = Instant::now();
    let error = camera.preview().unwrap_err();
    assert!(matches!(error, CameraError::Lost { .. }), "{error}");
    assert!(began.elapsed() < Duration::from_millis(200), "took {:?}", began.elapsed());
    assert_eq!(camera.host_id(), None, "no host was started for it");
    studio.server.mend();
    camera.recover().unwrap();
    camera.preview().unwrap();
}
