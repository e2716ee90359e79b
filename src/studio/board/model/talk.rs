//! Random conversations, held with the core and with the model at once.

use super::{Answer, BAD, Body, Model, Number, POLL, Step, Told};
use crate::rig::flash::line::{self, Event, Fields, Line};
use crate::studio::board::core::{Config, Core};
use proptest::prelude::*;

/// The core beside the model.
struct Pair {
    core: Core,
    model: Model,
    boot: u16,
}

impl Pair {
    fn new(now: u64) -> Self {
        let mut pair = Self {
            core: Core::new(Config::default(), 1, now as u32),
            model: Model::boot(now, false, true),
            boot: 1,
        };
        pair.core.light_sample(12);
        pair
    }

    fn now(&self) -> u32 {
        self.model.now as u32
    }

    fn step(&mut self, step: &Step) {
        match step {
            Step::Wait { ms } => {
                for _ in 0..u64::from(*ms) * 1000 / POLL {
                    self.model.now += POLL;
                    self.model.poll();
                    self.core.poll(self.model.now as u32);
                }
            }
            Step::Edge => self.edge(),
            Step::Contact { closed } => {
                let closes = *closed && !self.model.contact;
                self.model.contact = *closed;
                self.core.pins().sync_closed = *closed;
                if closes {
                    self.edge();
                }
            }
            Step::Charged(charged) => {
                self.model.charged = *charged;
                self.core.pins().charged = *charged;
            }
            Step::Ask(number, body) => {
                let (request, seq, answer) = self.model.ask(number, body);
                self.exchange(&request, Some((seq, answer)));
            }
            Step::Again => {
                if let Some((request, seq, answer)) = self.model.again() {
                    self.exchange(&request, Some((seq, answer)));
                } else {
                    self.core.poll(self.now());
                }
            }
            Step::Damaged => {
                self.model.poll();
                self.exchange("#7 arm tag=1 ttl=1000*0000\n", Some((0, Answer::Err(1))));
            }
            Step::Reboot => self.reboot(),
        }
        self.exchange("", None);
    }

    fn edge(&mut self) {
        let gated = self.model.gate();
        self.model.edge();
        let now = self.now();
        assert_eq!(self.core.sync_edge(now), gated, "the trigger at an edge");
    }

    fn reboot(&mut self) {
        self.boot += 1;
        self.model = Model::boot(self.model.now, self.model.contact, self.model.charged);
        self.core = Core::new(Config::default(), self.boot, self.model.now as u32);
        self.core.light_sample(12);
        self.core.pins().sync_closed = self.model.contact;
        self.core.pins().charged = self.model.charged;
    }

    /// Sends, and compares all that comes and all that can be seen.
    fn exchange(&mut self, request: &str, expected: Option<(u8, Answer)>) {
        let now = self.now();
        self.core.receive(request.as_bytes(), now);
        let sent = self.core.sent();
        let (mut answers, mut events) = (Vec::new(), Vec::new());
        for text in sent.split_inclusive(|byte| *byte == b'\n') {
            match line::parse(text.strip_suffix(b"\n").expect("whole lines")) {
                Some(Line::Event(event)) => events.push(event),
                Some(answer) => answers.push(answer),
                None => panic!("damaged: {}", String::from_utf8_lossy(text)),
            }
        }
        assert_eq!(answers.len(), usize::from(expected.is_some()), "{request:?}: {answers:?}");
        if let Some((seq, answer)) = expected {
            compare_answer(request, &answers[0], seq, &answer);
        }
        let first = self.model.events.wrapping_sub(self.model.told.len() as u16);
        let told = std::mem::take(&mut self.model.told);
        assert_eq!(events.len(), told.len(), "{events:?} and {told:?}");
        for (at, (event, told)) in events.iter().zip(&told).enumerate() {
            assert_eq!(event.number, first.wrapping_add(at as u16 + 1));
            compare_event(event, told);
        }
        assert_eq!(self.core.pins().gate_open, self.model.gate(), "the gate");
        assert_eq!(self.core.rises(), self.model.rises, "the trigger");
    }
}

fn assert_fields(what: &str, fields: &Fields, expected: &[(&'static str, u32)]) {
    for (key, value) in expected {
        assert_eq!(fields.uint(key), Some(*value), "{key} of {what:?}: {fields:?}");
    }
}

fn compare_answer(request: &str, heard: &Line, seq: u8, expected: &Answer) {
    match (heard, expected) {
        (Line::Ok { seq: heard, fields }, Answer::Ok(expected)) if *heard == seq => {
            assert_fields(request, fields, expected);
        }
        (Line::Err { seq: heard, code, .. }, Answer::Err(expected)) if *heard == seq && code == expected => {}
        _ => panic!("{request:?}: {heard:?}, expected #{seq} {expected:?}"),
    }
}

fn compare_event(event: &Event, told: &Told) {
    let (name, word, fields) = match told {
        Told::Boot => ("boot", None, Vec::new()),
        Told::Disarm(why) => ("disarm", Some(("why", *why)), Vec::new()),
        Told::Shot(shot) => ("shot", Some(("src", if shot.fired { "fire" } else { "sync" })), shot.fields()),
        Told::Ready => ("ready", None, Vec::new()),
        Told::Stuck => ("stuck", None, Vec::new()),
    };
    assert_eq!(event.name, name, "{event:?}");
    if let Some((key, value)) = word {
        assert_eq!(event.fields.word(key), Some(value), "{event:?}");
    }
    assert_fields(name, &event.fields, &fields);
}

fn body() -> impl Strategy<Value = Body> {
    prop_oneof![
        3 => (0u8..2).prop_map(|strict| Body::Hello { strict }),
        1 => Just(Body::Ping),
        1 => Just(Body::Stat),
        1 => Just(Body::Disarm),
        5 => (1u32..99, prop_oneof![1u32..100, 100u32..4000]).prop_map(|(tag, ttl)| Body::Arm { tag, ttl }),
        3 => (prop_oneof![Just(0), 1u32..300_000], 0u32..99).prop_map(|(d, tag)| Body::Fire { d, tag }),
        1 => (0u16..300, 2u16..60, 200u16..2000, 0u8..2)
            .prop_map(|(rec, lock, sil, rdy)| Body::Cfg { rec, lock, sil, rdy }),
        1 => (0u32..20).prop_map(|back| Body::Get { back }),
        1 => (0..BAD.len()).prop_map(|i| BAD[i].clone()),
    ]
}

fn step() -> impl Strategy<Value = Step> {
    let number = prop_oneof![6 => Just(Number::Next), 1 => Just(Number::Last), 1 => Just(Number::None)];
    prop_oneof![
        4 => prop_oneof![1u16..5, 5u16..200, 200u16..3000].prop_map(|ms| Step::Wait { ms }),
        4 => Just(Step::Edge),
        1 => any::<bool>().prop_map(|closed| Step::Contact { closed }),
        1 => any::<bool>().prop_map(Step::Charged),
        12 => (number, body()).prop_map(|(number, body)| Step::Ask(number, body)),
        1 => Just(Step::Again),
        1 => Just(Step::Damaged),
    ]
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(2000))]

    #[test]
    fn core_and_model_agree_on_every_conversation(
        start in 0u64..=u64::from(u32::MAX),
        steps in proptest::collection::vec(prop_oneof![60 => step(), 1 => Just(Step::Reboot)], 1..150),
    ) {
        let mut pair = Pair::new(start);
        pair.step(&Step::Ask(Number::Next, Body::Hello { strict: 0 }));
        for step in &steps {
            pair.step(step);
        }
    }
}
