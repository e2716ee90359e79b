//! `derived/manifest.json`: which result was made from what, so that a second run does only what changed.

use crate::session::{Session, store};
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;
use std::path::PathBuf;

/// Raised when the same inputs give other results than before.
const METHOD: u32 = 6;

/// Stages done, by name.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub(super) struct StageManifest {
    stages: BTreeMap<String, Done>,
}

#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
struct Done {
    /// Digest of everything that went in.
    inputs: String,
    /// Files made, from the session's folder, with their digests.
    outputs: BTreeMap<String, String>,
}

impl StageManifest {
    fn path(session: &Session) -> PathBuf {
        session.derived_dir().join("manifest.json")
    }

    /// Reads the manifest. One that is missing or damaged costs a run, nothing else: everything it speaks of
    /// can be made again.
    pub(super) fn load(session: &Session) -> Self {
        let bytes = std::fs::read(Self::path(session)).unwrap_or_default();
        serde_json::from_slice(&bytes).unwrap_or_default()
    }

    /// Whether a stage was done from these inputs and its files are still what it wrote.
    pub(super) fn is_done(&self, session: &Session, stage: &str, inputs: &str) -> bool {
        self.stages.get(stage).is_some_and(|done| {
            done.inputs == inputs
                && done.outputs.iter().all(|(file, digest)| {
                    store::digest_file(&session.path().join(file)).is_ok_and(|found| found == *digest)
                })
        })
    }

    /// Forgets all stages whose names begin so; written with the next note.
    pub(super) fn forget(&mut self, begin: &str) {
        self.stages.retain(|stage, _| !stage.starts_with(begin));
    }

    /// Notes a stage as done and writes the manifest.
    pub(super) fn note(
        &mut self,
        session: &Session,
        stage: &str,
        inputs: &str,
        outputs: &[String],
    ) -> std::io::Result<()> {
        let mut digests = BTreeMap::new();
        for file in outputs {
            digests.insert(file.clone(), store::digest_file(&session.path().join(file))?);
        }
        self.stages.insert(stage.to_owned(), Done { inputs: inputs.to_owned(), outputs: digests });
        let bytes = serde_json::to_vec_pretty(self).map_err(std::io::Error::other)?;
        store::write_atomic(&Self::path(session), &bytes)
    }
}

/// Digest of a stage's inputs: every part is set off by its length, so that no two lists look alike.
pub(super) fn digest(parts: &[&[u8]]) -> String {
    let mut all = METHOD.to_le_bytes().to_vec();
    all.extend(env!("CARGO_PKG_VERSION").as_bytes());
    for part in parts {
        all.extend((part.len() as u64).to_le_bytes());
        all.extend(*part);
    }
    store::digest(&all)
}
