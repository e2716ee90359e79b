//! Looking for the controller among ports that belong to others: what is greeted, what is left in peace.

use super::flash_wire::Wire;
use std::fs;
use std::os::unix::fs::symlink;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicU32, Ordering};
use unlit::rig::FlashError;
use unlit::rig::flash::{Finder, FlashSettings, SerialFlash};
use unlit::rig::system::{Identity, Roots};
use unlit::studio::{Board, BoardOptions};

/// Folders of a machine with serial ports, whose other ends are pseudo terminals.
struct Machine {
    folder: tempfile::TempDir,
    finder: Finder,
}

impl Machine {
    fn new() -> Self {
        let folder = tempfile::tempdir().unwrap();
        let at = |inside: &str| {
            let path = folder.path().join(inside);
            fs::create_dir_all(&path).unwrap();
            path
        };
        let roots =
            Roots { proc: at("proc"), dev: at("dev"), tty: at("tty"), usb: at("usb"), drivers: Vec::new() };
        Self { finder: Finder::new(roots, Identity::own()), folder }
    }

    /// Plugs a device in as `name`, with its USB number and address.
    fn plug(&self, name: &str, device: &Path, (vendor, product): (&str, &str), address: u32) -> PathBuf {
        let path = self.folder.path().join("dev").join(name);
        let node = device.canonicalize().unwrap();
        let _ = fs::remove_file(&path);
        symlink(&node, &path).unwrap();
        let usb = self.folder.path().join("tty").join(node.file_name().unwrap()).join("device");
        fs::create_dir_all(&usb).unwrap();
        let address = address.to_string();
        for (file, value) in
            [("idVendor", vendor), ("idProduct", product), ("busnum", "1"), ("devnum", &address)]
        {
            fs::write(usb.join(file), value).unwrap();
        }
        path
    }

    fn find(&self) -> Result<Option<SerialFlash>, FlashError> {
        self.finder.open(FlashSettings::default())
    }
}

const CH340: (&str, &str) = ("1a86", "7523");
const MODEM: (&str, &str) = ("12d1", "1506");

/// A device that says `words` to every line, and how many lines it heard.
fn stranger(words: &'static [u8]) -> (Wire, Arc<AtomicU32>) {
    let heard = Arc::new(AtomicU32::new(0));
    let counted = heard.clone();
    let wire = Wire::start(move |line| {
        if line.is_empty() {
            return Vec::new();
        }
        counted.fetch_add(1, Ordering::Relaxed);
        words.to_vec()
    });
    (wire, heard)
}

#[test]
fn a_port_with_another_usb_number_is_never_touched() {
    let machine = Machine::new();
    let (modem, heard) = stranger(b"OK\r\n");
    let port = machine.plug("ttyUSB0", modem.device(), MODEM, 3);
    assert!(machine.find().unwrap().is_none());
    assert_eq!(heard.load(Ordering::Relaxed), 0);
    // Named, it is asked.
    let error = SerialFlash::open(&port).err().unwrap();
    assert!(matches!(error, FlashError::Firmware { .. }), "{error}");
    assert!(heard.load(Ordering::Relaxed) > 0);
}

#[test]
fn a_stranger_is_greeted_once_until_it_is_plugged_in_anew_and_hides_no_controller() {
    let machine = Machine::new();
    let (printer, heard) = stranger(b"echo:Unknown command\r\n");
    machine.plug("ttyUSB0", printer.device(), CH340, 3);
    let error = machine.find().err().unwrap();
    assert!(matches!(error, FlashError::Firmware { .. }), "{error}");
    let greeted = heard.load(Ordering::Relaxed);
    assert!(greeted > 0);

    for _ in 0..3 {
        let error = machine.find().err().unwrap().to_string();
        assert!(error.contains("until it is plugged in anew"), "{error}");
    }
    let board = Board::start(BoardOptions::default()).unwrap();
    machine.plug("ttyUSB1", board.device(), CH340, 4);
    let flash = machine.find().unwrap().unwrap();
    drop(flash);
    assert_eq!(heard.load(Ordering::Relaxed), greeted, "left in peace");

    fs::remove_file(machine.folder.path().join("dev/ttyUSB1")).unwrap();
    machine.plug("ttyUSB0", printer.device(), CH340, 5);
    assert!(machine.find().is_err());
    assert!(heard.load(Ordering::Relaxed) > greeted, "plugged in anew, it is asked anew");
}

#[test]
fn a_port_that_another_program_has_open_is_left_alone_and_told() {
    let machine = Machine::new();
    let (printer, heard) = stranger(b"ok\n");
    machine.plug("ttyUSB0", printer.device(), CH340, 3);
    let process = machine.folder.path().join("proc/42");
    fs::create_dir_all(process.join("fd")).unwrap();
    fs::write(process.join("comm"), "octoprint\n").unwrap();
    symlink(printer.device().canonicalize().unwrap(), process.join("fd/3")).unwrap();
    let error = machine.find().err().unwrap().to_string();
    assert!(
        error.contains("octoprint (process 42) has it open") && error.contains("--flash PORT"),
        "{error}"
    );
    assert_eq!(heard.load(Ordering::Relaxed), 0);
}
