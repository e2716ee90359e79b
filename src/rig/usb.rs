//! Cameras on the USB bus, by libusb: which there are, and a reset for one whose driver was killed.
//!
//! A camera shows an interface of the still-image class (USB class 6); libgphoto2 names its port
//! `usb:BBB,DDD` by bus and device address.

use rusb::{Context, Device, UsbContext};
use serde::{Deserialize, Serialize};
use std::path::Path;

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
    let mut cameras = Vec::new();
    for device in devices()?.into_iter().filter(is_still_image) {
        // A device unplugged meanwhile has no descriptor, and no place in the list.
        let Ok(descriptor) = device.device_descriptor() else { continue };
        let handle = device.open().ok();
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
