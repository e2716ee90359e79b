//! What happens at the board, as it happens: for whoever follows ([`super::SerialFlash::follow`]).

use crate::pair::{FlashSync, SyncSource};
use serde::Serialize;
use std::fmt;

/// Something that happened, with its time.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct FlashEvent {
    /// When the driver heard of it, UTC seconds since 1970; a sync has its own time besides.
    pub at: f64,
    /// What.
    #[serde(flatten)]
    pub news: FlashNews,
}

/// What happened, at the board or on the way to it.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[serde(tag = "event", rename_all = "snake_case")]
pub enum FlashNews {
    /// The board restarted: its gate is closed, its shots are forgotten.
    Boot {
        /// Number of the new boot.
        boot: u32,
        /// Cause of the reset, as the board numbers it.
        reset: u32,
    },
    /// The sync contact closed, or the board fired on command.
    Shot {
        /// What it saw.
        sync: FlashSync,
        /// Its own report was lost; the board was asked for it.
        fetched: bool,
    },
    /// The gate closed without a request.
    Disarm {
        /// `used`, `ttl` (its time was over) or `silence` (this computer said nothing).
        why: String,
    },
    /// The recycle time after a trigger is over.
    Ready,
    /// The sync contact has been closed for two seconds.
    Stuck,
    /// An event that this driver does not know.
    Other {
        /// Its name.
        name: String,
    },
    /// Reports were lost on the wire; shots among them are fetched.
    Gap {
        /// How many.
        events: u16,
    },
    /// The link broke or the board fell silent.
    Lost {
        /// What the system said.
        reason: String,
    },
    /// The link is back.
    Reconnected {
        /// Who answers.
        description: String,
        /// Whether it is the same boot, with everything it had counted.
        same_boot: bool,
    },
}

impl fmt::Display for FlashNews {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            FlashNews::Boot { boot, reset } => {
                write!(f, "the board restarted (boot {boot}, reset cause {reset}); its gate is closed")
            }
            FlashNews::Shot { sync, fetched } => {
                write!(f, "{}{}", shot(sync), if *fetched { " (report was lost, fetched)" } else { "" })
            }
            FlashNews::Disarm { why } => match why.as_str() {
                "used" => write!(f, "gate closed: used"),
                "ttl" => write!(f, "gate closed: no sync came in time"),
                "silence" => write!(f, "gate closed: this computer was silent for too long"),
                other => write!(f, "gate closed: {other}"),
            },
            FlashNews::Ready => write!(f, "flash recycled"),
            FlashNews::Stuck => write!(f, "the sync contact stays closed"),
            FlashNews::Other { name } => write!(f, "unknown event {name}"),
            FlashNews::Gap { events } => write!(f, "{events} reports were lost on the wire"),
            FlashNews::Lost { reason } => write!(f, "link lost: {reason}"),
            FlashNews::Reconnected { description, same_boot: true } => {
                write!(f, "link is back: {description}, nothing forgotten")
            }
            FlashNews::Reconnected { description, same_boot: false } => {
                write!(f, "link is back: {description}, restarted")
            }
        }
    }
}

fn shot(sync: &FlashSync) -> String {
    let what = match (sync.source, sync.triggered) {
        (SyncSource::Contact, true) => format!("sync {} let through, tag {}", sync.number, sync.tag),
        (SyncSource::Contact, false) => format!("sync {} held back", sync.number),
        (SyncSource::Command, _) => format!("fire {}, tag {}", sync.number, sync.tag),
    };
    let light = match sync.light() {
        Some(energy) => {
            let clipped = if sync.clipped_samples > 0 { ", CLIPPED" } else { "" };
            let width = super::pulse::width_ms(sync);
            format!("light {energy:.0} counts, peak {:.0}, {width:.1} ms{clipped}", sync.peak_counts)
        }
        None => "no light".into(),
    };
    let bounces = if sync.bounces > 0 { format!(", {} bounces", sync.bounces) } else { String::new() };
    format!("{what}: {light}{bounces}")
}
