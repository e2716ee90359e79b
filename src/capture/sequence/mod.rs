//! Sequences: n positions, each with its pair, and something that says when one is in place.
//!
//! [`machine`] says what is to be done when (pure); [`Conductor`] does it for one session and keeps
//! `sequence.json`, so that a program that was killed goes on at the first position without an accepted pair,
//! once somebody says so; [`view`] puts it into words.

mod alone;
mod clock;
mod conductor;
mod error;
mod ledger;
mod machine;
#[cfg(test)]
mod tests;
mod view;

pub use alone::Alone;
pub(super) use conductor::read;
pub use conductor::{Conductor, Shooter};
pub use error::SequenceError;
pub use machine::Event as SequenceEvent;
pub use view::{PositionView, SequenceState, SequenceView};
