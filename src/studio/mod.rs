//! The simulated studio: a world at the end of the real wires.
//!
//! The camera is a PTP/IP responder that the unmodified libgphoto2 opens as a Canon EOS; the flash board is
//! the firmware's own C core on a pseudo terminal that the real serial driver opens; between them runs the
//! X-sync contact. What the camera sees comes from a path tracer that shares only the ray kernel with
//! [`crate::light`].

mod blank;
mod board;
pub mod camera;
pub mod experiment;
pub mod truth;
mod wires;
pub mod world;

pub use crate::codec::cr2;
pub use blank::BlankBoard;
pub use board::{Board, BoardOptions, Heat, LampOptions, Recharge, Rise};
pub use wires::{SyncContact, View};
