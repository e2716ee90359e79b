//! The simulated camera: a PTP responder that the unmodified libgphoto2 opens as a Canon EOS.
//!
//! It takes a [`View`] (what stands before the lens) and gives a port name for the real driver: a network port on
//! loopback (`ptpip:127.0.0.1:COMMANDS:EVENTS`), or an address on a simulated USB bus (`usb:001,004`). Packets are those
//! of CIPA DC-005 (`ptpip`) and of the still image class (`usb`), operations those that
//! libgphoto2's ptp2 driver was seen to use with an EOS (`operate`, `datasets`); the body is in M,
//! manual focus, RAW alone unless [`BodyOptions`] say otherwise (`body`, `properties`, `dials`, `objects`).
//!
//! The object is announced in Canon's format b103, so libgphoto2 names it `capt0000.cr2`, whatever name the
//! body gave; the bytes are those that [`View::expose`] returned, unchanged, and say themselves that they
//! are a DNG.

mod body;
mod datasets;
mod device;
mod dials;
mod fault;
mod objects;
mod operate;
mod options;
mod plug;
mod properties;
mod ptpip;
mod request;
mod usb;

pub use fault::{Count, Fault, Late};
pub use options::{BodyOptions, Drive, Files, Focus, Mode};

use crate::studio::View;
use device::Device;
use plug::Plug;
use std::net::SocketAddr;
use std::path::{Path, PathBuf};
use std::str::FromStr;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::{fmt, io};

/// A simulated camera that listens. Dropping it closes its links and ends its threads.
pub struct CameraServer {
    device: Arc<Device>,
    socket: Mutex<Socket>,
}

/// Where the plug is, or was.
enum Socket {
    /// PTP/IP, commands and events.
    Network([SocketAddr; 2]),
    /// A folder that stands for a bus, and bus and device number on it.
    Usb(PathBuf, UsbAddress),
}

/// Bus and device number, `001,004` in words.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct UsbAddress {
    bus: u8,
    device: u8,
}

impl UsbAddress {
    /// The number that a bus gives next.
    fn next(self) -> Self {
        let device = if self.device >= 127 { 1 } else { self.device + 1 };
        Self { device, ..self }
    }
}

impl FromStr for UsbAddress {
    type Err = io::Error;

    fn from_str(text: &str) -> io::Result<Self> {
        let number = |digits: &str| digits.parse::<u8>().ok().filter(|n| digits.len() == 3 && *n > 0);
        text.split_once(',')
            .and_then(|(bus, device)| Some(Self { bus: number(bus)?, device: number(device)? }))
            .ok_or_else(|| {
                let message = format!("{text} is no USB address; give bus and device as in 001,004");
                io::Error::new(io::ErrorKind::InvalidInput, message)
            })
    }
}

impl fmt::Display for UsbAddress {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{:03},{:03}", self.bus, self.device)
    }
}

impl CameraServer {
    /// Binds two free loopback ports and serves a body that looks at `view`: 1/125 s, f/11, ISO 100.
    pub fn start(view: Arc<dyn View>) -> io::Result<Self> {
        Self::start_with(view, &BodyOptions::default())
    }

    /// The same with a body that stands otherwise.
    pub fn start_with(view: Arc<dyn View>, options: &BodyOptions) -> io::Result<Self> {
        let device = Device::new(view, options);
        let (plug, addresses) = Plug::ptpip(&device)?;
        device.plug_in(plug);
        Ok(Self { device, socket: Mutex::new(Socket::Network(addresses)) })
    }

    /// Serves a body on a simulated USB bus: a socket in `folder` named by `address`, bus and device number as in
    /// `001,004`. libgphoto2 sees it with the stand-in for its USB port driver (`src/studio/usb/usb1.c`) in the folder
    /// that `IOLIBS` names, and `folder` in `UNLIT_STUDIO_USB`.
    pub fn start_usb(view: Arc<dyn View>, folder: &Path, address: &str) -> io::Result<Self> {
        Self::start_usb_with(view, folder, address, &BodyOptions::default())
    }

    /// The same with a body that stands otherwise.
    pub fn start_usb_with(
        view: Arc<dyn View>,
        folder: &Path,
        address: &str,
        options: &BodyOptions,
    ) -> io::Result<Self> {
        let device = Device::new(view, options);
        let address: UsbAddress = address.parse()?;
        device.plug_in(Plug::usb(&device, &folder.join(address.to_string()))?);
        Ok(Self { device, socket: Mutex::new(Socket::Usb(folder.to_owned(), address)) })
    }

    /// The port by which libgphoto2 opens this camera, as model "PTP/IP Camera" on a network port, by detection on a USB
    /// port; the last one while it is unplugged.
    pub fn port(&self) -> String {
        match &*self.socket() {
            Socket::Network([commands, events]) => format!("ptpip:{commands}:{}", events.port()),
            Socket::Usb(_, address) => format!("usb:{address}"),
        }
    }

    fn socket(&self) -> MutexGuard<'_, Socket> {
        self.socket.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Arms a fault, after those that are armed already: it strikes at the next operation that suits it.
    /// [`Fault::Unplug`] strikes at once.
    pub fn fault(&self, fault: Fault) {
        if fault == Fault::Unplug {
            self.unplug();
        } else {
            self.device.faults().arm(fault);
        }
    }

    /// Arms each fault at the PTP operation with its number, counted from 1 at the start of the server; a number that
    /// has passed arms at the next.
    pub fn script(&self, script: impl IntoIterator<Item = (u64, Fault)>) {
        self.device.faults().plan(script);
    }

    /// Arms one of `faults`, picked by `seed`, at every `every`th operation or release. An `every` of 0 ends it.
    pub fn fault_every(&self, count: Count, every: u64, seed: u64, faults: &[Fault]) {
        self.device.faults().repeat(count, every, seed, faults);
    }

    /// Mends whatever is armed or stands. The script and the repeating rule go on; a pulled plug stays pulled.
    pub fn mend(&self) {
        self.device.mend();
    }

    /// PTP operations since the start.
    pub fn operations(&self) -> u64 {
        self.device.faults().operations
    }

    /// Presses of the release since the start, refused ones too.
    pub fn releases(&self) -> u64 {
        self.device.faults().releases
    }

    /// Files in the body's memory that nobody has taken, announced or not; a frame with RAW and JPEG is two.
    pub fn frames_waiting(&self) -> usize {
        self.device.body().map_or(0, |body| body.waiting())
    }

    /// Files on the card.
    pub fn files_on_card(&self) -> usize {
        self.device.body().map_or(0, |mut body| body.objects().on_card())
    }

    /// Turns the mode dial, as only the photographer can.
    pub fn turn_mode_dial(&self, mode: Mode) {
        if let Ok(mut body) = self.device.body() {
            body.turn_mode_dial(mode);
        }
    }

    /// Moves the focus switch on the lens, as only the photographer can.
    pub fn switch_focus(&self, focus: Focus) {
        if let Ok(mut body) = self.device.body() {
            body.switch_focus(focus);
        }
    }

    /// The faults that have struck, in order.
    pub fn struck(&self) -> Vec<Fault> {
        self.device.faults().struck().to_vec()
    }

    /// Pulls the plug: all links drop, and whoever connects is refused.
    pub fn unplug(&self) {
        self.device.faults().note(Fault::Unplug);
        self.device.unplug();
    }

    /// Whether clients can connect.
    pub fn plugged(&self) -> bool {
        self.device.plugged()
    }

    /// Plugs the camera in, where it is found under another port than before: the next device number, or a network
    /// port that the system chooses.
    pub fn replug(&self) -> io::Result<()> {
        self.device.unplug();
        let mut socket = self.socket();
        match &mut *socket {
            Socket::Network(addresses) => {
                let before = *addresses;
                let plug = loop {
                    let (plug, now) = Plug::ptpip(&self.device)?;
                    // The system may hand the same numbers out again.
                    if now[0] != before[0] {
                        *addresses = now;
                        break plug;
                    }
                };
                self.device.plug_in(plug);
            }
            Socket::Usb(folder, address) => {
                let next = address.next();
                self.device.plug_in(Plug::usb(&self.device, &folder.join(next.to_string()))?);
                *address = next;
            }
        }
        Ok(())
    }
}

impl Drop for CameraServer {
    fn drop(&mut self) {
        self.device.stop();
    }
}
