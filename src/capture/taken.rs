//! One frame after its release: decoded, digested and written to the disk on threads of their own, while the next
//! frame is shot.

use super::error::CaptureError;
use crate::codec::raw::{Photo, RawError};
use crate::photometry::saturation::SaturationTable;
use crate::pipeline::saturation;
use crate::rig::Shot;
use crate::session::{SessionError, Staged, Stager, store};
use std::sync::Arc;
use std::thread::JoinHandle;

/// What the decoder made of a file.
pub(super) type Decoded = Result<Photo, RawError>;

/// A frame on its way.
pub(super) struct Taken {
    pub(super) shot: Arc<Shot>,
    decoding: Option<JoinHandle<(Decoded, String)>>,
    staging: Option<JoinHandle<Result<Staged, SessionError>>>,
}

impl Taken {
    pub(super) fn new(shot: Shot) -> Self {
        Self { shot: Arc::new(shot), decoding: None, staging: None }
    }

    /// Sets the decoder to work, and whoever writes the raw to the disk, if it is to go there ahead of the commit.
    pub(super) fn begin(
        &mut self,
        measured: Arc<SaturationTable>,
        stager: Option<Stager>,
    ) -> Result<(), CaptureError> {
        let shot = self.shot.clone();
        self.decoding = Some(spawn("frame check", move || {
            let photo = saturation::decode(&shot.raw.bytes, &shot.raw.name, &measured);
            (photo, store::digest(&shot.raw.bytes))
        })?);
        if let Some(stager) = stager {
            let shot = self.shot.clone();
            self.staging = Some(spawn("frame to disk", move || stager.stage(&shot.raw.bytes))?);
        }
        Ok(())
    }

    /// The decoder's outcome and the file's BLAKE3; `None` if it was never set to work.
    pub(super) fn decoded(&mut self) -> Option<(Decoded, String)> {
        // A decoder that stumbles over a file has found it unreadable.
        let stumbled = |what: String, digest: String| {
            (Err(RawError::Decoder { what, message: "the decoder stumbled over it".into() }), digest)
        };
        let shot = self.shot.clone();
        let done = self.decoding.take()?.join();
        Some(done.unwrap_or_else(|_| stumbled(shot.raw.name.clone(), store::digest(&shot.raw.bytes))))
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
