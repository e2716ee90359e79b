//! From arming to commit: one pair at a time, sole owner of the rig.
//!
//! [`machine`](step) says what is to be done when (pure); [`Engine`] does it with a camera and a flash; a
//! pair ends in a [`Session`](crate::session::Session), accepted or rejected with reasons, or not at all.
//! [`Desk`] is where pages, scripts and terminals hand in their wishes: sessions, pairs, calibration,
//! processing, each a job of [`crate::jobs`]. [`Events`] tells all of them what happens.

mod bench;
mod card;
mod desk;
mod engine;
mod error;
mod events;
mod find;
mod frame;
mod hands;
mod live;
mod machine;
mod place;
mod prompt;
mod repeat;
mod run;
mod sequence;
mod taken;
mod thumbnail;
mod window;
mod wish;

pub use bench::{DeviceState, Devices, FlashKind, ListCameras, OpenCamera, OpenFlash, RigSource};
pub use card::{CalibrationShot, calibration_frames, calibration_shots};
pub use desk::{
    CalibrationState, Desk, DeskError, FlashCard, Glance, IncomingFrames, SceneFiles, SeriesShot,
    SessionSummary, Works,
};
pub use engine::{AfterPair, CameraState, Engine, words_on};
pub use error::CaptureError;
pub use events::{Event, Events, Heard, Topic};
pub use find::ExposureWish;
pub use frame::ShotWish;
pub use live::LivePicture;
pub use machine::{Course, Effect, End, Event as PairEvent, State, step};
pub use place::PlaceError;
pub use repeat::{RepeatReport, words_on_repeatability};
pub use sequence::{
    Alone, Conductor, PositionView, SequenceError, SequenceEvent, SequenceState, SequenceView, Shooter,
};
pub use thumbnail::ThumbnailError;
pub use wish::PairWish;
