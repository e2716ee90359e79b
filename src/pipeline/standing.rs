//! Whether the finished model is still what the session's files make.

use super::manifest::StageManifest;
use super::process::{Inputs, ProcessError, ProcessSummary, stored, texture_key};
use super::{dress, uvs};
use crate::session::Session;

/// Whether the model is missing, or was not made from what the session holds now. An error says that something is
/// missing to make it from.
pub fn is_due(session: &Session) -> Result<bool, ProcessError> {
    Ok(match standing(session)? {
        Some(Standing { inputs, key, .. }) => {
            !dress::is_done(session, &inputs, &key, &StageManifest::load(session))?
        }
        None => true,
    })
}

/// A texture that was made from what the session holds now.
pub(super) struct Standing {
    /// With the texture coordinates that it has.
    pub(super) inputs: Inputs,
    pub(super) summary: ProcessSummary,
    /// Digest of all that it was made from.
    pub(super) key: String,
}

impl Standing {
    /// Makes GLB and report anew if what they tell of has changed.
    pub(super) fn dress(&self, session: &Session) -> Result<(), ProcessError> {
        let mut manifest = StageManifest::load(session);
        dress::dress(session, &self.inputs, &self.summary, &self.key, &mut manifest).map(|_| ())
    }
}

/// The finished texture, if it is still what the session's files make.
pub(super) fn standing(session: &Session) -> Result<Option<Standing>, ProcessError> {
    let mut inputs = Inputs::read(session)?;
    let Some(summary) = stored(session) else { return Ok(None) };
    // At the last run's size and texture coordinates: other inputs make another key in any case.
    inputs.uvs = (summary.uv_choice, summary.uvs.clone());
    let key = texture_key(&inputs.key, summary.texture_size, &inputs.uvs);
    if !StageManifest::load(session).is_done(session, "texture", &key) {
        return Ok(None);
    }
    uvs::apply(session, &mut inputs.scene)?;
    Ok(Some(Standing { inputs, summary, key }))
}
