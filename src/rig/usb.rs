//! Cameras on the USB bus, by libusb: which there are, word of their coming and going, and a reset for one whose
//! driver was killed.
//!
//! A camera shows an interface of the still-image class (USB class 6); libgphoto2 names its port
//! `usb:BBB,DDD` by bus and device address.

use rusb::{Context, Device, Hotplug, HotplugBuilder, UsbContext};
use serde::{Deserialize, Serialize};
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::JoinHandle;
use std::time::Duration;

/// Still-image capture, as the USB-IF numbers interface classes.
const STILL_IMAGE: u8 = 6;

/// A still-image device on the bus.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct UsbCamera {
    /// Bus number.
    pub bus: u8,
    /// Device address on the bus; another one after each plugging in.
    pub address: u8,
    /// Vendor id.
    pub vendor: u16,
    /// Product id.
    pub product: u16,
    /// Vendor's own name, where the device may be read.
    pub vendor_name: Option<String>,
    /// Product's own name, where the device may be read.
    pub product_name: Option<String>,
}

impl UsbCamera {
    /// The port by which libgphoto2 opens it.
    pub fn port(&self) -> String {
        format!("usb:{:03},{:03}", self.bus, self.address)
    }
}

/// What went wrong on the bus.
#[derive(Debug, thiserror::Error)]
pub enum UsbError {
    /// Not `usb:BBB,DDD`.
    #[error("`{0}` is no USB port; expected usb:BUS,DEVICE as in usb:001,004")]
    Port(String),
    /// It was unplugged.
    #[error(
        "nothing is plugged in at {0}; the camera has another port after each plugging in: list them again"
    )]
    Absent(String),
    /// libusb said no.
    #[error("USB {what} failed: {source}; may you use the device (udev rules of libgphoto2)?")]
    Bus {
        /// What was tried.
        what: String,
        /// What libusb said.
        source: rusb::Error,
    },
}

fn failed(what: impl Into<String>) -> impl FnOnce(rusb::Error) -> UsbError {
    let what = what.into();
    move |source| UsbError::Bus { what, source }
}

/// All devices; none on a machine without a bus.
fn devices() -> Result<Vec<Device<Context>>, UsbError> {
    let context = match Context::new() {
        // libusb cannot be initialised where the kernel offers no bus; there is then nothing to list.
        Err(_) if !Path::new("/dev/bus/usb").exists() => return Ok(Vec::new()),
        other => other.map_err(failed("initialisation"))?,
    };
    Ok(context.devices().map_err(failed("listing"))?.iter().collect())
}

fn is_still_image(device: &Device<Context>) -> bool {
    let Ok(config) = device.active_config_descriptor() else { return false };
    config.interfaces().flat_map(|i| i.descriptors()).any(|d| d.class_code() == STILL_IMAGE)
}

/// The still-image devices that are plugged in.
pub fn list() -> Result<Vec<UsbCamera>, UsbError> {
    plugged_in(true)
}

/// With their own names, each device is opened for a moment; without, none is touched.
fn plugged_in(with_names: bool) -> Result<Vec<UsbCamera>, UsbError> {
    let mut cameras = Vec::new();
    for device in devices()?.into_iter().filter(is_still_image) {
        // A device unplugged meanwhile has no descriptor, and no place in the list.
        let Ok(descriptor) = device.device_descriptor() else { continue };
        let handle = if with_names { device.open().ok() } else { None };
        let handle = handle.as_ref();
        cameras.push(UsbCamera {
            bus: device.bus_number(),
            address: device.address(),
            vendor: descriptor.vendor_id(),
            product: descriptor.product_id(),
            vendor_name: handle.and_then(|h| h.read_manufacturer_string_ascii(&descriptor).ok()),
            product_name: handle.and_then(|h| h.read_product_string_ascii(&descriptor).ok()),
        });
    }
    Ok(cameras)
}

fn parse(port: &str) -> Option<(u8, u8)> {
    let (bus, address) = port.strip_prefix("usb:")?.split_once(',')?;
    Some((bus.parse().ok()?, address.parse().ok()?))
}

/// Resets the device behind `usb:BBB,DDD`, as if it had been plugged out and in.
pub fn reset(port: &str) -> Result<(), UsbError> {
    let place = parse(port).ok_or_else(|| UsbError::Port(port.into()))?;
    let device = devices()?
        .into_iter()
        .find(|device| (device.bus_number(), device.address()) == place)
        .ok_or_else(|| UsbError::Absent(port.into()))?;
    device.open().and_then(|handle| handle.reset()).map_err(failed(format!("reset of {port}")))
}

/// How often a bus that cannot tell is looked at.
const POLL: Duration = Duration::from_secs(2);
/// How long libusb may wait for an event before it is asked whether the watch is over.
const PATIENCE: Duration = Duration::from_millis(250);

/// A watch on the bus; dropping it ends its thread.
#[must_use = "a watch that is dropped is over"]
pub struct Watch {
    over: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl Drop for Watch {
    fn drop(&mut self) {
        self.over.store(true, Ordering::Release);
        if let Some(thread) = self.thread.take() {
            thread.thread().unpark();
            // Whoever is told last may be in the middle of it; a panic of his is his own.
            let _ = thread.join();
        }
    }
}

/// Tells `on_change`, on a thread of its own, which cameras are plugged in whenever one comes or goes (names left
/// out). On a machine without a bus nothing ever changes.
pub fn watch(on_change: impl FnMut(&[UsbCamera]) + Send + 'static) -> std::io::Result<Watch> {
    let Ok(context) = Context::new() else {
        return Ok(Watch { over: Arc::default(), thread: None });
    };
    watch_by(
        move |over| {
            let bell = Arc::new(AtomicBool::new(false));
            let registered: Option<rusb::Registration<Context>> = rusb::has_hotplug()
                .then(|| HotplugBuilder::new().register(&context, Box::new(Bell(bell.clone()))).ok())
                .flatten();
            move || match &registered {
                Some(_) => {
                    while !over.load(Ordering::Acquire) && !bell.swap(false, Ordering::AcqRel) {
                        if let Err(error) = context.handle_events(Some(PATIENCE)) {
                            tracing::debug!("USB events: {error}");
                            std::thread::park_timeout(PATIENCE);
                        }
                    }
                }
                None => std::thread::park_timeout(POLL),
            }
        },
        || plugged_in(false).unwrap_or_default(),
        on_change,
    )
}

/// libusb must not be asked about devices from inside its own callback: it only rings.
struct Bell(Arc<AtomicBool>);

impl<T: UsbContext> Hotplug<T> for Bell {
    fn device_arrived(&mut self, _: Device<T>) {
        self.0.store(true, Ordering::Release);
    }

    fn device_left(&mut self, _: Device<T>) {
        self.0.store(true, Ordering::Release);
    }
}

/// The watch over any bus: `wait` returns when it may have changed, `look` says what is there.
fn watch_by<W: FnMut()>(
    wait: impl FnOnce(Arc<AtomicBool>) -> W + Send + 'static,
    mut look: impl FnMut() -> Vec<UsbCamera> + Send + 'static,
    mut on_change: impl FnMut(&[UsbCamera]) + Send + 'static,
) -> std::io::Result<Watch> {
    let over = Arc::new(AtomicBool::new(false));
    let told = over.clone();
    let mut seen = look();
    let thread = std::thread::Builder::new().name("usb-watch".into()).spawn(move || {
        let mut wait = wait(told.clone());
        loop {
            wait();
            if told.load(Ordering::Acquire) {
                return;
            }
            let now = look();
            if now != seen {
                seen = now;
                on_change(&seen);
            }
        }
    })?;
    Ok(Watch { over, thread: Some(thread) })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ports_read_as_libgphoto2_writes_them() {
        assert_eq!(parse("usb:001,004"), Some((1, 4)));
        for port in ["usb:", "usb:1", "usb:001,400", "ptpip:127.0.0.1", "usb:a,b"] {
            assert_eq!(parse(port), None, "{port}");
        }
    }

    fn camera(address: u8) -> UsbCamera {
        UsbCamera { bus: 1, address, vendor: 0x04a9, product: 0x3295, vendor_name: None, product_name: None }
    }

    #[test]
    fn a_watch_tells_of_each_change_once_and_ends_with_its_thread() {
        let (looks, bus) = std::sync::mpsc::channel();
        let (tell, told) = std::sync::mpsc::channel();
        let mut last = Vec::new();
        let look = move || {
            last = bus.try_recv().unwrap_or_else(|_| last.clone());
            last.clone()
        };
        let wait = |_| || std::thread::park_timeout(Duration::from_millis(1));
        let watch = watch_by(wait, look, move |now| tell.send(now.to_vec()).unwrap()).unwrap();
        let patience = Duration::from_secs(5);
        for now in [vec![camera(4)], vec![], vec![camera(5), camera(6)]] {
            looks.send(now.clone()).unwrap();
            assert_eq!(told.recv_timeout(patience).unwrap(), now);
        }
        looks.send(vec![camera(5), camera(6)]).unwrap();
        drop(watch);
        assert!(told.recv_timeout(patience).is_err(), "nothing changed, and the thread is gone");
    }

    #[test]
    fn watching_this_machines_bus_begins_and_ends() {
        drop(watch(|_| {}).unwrap());
    }

    #[test]
    fn a_machine_without_a_bus_has_an_empty_list() {
        list().unwrap();
    }

    #[test]
    fn a_reset_of_what_is_not_there_is_an_error_in_words() {
        let error = reset("usb:255,255").unwrap_err();
        assert!(matches!(error, UsbError::Absent(_)), "{error}");
        assert!(matches!(reset("ptpip:1"), Err(UsbError::Port(_))));
    }
}
