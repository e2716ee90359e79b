//! The flash controller on a serial port: `firmware/PROTOCOL.md` spoken from the host's side.
//!
//! [`SerialFlash`] implements [`Flash`]. One thread owns the port; the driver talks to it over channels, so
//! that pings, retries and reconnecting go on while nobody asks for anything. A board that restarted has
//! forgotten its shots and closed its gate: the next [`Flash::syncs`] says so instead of guessing.

pub(crate) mod line;
mod link;
mod ports;
mod worker;

pub use ports::list;

use self::line::Fields;
use self::link::Link;
use self::worker::{Command, Shared, Worker};
use super::{Flash, FlashError, FlashStatus};
use crate::pair::FlashSync;
use std::path::Path;
use std::sync::Arc;
use std::sync::mpsc::{Sender, channel};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

/// The longest recycling that is worth waiting for.
const RECYCLE_PATIENCE: Duration = Duration::from_secs(15);
/// Shortest pause between questions whether the flash has recycled.
const RECYCLE_STEP: Duration = Duration::from_millis(10);
/// The board's errors that mean "later".
const NOT_READY: u32 = 10;
const RATE: u32 = 12;

/// A flash controller on a serial port.
pub struct SerialFlash {
    port: String,
    commands: Option<Sender<Command>>,
    shared: Arc<Shared>,
    thread: Option<JoinHandle<()>>,
}

impl SerialFlash {
    /// Opens the port (a path of [`list`], or a simulated board's) and greets the board. The gate is closed
    /// then. Takes up to 4 s on a board that resets when its port is opened.
    pub fn open(path: &Path) -> Result<Self, FlashError> {
        let (link, hello) = Link::open(path)?;
        let shared = Arc::new(Shared::default());
        let worker = Worker::new(path.to_owned(), link, &hello, shared.clone());
        let (commands, receiver) = channel();
        let port = path.display().to_string();
        let thread = std::thread::Builder::new()
            .name("flash".into())
            .spawn(move || worker.run(&receiver))
            .map_err(|error| FlashError::Open { port: port.clone(), reason: error.to_string() })?;
        Ok(Self { port, commands: Some(commands), shared, thread: Some(thread) })
    }

    fn ask(&self, body: &str, fresh: bool) -> Result<Fields, FlashError> {
        let gone = || FlashError::Lost { port: self.port.clone(), reason: "its driver thread ended".into() };
        let (answer, result) = channel();
        let command = Command { body: body.to_owned(), fresh, answer };
        self.commands.as_ref().ok_or_else(gone)?.send(command).map_err(|_| gone())?;
        result.recv().map_err(|_| gone())?
    }

    /// What the board says about itself now, in words; an error if it does not answer.
    fn condition(&self) -> Result<(bool, String), FlashError> {
        let stat = self.ask("stat", false)?;
        if stat.uint("closed") == Some(1) {
            let words = "the camera's sync contact is closed; if it stays so, check the cable and the camera";
            return Ok((false, words.into()));
        }
        if stat.uint("ready") == Some(1) {
            return Ok((true, "ready".into()));
        }
        Ok((true, format!("recycling, {} ms to go", stat.uint("wait").unwrap_or(0))))
    }
}

impl Flash for SerialFlash {
    fn status(&mut self) -> FlashStatus {
        let (ready, words) = self.condition().unwrap_or_else(|error| (false, error.to_string()));
        FlashStatus { description: self.shared.lock().description.clone(), ready, words }
    }

    fn arm(&mut self, tag: u32, time_to_live: Duration) -> Result<(), FlashError> {
        self.disarm()?;
        let deadline = Instant::now() + RECYCLE_PATIENCE;
        let request = format!("arm tag={tag} ttl={}", time_to_live.as_millis());
        loop {
            match self.ask(&request, true) {
                Err(FlashError::Refused { code: NOT_READY | RATE, .. }) => {
                    let wait_ms = self.ask("stat", false)?.uint("wait").unwrap_or(0);
                    let wait = Duration::from_millis(u64::from(wait_ms)).max(RECYCLE_STEP);
                    if Instant::now() + wait > deadline {
                        return Err(FlashError::NotReady { wait_ms: wait.as_millis() as u64 });
                    }
                    std::thread::sleep(wait);
                }
                result => return result.map(|_| ()),
            }
        }
    }

    fn disarm(&mut self) -> Result<(), FlashError> {
        self.ask("disarm", true).map(|_| ())
    }

    fn syncs(&mut self, patience: Duration) -> Result<Vec<FlashSync>, FlashError> {
        let quiet = {
            let state = self.shared.wait(patience);
            state.shots.is_empty() && state.broken.is_none()
        };
        if quiet {
            // Nothing was heard; the answer to a ping tells whether a report was lost on its way.
            self.ask("ping", false)?;
        }
        let mut state = self.shared.lock();
        let shots = std::mem::take(&mut state.shots);
        match state.broken.take() {
            Some(reason) => Err(FlashError::Lost { port: self.port.clone(), reason }),
            None => Ok(shots),
        }
    }
}

impl Drop for SerialFlash {
    fn drop(&mut self) {
        // Without commands the thread closes the gate and ends.
        self.commands = None;
        if let Some(thread) = self.thread.take() {
            // A panic of the thread has been printed; there is no one left to tell.
            let _ = thread.join();
        }
    }
}
