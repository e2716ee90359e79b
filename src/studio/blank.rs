//! A simulated board without its program: a boot loader that speaks STK500v1, as on an Arduino, until it was
//! programmed; then the port's name leads to a running [`Board`].
//!
//! The program that was written is kept and can be looked at, but what runs afterwards is the natively built core:
//! this shows that programming works up to the last byte on the wire, not what an ATmega makes of the bytes.

use super::{Board, BoardOptions};
use serialport::{SerialPort, TTYPort};
use std::io::{self, Read, Write};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;
use std::time::Duration;

/// The boot loader's turn, when no byte comes.
const TURN: Duration = Duration::from_millis(2);
/// The ATmega328P's signature, and its flash memory in bytes.
const SIGNATURE: [u8; 3] = [0x1E, 0x95, 0x0F];
const FLASH: usize = 32 * 1024;
/// STK500v1: end of a command, start and end of an answer.
const END: u8 = 0x20;
const IN_SYNC: u8 = 0x14;
const OK: u8 = 0x10;

/// A board that waits to be programmed.
pub struct BlankBoard {
    folder: tempfile::TempDir,
    memory: Arc<Mutex<Memory>>,
    stop: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
    /// What runs once it was programmed.
    _board: Board,
}

/// Faults and state of the boot loader.
struct Memory {
    flash: Vec<u8>,
    signature: [u8; 3],
    /// It answers nothing, like a board of another kind.
    deaf: bool,
    /// A cell that does not keep what is written.
    worn: Option<usize>,
}

impl BlankBoard {
    /// Powers it up.
    pub fn start(options: BoardOptions) -> io::Result<Self> {
        let board = Board::start(options)?;
        let folder = tempfile::tempdir()?;
        let (pair_master, slave) = TTYPort::pair()?;
        let mut master = pair_master.try_clone_native()?;
        drop(pair_master);
        master.set_timeout(TURN)?;
        let device: PathBuf =
            slave.name().ok_or_else(|| io::Error::other("the pseudo terminal has no name"))?.into();
        let port = folder.path().join("unlit-blank-board");
        std::os::unix::fs::symlink(device, &port)?;
        let memory = Memory { flash: vec![0xFF; FLASH], signature: SIGNATURE, deaf: false, worn: None };
        let memory = Arc::new(Mutex::new(memory));
        let stop = Arc::new(AtomicBool::new(false));
        let thread = std::thread::Builder::new().name("studio-loader".into()).spawn({
            let (memory, stop, running) = (memory.clone(), stop.clone(), board.device().to_owned());
            move || {
                serve(master, &memory, &stop, || {
                    if let Err(error) = lead(&port, &running) {
                        tracing::error!("simulated board does not start its program: {error}");
                    }
                });
            }
        })?;
        Ok(Self { folder, memory, stop, thread: Some(thread), _board: board })
    }

    /// The port's lasting name: first the boot loader's, then the running program's.
    pub fn port(&self) -> PathBuf {
        self.folder.path().join("unlit-blank-board")
    }

    /// The flash memory; erased bytes are 0xFF.
    pub fn flash(&self) -> Vec<u8> {
        lock(&self.memory).flash.clone()
    }

    /// Fault: it is another processor.
    pub fn set_signature(&self, signature: [u8; 3]) {
        lock(&self.memory).signature = signature;
    }

    /// Fault: its boot loader does not answer.
    pub fn set_deaf(&self) {
        lock(&self.memory).deaf = true;
    }

    /// Fault: the byte at this address does not keep what is written.
    pub fn wear(&self, address: usize) {
        lock(&self.memory).worn = Some(address);
    }
}

impl Drop for BlankBoard {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
        if let Some(thread) = self.thread.take() {
            // A panic of the thread has been printed; there is no one left to tell.
            let _ = thread.join();
        }
    }
}

/// A panic elsewhere leaves plain bytes behind.
fn lock(memory: &Mutex<Memory>) -> MutexGuard<'_, Memory> {
    memory.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Leads the name to another device, in one step.
fn lead(name: &Path, device: &Path) -> io::Result<()> {
    let aside = name.with_extension("next");
    std::os::unix::fs::symlink(device, &aside)?;
    std::fs::rename(aside, name)
}

/// Answers commands until one ends programming.
fn serve(mut master: TTYPort, memory: &Mutex<Memory>, stop: &AtomicBool, leave: impl Fn()) {
    let (mut heard, mut address) = (Vec::new(), 0);
    let mut bytes = [0u8; 512];
    while !stop.load(Ordering::Relaxed) {
        match master.read(&mut bytes) {
            Ok(count) => heard.extend_from_slice(&bytes[..count]),
            Err(error) if error.kind() == io::ErrorKind::TimedOut => {}
            // Nobody has the port open; poll(2) does not wait then.
            Err(_) => std::thread::sleep(TURN),
        }
        while let Some(length) = command_length(&heard) {
            let command: Vec<u8> = heard.drain(..length).collect();
            let mut memory = lock(memory);
            let answer = if memory.deaf { None } else { answer(&command, &mut memory, &mut address) };
            drop(memory);
            if let Some(answer) = answer
                && master.write_all(&answer).is_err()
            {
                tracing::debug!("no one reads the simulated boot loader");
            }
            if command[0] == b'Q' {
                leave();
            }
        }
    }
}

/// Length of the first command with its end, once it is whole.
fn command_length(heard: &[u8]) -> Option<usize> {
    let arguments = match heard.first()? {
        b'A' => 1,
        b'B' => 20,
        b'E' => 5,
        b'U' => 2,
        b'V' => 4,
        b't' => 3,
        b'd' => 3 + page_size(heard)?,
        _ => 0,
    };
    (heard.len() >= arguments + 2).then_some(arguments + 2)
}

fn page_size(command: &[u8]) -> Option<usize> {
    Some(usize::from(u16::from_be_bytes([*command.get(1)?, *command.get(2)?])))
}

/// `None` for what is no command: a loader says nothing then.
fn answer(command: &[u8], memory: &mut Memory, address: &mut usize) -> Option<Vec<u8>> {
    if command.last() != Some(&END) {
        return None;
    }
    let mut said = vec![IN_SYNC];
    match command[0] {
        b'0' | b'B' | b'E' | b'P' | b'Q' => {}
        b'A' => said.push(4), // versions and the like; the host only wants a number
        b'V' => said.push(0),
        b'u' => said.extend(memory.signature),
        b'U' => *address = 2 * usize::from(u16::from_le_bytes([command[1], command[2]])),
        b'd' => {
            let page = &command[4..command.len() - 1];
            memory.flash.get_mut(*address..*address + page.len())?.copy_from_slice(page);
            if let Some(cell) = memory.worn.and_then(|cell| memory.flash.get_mut(cell)) {
                *cell = 0;
            }
        }
        b't' => said.extend(memory.flash.get(*address..*address + page_size(command)?)?),
        _ => return None,
    }
    said.push(OK);
    Some(said)
}
