//! What keeps camera and flash from working on this machine, and what to do about it: libgphoto2 and its port
//! drivers, cameras found by it and by the bus, who holds them, rights on device nodes, serial ports.
//!
//! [`examine`] looks at this machine; what it makes of what it sees is [`judge`], which takes the folders of the
//! system as plain paths.

use super::camera::{self, Launch};
use super::system::{self, Holder};
use super::usb::{self, UsbCamera};
use super::{CameraInfo, flash};
use serde::Serialize;
use std::path::{Path, PathBuf};

pub use super::system::{Identity, Roots};

/// How a finding stands.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Level {
    /// As it should be.
    Ok,
    /// Worth knowing; it may become a problem.
    Warning,
    /// It keeps something from working.
    Problem,
}

/// One thing looked at.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Finding {
    /// How it stands.
    pub level: Level,
    /// Stable name for scripts.
    pub code: &'static str,
    /// What was found.
    pub sentence: String,
    /// What to do; empty when there is nothing to do.
    pub advice: String,
}

impl Finding {
    fn new(level: Level, code: &'static str, sentence: impl Into<String>, advice: impl Into<String>) -> Self {
        Self { level, code, sentence: sentence.into(), advice: advice.into() }
    }
}

/// What devices were found, and what could not be asked.
#[derive(Debug)]
pub struct Seen {
    /// libgphoto2's version, or why it does not tell.
    pub library: Result<String, String>,
    /// Cameras that libgphoto2 finds by itself.
    pub listed: Result<Vec<CameraInfo>, String>,
    /// Still-image devices on the USB bus.
    pub on_bus: Result<Vec<UsbCamera>, String>,
    /// Serial ports behind which a flash controller may stand.
    pub serial: Vec<PathBuf>,
}

/// Looks at this machine.
pub fn examine() -> Vec<Finding> {
    let launch = Launch::own();
    let words = |error: &dyn std::error::Error| error.to_string();
    let seen = Seen {
        library: launch
            .as_ref()
            .map_err(|e| words(e))
            .and_then(|l| camera::library_with(l).map_err(|e| words(&e))),
        listed: launch
            .as_ref()
            .map_err(|e| words(e))
            .and_then(|l| camera::list_with(l).map_err(|e| words(&e))),
        on_bus: usb::list().map_err(|e| words(&e)),
        serial: flash::list(),
    };
    judge(&seen, &Roots::default(), &Identity::own())
}

/// What is to be made of `seen` on a machine whose system folders are `roots`, for the user `me`.
pub fn judge(seen: &Seen, roots: &Roots, me: &Identity) -> Vec<Finding> {
    let mut findings = vec![library(seen), port_drivers(roots)];
    findings.extend(cameras(seen));
    let mut nodes: Vec<PathBuf> = Vec::new();
    let ports = seen.listed.iter().flatten().map(|c| c.port.clone());
    for port in ports.chain(seen.on_bus.iter().flatten().map(UsbCamera::port)) {
        nodes.extend(roots.usb_node(&port).filter(|node| !nodes.contains(node)));
    }
    for node in &nodes {
        findings.push(rights(node, me, "camera_rights", "camera", UDEV));
        findings.extend(system::holders(roots, node).iter().map(|holder| held(node, holder)));
    }
    findings.extend(system::running(roots).iter().filter_map(|(name, id)| in_the_way(name, *id)));
    findings.extend(serial_ports(seen, roots, me));
    findings
}

const UDEV: &str = "Install the udev rules of libgphoto2 (Debian: `sudo apt install libgphoto2-6`, then plug the camera in \
                    again), or log in at the machine itself rather than from afar.";
const SERIAL: &str = "Install packaging/udev/60-unlit-flash.rules as it says itself and plug the controller in again; or join the \
                      group: `sudo usermod -aG dialout $USER`, then log out and in again.";

fn library(seen: &Seen) -> Finding {
    match &seen.library {
        Ok(version) => Finding::new(Level::Ok, "library", format!("libgphoto2 {version} is in use."), ""),
        Err(error) => Finding::new(
            Level::Problem,
            "library",
            format!("libgphoto2 does not run: {error}."),
            "Install it (Debian: `sudo apt install libgphoto2-6`).",
        ),
    }
}

fn port_drivers(roots: &Roots) -> Finding {
    let found = system::port_drivers(roots);
    let usb = found.iter().any(|name| name.starts_with("usb1") || name.starts_with("usb."));
    let names = found.join(", ");
    if usb {
        Finding::new(Level::Ok, "port_drivers", format!("Its port drivers are there: {names}."), "")
    } else {
        let sentence = match found.is_empty() {
            true => "No port drivers of libgphoto2 were found.".to_owned(),
            false => format!("libgphoto2 has port drivers for {names}, but none for USB."),
        };
        let advice = "Install them (Debian: `sudo apt install libgphoto2-port12`); IOLIBS, if set, must name their folder.";
        Finding::new(Level::Problem, "port_drivers", sentence, advice)
    }
}

fn cameras(seen: &Seen) -> Vec<Finding> {
    let mut findings = Vec::new();
    match &seen.listed {
        Ok(cameras) => findings.extend(cameras.iter().map(|camera| {
            Finding::new(Level::Ok, "camera", format!("{} is on {}.", camera.model, camera.port), "")
        })),
        Err(error) => findings.push(Finding::new(
            Level::Problem,
            "camera_list",
            format!("The cameras could not be listed: {error}."),
            "Unplug the camera, plug it in again, and look once more.",
        )),
    }
    match &seen.on_bus {
        Ok(devices) => {
            let known = |port: &str| seen.listed.iter().flatten().any(|c| c.port == port);
            findings.extend(devices.iter().filter(|d| !known(&d.port())).map(|device| {
                let name = device.product_name.as_deref().unwrap_or("a still-image device");
                Finding::new(
                    Level::Problem,
                    "camera_unknown",
                    format!(
                        "{name} ({:04x}:{:04x}) is on the bus as {}, but libgphoto2 does not know it.",
                        device.vendor,
                        device.product,
                        device.port()
                    ),
                    "Choose PTP or PC remote in the camera's USB menu, not mass storage; a newer libgphoto2 may know it.",
                )
            }));
        }
        Err(error) => findings.push(Finding::new(
            Level::Problem,
            "bus",
            format!("The USB bus could not be read: {error}."),
            UDEV,
        )),
    }
    if findings.is_empty() {
        findings.push(Finding::new(
            Level::Warning,
            "camera_none",
            "No camera was found on USB.",
            "Plug it in, switch it on, set its auto power off to never; a camera in the network is opened by its address \
             (--camera ptpip:ADDRESS).",
        ));
    }
    findings
}

fn rights(node: &Path, me: &Identity, code: &'static str, what: &str, advice: &str) -> Finding {
    let shown = node.display();
    match system::may_use(node, me) {
        Ok(true) => Finding::new(Level::Ok, code, format!("You may use the {what} at {shown}."), ""),
        Ok(false) => {
            Finding::new(Level::Problem, code, format!("You may not use the {what} at {shown}."), advice)
        }
        Err(error) => Finding::new(
            Level::Warning,
            code,
            format!("The {what} at {shown} could not be looked at: {error}."),
            "It may just have been unplugged; look once more.",
        ),
    }
}

fn held(node: &Path, holder: &Holder) -> Finding {
    let Holder { name, id } = holder;
    let shown = node.display();
    if name.starts_with("unlit") {
        let sentence = format!("unlit itself (process {id}) uses the camera at {shown}.");
        return Finding::new(Level::Ok, "camera_held", sentence, "");
    }
    let advice = if is_gvfs(name) { GVFS.to_owned() } else { format!("Close it, or end it: `kill {id}`.") };
    let sentence = format!("{name} (process {id}) holds the camera at {shown}.");
    Finding::new(Level::Problem, "camera_held", sentence, advice)
}

const GVFS: &str = "Give the camera free with `gio mount -s gphoto2`, and keep the desktop from taking it again with \
                    `systemctl --user mask --now gvfs-gphoto2-volume-monitor`.";

/// The kernel cuts names of processes at 15 letters.
fn is_gvfs(name: &str) -> bool {
    name.starts_with("gvfs-gphoto2") || name.starts_with("gvfsd-gphoto2")
}

/// Programs that take devices as soon as they are plugged in.
fn in_the_way(name: &str, id: u32) -> Option<Finding> {
    if is_gvfs(name) {
        let sentence = format!("The desktop's {name} (process {id}) takes cameras that are plugged in.");
        return Some(Finding::new(Level::Warning, "gvfs", sentence, GVFS));
    }
    (name == "ModemManager").then(|| {
        Finding::new(
            Level::Warning,
            "modem_manager",
            format!("ModemManager (process {id}) talks to serial ports that are plugged in, taking them for modems."),
            MODEM_MANAGER,
        )
    })
}

const MODEM_MANAGER: &str = "packaging/udev/60-unlit-flash.rules keeps it away from flash controllers; without it, \
                             `sudo systemctl mask --now ModemManager`.";

fn serial_ports(seen: &Seen, roots: &Roots, me: &Identity) -> Vec<Finding> {
    if seen.serial.is_empty() {
        let advice = "Plug the flash controller in, or shoot with `--flash manual`.";
        return vec![Finding::new(Level::Warning, "serial_none", "No serial port was found.", advice)];
    }
    let mut findings = Vec::new();
    for port in &seen.serial {
        findings.push(rights(port, me, "serial_rights", "serial port", SERIAL));
        // Processes have the device open, whatever name it has here.
        let node = port.canonicalize().unwrap_or_else(|_| port.clone());
        findings.extend(system::holders(roots, &node).iter().map(|holder| serial_held(port, holder)));
    }
    findings
}

fn serial_held(port: &Path, Holder { name, id }: &Holder) -> Finding {
    let shown = port.display();
    let (level, sentence, advice) = match name.as_str() {
        name if name.starts_with("unlit") => {
            (Level::Ok, format!("unlit itself (process {id}) uses the serial port {shown}."), String::new())
        }
        "ModemManager" => (
            Level::Problem,
            format!("ModemManager (process {id}) holds the serial port {shown}, taking it for a modem."),
            MODEM_MANAGER.to_owned(),
        ),
        name => (
            Level::Problem,
            format!("{name} (process {id}) holds the serial port {shown}."),
            format!("Close it, or end it: `kill {id}`."),
        ),
    };
    Finding::new(level, "serial_held", sentence, advice)
}

#[cfg(test)]
mod tests;
