//! The simulated camera against the unmodified libgphoto2, by its own command line: every setting and every fault as a
//! program that we did not write meets it.

use crate::usb_bench::iolibs;
use std::collections::BTreeMap;
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::sync::atomic::{AtomicU32, Ordering};
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};
use unlit::pair::Exposure;
use unlit::studio::View;
use unlit::studio::camera::{BodyOptions, CameraServer, Drive, Fault, Files, Focus, Late, Mode};
use unlit::units::Seconds;

/// Gives a different blob for each frame and remembers the exposures.
struct Blobs {
    size: u32,
    exposures: Mutex<Vec<Exposure>>,
    frames: AtomicU32,
}

const SIZE: u32 = 1_300_000;

impl Blobs {
    fn new(size: u32) -> Arc<Self> {
        Arc::new(Self { size, exposures: Mutex::default(), frames: AtomicU32::new(0) })
    }
}

fn blob(size: u32, number: u32) -> Vec<u8> {
    (0..size).map(|i| (i.wrapping_mul(2_654_435_761).wrapping_add(number) >> 13) as u8).collect()
}

/// A JPEG's markers round nothing: libgphoto2 looks at no more.
const JPEG: &[u8] = &[0xff, 0xd8, 0xff, 0xe0, 1, 2, 3, 4, 0xff, 0xd9];

impl View for Blobs {
    fn expose(&self, exposure: &Exposure) -> Vec<u8> {
        self.exposures.lock().unwrap().push(*exposure);
        blob(self.size, self.frames.fetch_add(1, Ordering::SeqCst))
    }

    fn preview(&self) -> Vec<u8> {
        JPEG.to_vec()
    }
}

/// What a run of gphoto2 left.
struct Run {
    code: Option<i32>,
    text: String,
    files: BTreeMap<String, Vec<u8>>,
    took: Duration,
}

impl Run {
    /// The one file that was stored.
    fn file(&self) -> &[u8] {
        assert_eq!(self.files.len(), 1, "{:?}\n{}", self.files.keys(), self.text);
        self.files.values().next().unwrap()
    }
}

/// gphoto2 with a home of its own.
struct Cli {
    home: tempfile::TempDir,
    port: Vec<String>,
    bus: Option<std::path::PathBuf>,
}

impl Cli {
    /// For a camera on the network.
    fn network(server: &CameraServer) -> Self {
        let port = ["--port", &server.port(), "--camera", "PTP/IP Camera"].map(str::to_owned).to_vec();
        Self { home: tempfile::tempdir().unwrap(), port, bus: None }
    }

    /// For whatever is on a bus.
    fn usb(bus: &Path) -> Self {
        Self { home: tempfile::tempdir().unwrap(), port: Vec::new(), bus: Some(bus.to_owned()) }
    }

    fn start(&self, arguments: &[&str]) -> Child {
        let mut command = Command::new("gphoto2");
        if let Some(bus) = &self.bus {
            command.env("IOLIBS", iolibs()).env("UNLIT_STUDIO_USB", bus);
        }
        command
            .args(&self.port)
            .args(arguments)
            .current_dir(self.home.path())
            .env("HOME", self.home.path())
            .env("LC_ALL", "C.UTF-8")
            .stdin(Stdio::null())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .expect("gphoto2 is needed: apt install gphoto2")
    }

    fn run(&self, arguments: &[&str]) -> Run {
        let began = Instant::now();
        let output = self.start(arguments).wait_with_output().unwrap();
        let mut files = BTreeMap::new();
        for entry in std::fs::read_dir(self.home.path()).unwrap().map(Result::unwrap) {
            if entry.file_type().unwrap().is_file() {
                let name = entry.file_name().into_string().unwrap();
                files.insert(name, std::fs::read(entry.path()).unwrap());
                std::fs::remove_file(entry.path()).unwrap();
            }
        }
        let text = [output.stdout, output.stderr].map(|t| String::from_utf8_lossy(&t).into_owned()).concat();
        Run { code: output.status.code(), text, files, took: began.elapsed() }
    }

    /// One shot into memory, downloaded and deleted there.
    fn shoot(&self) -> Run {
        self.run(&["--set-config", "capturetarget=0", "--capture-image-and-download"])
    }

    /// What a setting shows.
    fn setting(&self, name: &str) -> String {
        let run = self.run(&["--get-config", name]);
        let current = run.text.lines().find_map(|line| line.strip_prefix("Current: "));
        current.unwrap_or_else(|| panic!("{name}: {}", run.text)).to_owned()
    }
}

fn start(options: &BodyOptions) -> (Arc<Blobs>, CameraServer) {
    let view = Blobs::new(SIZE);
    (view.clone(), CameraServer::start_with(view, options).unwrap())
}

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

/// A bus with one camera at 001,004.
fn on_a_bus(size: u32) -> (tempfile::TempDir, CameraServer) {
    let bus = tempfile::tempdir().unwrap();
    let server = CameraServer::start_usb(Blobs::new(size), bus.path(), "001,004").unwrap();
    (bus, server)
}

/// Ports at which gphoto2 finds a 5DS.
fn detected(bus: &Path) -> Vec<String> {
    let text = Cli::usb(bus).run(&["--auto-detect"]).text;
    let port = |line: &str| line.strip_prefix("Canon EOS 5DS ").map(|port| port.trim().to_owned());
    text.lines().filter_map(port).collect()
}

#[test]
fn cameras_are_detected_on_the_bus_while_they_are_plugged_in() {
    let (bus, server) = on_a_bus(SIZE);
    assert_eq!(detected(bus.path()), ["usb:001,004"]);
    let options = BodyOptions { serial: "000000000043".into(), ..BodyOptions::default() };
    let other = CameraServer::start_usb_with(Blobs::new(SIZE), bus.path(), "002,001", &options).unwrap();
    assert_eq!(detected(bus.path()), ["usb:001,004", "usb:002,001"]);
    let cli = Cli { port: vec!["--port".into(), other.port()], ..Cli::usb(bus.path()) };
    assert_eq!(cli.setting("eosserialnumber"), "000000000043");
    server.unplug();
    assert_eq!(detected(bus.path()), ["usb:002,001"]);
    server.replug().unwrap();
    assert_eq!(server.port(), "usb:001,005");
    assert_eq!(detected(bus.path()), ["usb:001,005", "usb:002,001"]);
    drop((server, other));
    assert!(detected(bus.path()).is_empty());
}

#[test]
fn a_camera_on_a_bus_that_is_gone_can_still_be_switched_off() {
    let (bus, server) = on_a_bus(SIZE);
    bus.close().unwrap();
    drop(server);
}

#[test]
fn an_address_that_no_bus_gives_is_refused_in_words() {
    let bus = tempfile::tempdir().unwrap();
    for address in ["1,4", "001", "000,004", "001,999", "../001,004"] {
        let refused = CameraServer::start_usb(Blobs::new(1), bus.path(), address).err().unwrap();
        assert!(refused.to_string().contains("as in 001,004"), "{address}: {refused}");
    }
}

#[test]
fn frames_come_over_usb_whole_whatever_their_size() {
    // With the 12 bytes of a container's head: less than a packet, one packet, packets that are all full, a full chunk
    // of the library's downloads, and one byte round each.
    for size in [1, 499, 500, 501, 1012, 65_524, 1 << 20, (1 << 20) + 500, 1_300_000] {
        let (bus, server) = on_a_bus(size);
        let run = Cli::usb(bus.path()).shoot();
        assert!(run.file() == blob(size, 0), "{size} bytes: {}", run.text);
        assert_eq!(server.frames_waiting(), 0);
    }
}

#[test]
fn a_setting_is_set_over_usb() {
    let (bus, _server) = on_a_bus(SIZE);
    let cli = Cli::usb(bus.path());
    cli.run(&["--set-config", "iso=400"]);
    assert_eq!(cli.setting("iso"), "400");
}

#[test]
fn a_plug_pulled_in_a_download_is_an_error_and_the_next_address_works() {
    let (bus, server) = on_a_bus(SIZE);
    server.fault(Fault::UnplugInDownload);
    let run = Cli::usb(bus.path()).shoot();
    assert!(run.files.is_empty() && run.text.contains("PTP I/O Error"), "{}", run.text);
    assert!(!server.plugged() && detected(bus.path()).is_empty());
    server.replug().unwrap();
    let cli = Cli { port: vec!["--port".into(), "usb:001,005".into()], ..Cli::usb(bus.path()) };
    assert!(cli.shoot().file() == blob(SIZE, 1));
}

#[test]
fn a_link_that_drops_in_a_download_leaves_the_camera_on_the_bus() {
    let (bus, server) = on_a_bus(SIZE);
    server.fault(Fault::DropInDownload);
    let run = Cli::usb(bus.path()).shoot();
    assert!(run.files.is_empty() && run.text.contains("PTP I/O Error"), "{}", run.text);
    assert_eq!(detected(bus.path()), ["usb:001,004"]);
    assert!(Cli::usb(bus.path()).shoot().file() == blob(SIZE, 1));
}

#[test]
fn a_silent_usb_camera_costs_what_it_costs_in_the_field() {
    let (bus, server) = on_a_bus(SIZE);
    let cli = Cli::usb(bus.path());
    // The first question of a session is asked three times, 1.5 s each.
    server.fault(Fault::Stall);
    let run = cli.run(&["--summary"]);
    assert!(run.text.contains("I/O problem"), "{}", run.text);
    assert!((4.0..15.0).contains(&run.took.as_secs_f64()), "{:?}", run.took);
    server.mend();
    // Any other is waited for as long as libgphoto2 waits for a USB camera.
    server.script([(server.operations() + 2, Fault::StallOnce)]);
    let run = cli.run(&["--get-config", "iso"]);
    assert!(run.text.contains("PTP I/O Error"), "{}", run.text);
    assert!((20.0..40.0).contains(&run.took.as_secs_f64()), "{:?}", run.took);
    assert_eq!(server.struck(), [Fault::Stall, Fault::StallOnce]);
    assert!(cli.shoot().file() == blob(SIZE, 0));
}

#[test]
fn a_camera_that_another_process_holds_cannot_be_claimed() {
    let (bus, _server) = on_a_bus(SIZE);
    let cli = Cli::usb(bus.path());
    let claim = std::fs::File::create(bus.path().join(".001,004.lock")).unwrap();
    claim.lock().unwrap();
    let run = cli.shoot();
    assert!(run.text.contains("Could not claim the USB device"), "{}", run.text);
    drop(claim);
    assert!(cli.shoot().file() == blob(SIZE, 0));
}
