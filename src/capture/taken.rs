//! One frame after its release: decoded, digested and written to the disk on threads of their own, while the next
//! frame is shot.

use super::error::CaptureError;
use crate::codec::raw::{Photo, RawError};
use crate::pair::Settings;
use crate::pair::order::Slot;
use crate::photometry::levels::MeasuredLevels;
use crate::pipeline::levels;
use crate::rig::Shot;
use crate::session::{SessionError, Staged, Stager, store};
use std::sync::Arc;
use std::thread::JoinHandle;

/// What the decoder made of a file.
pub(super) type Decoded = Result<Photo, RawError>;

/// A frame on its way.
pub(super) struct Taken {
    /// Its place in the pair.
    pub(super) slot: Slot,
    pub(super) shot: Arc<Shot>,
    /// Decoded and not yet looked at.
    kept: Option<(Decoded, String)>,
    /// What stays of it once it was looked at: settings and digest.
    seen: Option<(Settings, String)>,
    decoding: Option<JoinHandle<(Decoded, String)>>,
    staging: Option<JoinHandle<Result<Staged, SessionError>>>,
}

impl Taken {
    pub(super) fn new(slot: Slot, shot: Shot) -> Self {
        Self { slot, shot: Arc::new(shot), kept: None, seen: None, decoding: None, staging: None }
    }

    /// Sets the decoder to work, and whoever writes the raw to the disk, if it is to go there ahead of the commit.
    pub(super) fn begin(
        &mut self,
        measured: Arc<MeasuredLevels>,
        stager: Option<Stager>,
    ) -> Result<(), CaptureError> {
        let shot = self.shot.clone();
        self.decoding = Some(spawn("frame check", move || {
            let photo = levels::decode(&shot.raw.bytes, &shot.raw.name, &measured);
            (photo, store::digest(&shot.raw.bytes))
        })?);
        if let Some(stager) = stager {
            let shot = self.shot.clone();
            self.staging = Some(spawn("frame to disk", move || stager.stage(&shot.raw.bytes))?);
        }
        Ok(())
    }

    /// The decoder's outcome and the file's BLAKE3, once; `None` if it was never set to work, or was looked at already.
    pub(super) fn decoded(&mut self) -> Option<(Decoded, String)> {
        if let Some(kept) = self.kept.take() {
            return Some(kept);
        }
        // A decoder that stumbles over a file has found it unreadable.
        let stumbled = |what: String, digest: String| {
            (Err(RawError::Decoder { what, message: "the decoder stumbled over it".into() }), digest)
        };
        let shot = self.shot.clone();
        let done = self.decoding.take()?.join();
        Some(done.unwrap_or_else(|_| stumbled(shot.raw.name.clone(), store::digest(&shot.raw.bytes))))
    }

    /// Puts back what [`Taken::decoded`] gave.
    pub(super) fn keep(&mut self, photo: Decoded, digest: String) {
        self.kept = Some((photo, digest));
    }

    /// Keeps what its record needs, now that it was looked at.
    pub(super) fn seen(&mut self, settings: Settings, digest: String) {
        self.seen = Some((settings, digest));
    }

    /// Settings out of its EXIF; none known before it was looked at.
    pub(super) fn settings(&self) -> Settings {
        self.seen.as_ref().map(|seen| seen.0.clone()).unwrap_or_default()
    }

    /// The file's BLAKE3; empty before it was looked at.
    pub(super) fn digest(&self) -> &str {
        self.seen.as_ref().map_or("", |seen| &seen.1)
    }

    /// The file on the disk; `None` if it was not to go there ahead, or its writer stumbled and the commit writes it.
    pub(super) fn staged(&mut self) -> Result<Option<Staged>, SessionError> {
        match self.staging.take().map(JoinHandle::join) {
            Some(Ok(staged)) => staged.map(Some),
            Some(Err(_)) | None => Ok(None),
        }
    }
}

impl Drop for Taken {
    fn drop(&mut self) {
        // What was written ahead for a pair that is given up must be gone when its end is told.
        if let Some(staging) = self.staging.take() {
            drop(staging.join());
        }
    }
}

fn spawn<T: Send + 'static>(
    name: &str,
    work: impl FnOnce() -> T + Send + 'static,
) -> Result<JoinHandle<T>, CaptureError> {
    std::thread::Builder::new().name(name.into()).spawn(work).map_err(CaptureError::NoThread)
}
