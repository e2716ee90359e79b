//! Checking a session while it is at work.

use super::works::Ask;
use super::{Desk, DeskError};
use crate::capture::place::name_of;
use crate::jobs::{Job, Lane, WorkError};
use crate::progress::Cancelled;
use crate::session::Verification;
use serde_json::json;

impl Desk {
    /// Reads everything that the session ever stored again and compares it with its checksums. Pairs may be shot
    /// meanwhile.
    pub fn verify(&self, session: &str) -> Result<Job, DeskError> {
        let session = self.session(session)?;
        let ask = Ask::new("verify", Lane::Processing).again(json!({})).coalescing();
        self.ask(ask, name_of(&session), move |progress| {
            let found: Verification = session.verify(progress).map_err(|Cancelled| WorkError::Cancelled)?;
            let mut result = json!(found);
            result["whole"] = json!(found.is_whole());
            Ok(result)
        })
    }
}
