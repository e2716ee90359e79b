//! How the flash stands, as sentences for a page: what is the matter, and what to do.

use super::pulse::{self, Placement};
use crate::pair::FlashSync;
use crate::rig::RECYCLE_PATIENCE;
use std::time::{Duration, Instant};

/// The board's answer to `stat`.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Stat {
    /// The sync contact is closed.
    pub(super) closed: bool,
    /// The gate is open.
    pub(super) gate: bool,
    /// The flash may be triggered.
    pub(super) ready: bool,
    /// Time until then, as far as it tells.
    pub(super) wait: Duration,
}

/// All that is known of the flash's state.
#[derive(Clone, Debug, Default)]
pub(super) struct Condition {
    /// Since when the link is away, and why.
    pub(super) away: Option<(Instant, String)>,
    /// What the board said last.
    pub(super) stat: Stat,
    /// It waits for the flash's ready output too.
    pub(super) ready_output: bool,
    /// The contact was reported stuck, and no sync came since.
    pub(super) stuck: bool,
    /// When the board was found restarted; forgotten when the next frame begins.
    pub(super) restarted: Option<Instant>,
    /// The gate was closed because this computer was silent; forgotten when the next frame begins.
    pub(super) silenced: bool,
    /// Until when the gate stays open at most.
    pub(super) armed_until: Option<Instant>,
    /// The last shot with a trigger.
    pub(super) last_pulse: Option<FlashSync>,
}

impl Condition {
    /// Whether a pair can be shot now (or within [`RECYCLE_PATIENCE`]), and the words. `port`: where the board is,
    /// or should be.
    pub(super) fn words(&self, port: &str, now: Instant) -> (bool, String) {
        if let Some((since, reason)) = &self.away {
            let seconds = now.saturating_duration_since(*since).as_secs();
            // Only that name goes with the board; the others go with the socket.
            let socket = if port.contains("/by-id/") { "at any socket" } else { "at the same socket" };
            return (
                false,
                format!(
                    "the flash controller has been gone for {seconds} s ({reason}); it is looked for at {port}. Plug \
                     it in again, {socket}."
                ),
            );
        }
        let Stat { closed, gate, ready, wait } = self.stat;
        if closed && self.stuck {
            let words = "the camera's sync contact has been closed for more than 2 s: take the sync cable off the \
                         camera. If it opens then, the camera or another flash on it holds it; if not, the cable is \
                         shorted.";
            return (false, words.into());
        }
        if closed {
            let words = "the camera's sync contact is closed; if it stays so, check the cable and the camera";
            return (false, words.into());
        }
        if gate {
            let left = self.armed_until.map(|until| until.saturating_duration_since(now).as_secs_f64());
            let left = left.map_or_else(String::new, |s| format!(", and closes by itself in {s:.1} s"));
            return (true, format!("armed: the gate is open for the next sync{left}"));
        }
        if !ready && wait > RECYCLE_PATIENCE {
            let seconds = wait.as_secs_f64();
            return (false, format!("recycling, {seconds:.0} s to go. Wait, or set a shorter recycle time."));
        }
        if !ready && wait > Duration::ZERO {
            return (true, format!("recycling, {} ms to go", wait.as_millis()));
        }
        if !ready && self.ready_output {
            let words = "the flash's ready output is low: it is charging, switched off, or its wire is loose";
            return (false, words.into());
        }
        if let Some(when) = self.restarted {
            let seconds = now.saturating_duration_since(when).as_secs();
            return (
                true,
                format!(
                    "ready, but the controller restarted {seconds} s ago: what was being shot must be taken again. If \
                     it happens often, check its cable and power."
                ),
            );
        }
        if self.silenced {
            let words = "ready, but the controller closed its gate because this computer was silent for too long: \
                         take the frame again, and close what keeps the computer busy";
            return (true, words.into());
        }
        match &self.last_pulse {
            Some(last) if matches!(pulse::placement(last), Placement::Dark | Placement::Clipped) => {
                (true, format!("ready, but look at the last pulse: {}", pulse::advice(last)))
            }
            _ => (true, "ready".into()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::pulse::tests::pulse;
    use super::*;

    fn at_rest() -> Condition {
        Condition { stat: Stat { ready: true, ..Stat::default() }, ..Condition::default() }
    }

    #[track_caller]
    fn says(condition: &Condition, now: Instant, ready: bool, part: &str) {
        let (is_ready, words) = condition.words("/dev/ttyACM0", now);
        assert!(is_ready == ready && words.contains(part), "{is_ready} {words}");
    }

    #[test]
    fn every_state_has_its_sentence() {
        let now = Instant::now();
        let later = |s: f64| now + Duration::from_secs_f64(s);
        let rest = at_rest();
        assert_eq!(rest.words("x", now), (true, "ready".into()));
        let with = |stat: Stat| Condition { stat, ..at_rest() };
        let away = Condition { away: Some((now, "Broken pipe".into())), ..at_rest() };
        says(&away, later(12.3), false, "gone for 12 s (Broken pipe); it is looked for at /dev/ttyACM0");
        says(&with(Stat { closed: true, ..Stat::default() }), now, false, "contact is closed");
        let stuck = Condition { stuck: true, ..with(Stat { closed: true, ..Stat::default() }) };
        says(&stuck, now, false, "take the sync cable off");
        let open = with(Stat { gate: true, ready: true, ..Stat::default() });
        says(&Condition { armed_until: Some(later(12.0)), ..open }, later(4.5), true, "in 7.5 s");
        let wait = |ms| with(Stat { wait: Duration::from_millis(ms), ..Stat::default() });
        says(&wait(340), now, true, "recycling, 340 ms to go");
        says(&wait(40_000), now, false, "recycling, 40 s to go");
        says(&Condition { ready_output: true, ..with(Stat::default()) }, now, false, "ready output is low");
        says(&Condition { restarted: Some(now), ..at_rest() }, later(3.0), true, "restarted 3 s ago");
        says(&Condition { silenced: true, ..at_rest() }, now, true, "silent for too long");
        says(&Condition { last_pulse: Some(pulse(2.0)), ..at_rest() }, now, true, "No light was seen");
        says(&Condition { last_pulse: Some(pulse(1015.0)), ..at_rest() }, now, true, "smaller resistor");
        says(&Condition { last_pulse: Some(pulse(500.0)), ..at_rest() }, now, true, "ready");
    }
}
