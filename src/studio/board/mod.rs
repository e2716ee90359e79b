//! The simulated flash controller: the firmware's own core, built natively, on a pseudo terminal.
//!
//! [`Board::start`] gives a device path that the real serial driver opens. The simulated camera closes the
//! sync contact ([`SyncContact`]); the core alone decides whether the trigger rises; only then the simulated
//! flash fires, and the photodiode that the core reads sees its light.

#[expect(unsafe_code, reason = "calls the C core; every block has its SAFETY line")]
mod core;
mod light;
#[cfg(test)]
mod model;
#[cfg(test)]
mod tests;

use self::core::{Config, Core};
use self::light::{Diode, Lamp};
use super::SyncContact;
use serialport::{SerialPort, TTYPort};
use std::io::{self, Read, Write};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, AtomicU16, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

/// Time between photodiode samples, us; `CORE_SAMPLE_US` of the core.
const SAMPLE_US: u64 = 13;
/// How long after an edge every sample is simulated, us; longer than the core's window.
const WINDOW_US: u64 = 25_000;
/// Samples of darkness at power-on, so that a shot at once is measured as well as a later one.
const SETTLING_SAMPLES: u64 = 1024;
/// The board's turn, when no byte comes from the host; a sample of darkness each, as `CORE_IDLE_US` asks.
const TURN: Duration = Duration::from_millis(1);

/// How the simulated flash behaves.
#[derive(Clone, Copy, Debug)]
pub struct BoardOptions {
    /// Seed of jitter and noise.
    pub seed: u64,
    /// Standard deviation of the flash's energy, relative.
    pub jitter_sd: f64,
    /// Recycle time of the flash, which the board keeps too.
    pub recycle: Duration,
}

impl Default for BoardOptions {
    /// The jitter that the thesis measured, and a recycle time short enough for a demonstration.
    fn default() -> Self {
        Self { seed: 1, jitter_sd: 0.0029, recycle: Duration::from_millis(150) }
    }
}

/// What is on the bench: controller, flash, diode and the clock they share.
struct Bench {
    core: Core,
    lamp: Lamp,
    diode: Diode,
    options: BoardOptions,
    started: Instant,
    /// When the core last booted; its clock starts there, us.
    booted: u64,
    /// Lines to the host that the wire is yet to lose: events, answers.
    lose: (u32, u32),
    /// Time of the next photodiode sample, us.
    next_sample: u64,
    /// Until when every sample is simulated, us.
    window_until: u64,
}

impl Bench {
    fn new(options: BoardOptions) -> io::Result<Self> {
        let rec_ms = u16::try_from(options.recycle.as_millis()).ok().filter(|ms| *ms <= 60_000);
        let rec_ms = rec_ms.ok_or_else(|| {
            io::Error::new(io::ErrorKind::InvalidInput, "recycle time of the simulated flash: at most 60 s")
        })?;
        if !(0.0..0.5).contains(&options.jitter_sd) {
            let message = "jitter of the simulated flash: a relative standard deviation in 0..0.5";
            return Err(io::Error::new(io::ErrorKind::InvalidInput, message));
        }
        let mut bench = Self {
            core: Core::new(Config { rec_ms, ..Config::default() }, next_boot(), 0),
            lamp: Lamp::new(options.seed, options.jitter_sd, options.recycle),
            diode: Diode::new(options.seed ^ 0x5EED_D10D),
            options,
            started: Instant::now(),
            booted: 0,
            lose: (0, 0),
            next_sample: 0,
            window_until: 0,
        };
        bench.settle();
        Ok(bench)
    }

    fn settle(&mut self) {
        for _ in 0..SETTLING_SAMPLES {
            let counts = self.diode.sample(self.next_sample);
            self.core.light_sample(counts);
        }
    }

    /// Time since the bench was set up, us.
    fn now(&self) -> u64 {
        self.started.elapsed().as_micros() as u64
    }

    /// The core's clock: time since its boot, modulo 2^32.
    fn core_time(&self, now: u64) -> u32 {
        (now - self.booted) as u32
    }

    /// Lets time pass up to `now`: light first, so that the core never judges a window it has not seen.
    fn advance(&mut self, now: u64) {
        self.sample_until(now.min(self.window_until));
        self.next_sample = self.next_sample.max(now);
        self.sample_until(now);
        let rises = self.core.rises();
        let core_time = self.core_time(now);
        self.core.poll(core_time);
        if self.core.rises() > rises {
            self.fire(now);
        }
    }

    fn sample_until(&mut self, end: u64) {
        while self.next_sample <= end {
            let counts = self.diode.sample(self.next_sample);
            self.core.pins().adc = counts;
            self.core.light_sample(counts);
            self.next_sample += SAMPLE_US;
        }
    }

    fn open_window(&mut self, now: u64) {
        self.next_sample = now;
        self.window_until = now + WINDOW_US;
    }

    fn fire(&mut self, now: u64) -> f64 {
        let energy = self.lamp.trigger(now);
        self.diode.light(now, energy);
        self.open_window(now);
        energy
    }

    fn close_contact(&mut self) -> f64 {
        let now = self.now();
        self.advance(now);
        let core_time = self.core_time(now);
        if self.core.sync_edge(core_time) {
            return self.fire(now);
        }
        self.open_window(now);
        0.0
    }

    fn exchange(&mut self, from_host: &[u8]) -> Vec<u8> {
        let now = self.now();
        self.advance(now);
        let core_time = self.core_time(now);
        self.core.receive(from_host, core_time);
        let mut sent = self.core.sent();
        if self.lose != (0, 0) {
            sent = self.without_lost_lines(&sent);
        }
        sent
    }

    fn without_lost_lines(&mut self, sent: &[u8]) -> Vec<u8> {
        let lost = |line: &&[u8]| {
            let left = if line.starts_with(b"!") { &mut self.lose.0 } else { &mut self.lose.1 };
            let lost = *left > 0;
            *left -= u32::from(lost);
            !lost
        };
        sent.split_inclusive(|byte| *byte == b'\n').filter(lost).flatten().copied().collect()
    }

    fn reset(&mut self) {
        self.booted = self.now();
        let rec_ms = self.options.recycle.as_millis() as u16;
        self.core = Core::new(Config { rec_ms, ..Config::default() }, next_boot(), 0);
        self.settle();
    }
}

/// A real board counts its boots in EEPROM; simulated ones share a counter, so that no two are mistaken.
fn next_boot() -> u16 {
    static BOOTS: AtomicU16 = AtomicU16::new(1);
    BOOTS.fetch_add(1, Ordering::Relaxed)
}

/// A running board. Dropping it unplugs it: the driver's port breaks.
pub struct Board {
    bench: Arc<Mutex<Bench>>,
    device: PathBuf,
    stop: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl Board {
    /// Powers a board up on a new pseudo terminal.
    pub fn start(options: BoardOptions) -> io::Result<Self> {
        let (pair_master, slave) = TTYPort::pair()?;
        // A copy that children do not inherit; else a camera host would keep an unplugged board alive.
        let mut master = pair_master.try_clone_native()?;
        drop(pair_master);
        master.set_timeout(TURN)?;
        let device = slave.name().ok_or_else(|| io::Error::other("the pseudo terminal has no name"))?.into();
        let bench = Arc::new(Mutex::new(Bench::new(options)?));
        let stop = Arc::new(AtomicBool::new(false));
        let thread = std::thread::Builder::new().name("studio-board".into()).spawn({
            let (bench, stop) = (bench.clone(), stop.clone());
            move || run(master, &bench, &stop)
        })?;
        Ok(Self { bench, device, stop, thread: Some(thread) })
    }

    /// The serial device that a driver opens.
    pub fn device(&self) -> &Path {
        &self.device
    }

    /// Fault: the next `count` triggers give no light.
    pub fn misfire(&self, count: u32) {
        lock(&self.bench).lamp.misfire(count);
    }

    /// Fault: the wire loses the next so many events and answers.
    pub fn lose(&self, events: u32, answers: u32) {
        lock(&self.bench).lose = (events, answers);
    }

    /// Fault: the board resets, as after a brown-out; it forgets everything and boots with a new number.
    pub fn reset(&self) {
        lock(&self.bench).reset();
    }
}

impl SyncContact for Board {
    fn close(&self) -> f64 {
        lock(&self.bench).close_contact()
    }
}

impl Drop for Board {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
        if let Some(thread) = self.thread.take() {
            // A panic of the board's thread has been printed; there is no one left to tell.
            let _ = thread.join();
        }
    }
}

/// A panic elsewhere leaves the bench as whole as it was: no step of it spans two calls.
fn lock(bench: &Mutex<Bench>) -> MutexGuard<'_, Bench> {
    bench.lock().unwrap_or_else(PoisonError::into_inner)
}

/// The wire between pseudo terminal and core. Bytes that no one listens to are lost, as on a real wire.
fn run(mut master: TTYPort, bench: &Mutex<Bench>, stop: &AtomicBool) {
    let mut buffer = [0u8; 256];
    while !stop.load(Ordering::Relaxed) {
        let (count, listened) = match master.read(&mut buffer) {
            Ok(count) => (count, true),
            Err(error) if error.kind() == io::ErrorKind::TimedOut => (0, true),
            Err(_) => {
                // No driver has the port open; poll(2) does not wait then.
                std::thread::sleep(TURN);
                (0, false)
            }
        };
        let sent = lock(bench).exchange(&buffer[..count]);
        if listened && !sent.is_empty() && master.write_all(&sent).is_err() {
            tracing::debug!(lost = sent.len(), "no one reads the simulated board");
        }
    }
}
