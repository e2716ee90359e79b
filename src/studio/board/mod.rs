//! The simulated flash controller: the firmware's own core, built natively, on a pseudo terminal.
//!
//! [`Board::start`] gives a device path that the real serial driver opens. The simulated camera closes the
//! sync contact ([`SyncContact`]); the core alone decides whether the trigger rises; only then the simulated
//! flash fires, and the photodiode that the core reads sees its light.

#[expect(unsafe_code, reason = "calls the C core; every block has its SAFETY line")]
mod core;
mod ledger;
mod light;
#[cfg(test)]
mod model;
#[cfg(test)]
mod tests;

pub use self::ledger::Rise;
pub use self::light::{Heat, LampOptions, Recharge};

use self::core::{Config, Core};
use self::ledger::Ledger;
use self::light::{Diode, Lamp};
use super::SyncContact;
use serialport::{SerialPort, TTYPort};
use std::io::{self, Read, Write};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicBool, AtomicU16, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};
use tempfile::TempDir;

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
    /// What else makes one pulse differ from the next; nothing by default.
    pub lamp: LampOptions,
}

impl Default for BoardOptions {
    /// The jitter that the thesis measured, and a recycle time short enough for a demonstration.
    fn default() -> Self {
        Self { seed: 1, jitter_sd: 0.0029, recycle: Duration::from_millis(150), lamp: LampOptions::default() }
    }
}

/// What is on the bench: controller, flash, diode and the clock they share.
struct Bench {
    core: Core,
    lamp: Lamp,
    diode: Diode,
    ledger: Ledger,
    /// What the host has sent of a line not yet ended.
    half_a_line: Vec<u8>,
    /// Without power nothing happens at all.
    powered: bool,
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
        if let Err(message) = options.lamp.check() {
            return Err(io::Error::new(io::ErrorKind::InvalidInput, message));
        }
        let config = Config { rec_ms, ..Config::default() };
        let mut bench = Self {
            core: Core::new(config, next_boot(), 0),
            lamp: Lamp::new(options.seed, options.jitter_sd, options.recycle, options.lamp),
            ledger: Ledger::new(Duration::from_millis(config.sil_ms.into())),
            half_a_line: Vec::new(),
            powered: true,
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
        self.ledger.rose(now, energy);
        self.diode.light(now, energy);
        self.open_window(now);
        energy
    }

    fn close_contact(&mut self) -> f64 {
        if !self.powered {
            return 0.0;
        }
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
        if !self.powered {
            return Vec::new();
        }
        let now = self.now();
        self.advance(now);
        let core_time = self.core_time(now);
        let mut sent = self.core.sent();
        for piece in from_host.split_inclusive(|byte| *byte == b'\n') {
            self.core.receive(piece, core_time);
            let answer = self.core.sent();
            self.half_a_line.extend_from_slice(piece);
            if piece.ends_with(b"\n") {
                let request = std::mem::take(&mut self.half_a_line);
                self.ledger.answered(now, &request, &answer);
            }
            sent.extend(answer);
        }
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
        self.ledger.forgotten();
        self.half_a_line.clear();
        self.booted = self.now();
        let rec_ms = self.options.recycle.as_millis() as u16;
        self.core = Core::new(Config { rec_ms, ..Config::default() }, next_boot(), 0);
        self.settle();
    }
}

impl Bench {
    fn lose_power(&mut self) {
        self.powered = false;
        // The trigger is low and the gate closed from here on.
        self.reset();
    }

    fn power_up(&mut self) {
        if !self.powered {
            self.powered = true;
            self.reset();
        }
    }
}

/// A real board counts its boots in EEPROM; simulated ones share a counter, so that no two are mistaken.
fn next_boot() -> u16 {
    static BOOTS: AtomicU16 = AtomicU16::new(1);
    BOOTS.fetch_add(1, Ordering::Relaxed)
}

/// Name of the board's port in a folder of its own, as udev names ports under `/dev/serial/by-id`.
const PORT_NAME: &str = "usb-unlit_flash_controller-if00";

/// What drives the core: with a wire, turn by turn with the host's bytes; without one, the turns alone.
struct Wire {
    stop: Arc<AtomicBool>,
    thread: JoinHandle<()>,
}

impl Wire {
    fn start(master: Option<TTYPort>, bench: Arc<Mutex<Bench>>) -> io::Result<Self> {
        let stop = Arc::new(AtomicBool::new(false));
        let stopped = stop.clone();
        let thread = std::thread::Builder::new()
            .name("studio-board".into())
            .spawn(move || run(master, &bench, &stopped))?;
        Ok(Self { stop, thread })
    }

    /// Cuts it: the board's side of the pseudo terminal is closed when this returns.
    fn cut(self) {
        self.stop.store(true, Ordering::Relaxed);
        // A panic of the board's thread has been printed; there is no one left to tell.
        let _ = self.thread.join();
    }
}

/// A running board. Dropping it unplugs it: the driver's port breaks.
pub struct Board {
    bench: Arc<Mutex<Bench>>,
    /// Where the port's stable name is.
    folder: TempDir,
    device: PathBuf,
    wire: Mutex<Option<Wire>>,
}

impl Board {
    /// Powers a board up on a new pseudo terminal.
    pub fn start(options: BoardOptions) -> io::Result<Self> {
        let bench = Arc::new(Mutex::new(Bench::new(options)?));
        let folder = tempfile::Builder::new().prefix("unlit-board-").tempdir()?;
        let device = folder.path().join(PORT_NAME);
        let board = Self { bench, folder, device, wire: Mutex::new(None) };
        board.plug_in()?;
        Ok(board)
    }

    /// The serial device that a driver opens: a name that stays the same however often the board is plugged in. There
    /// is nothing behind it while the board is unplugged.
    pub fn device(&self) -> &Path {
        &self.device
    }

    /// Fault: the port is pulled. The driver's side hangs up at once and the port's name is gone. If its `power` goes
    /// too, the board falls dark and forgets everything; otherwise it runs on, hearing nothing from its host.
    pub fn unplug(&self, power: bool) -> io::Result<()> {
        let mut wire = self.wire.lock().unwrap_or_else(PoisonError::into_inner);
        if power {
            lock(&self.bench).lose_power();
        }
        if let Some(wire) = wire.take() {
            wire.cut();
        }
        match std::fs::remove_file(&self.device) {
            Err(error) if error.kind() != io::ErrorKind::NotFound => return Err(error),
            _ => {}
        }
        if lock(&self.bench).powered {
            *wire = Some(Wire::start(None, self.bench.clone())?);
        }
        Ok(())
    }

    /// The port is plugged in again: a new pseudo terminal under the old name. A board that had lost its power boots
    /// with a new number.
    pub fn plug_in(&self) -> io::Result<()> {
        let mut wire = self.wire.lock().unwrap_or_else(PoisonError::into_inner);
        let (pair_master, slave) = TTYPort::pair()?;
        // A copy that children do not inherit; else a camera host would keep an unplugged board alive.
        let mut master = pair_master.try_clone_native()?;
        drop(pair_master);
        master.set_timeout(TURN)?;
        let terminal = slave.name().ok_or_else(|| io::Error::other("the pseudo terminal has no name"))?;
        if let Some(wire) = wire.take() {
            wire.cut();
        }
        lock(&self.bench).power_up();
        *wire = Some(Wire::start(Some(master), self.bench.clone())?);
        let aside = self.folder.path().join(".new");
        std::os::unix::fs::symlink(terminal, &aside)?;
        std::fs::rename(&aside, &self.device)
    }

    /// Every rise of the trigger so far.
    pub fn rises(&self) -> Vec<Rise> {
        lock(&self.bench).ledger.rises().to_vec()
    }

    /// The operator turns the flash's power: `stops` below full, 0 to begin with.
    pub fn set_power(&self, stops: f64) {
        lock(&self.bench).lamp.set_power(stops);
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
        if let Some(wire) = self.wire.get_mut().unwrap_or_else(PoisonError::into_inner).take() {
            wire.cut();
        }
    }
}

/// A panic elsewhere leaves the bench as whole as it was: no step of it spans two calls.
fn lock(bench: &Mutex<Bench>) -> MutexGuard<'_, Bench> {
    bench.lock().unwrap_or_else(PoisonError::into_inner)
}

/// The wire between pseudo terminal and core. Bytes that no one listens to are lost, as on a real wire.
fn run(mut master: Option<TTYPort>, bench: &Mutex<Bench>, stop: &AtomicBool) {
    let mut buffer = [0u8; 256];
    while !stop.load(Ordering::Relaxed) {
        let (count, listened) = match master.as_mut().map(|master| master.read(&mut buffer)) {
            Some(Ok(count)) => (count, true),
            Some(Err(error)) if error.kind() == io::ErrorKind::TimedOut => (0, true),
            Some(Err(_)) | None => {
                // No driver has the port open; poll(2) does not wait then.
                std::thread::sleep(TURN);
                (0, false)
            }
        };
        let sent = lock(bench).exchange(&buffer[..count]);
        if let Some(master) = &mut master
            && listened
            && !sent.is_empty()
            && master.write_all(&sent).is_err()
        {
            tracing::debug!(lost = sent.len(), "no one reads the simulated board");
        }
    }
}
