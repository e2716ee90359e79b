//! What may be asked of the next pair.

use super::place::PlaceError;
use crate::pair::order::{Order, Program};
use crate::session::Session;
use serde::{Deserialize, Serialize};

/// What is asked of the next pair. By default, the usual one.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default)]
pub struct PairWish {
    /// The order of its frames; of a pair that is shot again its own, else off-on.
    pub order: Option<Order>,
    /// Frames without flash in a row; of a pair that is shot again as many as it had, else one.
    pub off_frames: Option<u8>,
    /// The rejected pair that is to be shot again.
    pub again: Option<u32>,
}

impl PairWish {
    /// The frames to be shot; an error if they cannot be, or if the pair cannot be shot again.
    pub fn program(&self, session: &Session) -> Result<Program, PlaceError> {
        let before = self.again.map(|number| session.rejected_pair(number)).transpose()?;
        let before = before.map(|record| record.program()).unwrap_or_default();
        let (order, off_frames) = (self.order, self.off_frames);
        Ok(Program::new(order.unwrap_or(before.order()), off_frames.unwrap_or(before.off_frames()))?)
    }
}
