//! Doing again what did not come to a good end, from what was asked for then.

use super::{Desk, DeskError, For};
use crate::jobs::{Job, JobId, JobsError};
use serde_json::Value;

/// What the pair of a sequence's position is asked for with.
pub(super) const POSITION: &str = "sequence_position";

impl Desk {
    /// Asks again for what a job that failed, was cancelled or interrupted was asked for.
    pub fn retry(&self, id: JobId) -> Result<Job, DeskError> {
        let (job, order) = self.0.queue.to_repeat(id)?;
        let again = Desk(self.0.clone(), For { retry_of: Some(id), ..self.1.clone() });
        let session = job.subject.as_str();
        let refused = |why: String| DeskError::Jobs(JobsError::NotRepeatable(id, why));
        let lost = || refused("what was asked for cannot be read any more; ask for it anew".into());
        if let Some(position) = order[POSITION].as_u64() {
            return Err(refused(format!(
                "its pair is for position {position} of the sequence of {session}; tell the sequence `retry` or `skip`"
            )));
        }
        match job.kind.as_str() {
            "pair" => again.take_pair(Some(session), read(order).ok_or_else(lost)?),
            "find_exposure" => again.find_exposure(session, read(order).ok_or_else(lost)?),
            "flash_shots" => again.take_card_shot(session, read(order).ok_or_else(lost)?),
            "repeatability" => again.take_repeatability(session, read(order).ok_or_else(lost)?),
            "calibration_shot" => again.take_calibration_shot(session, read(order).ok_or_else(lost)?),
            "calibrate_flash" => again.calibrate_flash(session, read(order).ok_or_else(lost)?),
            "calibrate_levels"
            | "calibrate_noise"
            | "calibrate_exposure"
            | "calibrate_flat"
            | "calibrate_steadiness"
            | "calibrate_colour" => again.calibrate(session, read(order).ok_or_else(lost)?),
            "process" => again.process(session),
            "verify" => again.verify(session),
            "develop" => again.develop(session, read(order).ok_or_else(lost)?),
            // Written down by a program that knew more kinds.
            _ => Err(lost()),
        }
    }
}

fn read<T: serde::de::DeserializeOwned>(order: Value) -> Option<T> {
    serde_json::from_value(order).ok()
}
