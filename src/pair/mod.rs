//! Pure: what a pair is, what was asked of it, and what the checks say.

mod record;
mod settings;

pub use record::{FlashRecord, FrameRecord, PairRecord, Reason, ReasonCode, Verdict};
pub use settings::Settings;
