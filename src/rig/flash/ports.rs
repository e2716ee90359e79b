//! Serial ports behind which a flash controller may stand: their lasting names, what is known of the USB device,
//! who may use them and who does. Takes the system's folders, changes nothing.

use crate::rig::system::{self, Holder, Identity, Roots};
use serde::Serialize;
use std::path::{Path, PathBuf};

/// Steps from a tty up to its USB device in sysfs: interface, device; `ttyUSB*` has one more.
const UP_TO_USB: usize = 4;

/// A serial port.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Port {
    /// The path to open: a name that survives replugging where there is one.
    pub path: PathBuf,
    /// The device that it leads to (`/dev/ttyACM0`).
    pub node: PathBuf,
    /// The USB device that it belongs to.
    pub usb: Option<UsbDevice>,
    /// Whether this user may read and write it.
    pub usable: bool,
    /// The processes that have it open; those of other users show only to root.
    pub held_by: Vec<Holder>,
}

/// A USB device as sysfs shows it.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct UsbDevice {
    /// Vendor number, four hexadecimal digits.
    pub vendor: String,
    /// Product number, four hexadecimal digits.
    pub product: String,
    /// The maker's name for itself.
    pub maker: Option<String>,
    /// The product's name.
    pub name: Option<String>,
    /// Serial number.
    pub serial: Option<String>,
    /// Bus and device address (`001,004`); another one after each plugging in.
    pub address: Option<String>,
}

/// USB numbers that controllers have: vendor, products, what carries them. The udev rule knows the same.
const LIKELY: [(&str, &[&str], &str); 5] = [
    ("2341", &["0001", "0043", "0243"], "Arduino Uno"),
    ("2a03", &["0043", "0243"], "Arduino Uno"),
    ("1a86", &["7523"], "CH340: Arduino Nano copies"),
    ("0403", &["6001"], "FT232R: Arduino Nano"),
    ("10c4", &["ea60"], "CP2102: Nano copies"),
];

impl UsbDevice {
    /// What carries this USB number, where it is one of those that controllers have.
    pub fn likely(&self) -> Option<&'static str> {
        let is_it = |(vendor, products, _): &&(&str, &[&str], _)| {
            *vendor == self.vendor && products.contains(&self.product.as_str())
        };
        LIKELY.iter().find(is_it).map(|(_, _, what)| *what)
    }
}

impl Port {
    /// Whether a controller may be behind it, by its USB number. What else is plugged in (a printer, a modem) would be
    /// reset by being greeted.
    pub fn is_likely(&self) -> bool {
        self.usb.as_ref().is_some_and(|usb| usb.likely().is_some())
    }
}

/// USB serial ports of this machine: names under `/dev/serial/by-id` first, because they survive replugging; then
/// those under `by-path`, `/dev/ttyACM*` and `/dev/ttyUSB*` that have no such name. Empty if there are none.
pub fn list() -> Vec<PathBuf> {
    list_in(&Roots::default())
}

/// [`list`] for the machine whose system folders are `roots`.
pub fn list_in(roots: &Roots) -> Vec<PathBuf> {
    let serial = roots.dev.join("serial");
    let bare = files_of(&roots.dev, |name| name.starts_with("ttyACM") || name.starts_with("ttyUSB"));
    let (mut paths, mut known) = (Vec::new(), Vec::new());
    let named = [files_of(&serial.join("by-id"), |_| true), files_of(&serial.join("by-path"), |_| true)];
    for path in named.into_iter().flatten().chain(bare) {
        // A link whose device was just pulled leads nowhere; opening it will say so.
        let node = path.canonicalize().unwrap_or_else(|_| path.clone());
        if !known.contains(&node) {
            known.push(node);
            paths.push(path);
        }
    }
    paths
}

/// Everything about the ports of [`list_in`], for the user `me`.
pub fn survey(roots: &Roots, me: &Identity) -> Vec<Port> {
    list_in(roots).iter().map(|path| look_at(path, roots, me)).collect()
}

/// Everything about one port.
pub fn look_at(path: &Path, roots: &Roots, me: &Identity) -> Port {
    let node = path.canonicalize().unwrap_or_else(|_| path.to_owned());
    Port {
        path: path.to_owned(),
        usb: node.file_name().and_then(|name| usb_device(&roots.tty.join(name).join("device"))),
        usable: system::may_use(&node, me).unwrap_or(false),
        held_by: system::holders(roots, &node),
        node,
    }
}

fn usb_device(tty: &Path) -> Option<UsbDevice> {
    let start = tty.canonicalize().ok()?;
    let device = start.ancestors().take(UP_TO_USB).find(|folder| folder.join("idVendor").is_file())?;
    let read = |name: &str| {
        let text = std::fs::read_to_string(device.join(name)).ok()?;
        Some(text.trim().to_owned()).filter(|text| !text.is_empty())
    };
    Some(UsbDevice {
        vendor: read("idVendor")?,
        product: read("idProduct")?,
        maker: read("manufacturer"),
        name: read("product"),
        serial: read("serial"),
        address: read("busnum").zip(read("devnum")).map(|(bus, device)| format!("{bus:0>3},{device:0>3}")),
    })
}

/// Files of a folder, by name; a folder that is not there (no serial port was ever plugged in) has none.
fn files_of(folder: &Path, wanted: impl Fn(&str) -> bool) -> Vec<PathBuf> {
    let Ok(entries) = std::fs::read_dir(folder) else { return Vec::new() };
    let mut paths: Vec<PathBuf> =
        entries.flatten().filter(|e| e.file_name().to_str().is_some_and(&wanted)).map(|e| e.path()).collect();
    paths.sort();
    paths
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::fs;
    use std::os::unix::fs::symlink;

    /// A machine with an Uno (named by its serial number), a CH340 (named by its socket) and a bare port.
    fn machine() -> (tempfile::TempDir, Roots) {
        let folder = tempfile::tempdir().unwrap();
        let at = |inside: &str| folder.path().join(inside);
        let roots = Roots {
            proc: at("proc"),
            dev: at("dev"),
            tty: at("sys/class/tty"),
            usb: at("usb"),
            drivers: Vec::new(),
        };
        let write = |path: &str, text: &str| {
            fs::create_dir_all(at(path).parent().unwrap()).unwrap();
            fs::write(at(path), text).unwrap();
        };
        for name in ["ttyACM0", "ttyUSB0", "ttyUSB1", "ttyS0"] {
            write(&format!("dev/{name}"), "");
        }
        let link = |path: &str, target: &str| {
            fs::create_dir_all(at(path).parent().unwrap()).unwrap();
            symlink(at(target), at(path)).unwrap();
        };
        link("dev/serial/by-id/usb-Arduino_Uno_7583-if00", "dev/ttyACM0");
        link("dev/serial/by-path/pci-usb-0:1:1.0", "dev/ttyACM0");
        link("dev/serial/by-path/pci-usb-0:2:1.0-port0", "dev/ttyUSB0");
        for (name, value) in [
            ("idVendor", "2341\n"),
            ("idProduct", "0043\n"),
            ("manufacturer", "Arduino (www.arduino.cc)\n"),
            ("serial", "7583\n"),
            ("busnum", "1\n"),
            ("devnum", "14\n"),
        ] {
            write(&format!("sys/devices/1-1/{name}"), value);
        }
        fs::create_dir_all(at("sys/devices/1-1/1-1:1.0/tty/ttyACM0")).unwrap();
        link("sys/class/tty/ttyACM0/device", "sys/devices/1-1/1-1:1.0");
        write("sys/devices/1-2/idVendor", "1a86\n");
        write("sys/devices/1-2/idProduct", "7523\n");
        fs::create_dir_all(at("sys/devices/1-2/1-2:1.0/ttyUSB0")).unwrap();
        link("sys/class/tty/ttyUSB0/device", "sys/devices/1-2/1-2:1.0/ttyUSB0");
        (folder, roots)
    }

    #[test]
    fn lasting_names_come_first_and_each_port_once() {
        let (folder, roots) = machine();
        let names: Vec<PathBuf> =
            list_in(&roots).iter().map(|p| p.strip_prefix(folder.path()).unwrap().to_owned()).collect();
        let expected = [
            "dev/serial/by-id/usb-Arduino_Uno_7583-if00",
            "dev/serial/by-path/pci-usb-0:2:1.0-port0",
            "dev/ttyUSB1",
        ];
        assert_eq!(names, expected.map(PathBuf::from));
    }

    #[test]
    fn the_usb_device_behind_a_port_is_told() {
        let (folder, roots) = machine();
        let proc = folder.path().join("proc/42");
        fs::create_dir_all(proc.join("fd")).unwrap();
        fs::write(proc.join("comm"), "screen\n").unwrap();
        symlink(folder.path().join("dev/ttyACM0"), proc.join("fd/3")).unwrap();
        let ports = survey(&roots, &Identity::own());
        let uno = ports[0].usb.as_ref().unwrap();
        assert_eq!((uno.vendor.as_str(), uno.product.as_str(), uno.name.as_deref()), ("2341", "0043", None));
        assert_eq!((uno.serial.as_deref(), uno.likely()), (Some("7583"), Some("Arduino Uno")));
        assert_eq!(uno.address.as_deref(), Some("001,014"));
        assert_eq!(ports[0].held_by, [Holder { name: "screen".into(), id: 42 }]);
        assert!(ports[0].usable);
        assert!(ports[1].usb.as_ref().unwrap().likely().unwrap().contains("CH340"));
        assert_eq!(ports[2].usb, None);
    }

    #[test]
    fn the_udev_rule_knows_the_same_boards() {
        let rule = include_str!("../../../packaging/udev/60-unlit-flash.rules");
        for (kind, vendor_key, product_key) in [
            ("port", "ATTRS{idVendor}==", "ATTRS{idProduct}=="),
            ("device", "ATTR{idVendor}==", "ATTR{idProduct}=="),
        ] {
            let quoted = |line: &str, key: &str| -> Option<String> {
                Some(line.split_once(key)?.1.split('"').nth(1)?.to_owned())
            };
            let mut known: Vec<(String, String)> = Vec::new();
            for line in rule.lines().filter(|line| line.starts_with(vendor_key)) {
                let vendor = quoted(line, vendor_key).unwrap();
                let products = quoted(line, product_key).unwrap();
                known.extend(products.split('|').map(|product| (vendor.clone(), product.to_owned())));
            }
            let ours: Vec<(String, String)> = LIKELY
                .iter()
                .flat_map(|(v, products, _)| products.iter().map(|p| ((*v).to_owned(), (*p).to_owned())))
                .collect();
            assert_eq!(known, ours, "{kind}");
        }
    }
}
