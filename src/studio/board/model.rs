//! `firmware/PROTOCOL.md` once more, as a plain model, and random conversations that must go alike with it and with
//! the firmware's core: every answer, every event, the gate and the trigger.
//!
//! The model knows no bytes, no wrapping clock and no interrupts: it takes requests as values and the time in 64
//! bits. Light is left out; other tests measure it.

mod talk;

use super::core::Config;
use crate::rig::flash::line;

/// Time between two polls, us.
const POLL: u64 = 500;
const GAP: u64 = 50_000;
const STUCK: u64 = 2_000_000;
const LATE: u64 = 50_000;

/// What is asked. Texts that are no request carry the code they are refused with, and whether a person's such line
/// is a sign of life.
#[derive(Clone, Debug)]
enum Body {
    Hello { strict: u8 },
    Ping,
    Stat,
    Disarm,
    Arm { tag: u32, ttl: u32 },
    Fire { d: u32, tag: u32 },
    Cfg { rec: u16, lock: u16, sil: u16, rdy: u8 },
    Get { back: u32 },
    Bad(&'static str, u32, bool),
}

const BAD: [Body; 8] = [
    Body::Bad("PING", 2, false),
    Body::Bad("ping ", 2, false),
    Body::Bad("arm tag=1 ttl=", 2, false),
    Body::Bad("arm tag=1 tag=1 ttl=9", 5, false),
    Body::Bad("launch", 4, true),
    Body::Bad("ping x=1", 5, true),
    Body::Bad("arm tag=0 ttl=9", 5, true),
    Body::Bad("cfg win=60001", 5, true),
];

#[derive(Clone, Debug)]
enum Number {
    Next,
    Last,
    None,
}

#[derive(Clone, Debug)]
enum Step {
    Wait {
        ms: u16,
    },
    Edge,
    Contact {
        closed: bool,
    },
    Charged(bool),
    Ask(Number, Body),
    /// The last numbered request's bytes again.
    Again,
    /// A line that the wire has damaged.
    Damaged,
    Reboot,
}

#[derive(Clone, Debug, PartialEq)]
enum Answer {
    Ok(Vec<(&'static str, u32)>),
    Err(u32),
}

#[derive(Clone, Debug)]
struct Shot {
    n: u32,
    fired: bool,
    gated: bool,
    tag: u32,
    t: u64,
    bounces: u32,
}

impl Shot {
    fn fields(&self) -> Vec<(&'static str, u32)> {
        vec![
            ("n", self.n),
            ("g", self.gated.into()),
            ("tag", self.tag),
            ("t", self.t as u32),
            ("bn", self.bounces),
            ("e", 0),
            ("w", 0),
        ]
    }
}

/// What was told, with the fields that matter.
#[derive(Clone, Debug)]
enum Told {
    Boot,
    Disarm(&'static str),
    Shot(Shot),
    Ready,
    Stuck,
}

#[derive(Clone, Debug)]
struct Armed {
    tag: u32,
    at: u64,
    ttl: u64,
}

struct Model {
    now: u64,
    config: Config,
    greeted: bool,
    strict: bool,
    heard: u64,
    armed: Option<Armed>,
    /// When a sync used the gate, until that is told.
    used: Option<u64>,
    /// Tag and due time of a delayed fire.
    fire: Option<(u32, u64)>,
    /// The shot that light is gathered for.
    open: Option<Shot>,
    locked: Option<u64>,
    contact: bool,
    closed_since: Option<u64>,
    stuck: bool,
    charged: bool,
    triggered: u64,
    recycling: bool,
    ready_untold: bool,
    recent: bool,
    shots: Vec<Shot>,
    told: Vec<Told>,
    events: u16,
    rises: u32,
    last: Option<(u8, String, Answer)>,
}

/// What a request is known by, beside its number: two texts in 65536 share it.
fn checksum(request: &str) -> &str {
    request.rsplit_once('*').map_or("", |(_, digits)| digits)
}

impl Model {
    fn boot(now: u64, contact: bool, charged: bool) -> Self {
        let mut model = Self {
            now,
            config: Config::default(),
            greeted: false,
            strict: false,
            heard: now,
            armed: None,
            used: None,
            fire: None,
            open: None,
            locked: None,
            contact,
            closed_since: None,
            stuck: false,
            charged,
            triggered: 0,
            recycling: false,
            ready_untold: false,
            recent: false,
            shots: Vec::new(),
            told: Vec::new(),
            events: 0,
            rises: 0,
            last: None,
        };
        model.tell(Told::Boot);
        model
    }

    fn tell(&mut self, what: Told) {
        self.events = self.events.wrapping_add(1);
        self.told.push(what);
    }

    fn gate(&self) -> bool {
        self.armed.is_some() && self.used.is_none()
    }

    fn lock(&self) -> u64 {
        u64::from(self.config.lock_ms) * 1000
    }

    fn recycle(&self) -> u64 {
        u64::from(self.config.rec_ms) * 1000
    }

    fn charged(&self) -> bool {
        self.config.rdy == 0 || self.charged
    }

    fn safe(&mut self) {
        self.fire = None;
        if self.used.is_none() {
            self.armed = None;
        }
    }

    fn trigger(&mut self, at: u64) {
        self.triggered = at;
        self.recycling = true;
        self.ready_untold = true;
        self.recent = true;
    }

    fn begin(&mut self, fired: bool, gated: bool, tag: u32) {
        self.rises += u32::from(gated);
        self.open = Some(Shot { n: 0, fired, gated, tag, t: self.now, bounces: 0 });
        self.locked = Some(self.now);
    }

    fn edge(&mut self) {
        if self.gate() {
            let tag = self.armed.as_ref().map_or(0, |armed| armed.tag);
            self.used = Some(self.now);
            self.begin(false, true, tag);
        } else if self.locked.is_none() {
            self.begin(false, false, 0);
        } else if let Some(shot) = &mut self.open {
            shot.bounces = (shot.bounces + 1).min(255);
        }
    }

    /// What time brings.
    fn poll(&mut self) {
        let now = self.now;
        let silent = now - self.heard >= u64::from(self.config.sil_ms) * 1000;
        let over = self.armed.as_ref().is_some_and(|armed| now - armed.at >= armed.ttl);
        let late = self.fire.is_some_and(|(_, due)| now >= due + LATE);
        let why = match (self.armed.is_some() || self.fire.is_some(), silent, over, late) {
            (true, true, ..) => Some("silence"),
            (_, _, true, _) => Some("ttl"),
            (.., true) => Some("late"),
            _ => None,
        };
        if why.is_some() {
            self.safe();
        }
        if let Some((tag, due)) = self.fire
            && now >= due
            && self.locked.is_none()
            && self.charged()
        {
            self.fire = None;
            self.begin(true, true, tag);
            self.trigger(now);
        }
        if let Some(why) = why.filter(|_| self.used.is_none()) {
            self.tell(Told::Disarm(why));
        }
        if let Some(at) = self.used.take() {
            self.armed = None;
            self.trigger(at);
            self.tell(Told::Disarm("used"));
        }
        self.watch_contact();
        if self.open.as_ref().is_some_and(|shot| now - shot.t >= self.lock())
            && let Some(mut shot) = self.open.take()
        {
            shot.n = self.shots.len() as u32 + 1;
            self.shots.push(shot.clone());
            self.tell(Told::Shot(shot));
        }
        if let Some(since) = self.locked {
            let ended = !self.contact && now - since >= self.lock();
            self.locked = (!ended).then_some(if self.contact { now } else { since });
        }
        self.recent &= now - self.triggered < GAP;
        self.recycling &= now - self.triggered < self.recycle();
        if self.ready_untold && !self.recycling && self.charged() {
            self.ready_untold = false;
            self.tell(Told::Ready);
        }
    }

    fn watch_contact(&mut self) {
        if !self.contact {
            self.closed_since = None;
            self.stuck = false;
            return;
        }
        let since = *self.closed_since.get_or_insert(self.now);
        if !self.stuck && self.now - since >= STUCK {
            self.stuck = true;
            self.tell(Told::Stuck);
        }
    }

    fn wait_ms(&self) -> u32 {
        let left = |span: u64, since: u64| span.saturating_sub(self.now - since);
        let recycle = if self.recycling { left(self.recycle(), self.triggered) } else { 0 };
        let lock = self.locked.map_or(0, |since| left(self.lock(), since).max(1));
        recycle.max(lock).div_ceil(1000) as u32
    }

    fn refusal(&self) -> Option<u32> {
        if !self.greeted {
            Some(7)
        } else if self.armed.is_some() || self.fire.is_some() || self.contact {
            Some(11)
        } else if self.recycling || self.locked.is_some() || !self.charged() {
            Some(10)
        } else {
            self.recent.then_some(12)
        }
    }

    fn carry_out(&mut self, body: &Body) -> Answer {
        let (gate, events, shots) = (u32::from(self.gate()), u32::from(self.events), self.shots.len() as u32);
        match *body {
            Body::Hello { strict } => {
                self.safe();
                self.greeted = true;
                self.strict = strict == 1;
                Answer::Ok(vec![("v", 1), ("ev", events), ("n", shots), ("t", self.now as u32)])
            }
            Body::Ping => Answer::Ok(vec![("t", self.now as u32), ("g", gate), ("ev", events), ("n", shots)]),
            Body::Stat => {
                let ready = !self.recycling && self.locked.is_none() && self.charged();
                Answer::Ok(vec![
                    ("g", gate),
                    ("fire", self.fire.is_some().into()),
                    ("hello", self.greeted.into()),
                    ("ready", ready.into()),
                    ("wait", self.wait_ms()),
                    ("closed", self.contact.into()),
                    ("n", shots),
                ])
            }
            Body::Disarm => {
                self.safe();
                Answer::Ok(Vec::new())
            }
            Body::Arm { tag, ttl } => self.refusal().map_or_else(
                || {
                    self.armed = Some(Armed { tag, at: self.now, ttl: u64::from(ttl) * 1000 });
                    Answer::Ok(Vec::new())
                },
                Answer::Err,
            ),
            Body::Fire { d, tag } => self.refusal().map_or_else(
                || {
                    self.fire = Some((tag, self.now + u64::from(d)));
                    Answer::Ok(Vec::new())
                },
                Answer::Err,
            ),
            Body::Cfg { rec, lock, sil, rdy } => {
                if self.armed.is_some() || self.fire.is_some() || self.open.is_some() {
                    return Answer::Err(11);
                }
                self.config = Config { rec_ms: rec, lock_ms: lock, sil_ms: sil, rdy, ..self.config };
                Answer::Ok(vec![
                    ("rec", rec.into()),
                    ("lock", lock.into()),
                    ("sil", sil.into()),
                    ("rdy", rdy.into()),
                ])
            }
            Body::Get { back } => {
                let n = (shots + 1).saturating_sub(back);
                let kept = n > 0 && shots.checked_sub(n).is_some_and(|ago| ago < 16);
                if kept { Answer::Ok(self.shots[n as usize - 1].fields()) } else { Answer::Err(13) }
            }
            Body::Bad(_, code, _) => Answer::Err(code),
        }
    }

    fn text(&self, body: &Body) -> String {
        match *body {
            Body::Hello { strict } => format!("hello v=1 strict={strict}"),
            Body::Ping => "ping".into(),
            Body::Stat => "stat".into(),
            Body::Disarm => "disarm".into(),
            Body::Arm { tag, ttl } => format!("arm tag={tag} ttl={ttl}"),
            Body::Fire { d, tag } => format!("fire d={d} tag={tag}"),
            Body::Cfg { rec, lock, sil, rdy } => {
                format!("cfg rec={rec} lock={lock} sil={sil} rdy={rdy} win=1000 pulse=500")
            }
            Body::Get { back } => format!("get n={}", (self.shots.len() as u32 + 1).saturating_sub(back)),
            Body::Bad(text, ..) => text.into(),
        }
    }

    /// A line that came in whole, with the number and the answer that must come back.
    fn ask(&mut self, number: &Number, body: &Body) -> (String, u8, Answer) {
        self.poll();
        let text = self.text(body);
        let seq = match number {
            Number::None => return self.ask_unnumbered(text, body),
            Number::Next => self.last.as_ref().map_or(1, |(seq, ..)| seq % 255 + 1),
            Number::Last => self.last.as_ref().map_or(1, |(seq, ..)| *seq),
        };
        let request = line::request(seq, &text);
        self.heard = self.now;
        let hello = matches!(body, Body::Hello { .. });
        match &self.last {
            Some((last, bytes, answer)) if *last == seq && !hello => {
                let repeated = checksum(bytes) == checksum(&request);
                let answer = if repeated { answer.clone() } else { Answer::Err(6) };
                (request, seq, answer)
            }
            _ => {
                let answer = self.carry_out(body);
                self.last = Some((seq, request.clone(), answer.clone()));
                (request, seq, answer)
            }
        }
    }

    fn ask_unnumbered(&mut self, text: String, body: &Body) -> (String, u8, Answer) {
        let request = format!("{text}\n");
        if let Body::Bad(_, code, false) = body {
            return (request, 0, Answer::Err(*code));
        }
        if self.strict {
            return (request, 0, Answer::Err(7));
        }
        self.heard = self.now;
        let answer = self.carry_out(body);
        (request, 0, answer)
    }

    fn again(&mut self) -> Option<(String, u8, Answer)> {
        self.poll();
        let (seq, request, answer) = self.last.clone()?;
        self.heard = self.now;
        if !request.contains(" hello ") {
            return Some((request, seq, answer));
        }
        let strict = u8::from(request.contains("strict=1"));
        let answer = self.carry_out(&Body::Hello { strict });
        self.last = Some((seq, request.clone(), answer.clone()));
        Some((request, seq, answer))
    }
}
