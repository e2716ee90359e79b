use super::*;
use std::fs;
use std::os::unix::fs::{MetadataExt, PermissionsExt};

/// A machine in a folder: processes, device nodes, drivers.
struct Machine {
    folder: tempfile::TempDir,
}

impl Machine {
    fn new() -> Self {
        let machine = Self { folder: tempfile::tempdir().unwrap() };
        let drivers = machine.path("lib/0.12.1");
        fs::create_dir_all(&drivers).unwrap();
        for driver in ["usb1.so", "ptpip.so"] {
            fs::write(drivers.join(driver), "").unwrap();
        }
        machine
    }

    fn path(&self, inside: &str) -> PathBuf {
        self.folder.path().join(inside)
    }

    fn node(&self, inside: &str, mode: u32) -> PathBuf {
        let path = self.path(inside);
        fs::create_dir_all(path.parent().unwrap()).unwrap();
        fs::write(&path, "").unwrap();
        fs::set_permissions(&path, fs::Permissions::from_mode(mode)).unwrap();
        path
    }

    fn process(&self, id: u32, name: &str, open: &[&Path]) {
        let files = self.path(&format!("proc/{id}/fd"));
        fs::create_dir_all(&files).unwrap();
        fs::write(self.path(&format!("proc/{id}/comm")), format!("{name}\n")).unwrap();
        for (number, target) in open.iter().enumerate() {
            std::os::unix::fs::symlink(target, files.join(number.to_string())).unwrap();
        }
    }

    fn roots(&self) -> Roots {
        Roots {
            proc: self.path("proc"),
            dev: self.path("dev"),
            tty: self.path("tty"),
            usb: self.path("usb"),
            drivers: vec![self.path("lib")],
        }
    }

    /// Somebody to whom none of the files belong.
    fn stranger(&self) -> Identity {
        let about = fs::metadata(self.folder.path()).unwrap();
        Identity { user: about.uid() + 4242, groups: vec![about.gid() + 4242] }
    }

    fn judge(&self, seen: &Seen) -> Vec<Finding> {
        judge(seen, &self.roots(), &self.stranger())
    }
}

const PORT: &str = "usb:001,004";

fn one_camera() -> Seen {
    let camera = CameraInfo { model: "Canon EOS 5DS".into(), port: PORT.into(), serial: None };
    Seen {
        library: Ok("2.5.30".into()),
        listed: Ok(vec![camera]),
        on_bus: Ok(Vec::new()),
        serial: Vec::new(),
    }
}

#[track_caller]
fn find<'a>(findings: &'a [Finding], code: &str) -> &'a Finding {
    findings.iter().find(|f| f.code == code).unwrap_or_else(|| panic!("no {code}: {findings:?}"))
}

#[test]
fn a_machine_where_all_is_well_has_no_problem() {
    let machine = Machine::new();
    machine.node("usb/001/004", 0o666);
    let seen = Seen { serial: vec![machine.node("ttyACM0", 0o666)], ..one_camera() };
    let findings = machine.judge(&seen);
    assert!(findings.iter().all(|f| f.level == Level::Ok), "{findings:?}");
    assert!(find(&findings, "library").sentence.contains("2.5.30"));
}

#[test]
fn whoever_holds_the_camera_is_named_and_gvfs_with_the_cure() {
    let machine = Machine::new();
    let node = machine.node("usb/001/004", 0o666);
    machine.process(17, "gvfsd-gphoto2", &[Path::new("/dev/null"), &node]);
    machine.process(23, "darktable", &[&node]);
    machine.process(29, "unlit", &[&node]);
    machine.process(31, "bash", &[]);
    let findings = machine.judge(&one_camera());
    let held: Vec<_> = findings.iter().filter(|f| f.code == "camera_held").collect();
    assert_eq!(held.len(), 3, "{held:?}");
    assert!(held[0].level == Level::Problem && held[0].advice.contains("gio mount -s gphoto2"));
    assert!(held[1].sentence.contains("darktable") && held[1].advice.contains("kill 23"));
    assert_eq!(held[2].level, Level::Ok, "unlit's own host is no stranger");
}

#[test]
fn a_volume_monitor_that_waits_for_cameras_is_a_warning() {
    let machine = Machine::new();
    machine.process(17, "gvfs-gphoto2-vo", &[]);
    machine.process(18, "ModemManager", &[]);
    let findings = machine.judge(&one_camera());
    assert_eq!(find(&findings, "gvfs").level, Level::Warning);
    assert_eq!(find(&findings, "modem_manager").level, Level::Warning);
}

#[test]
fn nodes_that_may_not_be_used_come_with_what_to_do() {
    let machine = Machine::new();
    machine.node("usb/001/004", 0o664);
    let seen = Seen { serial: vec![machine.node("ttyUSB0", 0o660)], ..one_camera() };
    let findings = machine.judge(&seen);
    let camera = find(&findings, "camera_rights");
    assert!(camera.level == Level::Problem && camera.advice.contains("udev"), "{camera:?}");
    let serial = find(&findings, "serial_rights");
    assert!(serial.level == Level::Problem && serial.advice.contains("dialout"), "{serial:?}");
    assert!(serial.advice.contains("60-unlit-flash.rules"), "{serial:?}");
    // The group may.
    let group = fs::metadata(machine.folder.path()).unwrap().gid();
    let member = Identity { groups: vec![group], ..machine.stranger() };
    let findings = judge(&seen, &machine.roots(), &member);
    assert_eq!(find(&findings, "serial_rights").level, Level::Ok);
}

#[test]
fn whoever_holds_the_serial_port_is_named_and_the_modem_manager_with_the_cure() {
    let machine = Machine::new();
    machine.node("usb/001/004", 0o666);
    let node = machine.node("ttyACM0", 0o666);
    let named = machine.path("usb-Arduino-if00");
    std::os::unix::fs::symlink(&node, &named).unwrap();
    machine.process(17, "ModemManager", &[&node]);
    machine.process(23, "screen", &[&node]);
    machine.process(29, "unlit", &[&node]);
    let findings = machine.judge(&Seen { serial: vec![named], ..one_camera() });
    let held: Vec<_> = findings.iter().filter(|f| f.code == "serial_held").collect();
    assert_eq!(held.iter().map(|f| f.level).collect::<Vec<_>>(), [Level::Problem, Level::Problem, Level::Ok]);
    assert!(held[0].advice.contains("60-unlit-flash.rules"), "{held:?}");
    assert!(held[1].sentence.contains("screen") && held[1].advice.contains("kill 23"), "{held:?}");
    assert!(find(&findings, "modem_manager").advice.contains("60-unlit-flash.rules"));
}

#[test]
fn a_device_that_the_library_does_not_know_is_a_problem() {
    let machine = Machine::new();
    let stranger =
        UsbCamera { bus: 2, address: 9, vendor: 1, product: 2, vendor_name: None, product_name: None };
    let seen = Seen { listed: Ok(Vec::new()), on_bus: Ok(vec![stranger]), ..one_camera() };
    let findings = machine.judge(&seen);
    assert!(find(&findings, "camera_unknown").sentence.contains("usb:002,009"));
    // Its node is not there: it has just been unplugged.
    assert_eq!(find(&findings, "camera_rights").level, Level::Warning);
}

#[test]
fn missing_drivers_and_a_library_that_does_not_run_are_problems() {
    let machine = Machine::new();
    fs::remove_file(machine.path("lib/0.12.1/usb1.so")).unwrap();
    let seen = Seen {
        library: Err("it ended".into()),
        listed: Err("it ended".into()),
        on_bus: Ok(Vec::new()),
        serial: Vec::new(),
    };
    let findings = machine.judge(&seen);
    for code in ["library", "port_drivers", "camera_list"] {
        let finding = find(&findings, code);
        assert!(finding.level == Level::Problem && !finding.advice.is_empty(), "{finding:?}");
    }
    assert_eq!(find(&findings, "serial_none").level, Level::Warning);
}

#[test]
fn no_camera_is_a_warning_for_it_may_be_in_the_network() {
    let machine = Machine::new();
    let findings = machine.judge(&Seen { listed: Ok(Vec::new()), ..one_camera() });
    assert_eq!(find(&findings, "camera_none").level, Level::Warning);
}
