//! The simulated camera: a PTP/IP responder on loopback that the unmodified libgphoto2 opens as a Canon EOS.
//!
//! It takes a [`View`] (what stands before the lens) and gives a port name for the real driver
//! (`ptpip:127.0.0.1:COMMANDS:EVENTS`). Packets are those of CIPA DC-005 (`ptpip`), operations those that
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

pub use fault::{Count, Fault, Late};
pub use options::{BodyOptions, Drive, Files, Focus, Mode};

use crate::studio::View;
use device::Device;
use plug::Plug;
use std::io;
use std::net::SocketAddr;
use std::sync::{Arc, Mutex, PoisonError};

/// A simulated camera that listens. Dropping it closes its links and ends its threads.
pub struct CameraServer {
    device: Arc<Device>,
    port: Mutex<String>,
}

impl CameraServer {
    /// Binds two free loopback ports and serves a body that looks at `view`: 1/125 s, f/11, ISO 100.
    pub fn start(view: Arc<dyn View>) -> io::Result<Self> {
        Self::start_with(view, &BodyOptions::default())
    }

    /// The same with a body that stands otherwise.
    pub fn start_with(view: Arc<dyn View>, options: &BodyOptions) -> io::Result<Self> {
        let server = Self { device: Device::new(view, options), port: Mutex::default() };
        server.replug()?;
        Ok(server)
    }

    /// The port by which libgphoto2 opens this camera, as model "PTP/IP Camera"; the last one while it is unplugged.
    pub fn port(&self) -> String {
        self.port.lock().unwrap_or_else(PoisonError::into_inner).clone()
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

    /// Frames in the body's memory that nobody has taken, announced or not.
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

    /// Plugs the camera in, where it is found under another port than before.
    pub fn replug(&self) -> io::Result<()> {
        self.device.unplug();
        let before = self.port();
        let (plug, port) = loop {
            let (plug, [commands, events]) = Plug::ptpip(&self.device)?;
            let port = port_name(commands, events);
            // The system may hand the same numbers out again.
            if port != before {
                break (plug, port);
            }
        };
        *self.port.lock().unwrap_or_else(PoisonError::into_inner) = port;
        self.device.plug_in(plug);
        Ok(())
    }
}

fn port_name(commands: SocketAddr, events: SocketAddr) -> String {
    format!("ptpip:{commands}:{}", events.port())
}

impl Drop for CameraServer {
    fn drop(&mut self) {
        self.device.stop();
    }
}
