//! The firmware core on a bench with a clock of its own: every promise of `firmware/PROTOCOL.md`.

mod light;

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

fn refusal(seq: u8, code: u32, word: &str) -> Vec<Line> {
    vec![Line::Err { seq, code, word: word.into() }]
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
fn disarm_and_silence_cancel_a_pending_fire() {
    let mut bed = Bed::greeted();
    bed.ok("fire d=100000 tag=1");
    bed.wait_ms(50);
    bed.ok("disarm");
    bed.wait_ms(200);
    assert_eq!(bed.core.rises(), 0);

    bed.ok("fire d=5000000 tag=1");
    bed.wait_ms(1600);
    assert_eq!(bed.disarm_reasons(), ["silence"]);
    bed.wait_ms(5000);
    assert_eq!(bed.core.rises(), 0);
}

#[test]
fn fire_triggers_after_its_delay() {
    let mut bed = Bed::greeted();
    bed.ok("fire d=100000 tag=9");
    assert_eq!(bed.refused("arm tag=1 ttl=1000"), (11, "busy".into()));
    bed.wait_us(99_500);
    assert_eq!(bed.core.rises(), 0);
    bed.wait_us(1000);
    assert_eq!(bed.core.rises(), 1);
    bed.wait_ms(60);
    let shots = bed.take_events("shot");
    assert_eq!(
        (shots[0].word("src"), shots[0].uint("g"), shots[0].uint("tag")),
        (Some("fire"), Some(1), Some(9))
    );
}

#[test]
fn a_sync_beside_a_pending_fire_stays_dark_and_the_fire_waits_its_turn() {
    let mut bed = Bed::greeted();
    bed.ok("fire d=1000 tag=9");
    assert!(!bed.edge());
    bed.wait_ms(20);
    assert_eq!(bed.core.rises(), 0);
    bed.wait_ms(80);
    assert_eq!(bed.core.rises(), 1);
    let shots = bed.take_events("shot");
    assert_eq!(shots.iter().map(|s| s.uint("g").unwrap()).collect::<Vec<_>>(), [0, 1]);
}

#[test]
fn a_fire_that_a_closed_contact_holds_up_is_cancelled_and_does_not_come_when_it_opens() {
    let mut bed = Bed::greeted();
    bed.ok("fire d=100000 tag=9");
    bed.core.pins().sync_closed = true;
    assert!(!bed.edge());
    bed.wait_us(149_500);
    assert!(bed.disarm_reasons().is_empty());
    bed.wait_us(1000);
    assert_eq!(bed.disarm_reasons(), ["late"]);
    assert_eq!(bed.ok("stat").uint("fire"), Some(0));
    for _ in 0..3 {
        bed.wait_ms(1000);
        bed.ok("ping");
    }
    bed.core.pins().sync_closed = false;
    bed.wait_ms(1000);
    assert_eq!(bed.core.rises(), 0);
    bed.ok("fire");
    bed.wait_ms(1);
    assert_eq!(bed.core.rises(), 1);
}

#[test]
fn a_fire_asks_the_ready_output_again_when_its_moment_comes() {
    let mut bed = Bed::greeted();
    bed.ok("cfg rdy=1");
    bed.ok("fire d=100000 tag=1");
    bed.core.pins().charged = false;
    bed.wait_ms(151);
    assert_eq!((bed.disarm_reasons(), bed.core.rises()), (vec!["late".to_owned()], 0));
    bed.core.pins().charged = true;
    bed.wait_ms(500);
    assert_eq!(bed.core.rises(), 0, "cancelled for good");
    bed.ok("fire d=100000 tag=2");
    bed.core.pins().charged = false;
    bed.wait_ms(120);
    bed.core.pins().charged = true;
    bed.wait_ms(1);
    assert_eq!(bed.core.rises(), 1, "charged 20 ms late is in time");
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
fn a_fire_that_waited_for_a_shot_keeps_its_pulse() {
    let mut bed = Bed::greeted();
    bed.ok("fire d=1000 tag=9");
    bed.edge();
    bed.now += 30_000;
    bed.core.poll(bed.now); // tells the shot, and would be late by its writing
    bed.now += 4000;
    bed.core.poll(bed.now);
    assert!(bed.core.trigger_high());
    bed.now += 900;
    bed.core.poll(bed.now);
    assert!(bed.core.trigger_high(), "a pulse of 1 ms");
    bed.heard();
    assert_eq!(bed.core.rises(), 1);
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
fn a_repeated_request_replays_its_answer_and_is_not_carried_out_again() {
    let mut bed = Bed::greeted();
    bed.ok("arm tag=1 ttl=1000");
    let request = line::request(bed.seq, "arm tag=1 ttl=1000");
    assert_eq!(bed.raw(&request), [Line::Ok { seq: bed.seq, fields: Fields::default() }]);
    assert!(bed.edge());
    bed.wait_ms(500);
    assert_eq!(bed.raw(&request), [Line::Ok { seq: bed.seq, fields: Fields::default() }]);
    assert_eq!(bed.ok("ping").uint("g"), Some(0), "the replay armed nothing");
}

#[test]
fn the_same_number_with_other_bytes_is_refused() {
    let mut bed = Bed::greeted();
    bed.ok("ping");
    let request = line::request(bed.seq, "arm tag=1 ttl=1000");
    assert_eq!(bed.raw(&request), refusal(bed.seq, 6, "seq"));
    assert!(!bed.edge());
    let repeated = line::request(bed.seq, "ping");
    assert!(matches!(bed.raw(&repeated)[0], Line::Ok { .. }), "the first answer is still there");
}

#[test]
fn hello_is_carried_out_even_if_its_bytes_were_seen_before() {
    let mut bed = Bed::new();
    let hello = line::request(1, "hello v=1 strict=1");
    bed.raw(&hello);
    bed.now += 1_000_000;
    let Line::Ok { fields, .. } = &bed.raw(&hello)[0] else { panic!("refused") };
    assert_eq!(fields.uint("t"), Some(1_000_000));
    assert_eq!((fields.uint("boot"), fields.word("mcu")), (Some(7), Some("native")));
}

#[test]
fn numbered_requests_need_a_right_checksum_in_upper_case() {
    let mut bed = Bed::new();
    let whole = line::request(10, "ping");
    for damaged in
        ["#10 ping\n".to_owned(), whole.replace("ping", "pinh"), whole.to_lowercase(), "#1 ping*\n".into()]
    {
        assert_eq!(bed.raw(&damaged), refusal(0, 1, "crc"), "{damaged}");
    }
    assert!(matches!(bed.raw(&whole)[0], Line::Ok { seq: 10, .. }));
}

#[test]
fn a_person_may_type_until_strict() {
    let mut bed = Bed::new();
    assert!(matches!(bed.raw("ping\r\n")[0], Line::Ok { seq: 0, .. }));
    assert!(bed.raw("\n\r\n").is_empty());
    assert!(matches!(bed.raw("hello v=1\n")[0], Line::Ok { seq: 0, .. }));
    assert!(matches!(bed.raw("arm tag=5 ttl=1000\n")[0], Line::Ok { seq: 0, .. }));
    assert!(bed.edge());
    bed.ok("hello v=1 strict=1");
    assert_eq!(bed.raw("ping\n"), refusal(0, 7, "strict"));
}

#[test]
fn sloppy_requests_are_refused() {
    let mut bed = Bed::greeted();
    for (body, code) in [
        ("ping ", 2),
        ("ping  x=1", 2),
        ("PING", 2),
        ("", 2),
        ("arm tag=1 ttl", 2),
        ("arm tag=1 ttl=", 2),
        ("arm tag=1 ttl=-1", 2),
        ("arm tag=1 ttl=1x", 2),
        ("launch", 4),
        ("ping x=1", 5),
        ("arm tag=1", 5),
        ("arm tag=0 ttl=100", 5),
        ("arm tag=1 ttl=0", 5),
        ("arm tag=1 ttl=60001", 5),
        ("arm tag=1 tag=1 ttl=10", 5),
        ("arm tag=4294967296 ttl=10", 5),
        ("arm tag=1 ttl=10 x=1", 5),
        ("fire d=10000001", 5),
        ("adc ch=1", 5),
        ("hello v=2", 5),
        ("cfg lock=10", 5),
        ("cfg win=60001", 5),
        ("get n=1", 13),
    ] {
        assert_eq!(bed.refused(body).0, code, "{body:?}");
    }
    assert_eq!(bed.raw("#0 ping*A7DC\n").len(), 1);
    assert!(!bed.edge(), "none of it armed");
}

#[test]
fn an_overlong_line_is_refused_whole() {
    let mut bed = Bed::new();
    let longest = format!("{:<96}\n", "ping").replace(' ', "x");
    assert_eq!(longest.len(), 97);
    assert_eq!(bed.raw(&longest), refusal(0, 4, "verb"));
    let too_long = format!("{}\n", "x".repeat(97));
    assert_eq!(bed.raw(&too_long), refusal(0, 3, "long"));
    assert!(matches!(bed.raw("ping\n")[0], Line::Ok { .. }));
}

#[test]
fn the_last_sixteen_shots_are_kept() {
    let mut bed = Bed::greeted();
    for _ in 0..20 {
        bed.edge();
        bed.wait_ms(60);
    }
    let reported = bed.take_events("shot");
    assert_eq!(bed.refused("get n=4"), (13, "gone".into()));
    assert_eq!(bed.refused("get n=21"), (13, "gone".into()));
    for n in 5..=20 {
        assert_eq!(bed.ok(&format!("get n={n}")), reported[n - 1]);
    }
}

#[test]
fn events_are_numbered_without_a_gap() {
    let mut bed = Bed::greeted();
    bed.ok("arm tag=1 ttl=1000");
    bed.edge();
    bed.wait_ms(200);
    let numbers: Vec<u16> = bed.events.iter().map(|e| e.number).collect();
    assert_eq!(numbers, (1..=numbers.len() as u16).collect::<Vec<_>>());
    assert_eq!(bed.ok("ping").uint("ev"), Some(numbers.len() as u32));
}

#[test]
fn settings_are_taken_whole_or_not_at_all() {
    let mut bed = Bed::greeted();
    let before = bed.ok("cfg");
    assert_eq!(bed.refused("cfg rec=300 sil=1").0, 5);
    assert_eq!(bed.ok("cfg"), before);
    assert_eq!(bed.ok("cfg rec=300 sil=800").uint("rec"), Some(300));
    bed.ok("arm tag=1 ttl=500");
    assert_eq!(bed.refused("cfg rec=0").0, 11);
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

proptest::proptest! {
    #![proptest_config(proptest::test_runner::Config::with_cases(300))]

    #[test]
    fn no_bytes_upset_the_core_nor_open_its_gate(bytes in proptest::collection::vec(proptest::num::u8::ANY, 0..400)) {
        let mut bed = Bed::greeted();
        bed.core.receive(&bytes, bed.now);
        bed.core.receive(b"\n", bed.now);
        bed.heard();
        proptest::prop_assert!(!bed.edge());
        bed.wait_ms(60);
        bed.ok("ping");
    }
}
