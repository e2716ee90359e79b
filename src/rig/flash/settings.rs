//! What the host wants of the board's settings. A board that restarted has its defaults, so they are sent after
//! every greeting; what is not given stays as the board has it.

use super::line::Fields;
use std::time::Duration;

/// Settings wanted; `None` leaves the board's own. `firmware/PROTOCOL.md` has the ranges.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct FlashSettings {
    /// Recycle time of the flash, counted from the trigger, to the millisecond; up to 60 s.
    pub recycle: Option<Duration>,
    /// Whether the flash's ready output is wired, and must be high before it is triggered.
    pub ready_output: Option<bool>,
    /// Length of the trigger pulse.
    pub pulse: Option<Duration>,
    /// After an edge of the sync contact, further ones are bounce for so long.
    pub lock: Option<Duration>,
    /// How long light is gathered after an edge.
    pub window: Option<Duration>,
    /// Silence of the host after which the board goes safe. Pings go out every 400 ms.
    pub silence: Option<Duration>,
}

impl FlashSettings {
    /// The request that sets them; without any it asks for the board's own.
    pub(super) fn request(&self) -> String {
        let ms = |wish: Option<Duration>| wish.map(|time| time.as_millis());
        let us = |wish: Option<Duration>| wish.map(|time| time.as_micros());
        let wishes = [
            ("sil", ms(self.silence)),
            ("pulse", us(self.pulse)),
            ("lock", ms(self.lock)),
            ("win", us(self.window)),
            ("rec", ms(self.recycle)),
            ("rdy", self.ready_output.map(u128::from)),
        ];
        let mut request = "cfg".to_owned();
        for (key, value) in wishes {
            if let Some(value) = value {
                request += &format!(" {key}={value}");
            }
        }
        request
    }
}

/// The board's settings as it tells them.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct BoardSettings {
    /// Silence after which it goes safe, ms.
    pub silence_ms: u32,
    /// Length of the trigger pulse, us.
    pub pulse_us: u32,
    /// After an edge, further ones are bounce for so long, ms.
    pub lock_ms: u32,
    /// How long light is gathered, us.
    pub window_us: u32,
    /// Recycle time, ms.
    pub recycle_ms: u32,
    /// Whether the flash's ready output must be high.
    pub ready_output: bool,
}

impl BoardSettings {
    /// Out of the answer to `cfg`.
    pub(super) fn read(fields: &Fields) -> Option<Self> {
        Some(Self {
            silence_ms: fields.uint("sil")?,
            pulse_us: fields.uint("pulse")?,
            lock_ms: fields.uint("lock")?,
            window_us: fields.uint("win")?,
            recycle_ms: fields.uint("rec")?,
            ready_output: fields.uint("rdy")? == 1,
        })
    }

    /// How long after an edge its report may be under way: the lock time, and the board's own turn.
    pub(super) fn report_delay(&self) -> Duration {
        Duration::from_millis(u64::from(self.lock_ms) + 5)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_what_is_wished_is_sent() {
        assert_eq!(FlashSettings::default().request(), "cfg");
        let wishes = FlashSettings {
            recycle: Some(Duration::from_secs_f64(4.5)),
            ready_output: Some(false),
            window: Some(Duration::from_micros(15_000)),
            ..FlashSettings::default()
        };
        assert_eq!(wishes.request(), "cfg win=15000 rec=4500 rdy=0");
    }

    #[test]
    fn a_request_with_everything_fits_the_line() {
        let most = Some(Duration::from_secs(60));
        let wishes = FlashSettings {
            recycle: most,
            ready_output: Some(true),
            pulse: Some(Duration::from_millis(20)),
            lock: Some(Duration::from_secs(1)),
            window: Some(Duration::from_millis(60)),
            silence: most,
        };
        let line = super::super::line::request(255, &wishes.request());
        assert!(line.len() <= 97, "{} bytes: {line}", line.len());
    }
}
