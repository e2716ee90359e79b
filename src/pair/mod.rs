//! Pure: what a pair is, what was asked of it, and what the checks say.

mod checks;
mod limits;
mod motion;
mod plan;
mod record;
mod rise;
mod settings;

pub use checks::{Expected, FrameView, judge, judge_expecting};
pub use limits::Limits;
pub use plan::{Dial, Exposure, Offered, Plan, Window, WindowOutside};
pub use record::{CompanionRecord, FlashRecord, FrameRecord, PairRecord, Reason, ReasonCode, Verdict};
pub use settings::Settings;
