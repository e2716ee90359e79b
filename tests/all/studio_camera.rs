//! The simulated camera on the network against the unmodified libgphoto2, by its own command line: every setting and
//! every fault as a program that we did not write meets it.

use crate::gphoto_cli::{Cli, JPEG, SIZE, blob, start};
use std::collections::BTreeMap;
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};
use unlit::studio::camera::{BodyOptions, CameraServer, Drive, Fault, Files, Focus, Late, Mode};
use unlit::units::Seconds;

#[test]
fn every_setting_of_the_lock_is_told_with_its_choices() {
    let (_, server) = start(&BodyOptions::default());
    let text = Cli::network(&server).run(&["--list-all-config"]).text;
    let mut told = BTreeMap::new();
    for entry in text.split("END\n") {
        let mut lines = entry.lines();
        let Some(name) = lines.next().and_then(|path| path.rsplit('/').next()) else { continue };
        let current = lines.clone().find_map(|l| l.strip_prefix("Current: ")).unwrap_or_default();
        let choices: Vec<&str> =
            lines.filter_map(|l| l.strip_prefix("Choice: ")?.split_once(' ').map(|c| c.1)).collect();
        told.insert(name, (current, choices));
    }
    for (name, current, choice) in [
        ("autoexposuremode", "Manual", "AV"),
        ("autoexposuremodedial", "Manual", "AV"),
        ("drivemode", "Single", "Continuous high speed"),
        ("focusmode", "Manual", "Manual"),
        ("whitebalance", "Daylight", "Auto"),
        ("imageformat", "RAW", "RAW + Large Fine JPEG"),
        ("autopoweroff", "0", "60"),
        ("highisonr", "Off", "High"),
        ("aeb", "off", "+/- 1"),
        ("alomode", "x3", "x1"),
        ("capturetarget", "Internal RAM", "Memory card"),
        ("shutterspeed", "1/125", "1/60"),
        ("aperture", "11", "5.6"),
        ("iso", "100", "Auto"),
    ] {
        let (shown, choices) = told.get(name).unwrap_or_else(|| panic!("{name} is not told:\n{text}"));
        assert_eq!(*shown, current, "{name}");
        assert!(choices.contains(&choice), "{name} offers {choices:?}");
    }
    for (name, current) in [
        ("batterylevel", "100%"),
        ("availableshots", "99"),
        ("eosserialnumber", "000000000042"),
        ("lensname", "EF100mm f/2.8L Macro IS USM"),
        ("cameramodel", "Canon EOS 5DS"),
    ] {
        assert_eq!(told.get(name).map(|t| t.0), Some(current), "{name}");
    }
}

#[test]
fn a_body_may_stand_as_a_photographer_left_it() {
    let (_, server) = start(&BodyOptions {
        mode: Mode::Aperture,
        focus: Focus::OneShot,
        drive: Drive::Continuous,
        files: Files::RawAndJpeg,
        white_balance: 0,
        auto_power_off: 60,
        noise_reduction: 3,
        lighting_optimizer: 0,
        bracketing: 8,
        serial: "000000000077".into(),
        ..BodyOptions::default()
    });
    let cli = Cli::network(&server);
    for (name, shown) in [
        ("autoexposuremode", "AV"),
        ("focusmode", "One Shot"),
        ("drivemode", "Continuous high speed"),
        ("imageformat", "RAW + Large Fine JPEG"),
        ("whitebalance", "Auto"),
        ("autopoweroff", "60"),
        ("highisonr", "High"),
        ("aeb", "+/- 1"),
        ("eosserialnumber", "000000000077"),
    ] {
        assert_eq!(cli.setting(name), shown, "{name}");
    }
}

#[test]
fn settings_are_set_by_the_computer_and_switches_by_hand() {
    let (_, server) = start(&BodyOptions::default());
    let cli = Cli::network(&server);
    for (set, name, shown) in [
        ("drivemode=1", "drivemode", "Continuous high speed"),
        ("whitebalance=Flash", "whitebalance", "Flash"),
        ("imageformat=RAW + Large Fine JPEG", "imageformat", "RAW + Large Fine JPEG"),
        ("autopoweroff=60", "autopoweroff", "60"),
        ("highisonr=Low", "highisonr", "Low"),
    ] {
        cli.run(&["--set-config", set]);
        assert_eq!(cli.setting(name), shown, "after {set}");
    }
    cli.run(&["--set-config", "autoexposuremode=AV"]);
    assert_eq!(cli.setting("autoexposuremode"), "Manual", "the dial is turned by hand alone");
    server.turn_mode_dial(Mode::Aperture);
    server.switch_focus(Focus::OneShot);
    assert_eq!(cli.setting("autoexposuremode"), "AV");
    assert_eq!(cli.setting("focusmode"), "One Shot");
}

#[test]
fn a_frame_becomes_the_files_that_the_image_format_says_in_either_order() {
    for (files, jpeg_first, names) in [
        (Files::Raw, false, vec!["capt0000.cr2"]),
        (Files::RawAndJpeg, false, vec!["capt0000.cr2", "capt0001.jpg"]),
        (Files::RawAndJpeg, true, vec!["capt0000.jpg", "capt0001.cr2"]),
        (Files::Jpeg, false, vec!["capt0000.jpg"]),
    ] {
        let (view, server) = start(&BodyOptions { files, jpeg_first, ..BodyOptions::default() });
        let run = Cli::network(&server).run(&["--capture-image-and-download", "--wait-event=500ms"]);
        assert_eq!(run.files.keys().collect::<Vec<_>>(), names, "{}", run.text);
        for (name, bytes) in &run.files {
            let wanted = if name.ends_with("jpg") { JPEG.to_vec() } else { blob(SIZE, 0) };
            assert!(*bytes == wanted, "{name}");
        }
        assert_eq!((view.frames.load(Ordering::SeqCst), server.frames_waiting()), (1, 0));
    }
}

#[test]
fn a_card_keeps_its_files_and_is_full_until_one_is_deleted() {
    let (_, server) = start(&BodyOptions { card_room: Some(2), ..BodyOptions::default() });
    let cli = Cli::network(&server);
    let keep = &["--set-config", "capturetarget=1", "--keep", "--capture-image-and-download"];
    let run = cli.run(keep);
    assert!(run.file() == blob(SIZE, 0), "{}", run.text);
    assert_eq!(run.files.keys().next().unwrap(), "IMG_0001.CR2");
    assert!(cli.run(keep).file() == blob(SIZE, 1));
    assert_eq!((server.files_on_card(), server.frames_waiting()), (2, 0));
    let run = cli.run(keep);
    assert!(run.text.contains("0x200c: PTP Store Full"), "{}", run.text);
    let listed = cli.run(&["--list-files"]).text;
    assert!(listed.contains("There are 2 files in folder '/store_00010001/DCIM/100CANON'"), "{listed}");
    cli.run(&["--folder", "/store_00010001/DCIM/100CANON", "--delete-file", "IMG_0001.CR2"]);
    assert_eq!(server.files_on_card(), 1);
    assert!(cli.run(keep).file() == blob(SIZE, 2));
}

#[test]
fn refused_releases_say_what_the_body_said() {
    for (fault, said) in [
        (Fault::BusyOnce, "Canon EOS Full-Press failed (0x2019: PTP Device Busy)"),
        (
            Fault::FocusHunt(Duration::from_millis(300)),
            "Canon EOS Full-Press failed (0x2019: PTP Device Busy)",
        ),
        (Fault::NoFocus, "Canon EOS Full-Press failed (0x2002: PTP General Error)"),
        (Fault::LowBattery, "Canon EOS Full-Press failed (0x2002: PTP General Error)"),
    ] {
        let (view, server) = start(&BodyOptions::default());
        let cli = Cli::network(&server);
        server.fault(fault);
        let run = cli.shoot();
        assert!(run.text.contains(said), "{fault:?}: {}", run.text);
        assert_eq!((view.frames.load(Ordering::SeqCst), server.releases()), (0, 1), "{fault:?}");
        assert_eq!(server.struck(), [fault]);
        server.mend();
        assert!(cli.shoot().file() == blob(SIZE, 0), "{fault:?} is over");
    }
}

#[test]
fn a_full_card_and_an_empty_slot_refuse_the_release() {
    let (_, server) = start(&BodyOptions { card_room: Some(9), ..BodyOptions::default() });
    server.fault(Fault::CardFull);
    let to_card = &["--set-config", "capturetarget=1", "--capture-image"];
    let run = Cli::network(&server).run(to_card);
    assert!(run.text.contains("0x200c: PTP Store Full"), "{}", run.text);
    let (_, server) = start(&BodyOptions::default());
    let run = Cli::network(&server).run(to_card);
    assert!(run.text.contains("0x2013: PTP Store Not Available"), "{}", run.text);
}

#[test]
fn a_low_battery_shows_until_it_is_mended() {
    let (_, server) = start(&BodyOptions::default());
    let cli = Cli::network(&server);
    server.fault(Fault::LowBattery);
    assert_eq!(cli.setting("batterylevel"), "Low");
    server.mend();
    assert_eq!(cli.setting("batterylevel"), "100%");
}

#[test]
fn an_ignored_set_shows_the_old_value() {
    let (_, server) = start(&BodyOptions::default());
    let cli = Cli::network(&server);
    server.fault(Fault::SetIgnored);
    let run = cli.run(&["--set-config", "iso=400"]);
    assert_eq!(run.code, Some(0), "the library is told that it worked: {}", run.text);
    assert_eq!(cli.setting("iso"), "100");
    cli.run(&["--set-config", "iso=400"]);
    assert_eq!(cli.setting("iso"), "400");
    assert_eq!(server.struck(), [Fault::SetIgnored]);
}

#[test]
fn spoilt_frames_come_as_they_are_spoilt() {
    let (view, server) = start(&BodyOptions::default());
    let cli = Cli::network(&server);
    server.fault(Fault::ShortFile { missing: 1000 });
    assert!(cli.shoot().file() == &blob(SIZE, 0)[..SIZE as usize - 1000]);
    server.fault(Fault::RepeatedFrame);
    assert!(cli.shoot().file() == blob(SIZE, 0), "the frame before, whole");
    server.fault(Fault::WrongExif);
    assert!(cli.shoot().file() == blob(SIZE, 2));
    let shutters: Vec<Seconds> = view.exposures.lock().unwrap().iter().map(|e| e.shutter).collect();
    assert_eq!(shutters, [125.0, 125.0, 60.0].map(|n| Seconds(1.0 / n)), "a stop slower than the dial");
    for fault in [Fault::CutObject { missing: 1000 }, Fault::CutDownload { missing: 1000 }] {
        server.fault(fault);
        let run = cli.shoot();
        assert!(
            run.files.is_empty() && run.text.contains("PTP Invalid Parameter"),
            "{fault:?}: {}",
            run.text
        );
    }
    assert_eq!(server.struck().len(), 5);
}

#[test]
fn a_doubled_announcement_leads_to_an_object_that_is_gone() {
    let (_, server) = start(&BodyOptions::default());
    server.fault(Fault::DoubledObject);
    let run = Cli::network(&server).run(&["--capture-image-and-download", "--wait-event=500ms"]);
    assert!(run.text.contains("PTP Invalid Object Handle"), "{}", run.text);
    assert!(run.files.values().any(|f| *f == blob(SIZE, 0)));
    assert_eq!(server.frames_waiting(), 0);
}

/// Starts a shot that never ends by itself, and kills it once the fault has struck and `lasts` has passed.
fn abandon(server: &CameraServer, cli: &Cli, lasts: Duration) {
    let mut child = cli.start(&["--set-config", "capturetarget=0", "--capture-image-and-download"]);
    let deadline = Instant::now() + Duration::from_secs(20);
    while server.struck().is_empty() {
        assert!(Instant::now() < deadline, "the fault never struck");
        std::thread::sleep(Duration::from_millis(20));
    }
    let until = Instant::now() + lasts;
    while Instant::now() < until {
        let ended = child.try_wait().unwrap();
        assert!(ended.is_none(), "the library should wait for ever, but ended: {ended:?}");
        std::thread::sleep(Duration::from_millis(20));
    }
    child.kill().unwrap();
    child.wait().unwrap();
}

#[test]
fn a_frame_that_is_never_announced_is_waited_for() {
    let (view, server) = start(&BodyOptions::default());
    let cli = Cli::network(&server);
    server.fault(Fault::NeverAnnounced);
    abandon(&server, &cli, Duration::from_secs(1));
    assert_eq!(view.frames.load(Ordering::SeqCst), 1);
    assert!(cli.shoot().file() == blob(SIZE, 1));
}

#[test]
fn a_late_frame_passes_for_the_next_one_with_a_driver_that_does_not_look() {
    let (_, server) = start(&BodyOptions::default());
    let cli = Cli::network(&server);
    server.fault(Fault::LateObject(Late::NextRelease));
    abandon(&server, &cli, Duration::from_secs(1));
    assert_eq!(server.frames_waiting(), 1);
    let run = cli.run(&["--capture-image-and-download", "--wait-event=500ms"]);
    assert!(run.files["capt0000.cr2"] == blob(SIZE, 0), "the frame of the shot that was given up");
    assert!(run.files["capt0001.cr2"] == blob(SIZE, 1));
    assert_eq!(server.frames_waiting(), 0);
}

#[test]
fn a_late_frame_is_there_to_be_drained_when_the_next_client_connects() {
    let (_, server) = start(&BodyOptions::default());
    let cli = Cli::network(&server);
    server.fault(Fault::LateObject(Late::NextClient));
    abandon(&server, &cli, Duration::from_secs(1));
    let run = cli.run(&["--wait-event-and-download=1s"]);
    assert!(run.file() == blob(SIZE, 0), "{}", run.text);
    assert_eq!(server.frames_waiting(), 0);
}

#[test]
fn a_shutter_in_real_time_is_waited_for() {
    let (_, server) = start(&BodyOptions { real_shutter: true, ..BodyOptions::default() });
    let run = Cli::network(&server).run(&["--set-config", "shutterspeed=2", "--capture-image-and-download"]);
    assert!(run.file() == blob(SIZE, 0) && run.took > Duration::from_secs(2), "{:?}", run.took);
}

#[test]
fn a_late_frame_comes_after_its_time() {
    let (_, server) = start(&BodyOptions::default());
    server.fault(Fault::LateObject(Late::After(Duration::from_secs(1))));
    let run = Cli::network(&server).shoot();
    assert!(run.file() == blob(SIZE, 0) && run.took > Duration::from_secs(1), "{:?}", run.took);
}

#[test]
fn two_faults_keep_the_library_asking_for_ever() {
    for fault in [Fault::NoRoom, Fault::HollowObject { missing: 1000 }] {
        let (_, server) = start(&BodyOptions::default());
        let cli = Cli::network(&server);
        server.fault(fault);
        let before = server.operations();
        abandon(&server, &cli, Duration::from_secs(2));
        let asked = server.operations() - before;
        assert!(asked > 500, "{fault:?}: only {asked} questions");
        server.mend();
        assert_eq!(cli.shoot().files.len(), 1, "{fault:?} is over");
    }
}

#[test]
fn a_slow_body_refuses_a_second_release() {
    let (view, server) = start(&BodyOptions::default());
    server.fault(Fault::SlowReady(Duration::from_secs(30)));
    let run = Cli::network(&server).run(&["--capture-image", "--capture-image"]);
    assert!(run.text.contains("I/O in progress") || run.text.contains("Device Busy"), "{}", run.text);
    assert_eq!(view.frames.load(Ordering::SeqCst), 1);
}

#[test]
fn a_scripted_fault_strikes_at_its_operation() {
    let (_, server) = start(&BodyOptions::default());
    let cli = Cli::network(&server);
    assert!(cli.shoot().file() == blob(SIZE, 0));
    server.script([(server.operations() + 3, Fault::StallOnce), (server.operations() + 1, Fault::BusyOnce)]);
    let run = cli.shoot();
    assert!(run.took > Duration::from_secs(2), "one question was never answered: {:?}", run.took);
    assert_eq!(server.struck(), [Fault::StallOnce, Fault::BusyOnce]);
    assert!(cli.shoot().file() == blob(SIZE, 1));
}

#[test]
fn an_unplugged_network_camera_refuses_and_comes_back_under_another_port() {
    let (_, server) = start(&BodyOptions::default());
    let port = server.port();
    let cli = Cli::network(&server);
    server.unplug();
    let run = cli.shoot();
    assert!(run.files.is_empty() && !server.plugged(), "{}", run.text);
    server.replug().unwrap();
    assert_ne!(server.port(), port);
    assert!(Cli::network(&server).shoot().file() == blob(SIZE, 0));
}
