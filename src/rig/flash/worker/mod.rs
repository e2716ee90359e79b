//! The one thread that owns the port: carries orders out, keeps the board awake with pings, and connects again
//! after an unplug. What the board counted is kept in `account.rs`.

mod account;

use self::account::Account;
use super::condition::Stat;
use super::line::Fields;
use super::link::{Answer, Hello, Link};
use super::news::FlashNews;
use super::settings::{BoardSettings, FlashSettings};
use super::shared::Shared;
use crate::rig::FlashError;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender};
use std::time::{Duration, Instant};

/// The board goes safe after a longer silence.
const PING: Duration = Duration::from_millis(400);
/// How often a port that is gone is looked for; costs one look into a folder.
const LOOK: Duration = Duration::from_millis(50);
/// Pauses between attempts at a port that is there, but does not open or answer: doubled from the first to the last.
const RETRY: (Duration, Duration) = (Duration::from_millis(250), Duration::from_secs(4));
/// How long an order waits for a board that is away, so that a loose plug costs a moment and no pair.
const RETURN: Duration = Duration::from_secs(3);
/// Pings right after a greeting, which set the clock.
const SETTING_PINGS: u32 = 4;
/// The board's error for "a measurement runs", how often it is asked again, and after which pause; a measurement
/// takes the lock time, a second at most.
const BUSY: u32 = 11;
const BUSY_TRIES: u32 = 24;
const BUSY_PAUSE: Duration = Duration::from_millis(50);
/// The board's error for "arm or fire before hello in this boot".
const NOT_GREETED: u32 = 7;

/// What the driver asks of the thread.
pub(super) enum What {
    /// One request; `fresh` if it opens a new frame, for which earlier losses do not matter.
    Ask {
        /// Verb and arguments.
        body: String,
        /// It opens a new frame.
        fresh: bool,
    },
    /// Makes sure that everything counted so far has come, and that the board has not restarted meanwhile.
    Audit,
}

/// An order and where the answer goes.
pub(super) struct Order {
    pub(super) what: What,
    pub(super) answer: Sender<Result<Fields, FlashError>>,
}

/// The thread's own state.
pub(super) struct Worker {
    path: PathBuf,
    settings: FlashSettings,
    link: Option<Link>,
    /// Number of the last request of the link before.
    seq: u8,
    shared: Arc<Shared>,
    account: Account,
    asked: Instant,
    /// When a port that did not answer is tried again, and the pause after that.
    retry: (Instant, Duration),
}

impl Worker {
    /// Opens the port and greets the board.
    pub(super) fn open(
        path: PathBuf,
        settings: FlashSettings,
        shared: Arc<Shared>,
    ) -> Result<Self, FlashError> {
        // Another number than the program before us had, so that a late answer to that one is not ours.
        let seq = (super::shared::utc_now() * 1e3) as u64 % 255;
        let (link, hello) = Link::open(&path, seq as u8, &shared.stop)?;
        let now = Instant::now();
        let mut worker = Self {
            path,
            settings,
            seq: link.seq(),
            link: Some(link),
            account: Account::new(&hello),
            shared,
            asked: now,
            retry: (now, RETRY.0),
        };
        worker.introduce(&hello);
        worker.set_up(&hello)?;
        Ok(worker)
    }

    /// Runs until the driver is dropped; leaves the gate closed.
    pub(super) fn run(mut self, orders: &Receiver<Order>) {
        loop {
            let wait = if self.link.is_some() { Duration::ZERO } else { LOOK };
            match orders.recv_timeout(wait) {
                Ok(order) => {
                    let result = self.serve(&order.what);
                    self.note_loss(&result);
                    // A driver that no longer waits has been dropped.
                    let _ = order.answer.send(result);
                }
                Err(RecvTimeoutError::Timeout) => {
                    let result = if self.link.is_some() { self.idle() } else { self.look() };
                    self.note_loss(&result);
                }
                Err(RecvTimeoutError::Disconnected) => break,
            }
        }
        if let Some(link) = &mut self.link
            && let Err(error) = link.request("disarm")
        {
            tracing::warn!(%error, "flash controller did not confirm the closed gate; it closes by itself");
        }
    }

    fn serve(&mut self, what: &What) -> Result<Fields, FlashError> {
        let end = Instant::now() + RETURN;
        while self.link.is_none() {
            let result = self.look();
            self.note_loss(&result);
            if self.link.is_none() {
                if Instant::now() >= end {
                    return Err(self.lost(&self.why_away()));
                }
                std::thread::sleep(LOOK);
            }
        }
        match what {
            What::Ask { body, fresh } => self.carry_out(body, *fresh),
            What::Audit => self.audit().map(|()| Fields::default()),
        }
    }

    /// Between orders: hears events, pings.
    fn idle(&mut self) -> Result<(), FlashError> {
        let pinged = self.asked.elapsed() >= PING;
        if pinged {
            self.ping()?;
        } else if let Some(link) = &mut self.link {
            link.listen()?;
        }
        self.attend()
    }

    /// Looks for a board that is away, and greets it.
    fn look(&mut self) -> Result<(), FlashError> {
        if Instant::now() < self.retry.0 || !self.path.exists() {
            return Ok(());
        }
        match Link::open(&self.path, self.seq, &self.shared.stop) {
            Ok((link, hello)) => {
                self.link = Some(link);
                self.greeted(&hello, true, false)
            }
            Err(error) => {
                tracing::debug!(%error, "flash controller is not back yet");
                self.retry = (Instant::now() + self.retry.1, (2 * self.retry.1).min(RETRY.1));
                self.shared.update(|state| {
                    if let Some((_, reason)) = &mut state.condition.away {
                        *reason = error.to_string();
                    }
                });
                Ok(())
            }
        }
    }

    fn carry_out(&mut self, body: &str, fresh: bool) -> Result<Fields, FlashError> {
        self.attend()?;
        // What was lost before this request went out does not matter to the frame that it opens; what is lost from
        // here on does.
        let before = if fresh { self.begin_frame() } else { None };
        let mut result = self.ask(body);
        if matches!(result, Err(FlashError::Refused { code: NOT_GREETED, .. })) {
            // It does not know us: it restarted, and its boot event was lost.
            result = self.greet_again(true).and_then(|()| {
                if fresh {
                    self.begin_frame();
                }
                self.ask(body)
            });
        }
        let result = result.and_then(|answer| self.attend().map(|()| answer.fields));
        let broken = self.shared.update(|state| {
            if result.is_err() && state.broken.is_none() {
                state.broken = before;
            }
            state.broken.clone()
        });
        match (result, broken) {
            (Ok(_), Some(reason)) if fresh => Err(self.lost(&reason)),
            (Ok(fields), _) => {
                self.note_answer(body, &fields);
                Ok(fields)
            }
            (error, _) => error,
        }
    }

    /// Takes note of what an answer says of the flash's state.
    fn note_answer(&self, body: &str, fields: &Fields) {
        let verb = body.split(' ').next().unwrap_or_default();
        self.shared.update(|state| match verb {
            "stat" => {
                let set = |key| fields.uint(key) == Some(1);
                let wait = Duration::from_millis(u64::from(fields.uint("wait").unwrap_or(0)));
                state.condition.stat =
                    Stat { closed: set("closed"), gate: set("g"), ready: set("ready"), wait };
                state.condition.stuck &= set("closed");
            }
            "disarm" => state.condition.armed_until = None,
            _ => {}
        });
    }

    /// Forgets the losses of the frame before and returns them.
    fn begin_frame(&self) -> Option<String> {
        self.shared.update(|state| {
            state.condition.restarted = None;
            state.condition.silenced = false;
            state.broken.take()
        })
    }

    fn ask(&mut self, body: &str) -> Result<Answer, FlashError> {
        self.asked = Instant::now();
        match &mut self.link {
            Some(link) => link.request(body),
            None => Err(self.lost(&self.why_away())),
        }
    }

    fn introduce(&self, hello: &Hello) -> String {
        let description =
            format!("unlit flash controller {} ({}) on {}", hello.firmware, hello.mcu, self.path.display());
        self.shared.update(|state| state.description = description.clone());
        description
    }

    /// Sends the settings and sets the clock.
    fn set_up(&mut self, hello: &Hello) -> Result<(), FlashError> {
        self.account.note_time(hello.told, hello.clock_us);
        let request = self.settings.request();
        let mut tries = BUSY_TRIES;
        let answer = loop {
            match self.ask(&request) {
                Err(FlashError::Refused { code: BUSY, .. }) if tries > 0 => {
                    tries -= 1;
                    std::thread::sleep(BUSY_PAUSE);
                }
                answered => break answered?,
            }
        };
        let settings = BoardSettings::read(&answer.fields).ok_or_else(|| self.old("its settings"))?;
        self.shared.update(|state| {
            state.settings = Some(settings);
            state.condition.ready_output = settings.ready_output;
        });
        for _ in 0..SETTING_PINGS {
            let Answer { fields, sent, heard } = self.ask("ping")?;
            let clock = fields.uint("t").ok_or_else(|| self.old("its answer to ping"))?;
            self.account.note_time((sent, heard), clock);
        }
        self.shared.update(|state| state.clock = self.account.clock_state());
        Ok(())
    }

    fn why_away(&self) -> String {
        let away = self.shared.lock().condition.away.clone();
        away.map_or_else(|| "it is not connected".into(), |(_, reason)| reason)
    }

    fn lost(&self, reason: &str) -> FlashError {
        FlashError::Lost { port: self.path.display().to_string(), reason: reason.to_owned() }
    }

    fn old(&mut self, what: &str) -> FlashError {
        self.give_up();
        FlashError::Firmware {
            port: self.path.display().to_string(),
            reason: format!("{what} lacks numbers of protocol 1"),
        }
    }

    /// Has the link opened anew.
    fn give_up(&mut self) {
        if let Some(link) = &mut self.link {
            link.failed = true;
        }
    }

    /// A broken, silent or strange link is closed, so that the next turn connects again.
    fn note_loss<T>(&mut self, result: &Result<T, FlashError>) {
        let Err(error) = result else { return };
        let Some(link) = self.link.take_if(|link| link.failed) else { return };
        let reason = match error {
            FlashError::Lost { reason, .. } | FlashError::Firmware { reason, .. } => reason.clone(),
            FlashError::Silent { request, .. } => format!("no answer to {request}"),
            other => other.to_string(),
        };
        self.seq = link.seq();
        drop(link);
        tracing::warn!(port = %self.path.display(), %reason, "flash controller lost");
        self.retry = (Instant::now() + RETRY.0, 2 * RETRY.0);
        self.shared.update(|state| {
            let since = state.condition.away.take().map_or_else(Instant::now, |(since, _)| since);
            state.condition.away = Some((since, reason.clone()));
        });
        self.shared.tell(FlashNews::Lost { reason });
    }
}
