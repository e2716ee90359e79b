//! What the studio knows of the trigger by itself: every rise, and whether an order from the host covered it.
//!
//! Listens on the wire between host and core, on the board's side of it, and shares no state with either: an `arm` or
//! `fire` counts when the core has answered it with `ok`; it is over when it has been used, its time to live has
//! passed, the host was silent for too long, the board was told `disarm` or `hello`, or lost its power.

use std::time::Duration;

/// One rise of the trigger, as the studio saw it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rise {
    /// Time since the board was first powered up.
    pub at: Duration,
    /// Whether an order of the host that the board had accepted covered it.
    pub ordered: bool,
    /// Tag of that order; 0 without one.
    pub tag: u32,
    /// Energy that the flash gave, relative to nominal; 0 for a misfire.
    pub energy: f64,
}

/// An order that the board has accepted and not yet carried out.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Order {
    tag: u32,
    /// When it is over, us; a fire has no end of its own.
    until: Option<u64>,
}

/// Listens and keeps the books.
#[derive(Debug, Default)]
pub(super) struct Ledger {
    /// Silence of the host after which no order holds any more, us.
    silence_us: u64,
    order: Option<Order>,
    heard_us: u64,
    /// The last whole request: the same again is answered from memory and carried out once.
    last: Vec<u8>,
    rises: Vec<Rise>,
}

impl Ledger {
    pub(super) fn new(silence: Duration) -> Self {
        Self { silence_us: silence.as_micros() as u64, ..Self::default() }
    }

    /// The host sent the line `request`, and the core answered it with what begins `sent`.
    pub(super) fn answered(&mut self, now_us: u64, request: &[u8], sent: &[u8]) {
        let Some((numbered, words)) = words(request) else { return };
        let verb = words[0];
        if numbered && request == self.last && verb != "hello" {
            self.heard_us = now_us;
            return;
        }
        let Some(answer) = sent.split(|byte| *byte == b'\n').find(|line| line.starts_with(b"#")) else {
            return;
        };
        let obeyed =
            std::str::from_utf8(answer).is_ok_and(|text| text.split([' ', '*']).nth(1) == Some("ok"));
        if numbered {
            self.heard_us = now_us;
            self.last = request.to_vec();
        }
        if !obeyed {
            return;
        }
        self.heard_us = now_us;
        let number = |key: &str| {
            let mut fields = words.iter().filter_map(|word| word.split_once('='));
            fields.find(|(name, _)| *name == key).and_then(|(_, value)| value.parse::<u32>().ok())
        };
        let tag = number("tag").unwrap_or(0);
        match verb {
            "arm" => {
                let until = number("ttl").map(|ms| now_us + u64::from(ms) * 1000);
                self.order = Some(Order { tag, until });
            }
            "fire" => self.order = Some(Order { tag, until: None }),
            "disarm" | "hello" => self.order = None,
            _ => {}
        }
    }

    /// The board lost its power, or was reset.
    pub(super) fn forgotten(&mut self) {
        self.order = None;
        self.last.clear();
    }

    /// The trigger rose, and the flash gave `energy`.
    pub(super) fn rose(&mut self, now_us: u64, energy: f64) {
        let silent = now_us.saturating_sub(self.heard_us) >= self.silence_us;
        let order =
            self.order.take().filter(|order| !silent && order.until.is_none_or(|until| now_us < until));
        self.rises.push(Rise {
            at: Duration::from_micros(now_us),
            ordered: order.is_some(),
            tag: order.map_or(0, |order| order.tag),
            energy,
        });
    }

    pub(super) fn rises(&self) -> &[Rise] {
        &self.rises
    }
}

/// Verb and arguments of a request, and whether it has a number.
fn words(request: &[u8]) -> Option<(bool, Vec<&str>)> {
    let text = std::str::from_utf8(request).ok()?.trim_end_matches(['\r', '\n']);
    let text = text.rsplit_once('*').map_or(text, |(text, _)| text);
    let mut words: Vec<&str> = text.split(' ').collect();
    let numbered = words[0].starts_with('#');
    if numbered {
        words.remove(0);
    }
    (!words.is_empty() && !words[0].is_empty()).then_some((numbered, words))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ledger() -> Ledger {
        Ledger::new(Duration::from_millis(1500))
    }

    fn last(ledger: &Ledger) -> (bool, u32) {
        ledger.rises().last().map(|rise| (rise.ordered, rise.tag)).unwrap()
    }

    #[test]
    fn an_accepted_order_covers_one_rise_while_it_holds() {
        let mut ledger = ledger();
        ledger.rose(0, 1.0);
        assert_eq!(last(&ledger), (false, 0));
        let arm = b"#1 arm tag=7 ttl=1000*0000\n";
        ledger.answered(1000, arm, b"!3 ready*0000\n#1 ok*0000\n");
        ledger.rose(900_000, 1.0);
        assert_eq!(last(&ledger), (true, 7));
        ledger.rose(910_000, 1.0);
        assert_eq!(last(&ledger), (false, 0), "once");
        ledger.answered(920_000, arm, b"#1 ok*0000\n");
        ledger.rose(930_000, 1.0);
        assert_eq!(last(&ledger), (false, 0), "an answer from memory opens nothing");
        ledger.answered(940_000, b"#2 fire d=0 tag=9*0000\n", b"#2 ok*0000\n");
        ledger.rose(950_000, 0.0);
        assert_eq!(last(&ledger), (true, 9));
    }

    #[test]
    fn refusal_time_silence_and_disarming_end_an_order() {
        let covered = |prepare: &dyn Fn(&mut Ledger), at_us: u64| {
            let mut ledger = ledger();
            prepare(&mut ledger);
            ledger.rose(at_us, 1.0);
            last(&ledger).0
        };
        let armed =
            |ledger: &mut Ledger| ledger.answered(0, b"#1 arm tag=7 ttl=5000*0000\n", b"#1 ok*0000\n");
        assert!(covered(&armed, 1_499_000));
        assert!(!covered(&armed, 1_500_000), "silence");
        let pinged = |ledger: &mut Ledger| {
            armed(ledger);
            for second in 1..=5u64 {
                ledger.answered(second * 1_000_000, b"#2 ping*0000\n", b"#2 ok t=1*0000\n");
            }
        };
        assert!(covered(&pinged, 4_999_000));
        assert!(!covered(&pinged, 5_000_000), "time to live");
        let refused = |ledger: &mut Ledger| {
            ledger.answered(0, b"#1 arm tag=7 ttl=5000*0000\n", b"#1 err 10 notready*0000\n");
        };
        assert!(!covered(&refused, 1000));
        let disarmed = |ledger: &mut Ledger| {
            armed(ledger);
            ledger.answered(10, b"#2 disarm*0000\n", b"#2 ok*0000\n");
        };
        assert!(!covered(&disarmed, 1000));
        let reset = |ledger: &mut Ledger| {
            armed(ledger);
            ledger.forgotten();
        };
        assert!(!covered(&reset, 1000));
    }
}
