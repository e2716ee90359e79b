//! Pure: what a pair is, what was asked of it, and what the checks say.

mod agreement;
mod checks;
mod drift;
pub mod energy;
pub mod finding;
mod flash;
mod light;
mod lighting;
mod limits;
mod motion;
pub mod order;
pub mod parts;
mod plan;
pub mod proof;
mod record;
mod settings;
mod stop;
mod survey;

pub use checks::{EnergyExpectation, Expected, Files, FrameView, Judgement, Role, judge, judge_expecting};
pub use drift::{Drift, compare_dark};
pub use flash::{FlashRecord, FlashSync, SyncSource};
pub use lighting::{Lighting, Polariser};
pub use limits::Limits;
pub use plan::{Dial, Exposure, Offered, Plan, Window, WindowOutside};
pub use record::{Attempt, CompanionRecord, FrameRecord, PairRecord, Reason, ReasonCode, Verdict, current};
pub use settings::Settings;
pub use stop::{EarlierStops, Stop, StopKey};
