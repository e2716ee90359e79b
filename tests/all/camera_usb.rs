//! The camera on USB, through the real library and a stand-in for its USB port driver: found by itself, stalled for
//! longer than the library waits, unplugged, plugged in again at another address.

use crate::camera::{Blobs, blob, launch};
use crate::usb_bench::iolibs;
use std::sync::Arc;
use std::time::{Duration, Instant};
use tempfile::TempDir;
use unlit::rig::camera::{Deadlines, HostedCamera, Launch, Target, list_with};
use unlit::rig::{Camera, CameraError};
use unlit::studio::camera::{BodyOptions, CameraServer, Fault};

/// A simulated bus and how hosts see it.
struct Bus {
    folder: TempDir,
}

impl Bus {
    fn new() -> Self {
        Self { folder: tempfile::tempdir().unwrap() }
    }

    fn launch(&self) -> Launch {
        launch().env("IOLIBS", iolibs()).env("UNLIT_STUDIO_USB", self.folder.path())
    }

    fn plug_in(&self, address: &str, serial: &str) -> CameraServer {
        let options = BodyOptions { serial: serial.into(), ..BodyOptions::default() };
        let view = Arc::new(Blobs::default());
        CameraServer::start_usb_with(view, self.folder.path(), address, &options).unwrap()
    }

    fn open(&self, port: Option<&str>) -> Result<HostedCamera, CameraError> {
        HostedCamera::open_with(&self.launch(), port, Deadlines::default(), Target::Memory)
    }
}

#[test]
fn cameras_on_the_bus_are_listed_and_the_first_or_the_chosen_one_is_opened() {
    let bus = Bus::new();
    assert!(matches!(bus.open(None), Err(CameraError::NotFound { .. })));
    let _first = bus.plug_in("001,004", "000000000042");
    let _second = bus.plug_in("001,007", "000000000077");
    let listed = list_with(&bus.launch()).unwrap();
    let ports: Vec<&str> = listed.iter().map(|c| c.port.as_str()).collect();
    assert_eq!(ports, ["usb:001,004", "usb:001,007"]);
    assert!(listed.iter().all(|c| c.model == "Canon EOS 5DS"), "{listed:?}");
    assert_eq!(bus.open(None).unwrap().info().unwrap().serial.as_deref(), Some("000000000042"));
    let mut chosen = bus.open(Some("usb:001,007")).unwrap();
    assert_eq!(chosen.info().unwrap().serial.as_deref(), Some("000000000077"));
    let shot = chosen.shoot().unwrap();
    assert!(shot.raw.bytes == blob(0));
    eprintln!("a shot over the simulated USB: {:?}", shot.times);
}

#[test]
fn a_stall_of_twenty_seconds_ends_at_our_deadline_and_the_camera_comes_back() {
    let bus = Bus::new();
    let server = bus.plug_in("001,004", "000000000042");
    let mut camera = bus.open(None).unwrap();
    camera.shoot().unwrap();
    server.fault(Fault::Stall);
    let began = Instant::now();
    let error = camera.shoot().unwrap_err();
    let took = began.elapsed();
    eprintln!("stalled: {error} after {took:.1?}");
    assert!(matches!(error, CameraError::Deadline { .. }), "{error}");
    assert!(took < Duration::from_secs(12), "deadline is 10 s, took {took:?}");
    server.mend();
    let began = Instant::now();
    let steps = camera.recover().unwrap();
    eprintln!("back after {:.1?}: {steps:?}", began.elapsed());
    assert!(camera.shoot().unwrap().raw.bytes == blob(1));
}

#[test]
fn a_camera_unplugged_and_plugged_in_again_is_found_at_its_new_address_by_its_serial_number() {
    let bus = Bus::new();
    let server = bus.plug_in("001,004", "000000000042");
    let mut camera = bus.open(None).unwrap();
    camera.shoot().unwrap();
    server.unplug();
    let error = camera.shoot().unwrap_err();
    eprintln!("unplugged: {error}");
    assert!(error.may_pass(), "{error}");
    let error = camera.recover().unwrap_err();
    assert!(matches!(error, CameraError::Unplugged { .. }), "{error}");
    // Another body of the same model is not taken for it.
    let _other = bus.plug_in("001,009", "000000000077");
    server.replug().unwrap();
    let began = Instant::now();
    let steps = camera.recover().unwrap();
    eprintln!("back after {:.1?}: {steps:?}", began.elapsed());
    let info = camera.info().unwrap();
    assert_ne!(info.port, "usb:001,004");
    assert_eq!(info.serial.as_deref(), Some("000000000042"));
    assert!(camera.shoot().unwrap().raw.bytes == blob(1));
}

#[test]
fn a_plug_pulled_in_the_middle_of_a_download_costs_that_frame_alone() {
    let bus = Bus::new();
    let server = bus.plug_in("001,004", "000000000042");
    let mut camera = bus.open(None).unwrap();
    camera.shoot().unwrap();
    server.fault(Fault::UnplugInDownload);
    let error = camera.shoot().unwrap_err();
    eprintln!("unplugged in the download: {error}");
    server.replug().unwrap();
    camera.recover().unwrap();
    assert!(camera.shoot().unwrap().raw.bytes == blob(2), "never the frame of the release before");
}

#[test]
fn a_camera_that_left_while_nobody_used_it_is_not_said_to_be_there() {
    let bus = Bus::new();
    let server = bus.plug_in("001,004", "000000000042");
    let mut camera = bus.open(None).unwrap();
    camera.info().unwrap();
    server.unplug();
    let until = Instant::now() + Duration::from_secs(8);
    let error = loop {
        match camera.info() {
            Err(error) => break error,
            Ok(_) => assert!(Instant::now() < until, "it is still said to be there"),
        }
        std::thread::sleep(Duration::from_millis(100));
    };
    eprintln!("left the bus: {error}");
    assert!(error.may_pass(), "{error}");
    server.replug().unwrap();
    assert_eq!(camera.info().unwrap().serial.as_deref(), Some("000000000042"));
}
