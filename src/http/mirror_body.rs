//! The mirror in the API.

use crate::session::{MirrorState, MirrorStatus};
use serde::Serialize;
use utoipa::ToSchema;

/// The second copy of a session on another disk (`unlit serve --mirror`).
#[derive(Serialize, ToSchema)]
pub(super) struct MirrorBody {
    /// The copy's folder.
    folder: String,
    /// `behind`, `in_step` or `failing`.
    #[schema(example = "in_step")]
    state: &'static str,
    /// Pairs, calibration shots and other files that are not there yet, as far as that is known.
    behind: usize,
    /// The same in a sentence, and what to do where it fails.
    words: String,
}

impl From<MirrorStatus> for MirrorBody {
    fn from(status: MirrorStatus) -> Self {
        let (state, behind) = match &status.state {
            MirrorState::Behind { items } => ("behind", *items),
            MirrorState::InStep => ("in_step", 0),
            MirrorState::Failing { .. } => ("failing", 0),
        };
        Self { folder: status.folder.display().to_string(), state, behind, words: status.words() }
    }
}
