//! Pure: what a pair is, what was asked of it, and what the checks say.

mod agreement;
mod checks;
pub mod finding;
mod light;
mod limits;
mod motion;
pub mod parts;
mod plan;
mod record;
mod settings;
mod stop;
mod survey;

pub use checks::{EnergyExpectation, Expected, Files, FrameView, Judgement, Role, judge, judge_expecting};
pub use limits::Limits;
pub use plan::{Dial, Exposure, Offered, Plan, Window, WindowOutside};
pub use record::{CompanionRecord, FlashRecord, FrameRecord, PairRecord, Reason, ReasonCode, Verdict};
pub use settings::Settings;
pub use stop::{EarlierStops, Stop, StopKey};
