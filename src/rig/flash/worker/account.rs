//! The account of what the board counted: events taken in order, gaps filled, restarts noticed.
//!
//! A frame is proven by the syncs that the board counted, so none may be missed and none of another boot may be
//! taken for one. Three things tell a restart: the `boot` event; a number, or a clock, that went back; and
//! `hello=0` in the answer to `stat`, because nobody but this link greets the board. The last one is certain
//! whatever was lost, so [`Worker::audit`] ends with it, after the last fetch.

use super::super::clock::{BoardClock, ClockState, Moment};
use super::super::line::{Event, Fields};
use super::super::link::{Answer, Hello};
use super::super::news::FlashNews;
use super::super::pulse::SAMPLE_US;
use super::Worker;
use crate::pair::{FlashSync, SyncSource};
use crate::rig::FlashError;
use std::cmp::Ordering;
use std::time::Instant;

/// The board's clock and ours may part by so much, retries included; more means that it restarted.
const CLOCK_SLACK: f64 = 2.0;
/// A pulse's energy is that of the whole window, give or take this share of its samples.
const WINDOW_SLACK: f64 = 0.01;
/// Shots that the board remembers.
const LOG: u32 = 16;
/// The board's error for a shot that it no longer knows.
const GONE: u32 = 13;
/// How often the account is compared in one audit; a contact that never rests cannot keep it going.
const ROUNDS: u32 = 8;

/// What the board has said so far, in this boot.
pub(super) struct Account {
    boot: u32,
    events: u16,
    shots: u32,
    clock: BoardClock,
    /// Where the clock's host times start.
    origin: Instant,
}

impl Account {
    pub(super) fn new(hello: &Hello) -> Self {
        let Hello { boot, events, shots, .. } = *hello;
        Self { boot, events, shots, clock: BoardClock::default(), origin: Instant::now() }
    }

    /// Host times before the origin are negative.
    fn seconds(&self, at: Instant) -> f64 {
        match at.checked_duration_since(self.origin) {
            Some(after) => after.as_secs_f64(),
            None => -self.origin.duration_since(at).as_secs_f64(),
        }
    }

    pub(super) fn note_time(&mut self, between: (Instant, Instant), clock_us: u32) {
        self.clock.note(self.seconds(between.0), self.seconds(between.1), clock_us);
    }

    pub(super) fn clock_state(&self) -> Option<ClockState> {
        self.clock.state()
    }

    /// UTC of a board's stamp of the last half hour. Converted here and now, once: a time of day that is set right
    /// meanwhile moves this stamp alone, never the fit.
    fn utc(&self, clock_us: u32) -> Option<f64> {
        let now = self.seconds(Instant::now());
        let Moment { host, .. } = self.clock.moment(clock_us, now)?;
        Some(super::super::shared::utc_now() - (now - host))
    }

    /// How the stamp compares with what the clock should show. A board that restarted is behind; one that is ahead
    /// belongs to a computer that slept.
    fn compare(&self, clock_us: u32, heard: Instant) -> Ordering {
        self.clock.compare(clock_us, self.seconds(heard), CLOCK_SLACK)
    }

    /// Whether the greeting can come from the boot that is known.
    fn is_same_boot(&self, hello: &Hello) -> bool {
        hello.boot == self.boot
            && hello.shots >= self.shots
            && hello.events.wrapping_sub(self.events) as i16 >= 0
            && self.compare(hello.clock_us, hello.told.1) != Ordering::Less
    }

    /// Whether this boot became known after `moment`.
    fn is_younger_than(&self, moment: Instant) -> bool {
        self.origin > moment
    }
}

impl Worker {
    /// Takes the events that came.
    pub(super) fn attend(&mut self) -> Result<(), FlashError> {
        if let Some(link) = &mut self.link {
            link.catch_up()?;
        }
        while let Some(event) = self.link.as_mut().and_then(|link| link.events.pop_front()) {
            self.take(&event)?;
        }
        Ok(())
    }

    fn take(&mut self, event: &Event) -> Result<(), FlashError> {
        if event.name == "boot" {
            // The greeting has swallowed all that came before it: this one is news, whatever its number.
            return self.greet_again(true);
        }
        let ahead = event.number.wrapping_sub(self.account.events) as i16;
        if ahead <= 0 {
            return Ok(()); // already made up for
        }
        self.account.events = event.number;
        if ahead > 1 {
            self.shared.tell(FlashNews::Gap { events: ahead as u16 - 1 });
        }
        let news = match event.name.as_str() {
            "shot" => {
                let number = event.fields.uint("n").ok_or_else(|| self.old("a shot's report"))?;
                self.fetch_up_to(number.saturating_sub(1))?;
                return self.keep(&event.fields, false);
            }
            "disarm" => {
                let why = event.fields.word("why").unwrap_or("unknown").to_owned();
                let silenced = why == "silence";
                if silenced {
                    self.tell_broken("this computer was silent for too long, and the gate closed");
                }
                self.shared.update(|state| {
                    state.condition.silenced |= silenced;
                    state.condition.armed_until = None;
                });
                FlashNews::Disarm { why }
            }
            "ready" => FlashNews::Ready,
            "stuck" => {
                tracing::warn!("the camera's sync contact stays closed");
                self.shared.update(|state| state.condition.stuck = true);
                FlashNews::Stuck
            }
            name => FlashNews::Other { name: name.to_owned() },
        };
        self.shared.tell(news);
        Ok(())
    }

    /// Fetches shots whose events were lost.
    fn fetch_up_to(&mut self, last: u32) -> Result<(), FlashError> {
        if last.saturating_sub(self.account.shots) > LOG {
            self.account.shots = last - LOG;
            self.tell_broken("more syncs came than the controller remembers, and their reports were lost");
        }
        while self.account.shots < last {
            let number = self.account.shots + 1;
            match self.ask(&format!("get n={number}")) {
                Ok(answer) if answer.fields.uint("n") == Some(number) => self.keep(&answer.fields, true)?,
                Ok(_) => return Err(self.old("its answer to get")),
                Err(FlashError::Refused { code: GONE, .. }) => {
                    self.account.shots = number;
                    self.tell_broken("a sync's report was lost, and the controller no longer remembers it");
                }
                Err(error) => return Err(error),
            }
        }
        Ok(())
    }

    fn keep(&mut self, fields: &Fields, fetched: bool) -> Result<(), FlashError> {
        let (Some(mut sync), Some(samples)) = (read_shot(fields), fields.uint("m")) else {
            return Err(self.old("a shot's report"));
        };
        if sync.number <= self.account.shots {
            return Ok(());
        }
        self.account.shots = sync.number;
        sync.at = fields.uint("t").and_then(|stamp| self.account.utc(stamp));
        self.shared.update(|state| {
            state.shots.push(sync);
            state.condition.stuck = false;
            if sync.triggered {
                state.condition.last_pulse = Some(sync);
            }
        });
        self.shared.tell(FlashNews::Shot { sync, fetched });
        let window = self.shared.lock().settings.map(|settings| f64::from(settings.window_us));
        let wanted = window.map_or(f64::NAN, |window| (window / SAMPLE_US).floor());
        if sync.light().is_some() && (f64::from(samples) - wanted).abs() > WINDOW_SLACK * wanted {
            let ms = |samples: f64| 1e-3 * SAMPLE_US * samples;
            self.tell_broken(&format!(
                "it gathered the light of sync {} for {:.1} ms instead of {:.1} ms, so that its energy is not known",
                sync.number,
                ms(f64::from(samples)),
                ms(wanted)
            ));
        }
        Ok(())
    }

    /// Keeps the gate's time, the clock's fit and the account up to date.
    pub(super) fn ping(&mut self) -> Result<(), FlashError> {
        let Answer { fields, sent, heard } = self.ask("ping")?;
        self.attend()?;
        let (Some(clock), Some(events), Some(shots)) =
            (fields.uint("t"), fields.uint("ev"), fields.uint("n"))
        else {
            return Err(self.old("its answer to ping"));
        };
        let ahead = (events as u16).wrapping_sub(self.account.events) as i16;
        // The board may have restarted, and been greeted again, since it gave this answer.
        if self.account.is_younger_than(sent) {
            return Ok(());
        }
        let in_time = self.account.compare(clock, heard) == Ordering::Equal;
        if !in_time || shots < self.account.shots || ahead < 0 {
            return self.greet_again(false);
        }
        self.account.note_time((sent, heard), clock);
        if ahead > 0 {
            self.account.events = events as u16;
            self.shared.tell(FlashNews::Gap { events: ahead as u16 });
        }
        self.shared.update(|state| state.clock = self.account.clock_state());
        self.fetch_up_to(shots)
    }

    /// Takes and fetches everything that the board has counted so far; afterwards it is certain that it has not
    /// restarted, or [`super::super::shared::State::broken`] says so.
    pub(super) fn audit(&mut self) -> Result<(), FlashError> {
        for _ in 0..ROUNDS {
            let Answer { fields: stat, sent, .. } = self.ask("stat")?;
            self.attend()?;
            if self.account.is_younger_than(sent) {
                return Ok(()); // restarted, as has been told
            }
            let (Some(greeted), Some(shots)) = (stat.uint("hello"), stat.uint("n")) else {
                return Err(self.old("its answer to stat"));
            };
            if greeted != 1 {
                return self.greet_again(true);
            }
            if shots <= self.account.shots {
                return Ok(());
            }
            self.fetch_up_to(shots)?;
        }
        self.tell_broken("the sync contact does not come to rest (is its cable loose?)");
        Ok(())
    }

    /// Greets a board that may have restarted; `certain` if it has.
    pub(super) fn greet_again(&mut self, certain: bool) -> Result<(), FlashError> {
        self.asked = Instant::now();
        let hello = match &mut self.link {
            Some(link) => link.hello()?,
            None => return Err(self.lost("it is not connected")),
        };
        self.greeted(&hello, false, certain)
    }

    /// After a greeting: the same boot has kept its shots, another one has lost all. `reconnected`: the port was
    /// opened anew; `restarted`: it is known to be another boot.
    pub(super) fn greeted(
        &mut self,
        hello: &Hello,
        reconnected: bool,
        restarted: bool,
    ) -> Result<(), FlashError> {
        let same = !restarted && self.account.is_same_boot(hello);
        let description = self.introduce(hello);
        if same {
            self.account.events = hello.events;
            if self.account.compare(hello.clock_us, hello.told.1) != Ordering::Equal {
                self.account.clock = BoardClock::default();
            }
        } else {
            self.account = Account::new(hello);
            self.shared.update(|state| {
                state.shots.clear();
                state.condition.stuck = false;
                state.condition.restarted = Some(Instant::now());
            });
            self.tell_broken("it restarted, and its gate is closed");
            self.shared.tell(FlashNews::Boot { boot: hello.boot, reset: hello.reset });
        }
        if reconnected {
            tracing::info!(port = %self.path.display(), same, "flash controller is back");
            self.shared.tell(FlashNews::Reconnected { description, same_boot: same });
        }
        let done = self.set_up(hello).and_then(|()| self.fetch_up_to(hello.shots));
        match &done {
            Ok(()) => {
                let robbed = self.shared.update(|state| {
                    state.condition.away = None;
                    let armed = state.condition.armed_until.take().is_some();
                    armed && !state.shots.iter().any(|sync| sync.triggered)
                });
                if robbed && same {
                    self.tell_broken("the link broke while the gate was open, which closed it");
                }
            }
            // A board without its settings is none to shoot with.
            Err(_) => self.give_up(),
        }
        done
    }

    fn tell_broken(&self, why: &str) {
        tracing::warn!(port = %self.path.display(), "flash controller: {why}");
        self.shared.update(|state| state.broken = Some(why.to_owned()));
    }
}

/// A shot out of its report. The dark level comes in sixteenths of a count.
fn read_shot(fields: &Fields) -> Option<FlashSync> {
    Some(FlashSync {
        number: fields.uint("n")?,
        source: if fields.word("src")? == "fire" { SyncSource::Command } else { SyncSource::Contact },
        triggered: fields.uint("g")? == 1,
        tag: fields.uint("tag")?,
        at: None,
        energy_counts: f64::from(fields.int("e")?),
        peak_counts: f64::from(fields.uint("pk")?),
        dark_counts: f64::from(fields.uint("b")?) / 16.0,
        lit_samples: fields.uint("w")?,
        clipped_samples: fields.uint("c")?,
        bounces: fields.uint("bn")?,
    })
}
