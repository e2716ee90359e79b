//! The simulated camera on a simulated USB bus against the unmodified libgphoto2, by its own command line.

use crate::gphoto_cli::{Blobs, Cli, SIZE, blob};
use std::path::Path;
use unlit::studio::camera::{BodyOptions, CameraServer, Fault};

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
    let cli = Cli::usb_at(bus.path(), &other.port());
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
    let cli = Cli::usb_at(bus.path(), "usb:001,005");
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
