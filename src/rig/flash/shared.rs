//! What the driver and its thread share: shots not yet taken, the state for the page, and who follows.

use super::clock::ClockState;
use super::condition::Condition;
use super::news::{FlashEvent, FlashNews};
use super::settings::BoardSettings;
use crate::pair::FlashSync;
use std::sync::atomic::AtomicBool;
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::sync::{Condvar, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, SystemTime};

/// Events that a follower may leave unread; beyond that he is let go, so that nothing piles up.
const UNREAD: usize = 4096;

/// What driver and thread share.
#[derive(Default)]
pub(super) struct Shared {
    state: Mutex<State>,
    changed: Condvar,
    /// The driver is being closed; long waits end.
    pub(super) stop: AtomicBool,
}

/// What the thread knows about the board.
#[derive(Default)]
pub(super) struct State {
    /// "unlit flash controller 1.0 (atmega328p) on /dev/ttyACM0".
    pub(super) description: String,
    /// Shots that no one has taken yet.
    pub(super) shots: Vec<FlashSync>,
    /// Why shots of the frame under way may be missing.
    pub(super) broken: Option<String>,
    /// How the flash stands.
    pub(super) condition: Condition,
    /// The board's settings, once it has told them.
    pub(super) settings: Option<BoardSettings>,
    /// How its clock runs.
    pub(super) clock: Option<ClockState>,
    followers: Vec<SyncSender<FlashEvent>>,
}

impl Shared {
    /// A panic in the other thread leaves plain values behind, all of them valid.
    pub(super) fn lock(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Waits until there is a shot or a reason why not, or `patience` is over.
    pub(super) fn wait(&self, patience: Duration) {
        let quiet = |state: &mut State| {
            state.shots.is_empty() && state.broken.is_none() && state.condition.away.is_none()
        };
        drop(
            self.changed
                .wait_timeout_while(self.lock(), patience, quiet)
                .unwrap_or_else(PoisonError::into_inner),
        );
    }

    pub(super) fn update<T>(&self, change: impl FnOnce(&mut State) -> T) -> T {
        let changed = change(&mut self.lock());
        self.changed.notify_all();
        changed
    }

    pub(super) fn follow(&self) -> Receiver<FlashEvent> {
        let (sender, receiver) = sync_channel(UNREAD);
        self.lock().followers.push(sender);
        receiver
    }

    /// Tells all followers.
    pub(super) fn tell(&self, news: FlashNews) {
        tracing::debug!("flash: {news}");
        let event = FlashEvent { at: utc_now(), news };
        self.lock().followers.retain(|follower| follower.try_send(event.clone()).is_ok());
    }
}

/// UTC seconds since 1970. A host clock before that counts as 1970.
pub(super) fn utc_now() -> f64 {
    SystemTime::now().duration_since(SystemTime::UNIX_EPOCH).unwrap_or_default().as_secs_f64()
}
