//! The one thread that owns the port: carries commands out, keeps the board awake with pings, notices
//! restarts and losses, and connects again after an unplug.

use super::line::{Event, Fields};
use super::link::{Hello, Link};
use crate::rig::{FlashError, FlashShot};
use std::path::PathBuf;
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, TryRecvError};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

/// The board goes safe after a longer silence.
const PING: Duration = Duration::from_millis(400);
/// Pause between attempts to connect again.
const RECONNECT: Duration = Duration::from_millis(500);
/// The board's clock and ours may part by so much between two pings, retries included; more means that it restarted.
const CLOCK_SLACK: Duration = Duration::from_secs(2);

/// What the driver asks of the thread.
pub(super) struct Command {
    /// Verb and arguments.
    pub(super) body: String,
    /// The request opens a new frame, for which earlier losses do not matter.
    pub(super) fresh: bool,
    /// Where the answer goes.
    pub(super) answer: Sender<Result<Fields, FlashError>>,
}

/// What driver and thread share.
#[derive(Default)]
pub(super) struct Shared {
    state: Mutex<State>,
    changed: Condvar,
}

/// What the thread knows about the board.
#[derive(Default)]
pub(super) struct State {
    /// "unlit flash controller 1.0 (atmega328p) on /dev/ttyACM0".
    pub(super) description: String,
    /// Shots that no one has taken yet.
    pub(super) shots: Vec<FlashShot>,
    /// Why shots of the frame under way may be missing.
    pub(super) broken: Option<String>,
}

impl Shared {
    /// A panic in the other thread leaves plain values behind, all of them valid.
    pub(super) fn lock(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Waits until there is a shot or a reason why not, or `patience` is over.
    pub(super) fn wait(&self, patience: Duration) -> MutexGuard<'_, State> {
        let quiet = |state: &mut State| state.shots.is_empty() && state.broken.is_none();
        self.changed
            .wait_timeout_while(self.lock(), patience, quiet)
            .unwrap_or_else(PoisonError::into_inner)
            .0
    }

    fn update(&self, change: impl FnOnce(&mut State)) {
        change(&mut self.lock());
        self.changed.notify_all();
    }
}

/// The thread's own state.
pub(super) struct Worker {
    path: PathBuf,
    link: Option<Link>,
    shared: Arc<Shared>,
    boot: u32,
    events: u16,
    shots: u32,
    /// The board's clock in us, and when it said so.
    clock: (u32, Instant),
    asked: Instant,
}

impl Worker {
    pub(super) fn new(path: PathBuf, link: Link, hello: &Hello, shared: Arc<Shared>) -> Self {
        let now = Instant::now();
        let mut worker = Self {
            path,
            link: Some(link),
            shared,
            boot: hello.boot,
            events: 0,
            shots: 0,
            clock: (0, now),
            asked: now,
        };
        // What happened before we came is not our business.
        if let Some(link) = &mut worker.link {
            link.events.clear();
        }
        worker.begin_boot(hello);
        worker
    }

    /// Runs until the driver is dropped; leaves the gate closed.
    pub(super) fn run(mut self, commands: &Receiver<Command>) {
        loop {
            let command = if self.link.is_some() {
                match commands.try_recv() {
                    Ok(command) => Some(command),
                    Err(TryRecvError::Empty) => None,
                    Err(TryRecvError::Disconnected) => break,
                }
            } else {
                match commands.recv_timeout(RECONNECT) {
                    Ok(command) => Some(command),
                    Err(RecvTimeoutError::Timeout) => None,
                    Err(RecvTimeoutError::Disconnected) => break,
                }
            };
            let connected = self.connect();
            match command {
                Some(command) => {
                    let result = connected.and_then(|()| self.carry_out(&command));
                    // A driver that no longer waits has been dropped.
                    let _ = command.answer.send(result);
                }
                None if connected.is_ok() => {
                    let result = self.idle();
                    self.note_loss(&result);
                }
                None => {}
            }
        }
        if let Some(link) = &mut self.link
            && let Err(error) = link.request("disarm")
        {
            tracing::warn!(%error, "flash controller did not confirm the closed gate; it closes by itself");
        }
    }

    fn connect(&mut self) -> Result<(), FlashError> {
        if self.link.is_some() {
            return Ok(());
        }
        let (link, hello) = Link::open(&self.path)?;
        tracing::info!(port = %self.path.display(), "flash controller is back");
        self.link = Some(link);
        let result = self.greeted(&hello);
        self.note_loss(&result);
        result
    }

    fn ask(&mut self, body: &str) -> Result<Fields, FlashError> {
        self.asked = Instant::now();
        match &mut self.link {
            Some(link) => link.request(body),
            None => Err(self.lost("it is not connected")),
        }
    }

    fn carry_out(&mut self, command: &Command) -> Result<Fields, FlashError> {
        let mut result = self.attend().and_then(|()| self.ask(&command.body));
        if matches!(result, Err(FlashError::Refused { code: 7, .. })) {
            // It does not know us: it restarted and its boot event was lost.
            result = self.greet_again().and_then(|()| self.ask(&command.body));
        }
        let result = match result {
            Ok(fields) if command.body == "ping" => self.compare(&fields).map(|()| fields),
            other => other,
        };
        let result = result.and_then(|fields| self.attend().map(|()| fields));
        if result.is_ok() && command.fresh {
            self.shared.update(|state| state.broken = None);
        }
        self.note_loss(&result);
        result
    }

    fn idle(&mut self) -> Result<(), FlashError> {
        if let Some(link) = &mut self.link {
            link.listen()?;
        }
        self.attend()?;
        if self.asked.elapsed() >= PING {
            let pong = self.ask("ping")?;
            self.compare(&pong)?;
        }
        Ok(())
    }

    /// Takes the events that came in.
    fn attend(&mut self) -> Result<(), FlashError> {
        while let Some(event) = self.link.as_mut().and_then(|link| link.events.pop_front()) {
            self.take(&event)?;
        }
        Ok(())
    }

    fn take(&mut self, event: &Event) -> Result<(), FlashError> {
        if event.name == "boot" {
            return if event.fields.uint("boot") == Some(self.boot) { Ok(()) } else { self.greet_again() };
        }
        if event.number.wrapping_sub(self.events) as i16 <= 0 {
            return Ok(()); // already made up for
        }
        self.events = event.number;
        match event.name.as_str() {
            "shot" => {
                let number = event.fields.uint("n").unwrap_or(0);
                self.fetch_up_to(number.saturating_sub(1))?;
                self.keep(&event.fields)
            }
            "stuck" => {
                tracing::warn!("the camera's sync contact stays closed");
                Ok(())
            }
            _ => Ok(()),
        }
    }

    /// Fetches shots whose events were lost.
    fn fetch_up_to(&mut self, last: u32) -> Result<(), FlashError> {
        while self.shots < last {
            let number = self.shots + 1;
            match self.ask(&format!("get n={number}")) {
                Ok(fields) => self.keep(&fields)?,
                Err(FlashError::Refused { code: 13, .. }) => {
                    self.shots = number;
                    self.tell_broken(
                        "more syncs came than the controller remembers, and their reports were lost",
                    );
                }
                Err(error) => return Err(error),
            }
        }
        Ok(())
    }

    fn keep(&mut self, fields: &Fields) -> Result<(), FlashError> {
        let shot =
            shot(fields).ok_or_else(|| self.lost("a shot's report lacks numbers; update the firmware"))?;
        if shot.number > self.shots {
            self.shots = shot.number;
            self.shared.update(|state| state.shots.push(shot));
        }
        Ok(())
    }

    /// Checks a pong against what we believe.
    fn compare(&mut self, pong: &Fields) -> Result<(), FlashError> {
        self.attend()?;
        let (Some(clock), Some(events), Some(shots)) = (pong.uint("t"), pong.uint("ev"), pong.uint("n"))
        else {
            return Err(self.lost("its answer to ping lacks numbers; update the firmware"));
        };
        let (then_us, then) = self.clock;
        let board = Duration::from_micros(u64::from(clock.wrapping_sub(then_us)));
        let drifted = board.abs_diff(then.elapsed()) > CLOCK_SLACK;
        if drifted || shots < self.shots || (events as u16).wrapping_sub(self.events) as i16 <= -1 {
            return self.greet_again();
        }
        self.clock = (clock, Instant::now());
        self.events = events as u16;
        self.fetch_up_to(shots)
    }

    fn greet_again(&mut self) -> Result<(), FlashError> {
        self.asked = Instant::now();
        let hello = match &mut self.link {
            Some(link) => link.hello()?,
            None => return Err(self.lost("it is not connected")),
        };
        self.greeted(&hello)
    }

    /// After a greeting: the same boot has kept its shots, another one has lost all.
    fn greeted(&mut self, hello: &Hello) -> Result<(), FlashError> {
        if hello.boot == self.boot && hello.shots >= self.shots {
            self.clock = (hello.clock_us, Instant::now());
            self.events = hello.events;
            return self.fetch_up_to(hello.shots);
        }
        self.begin_boot(hello);
        self.tell_broken("it restarted; its gate is closed, take this frame again");
        Ok(())
    }

    fn begin_boot(&mut self, hello: &Hello) {
        self.boot = hello.boot;
        self.events = hello.events;
        self.shots = hello.shots;
        self.clock = (hello.clock_us, Instant::now());
        let description =
            format!("unlit flash controller {} ({}) on {}", hello.firmware, hello.mcu, self.path.display());
        self.shared.update(|state| state.description = description);
    }

    fn tell_broken(&self, why: &str) {
        tracing::warn!(port = %self.path.display(), "flash controller: {why}");
        self.shared.update(|state| state.broken = Some(why.to_owned()));
    }

    fn lost(&self, reason: &str) -> FlashError {
        FlashError::Lost { port: self.path.display().to_string(), reason: reason.to_owned() }
    }

    /// A broken or silent link is closed, so that the next turn connects again.
    fn note_loss<T>(&mut self, result: &Result<T, FlashError>) {
        if let Err(error @ (FlashError::Lost { .. } | FlashError::Silent { .. })) = result {
            tracing::warn!(%error, "flash controller");
            self.link = None;
        }
    }
}

/// A shot out of its report. No sample above the light threshold is no light, whatever the noise adds up to.
fn shot(fields: &Fields) -> Option<FlashShot> {
    let lit = fields.uint("w")? > 0;
    Some(FlashShot {
        number: fields.uint("n")?,
        triggered: fields.uint("g")? == 1,
        tag: fields.uint("tag")?,
        energy_counts: lit.then_some(f64::from(fields.int("e")?)),
    })
}
