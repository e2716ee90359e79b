//! The firmware core on a bench with a clock of its own: every promise of `firmware/PROTOCOL.md`.

mod fire;
mod light;
mod lines;

use super::core::{Config, Core};
use crate::rig::flash::line::{self, Event, Fields, Line};

/// A core, its time, and a host that numbers its requests.
struct Bed {
    core: Core,
    now: u32,
    seq: u8,
    events: Vec<Event>,
}

impl Bed {
    fn new() -> Self {
        Self::at(0)
    }

    fn at(now: u32) -> Self {
        let mut bed = Self { core: Core::new(Config::default(), 7, now), now, seq: 0, events: Vec::new() };
        for _ in 0..4096 {
            bed.core.light_sample(12);
        }
        bed
    }

    fn greeted() -> Self {
        let mut bed = Self::new();
        bed.ok("hello v=1 strict=1");
        bed
    }

    /// What the board sent: answers returned, events kept.
    fn heard(&mut self) -> Vec<Line> {
        let sent = self.core.sent();
        let mut answers = Vec::new();
        for text in sent.split_inclusive(|byte| *byte == b'\n') {
            let text = text.strip_suffix(b"\n").expect("the board sends whole lines");
            match line::parse(text) {
                Some(Line::Event(event)) => self.events.push(event),
                Some(answer) => answers.push(answer),
                None => panic!("the board sent a damaged line: {}", String::from_utf8_lossy(text)),
            }
        }
        answers
    }

    /// Bytes as they are, with the answers to them.
    fn raw(&mut self, bytes: &str) -> Vec<Line> {
        self.core.receive(bytes.as_bytes(), self.now);
        self.heard()
    }

    fn ask(&mut self, body: &str) -> Line {
        self.seq = self.seq % 255 + 1;
        let mut answers = self.raw(&line::request(self.seq, body));
        assert_eq!(answers.len(), 1, "one answer to {body}");
        answers.remove(0)
    }

    fn ok(&mut self, body: &str) -> Fields {
        match self.ask(body) {
            Line::Ok { seq, fields } if seq == self.seq => fields,
            other => panic!("{body}: {other:?}"),
        }
    }

    fn refused(&mut self, body: &str) -> (u32, String) {
        match self.ask(body) {
            Line::Err { seq, code, word } if seq == self.seq => (code, word),
            other => panic!("{body}: {other:?}"),
        }
    }

    /// Lets time pass in half milliseconds, dark, without a word from the host.
    fn wait_us(&mut self, us: u32) {
        for _ in 0..us / 500 {
            self.now = self.now.wrapping_add(500);
            for _ in 0..38 {
                self.core.light_sample(12);
            }
            self.core.poll(self.now);
        }
        assert!(self.heard().is_empty());
    }

    fn wait_ms(&mut self, ms: u32) {
        self.wait_us(ms * 1000);
    }

    fn edge(&mut self) -> bool {
        self.core.sync_edge(self.now)
    }

    fn take_events(&mut self, name: &str) -> Vec<Fields> {
        let (wanted, rest) = std::mem::take(&mut self.events).into_iter().partition(|e| e.name == name);
        self.events = rest;
        let wanted: Vec<Event> = wanted;
        wanted.into_iter().map(|e| e.fields).collect()
    }

    fn disarm_reasons(&mut self) -> Vec<String> {
        self.take_events("disarm").iter().map(|f| f.word("why").unwrap().to_owned()).collect()
    }
}

#[test]
fn boot_is_the_first_event_and_the_gate_is_closed() {
    let mut bed = Bed::new();
    assert!(bed.heard().is_empty());
    assert_eq!((bed.events[0].number, bed.events[0].name.as_str()), (1, "boot"));
    assert_eq!(bed.events[0].fields.uint("boot"), Some(7));
    assert!(!bed.edge());
    assert_eq!(bed.core.rises(), 0);
}

#[test]
fn arm_and_fire_are_refused_until_hello_in_this_boot() {
    let mut bed = Bed::new();
    assert_eq!(bed.refused("arm tag=1 ttl=1000"), (7, "hello".into()));
    assert_eq!(bed.refused("fire"), (7, "hello".into()));
    bed.ok("hello v=1 strict=1");
    bed.ok("arm tag=1 ttl=1000");
    bed.ok("disarm");
    bed.ok("fire");
    let mut rebooted = Bed::new();
    assert_eq!(rebooted.refused("fire"), (7, "hello".into()));
}

#[test]
fn an_armed_gate_lets_one_sync_through_and_closes_at_once() {
    let mut bed = Bed::greeted();
    bed.ok("arm tag=42 ttl=1000");
    assert!(bed.edge(), "triggered");
    assert!(bed.core.trigger_high());
    assert_eq!(bed.ok("ping").uint("g"), Some(0), "closed inside the interrupt");
    bed.now += 1;
    assert!(!bed.edge(), "a microsecond later the gate is closed");
    bed.wait_ms(40);
    assert!(!bed.core.trigger_high());
    assert_eq!(bed.core.rises(), 1);
    assert_eq!(bed.disarm_reasons(), ["used"]);
    let shots = bed.take_events("shot");
    assert_eq!(shots.len(), 1);
    let number = |key| shots[0].uint(key).unwrap();
    assert_eq!((number("n"), number("g"), number("tag"), number("bn")), (1, 1, 42, 1));
    assert_eq!(shots[0].word("src"), Some("sync"));
}

#[test]
fn every_sync_is_reported_gated_or_not() {
    let mut bed = Bed::greeted();
    for n in 1..=5 {
        assert!(!bed.edge());
        bed.wait_ms(60);
        let shots = bed.take_events("shot");
        assert_eq!(shots.len(), 1);
        let number = |key| shots[0].uint(key);
        assert_eq!((number("n"), number("g"), number("tag")), (Some(n), Some(0), Some(0)));
        assert_eq!((number("e"), number("w")), (Some(0), Some(0)));
    }
    assert_eq!(bed.core.rises(), 0);
}

#[test]
fn contact_bounce_gives_one_trigger_and_one_shot() {
    let mut bed = Bed::greeted();
    bed.ok("arm tag=1 ttl=1000");
    assert!(bed.edge());
    for _ in 0..9 {
        bed.now += 170;
        assert!(!bed.edge());
    }
    bed.wait_ms(60);
    let shots = bed.take_events("shot");
    assert_eq!((shots.len(), shots[0].uint("bn"), bed.core.rises()), (1, Some(9), 1));
}

#[test]
fn a_contact_that_bounces_when_it_opens_is_no_second_sync() {
    let mut bed = Bed::greeted();
    bed.core.pins().sync_closed = true;
    assert!(!bed.edge());
    bed.wait_ms(250);
    bed.core.pins().sync_closed = false;
    assert!(!bed.edge());
    bed.wait_ms(60);
    assert_eq!(bed.take_events("shot").len(), 1);
}

#[test]
fn time_to_live_closes_the_gate() {
    let mut bed = Bed::greeted();
    bed.ok("arm tag=1 ttl=100");
    bed.wait_us(99_500);
    assert_eq!(bed.ok("ping").uint("g"), Some(1));
    bed.wait_us(1000);
    assert_eq!(bed.ok("ping").uint("g"), Some(0));
    assert!(!bed.edge());
    assert_eq!(bed.disarm_reasons(), ["ttl"]);
    assert_eq!(bed.core.rises(), 0);
}

#[test]
fn disarm_closes_the_gate() {
    let mut bed = Bed::greeted();
    bed.ok("arm tag=1 ttl=1000");
    bed.ok("disarm");
    assert!(!bed.edge());
    bed.wait_ms(2000);
    assert_eq!(bed.core.rises(), 0);
    assert!(bed.disarm_reasons().is_empty(), "it was no surprise");
}

#[test]
fn hello_closes_the_gate_and_cancels_a_fire() {
    let mut bed = Bed::greeted();
    bed.ok("arm tag=1 ttl=1000");
    bed.ok("hello v=1 strict=1");
    assert!(!bed.edge());
    bed.wait_ms(60);
    bed.ok("fire d=100000");
    bed.ok("hello v=1 strict=1");
    bed.wait_ms(300);
    assert_eq!(bed.core.rises(), 0);
}

#[test]
fn silence_of_the_host_closes_the_gate() {
    let mut bed = Bed::greeted();
    bed.ok("arm tag=1 ttl=60000");
    for _ in 0..5 {
        bed.wait_ms(1400);
        bed.ok("ping");
    }
    assert!(bed.disarm_reasons().is_empty());
    bed.wait_ms(1501);
    assert_eq!(bed.disarm_reasons(), ["silence"]);
    assert!(!bed.edge());
    assert_eq!(bed.core.rises(), 0);
}

#[test]
fn noise_on_the_line_is_silence() {
    let mut bed = Bed::greeted();
    bed.ok("arm tag=1 ttl=60000");
    for _ in 0..4 {
        bed.wait_ms(400);
        bed.raw("#9 ping*0000\n");
        bed.raw("ping\n");
    }
    assert_eq!(bed.disarm_reasons(), ["silence"]);
}

#[test]
fn arm_and_fire_honour_the_recycle_time() {
    let mut bed = Bed::greeted();
    bed.ok("arm tag=1 ttl=1000");
    assert!(bed.edge());
    for _ in 0..5 {
        assert_eq!(bed.refused("arm tag=2 ttl=1000").0, 10);
        assert_eq!(bed.refused("fire").0, 10);
        bed.wait_ms(28);
    }
    assert!(bed.ok("stat").uint("wait").unwrap() <= 10);
    assert!(bed.take_events("ready").is_empty());
    bed.wait_ms(11);
    assert_eq!(bed.take_events("ready").len(), 1);
    bed.ok("arm tag=2 ttl=1000");
    assert!(bed.edge());
    assert_eq!(bed.core.rises(), 2);
}

#[test]
fn a_wired_ready_output_is_waited_for() {
    let mut bed = Bed::greeted();
    bed.ok("cfg rdy=1");
    bed.core.pins().charged = false;
    assert_eq!(bed.refused("arm tag=1 ttl=1000").0, 10);
    bed.core.pins().charged = true;
    bed.ok("arm tag=1 ttl=1000");
}

#[test]
fn no_flash_is_triggered_more_than_twenty_times_a_second() {
    let mut bed = Bed::greeted();
    bed.ok("cfg rec=0");
    bed.ok("fire");
    bed.wait_ms(35);
    assert_eq!(bed.refused("fire"), (12, "rate".into()));
    bed.wait_ms(20);
    bed.ok("fire");
}

#[test]
fn an_edge_later_than_the_polls_time_ends_neither_its_pulse_nor_its_shot() {
    let mut bed = Bed::greeted();
    bed.ok("arm tag=1 ttl=1000");
    assert!(bed.core.sync_edge(bed.now + 40));
    bed.core.poll(bed.now);
    assert!(bed.core.trigger_high(), "an interrupt came after the main loop read the clock");
    bed.heard();
    assert!(bed.take_events("shot").is_empty());
    bed.wait_ms(40);
    assert_eq!(bed.take_events("shot").len(), 1);
}

#[test]
fn settings_do_not_change_under_a_trigger_that_is_high() {
    let mut bed = Bed::greeted();
    bed.ok("cfg lock=1 win=1000 pulse=20000");
    bed.ok("fire");
    bed.wait_ms(5);
    assert_eq!(bed.refused("cfg pulse=10").0, 11);
    bed.wait_ms(20);
    bed.ok("cfg pulse=10");
}

#[test]
fn a_flash_that_is_not_charged_for_hours_is_not_ready_until_it_is() {
    let mut bed = Bed::greeted();
    bed.ok("cfg rdy=1");
    bed.ok("fire");
    bed.wait_ms(100);
    bed.core.pins().charged = false;
    for _ in 0..90 * 60 {
        bed.now = bed.now.wrapping_add(1_000_000);
        bed.core.poll(bed.now);
    }
    assert!(bed.heard().is_empty() && bed.take_events("ready").is_empty());
    assert_eq!(bed.refused("arm tag=1 ttl=1000").0, 10);
    bed.core.pins().charged = true;
    bed.wait_ms(1);
    assert_eq!(bed.take_events("ready").len(), 1);
    bed.ok("arm tag=1 ttl=1000");
}

#[test]
fn a_contact_that_stays_closed_is_reported_once_and_not_armed_on() {
    let mut bed = Bed::greeted();
    bed.core.pins().sync_closed = true;
    bed.edge();
    bed.wait_ms(5000);
    assert_eq!(bed.take_events("stuck").len(), 1);
    assert_eq!(bed.refused("arm tag=1 ttl=1000"), (11, "busy".into()));
    bed.core.pins().sync_closed = false;
    bed.wait_ms(40);
    bed.ok("arm tag=1 ttl=1000");
}

#[test]
fn the_clock_may_wrap_between_arming_and_sync() {
    let mut bed = Bed::at(u32::MAX - 50_000);
    bed.ok("hello v=1 strict=1");
    bed.ok("arm tag=1 ttl=1000");
    bed.wait_ms(100);
    assert!(bed.edge());
    bed.wait_ms(149);
    assert_eq!(bed.refused("arm tag=2 ttl=1000").0, 10);
    bed.wait_ms(2);
    bed.ok("arm tag=2 ttl=1000");
}
