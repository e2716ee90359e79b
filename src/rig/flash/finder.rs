//! Finds the controller among this machine's serial ports without troubling what else is plugged in: opening a port
//! raises DTR, which resets an Arduino or a 3-D printer in the middle of its work.
//!
//! Only ports with the USB number of a likely board are greeted, none that another program has open, and what gave no
//! controller's answer is left in peace until it is plugged in again. A port that the user names is no matter of this
//! module: it is always opened.

use super::ports::{self, Port};
use super::{FlashSettings, SerialFlash};
use crate::rig::FlashError;
use crate::rig::system::{Identity, Roots};
use std::collections::{HashMap, HashSet};
use std::os::unix::fs::MetadataExt;
use std::path::PathBuf;
use std::sync::{Mutex, MutexGuard, PoisonError};

/// How often something is greeted in vain between two pluggings in: a stranger, and what stands where a controller once
/// answered, because that may be a controller still in its boot loader.
const CHANCES: (u32, u32) = (1, 5);

/// One plugging in of one device: its node, the node's inode and the USB address, which are new each time.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
struct Plugged {
    node: PathBuf,
    inode: Option<u64>,
    address: Option<String>,
}

impl Plugged {
    fn of(port: &Port) -> Self {
        Self {
            node: port.node.clone(),
            inode: std::fs::metadata(&port.node).ok().map(|about| about.ino()),
            address: port.usb.as_ref().and_then(|usb| usb.address.clone()),
        }
    }
}

/// What was learnt of the ports so far.
#[derive(Default)]
struct Memory {
    /// Vain greetings of what is plugged in.
    vain: HashMap<Plugged, u32>,
    /// Ports behind which a controller has answered, by their lasting names.
    homes: HashSet<PathBuf>,
}

/// Looks for a controller, and remembers whom it need not ask again.
pub struct Finder {
    roots: Roots,
    me: Identity,
    memory: Mutex<Memory>,
}

impl Finder {
    /// On the machine whose system folders are `roots`, for the user `me`.
    pub fn new(roots: Roots, me: Identity) -> Self {
        Self { roots, me, memory: Mutex::default() }
    }

    /// The first likely port behind which a controller answers; `None` where there is no likely port. With likely ports
    /// but no controller, the last port's error tells more than "none".
    pub fn open(&self, settings: FlashSettings) -> Result<Option<SerialFlash>, FlashError> {
        let ports = ports::survey(&self.roots, &self.me);
        let plugged: Vec<Plugged> = ports.iter().map(Plugged::of).collect();
        self.memory().vain.retain(|known, _| plugged.contains(known));
        let mut failure = None;
        for (port, plugged) in ports.iter().zip(plugged).filter(|(port, _)| port.is_likely()) {
            match self.try_one(port, plugged, settings) {
                Ok(flash) => return Ok(Some(flash)),
                Err(error) => failure = Some(error),
            }
        }
        failure.map_or(Ok(None), Err)
    }

    fn try_one(
        &self,
        port: &Port,
        plugged: Plugged,
        settings: FlashSettings,
    ) -> Result<SerialFlash, FlashError> {
        let name = port.path.display().to_string();
        if let Some(holder) = port.held_by.first() {
            return Err(FlashError::Open {
                port: name,
                reason: format!("{} (process {}) has it open", holder.name, holder.id),
                advice: "end that program, or name the controller's port (`--flash PORT`)".into(),
            });
        }
        let vain = self.memory().vain.get(&plugged).copied().unwrap_or(0);
        let chances = if self.memory().homes.contains(&port.path) { CHANCES.1 } else { CHANCES.0 };
        if vain >= chances {
            return Err(FlashError::Firmware {
                port: name,
                reason:
                    "it gave no controller's answer, and is not asked again (which may reset it) until it is \
                         plugged in anew"
                        .into(),
            });
        }
        let opened = SerialFlash::open_with(&port.path, settings);
        let mut memory = self.memory();
        match &opened {
            Ok(_) => {
                memory.vain.remove(&plugged);
                memory.homes.insert(port.path.clone());
            }
            Err(FlashError::Firmware { .. } | FlashError::Silent { .. }) => {
                memory.vain.insert(plugged, vain + 1);
            }
            // Nothing was asked, or a controller answered in part.
            Err(_) => {}
        }
        opened
    }

    /// A panic elsewhere leaves a valid memory behind.
    fn memory(&self) -> MutexGuard<'_, Memory> {
        self.memory.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Default for Finder {
    /// On this machine, for this process.
    fn default() -> Self {
        Self::new(Roots::default(), Identity::own())
    }
}
