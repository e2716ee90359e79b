//! Pairs of a sequence where nobody else shoots: the terminal's.

use super::conductor::{Conductor, Shooter};
use crate::capture::engine::{AfterPair, Engine};
use crate::progress::Progress;
use std::sync::{Arc, Mutex, PoisonError};
use std::thread::JoinHandle;

/// Takes each pair on a thread of its own.
pub struct Alone {
    engine: Arc<Engine>,
    after_pair: Option<AfterPair>,
    progress: Progress,
    thread: Mutex<Option<JoinHandle<()>>>,
}

impl Alone {
    /// Pairs by `engine`, reported to `progress`.
    pub fn new(engine: Arc<Engine>, after_pair: Option<AfterPair>, progress: Progress) -> Self {
        Self { engine, after_pair, progress, thread: Mutex::default() }
    }
}

impl Shooter for Alone {
    fn begin(&self, conductor: &Arc<Conductor>, _position: u32) -> Result<(), String> {
        let (engine, after_pair) = (self.engine.clone(), self.after_pair.clone());
        let (progress, conductor) = (self.progress.clone(), conductor.clone());
        let taking = move || drop(conductor.take_pair(&engine, after_pair.as_ref(), &progress));
        let spawned = std::thread::Builder::new().name("pair".into()).spawn(taking);
        let thread = spawned.map_err(|error| format!("no thread to be had ({error})"))?;
        *self.thread.lock().unwrap_or_else(PoisonError::into_inner) = Some(thread);
        Ok(())
    }

    fn stop(&self) {
        self.progress.cancel();
    }

    fn is_lost(&self) -> bool {
        let thread = self.thread.lock().unwrap_or_else(PoisonError::into_inner);
        thread.as_ref().is_none_or(JoinHandle::is_finished)
    }
}
