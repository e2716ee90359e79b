//! A second copy of every open session on another disk.

use super::Desk;
use crate::capture::events::Topic;
use crate::capture::place::name_of;
use crate::session::{MirrorPatience, MirrorStatus, Session};
use serde_json::json;
use std::path::Path;
use std::sync::Arc;
use std::time::{Duration, Instant};

impl Desk {
    /// From now on, sessions are copied into this folder as soon as they are opened: each into one of its own name. A
    /// second wish changes nothing.
    pub fn mirror_to(&self, mirrors: &Path) -> std::io::Result<()> {
        let mirrors = std::path::absolute(mirrors)?;
        if mirrors.starts_with(&self.0.folder) {
            let words = format!(
                "the mirror {} lies inside the sessions folder: a second copy belongs on another disk, give a folder there",
                mirrors.display()
            );
            return Err(std::io::Error::other(words));
        }
        // Set before anybody asks for a session.
        let _second = self.0.mirrors.set(mirrors);
        Ok(())
    }

    /// Begins to copy a session that was opened, if that is wished.
    pub(super) fn mirror(&self, session: &Arc<Session>) {
        let Some(mirrors) = self.0.mirrors.get() else { return };
        let (events, name) = (self.0.events.clone(), name_of(session));
        let tell = move |status: &MirrorStatus| {
            events.tell(Topic::Mirror, status.words(), json!({ "session": name, "mirror": status }));
        };
        if let Err(error) = session.mirror_to(mirrors, MirrorPatience::default(), tell) {
            let data = json!({ "code": "mirror_failed", "session": name_of(session) });
            self.0.events.tell(Topic::Trouble, error.to_string(), data);
        }
    }

    /// Has the mirrors take in what is stored, waits no longer than `patience` altogether, and says how they then stand.
    pub fn finish_mirrors(&self, patience: Duration) -> Vec<MirrorStatus> {
        let open: Vec<Arc<Session>> = self.sessions().open.values().cloned().collect();
        let end = Instant::now() + patience;
        let left = || end.saturating_duration_since(Instant::now());
        open.iter().filter_map(|session| session.finish_mirror(left())).collect()
    }
}
