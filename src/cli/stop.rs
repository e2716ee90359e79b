//! The end of `unlit serve`: the first signal ends it gracefully, the second at once. Either disarms the flash.

use super::CliError;
use crate::capture::Desk;
use std::future::Future;
use std::time::Duration;
use tokio::signal::unix::{Signal, SignalKind, signal};
use tokio::sync::{oneshot, watch};

/// How long running jobs may take to end after the signal to stop. A release under way may last its exposure.
const LAST_PATIENCE: Duration = Duration::from_secs(10);
/// How long mirrors may take to come into step after that.
const MIRROR_PATIENCE: Duration = Duration::from_secs(10);

/// Waits for signals from the moment it is made.
pub(super) struct Stop {
    desk: Desk,
    asked: watch::Receiver<bool>,
    /// Ends when the work has.
    closing: oneshot::Receiver<()>,
}

impl Stop {
    /// SIGINT and SIGTERM from now on.
    pub(super) fn listen(desk: Desk) -> Result<Self, CliError> {
        let runtime =
            tokio::runtime::Builder::new_current_thread().enable_all().build().map_err(CliError::new)?;
        let mut signals = {
            let _within = runtime.enter();
            Signals {
                interrupted: signal(SignalKind::interrupt()).map_err(CliError::new)?,
                terminated: signal(SignalKind::terminate()).map_err(CliError::new)?,
            }
        };
        let (ask, asked) = watch::channel(false);
        let (over, closing) = oneshot::channel();
        let ending = desk.clone();
        let end = async move {
            signals.next().await;
            ask.send_replace(true);
            tracing::info!("stopping: running work is finished or given up");
            tokio::select! {
                () = close(ending.clone()) => {}
                () = signals.next() => {
                    let gate = tokio::task::spawn_blocking(move || ending.close_gate());
                    if let Err(panic) = gate.await {
                        tracing::error!("{panic}");
                    }
                    eprintln!("unlit: ended at once on a second signal; what was running was abandoned");
                    std::process::exit(1);
                }
            }
            // Nobody waits where the listener has failed meanwhile.
            let _heard = over.send(());
        };
        // Whatever keeps those who answer requests, a signal is heard.
        std::thread::Builder::new()
            .name("stop".into())
            .spawn(move || runtime.block_on(end))
            .map_err(CliError::new)?;
        Ok(Self { desk, asked, closing })
    }

    /// Resolves at the first signal. Work is cancelled from then on, while the last answers are given.
    pub(super) fn asked(&self) -> impl Future<Output = ()> + Send + use<> {
        let mut asked = self.asked.clone();
        async move {
            // An error says that nobody can ask any more, and the task that could has ended the program's work.
            drop(asked.wait_for(|asked| *asked).await);
        }
    }

    /// Resolves when the work has come to rest and mirrors are in step, or their time is over.
    pub(super) async fn ended(self) {
        if *self.asked.borrow() {
            drop(self.closing.await);
        } else {
            // No signal: the listener failed.
            close(self.desk).await;
        }
    }
}

struct Signals {
    interrupted: Signal,
    terminated: Signal,
}

impl Signals {
    async fn next(&mut self) {
        tokio::select! {
            _ = self.interrupted.recv() => {}
            _ = self.terminated.recv() => {}
        }
    }
}

async fn close(desk: Desk) {
    let closing = tokio::task::spawn_blocking(move || {
        if !desk.close(LAST_PATIENCE) {
            tracing::warn!("some work did not end within {LAST_PATIENCE:?} and was abandoned");
        }
        for mirror in desk.finish_mirrors(MIRROR_PATIENCE) {
            eprintln!("{}", mirror.words());
        }
    });
    if let Err(panic) = closing.await {
        tracing::error!("{panic}");
    }
}
