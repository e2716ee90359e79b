//! Live view: the newest picture wins. Whoever watches sees the latest one, however slow he is; nothing waits
//! for a watcher, and a pair that is to be shot waits for one picture at most.

use super::engine::Engine;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::{Arc, Weak};
use std::time::Duration;
use tokio::sync::watch;

/// Pause between two pictures: the eye needs no more than some fifteen a second.
const PAUSE: Duration = Duration::from_millis(60);
/// Pause after a picture that could not be had.
const PAUSE_AFTER_TROUBLE: Duration = Duration::from_secs(1);

/// What a watcher sees.
#[derive(Clone, Debug, Default)]
pub enum LivePicture {
    /// No picture has come yet.
    #[default]
    None,
    /// A JPEG.
    Jpeg(Arc<Vec<u8>>),
    /// Why there is none, in words.
    Trouble(Arc<str>),
}

/// The channel and who uses the camera.
pub(super) struct Live {
    sender: watch::Sender<LivePicture>,
    running: AtomicBool,
    /// Calls that want the camera for something else.
    wanted: AtomicUsize,
}

impl Default for Live {
    fn default() -> Self {
        Self {
            sender: watch::Sender::default(),
            running: AtomicBool::new(false),
            wanted: AtomicUsize::new(0),
        }
    }
}

/// While it lives, live view leaves the camera alone.
pub(super) struct Reserved<'a>(&'a Live);

impl Drop for Reserved<'_> {
    fn drop(&mut self) {
        self.0.wanted.fetch_sub(1, Ordering::AcqRel);
    }
}

impl Live {
    pub(super) fn reserve(&self) -> Reserved<'_> {
        self.wanted.fetch_add(1, Ordering::AcqRel);
        Reserved(self)
    }

    fn show(&self, picture: LivePicture) {
        self.sender.send_replace(picture);
    }
}

impl Engine {
    /// Joins the watchers; the first one starts the pictures, and they end with the last one.
    pub fn watch_live(self: &Arc<Self>) -> std::io::Result<watch::Receiver<LivePicture>> {
        let live = self.live();
        let watcher = live.sender.subscribe();
        if !live.running.swap(true, Ordering::AcqRel) {
            live.show(LivePicture::None);
            let engine = Arc::downgrade(self);
            let started = std::thread::Builder::new().name("live view".into()).spawn(move || run(&engine));
            if let Err(error) = started {
                self.live().running.store(false, Ordering::Release);
                return Err(error);
            }
        }
        Ok(watcher)
    }
}

fn run(engine: &Weak<Engine>) {
    while let Some(engine) = engine.upgrade() {
        let live = engine.live();
        if live.sender.receiver_count() == 0 {
            engine.end_preview();
            live.running.store(false, Ordering::Release);
            // Somebody may have come between the count and the flag, and seen the flag still up.
            if live.sender.receiver_count() == 0 || live.running.swap(true, Ordering::AcqRel) {
                return;
            }
        }
        let mut pause = PAUSE;
        if live.wanted.load(Ordering::Acquire) == 0 {
            match engine.preview() {
                Some(Ok(jpeg)) => live.show(LivePicture::Jpeg(Arc::new(jpeg))),
                Some(Err(error)) => {
                    live.show(LivePicture::Trouble(error.to_string().into()));
                    pause = PAUSE_AFTER_TROUBLE;
                }
                // Somebody else has the camera.
                None => {}
            }
        }
        drop(engine);
        std::thread::sleep(pause);
    }
}
