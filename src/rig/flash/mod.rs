//! The flash controller on a serial port: `firmware/PROTOCOL.md` spoken from the host's side.
//!
//! [`SerialFlash`] implements [`Flash`]. One thread owns the port; the driver talks to it over channels, so
//! that pings, retries and reconnecting go on while nobody asks for anything. A board that restarted has
//! forgotten its shots and closed its gate: the next [`Flash::syncs`] says so instead of guessing.
//! `docs/flash.md` tells the same to the one who shoots.

mod clock;
mod condition;
mod finder;
mod greeting;
pub(crate) mod line;
mod link;
mod news;
pub mod ports;
pub mod pulse;
mod settings;
mod shared;
pub mod trial;
pub mod upload;
mod worker;

pub use clock::ClockState;
pub use finder::Finder;
pub use greeting::{Greeting, greet};
pub use news::{FlashEvent, FlashNews};
pub use ports::list;
pub use settings::{BoardSettings, FlashSettings};

use self::line::Fields;
use self::shared::Shared;
use self::worker::{Order, What, Worker};
use super::{Closer, Flash, FlashError, FlashStatus, RECYCLE_PATIENCE};
use crate::pair::FlashSync;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::sync::mpsc::{Receiver, Sender, channel};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

/// Shortest pause between questions whether the flash has recycled.
const RECYCLE_STEP: Duration = Duration::from_millis(10);
/// How long arming waits for the flash by itself: longer waits are the caller's, who can be told to stop.
const ARM_PATIENCE: Duration = Duration::from_secs(1);
/// A trial waits for any recycle time that the board keeps (a minute), and whoever runs it can end the program.
const FIRE_PATIENCE: Duration = Duration::from_secs(61);
/// How long closing the gate from the side waits for the board's word.
const CLOSE_PATIENCE: Duration = Duration::from_secs(2);
/// The board's errors that mean "later".
const NOT_READY: u32 = 10;
const RATE: u32 = 12;

/// A flash controller on a serial port.
pub struct SerialFlash {
    port: String,
    /// The thread ends with the last sender: nobody else keeps one.
    orders: Option<Arc<Sender<Order>>>,
    shared: Arc<Shared>,
    thread: Option<JoinHandle<()>>,
}

impl SerialFlash {
    /// Opens the port (a path of [`list`], or a simulated board's) and greets the board, whose own settings stay. The
    /// gate is closed then. Takes up to 4 s on a board that resets when its port is opened.
    pub fn open(path: &Path) -> Result<Self, FlashError> {
        Self::open_with(path, FlashSettings::default())
    }

    /// [`SerialFlash::open`] with settings, which are sent again whenever the board restarts.
    pub fn open_with(path: &Path, settings: FlashSettings) -> Result<Self, FlashError> {
        let shared = Arc::new(Shared::default());
        let worker = Worker::open(path.to_owned(), settings, shared.clone())?;
        let (orders, receiver) = channel();
        let port = path.display().to_string();
        let thread = std::thread::Builder::new()
            .name("flash".into())
            .spawn(move || worker.run(&receiver))
            .map_err(|error| FlashError::Open {
                port: port.clone(),
                reason: error.to_string(),
                advice: "the system gives no more threads; close other programs".into(),
            })?;
        Ok(Self { port, orders: Some(Arc::new(orders)), shared, thread: Some(thread) })
    }

    /// Who answers: firmware, processor, port.
    pub fn description(&self) -> String {
        self.shared.lock().description.clone()
    }

    /// The settings that are in force on the board.
    pub fn settings(&self) -> Option<BoardSettings> {
        self.shared.lock().settings
    }

    /// How the board's clock runs against this computer's.
    pub fn clock(&self) -> Option<ClockState> {
        self.shared.lock().clock
    }

    /// Everything that happens from now on, as it happens. Ends with the driver.
    pub fn follow(&self) -> Receiver<FlashEvent> {
        self.shared.follow()
    }

    /// Fires the flash `delay` after the board has the order, without any sync; waits for the flash to recycle, a minute at most.
    /// `tag` comes back in [`Flash::syncs`]. Never used while pairs are shot.
    pub fn fire(&mut self, tag: u32, delay: Duration) -> Result<(), FlashError> {
        self.disarm()?;
        self.once_recycled(&format!("fire d={} tag={tag}", delay.as_micros()), FIRE_PATIENCE)
    }

    /// What the photodiode's converter reads now, counts of 1023.
    pub fn light_level(&mut self) -> Result<u32, FlashError> {
        let fields = self.ask("adc ch=0", false)?;
        fields.uint("v").ok_or_else(|| FlashError::Firmware {
            port: self.port.clone(),
            reason: "its answer to adc lacks a number of protocol 1".into(),
        })
    }

    fn order(&self, what: What) -> Result<Fields, FlashError> {
        let gone = || FlashError::Lost { port: self.port.clone(), reason: "its driver thread ended".into() };
        let (answer, result) = channel();
        self.orders.as_ref().ok_or_else(gone)?.send(Order { what, answer }).map_err(|_| gone())?;
        result.recv().map_err(|_| gone())?
    }

    fn ask(&self, body: &str, fresh: bool) -> Result<Fields, FlashError> {
        self.order(What::Ask { body: body.to_owned(), fresh })
    }

    /// Repeats a request that opens a frame while the flash recycles, as long as that ends within `patience`.
    fn once_recycled(&self, request: &str, patience: Duration) -> Result<(), FlashError> {
        let begun = Instant::now();
        loop {
            match self.ask(request, true) {
                Err(FlashError::Refused { code: NOT_READY | RATE, .. }) => {
                    let stat = self.ask("stat", false)?;
                    let wait_ms = stat.uint("wait").unwrap_or(0);
                    let wait = Duration::from_millis(u64::from(wait_ms)).max(RECYCLE_STEP);
                    let awaited = self.settings().is_some_and(|settings| settings.ready_output);
                    let low = awaited && wait_ms == 0 && stat.uint("ready") == Some(0);
                    // No time tells how long the output stays low.
                    let patience = if low { patience.min(RECYCLE_PATIENCE) } else { patience };
                    if begun.elapsed() + wait > patience {
                        return Err(match low {
                            true => FlashError::ReadyLow,
                            false => FlashError::NotReady { wait_ms: wait.as_millis() as u64 },
                        });
                    }
                    std::thread::sleep(wait);
                }
                result => return result.map(|_| ()),
            }
        }
    }
}

impl Flash for SerialFlash {
    /// Never waits for a board that is away.
    fn status(&mut self) -> FlashStatus {
        if self.shared.lock().condition.away.is_none()
            && let Err(error) = self.ask("stat", false)
        {
            tracing::debug!(%error, "flash status");
        }
        let state = self.shared.lock();
        let (ready, words) = state.condition.words(&self.port, Instant::now());
        FlashStatus { description: state.description.clone(), ready, words }
    }

    fn arm(&mut self, tag: u32, time_to_live: Duration) -> Result<(), FlashError> {
        self.disarm()?;
        self.once_recycled(&format!("arm tag={tag} ttl={}", time_to_live.as_millis()), ARM_PATIENCE)?;
        self.shared.lock().condition.armed_until = Some(Instant::now() + time_to_live);
        Ok(())
    }

    fn disarm(&mut self) -> Result<(), FlashError> {
        self.ask("disarm", true).map(|_| ())
    }

    fn closer(&self) -> Option<Closer> {
        let (orders, port) = (Arc::downgrade(self.orders.as_ref()?), self.port.clone());
        Some(Arc::new(move || {
            // Who is closed has closed the gate.
            let Some(orders) = orders.upgrade() else { return Ok(()) };
            let lost = |reason: &str| FlashError::Lost { port: port.clone(), reason: reason.into() };
            let (answer, result) = channel();
            let what = What::Ask { body: "disarm".into(), fresh: false };
            orders.send(Order { what, answer }).map_err(|_| lost("its driver thread ended"))?;
            drop(orders);
            let answered = result.recv_timeout(CLOSE_PATIENCE);
            answered.map_err(|_| lost("it did not say in time that its gate is closed"))?.map(|_| ())
        }))
    }

    /// A sync whose contact closed before the call is in the answer, or the answer is an error: whatever came in, the
    /// board is asked once more what it has counted, after the time that a report may take.
    fn syncs(&mut self, patience: Duration) -> Result<Vec<FlashSync>, FlashError> {
        let begun = Instant::now();
        self.shared.wait(patience);
        let report = self.settings().map_or(Duration::ZERO, |settings| settings.report_delay());
        std::thread::sleep(report.saturating_sub(begun.elapsed()));
        self.order(What::Audit)?;
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
        // Without orders the thread closes the gate and ends.
        self.shared.stop.store(true, Ordering::Relaxed);
        self.orders = None;
        if let Some(thread) = self.thread.take() {
            // A panic of the thread has been printed; there is no one left to tell.
            let _ = thread.join();
        }
    }
}
