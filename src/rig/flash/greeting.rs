//! A short visit at a port: who is there? Nothing is fired, and the gate is closed afterwards.

use super::link::Link;
use crate::rig::FlashError;
use serde::Serialize;
use std::path::Path;
use std::sync::atomic::AtomicBool;

/// A controller as it introduces itself.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct Greeting {
    /// Firmware version.
    pub firmware: String,
    /// Processor.
    pub mcu: String,
    /// Number of its boot.
    pub boot: u32,
}

/// Greets what is behind the port; resets an Uno, and takes up to 4 s there.
pub fn greet(path: &Path) -> Result<Greeting, FlashError> {
    let (_link, hello) = Link::open(path, 0, &AtomicBool::new(false))?;
    Ok(Greeting { firmware: hello.firmware, mcu: hello.mcu, boot: hello.boot })
}
