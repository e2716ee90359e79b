//! A second copy of a session on another disk while pairs are shot.
//!
//! A thread of its own compares the session's folder with its copy and copies what is missing; whoever stores something
//! only wakes it. So nothing waits for the copy and nothing is queued but the wish to look again: the session's own disk
//! is the queue. A copy that fails is told once and tried again, ever more seldom; one that hangs is told by whoever asks,
//! and is never waited for beyond a limit.
//!
//! Copied is what cannot be made again: pairs, calibration, scene, `session.json`, `sequence.json` and the journal, which
//! comes last, so that the copy is a session by itself and holds whatever its journal speaks of.

mod account;
mod copy;
mod outcome;
mod round;

use super::{Session, SessionError};
use outcome::Outcome;
use round::Copyist;
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

/// How a mirror stands.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(tag = "state", rename_all = "snake_case")]
pub enum MirrorState {
    /// It is being written to.
    Behind {
        /// Pairs, calibration shots and other files that are not there yet, as far as that is known.
        items: usize,
    },
    /// It holds everything.
    InStep,
    /// It cannot be written to, or should not.
    Failing {
        /// Why, and what to do.
        why: String,
    },
}

/// A mirror as it stands at one moment.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct MirrorStatus {
    /// The copy's folder.
    pub folder: PathBuf,
    /// How it stands.
    #[serde(flatten)]
    pub state: MirrorState,
    /// What is to be known of it beside.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub warning: Option<String>,
}

impl MirrorStatus {
    /// The same in a sentence.
    pub fn words(&self) -> String {
        let folder = self.folder.display();
        let words = match &self.state {
            MirrorState::Behind { items } => format!("The mirror {folder} is behind by {items}."),
            MirrorState::InStep => format!("The mirror {folder} is in step."),
            MirrorState::Failing { why } => {
                let stop = if why.ends_with('?') { "" } else { "." };
                format!("The mirror {folder} fails: {why}{stop} Pairs go on being stored; it is tried again.")
            }
        };
        match &self.warning {
            Some(warning) => format!("{words} {warning}"),
            None => words,
        }
    }
}

/// How long a mirror is waited for.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MirrorPatience {
    /// A disk that does not answer for so long is told of.
    pub silence: Duration,
    /// From a failure to the next attempt; doubled each time.
    pub first_retry: Duration,
    /// At the most.
    pub longest_retry: Duration,
}

impl Default for MirrorPatience {
    fn default() -> Self {
        let [silence, first_retry, longest_retry] = [30, 1, 60].map(Duration::from_secs);
        Self { silence, first_retry, longest_retry }
    }
}

/// Hears of a mirror that came into step or fails; must not block.
type Tell = dyn Fn(&MirrorStatus) + Send + Sync;

/// What the thread and its handle share.
struct Shared {
    folder: PathBuf,
    patience: MirrorPatience,
    board: Mutex<Board>,
    changed: Condvar,
    tell: Box<Tell>,
}

struct Board {
    state: MirrorState,
    warning: Option<String>,
    /// Something was stored since the last look.
    news: bool,
    /// When the disk last answered; `None` while nothing is asked of it.
    asked: Option<Instant>,
    /// What listeners heard last.
    told: Option<MirrorState>,
    /// One more look, then the end.
    finish: bool,
    /// The end, as soon as may be.
    stop: bool,
    ended: bool,
}

impl Shared {
    fn board(&self) -> MutexGuard<'_, Board> {
        // The board is whole after each statement.
        self.board.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// The state, or the silence of a disk that does not answer.
    fn state(&self, board: &Board) -> MirrorState {
        match board.asked.map(|asked| asked.elapsed()) {
            Some(silence) if silence > self.patience.silence => MirrorState::Failing {
                why: format!(
                    "its disk has not answered for {} s; check the cable or the network",
                    silence.as_secs()
                ),
            },
            _ => board.state.clone(),
        }
    }

    /// Tells what is new of it: that it failed, or that it is in step again.
    fn tell(&self, mut board: MutexGuard<'_, Board>) {
        let state = self.state(&board);
        let known = match (&state, &board.told) {
            (MirrorState::Behind { .. }, _) => true,
            // One silence is told once, however long it lasts by then.
            (MirrorState::Failing { .. }, Some(MirrorState::Failing { .. })) if board.asked.is_some() => true,
            (state, Some(told)) => state == told,
            (_, None) => false,
        };
        if !known {
            board.told = Some(state.clone());
            let warning = board.warning.clone();
            drop(board);
            (self.tell)(&MirrorStatus { folder: self.folder.clone(), state, warning });
        }
    }
}

/// The handle on a mirror; dropping it ends the mirror without waiting.
pub(super) struct Mirror(Arc<Shared>);

impl std::fmt::Debug for Mirror {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_tuple("Mirror").field(&self.0.folder).finish()
    }
}

impl Drop for Mirror {
    fn drop(&mut self) {
        self.0.board().stop = true;
        self.0.changed.notify_all();
    }
}

impl Mirror {
    /// Begins to keep a copy of the session's folder in `mirrors`, under the folder's name.
    fn start(
        session: &Path,
        mirrors: &Path,
        patience: MirrorPatience,
        tell: Box<Tell>,
    ) -> Result<Self, SessionError> {
        let session = std::path::absolute(session).map_err(SessionError::io(session))?;
        let mirrors = std::path::absolute(mirrors).map_err(SessionError::io(mirrors))?;
        let folder = mirrors.join(session.file_name().unwrap_or_default());
        // Told before anything is begun where the names alone say so; links are followed by the thread.
        if session.parent().is_some_and(|own| mirrors.starts_with(own)) || session.starts_with(&folder) {
            return Err(SessionError::MirrorInside { path: mirrors });
        }
        let shared = Arc::new(Shared {
            folder: folder.clone(),
            patience,
            board: Mutex::new(Board {
                state: MirrorState::Behind { items: 1 },
                warning: None,
                news: true,
                asked: None,
                told: None,
                finish: false,
                stop: false,
                ended: false,
            }),
            changed: Condvar::new(),
            tell,
        });
        let own = shared.clone();
        let copyist = Copyist::new(session, mirrors, folder);
        std::thread::Builder::new()
            .name("mirror".into())
            .spawn(move || live(&own, copyist))
            .map_err(SessionError::io(&shared.folder))?;
        Ok(Self(shared))
    }

    /// Something was stored, `items` pairs and shots among it.
    pub(super) fn wake(&self, items: usize) {
        let mut board = self.0.board();
        board.news = true;
        board.state = match &board.state {
            MirrorState::InStep => MirrorState::Behind { items: items.max(1) },
            MirrorState::Behind { items: before } => MirrorState::Behind { items: before + items },
            failing => failing.clone(),
        };
        self.0.tell(board);
        self.0.changed.notify_all();
    }

    fn status(&self) -> MirrorStatus {
        let board = self.0.board();
        let (state, warning) = (self.0.state(&board), board.warning.clone());
        MirrorStatus { folder: self.0.folder.clone(), state, warning }
    }

    /// Has everything copied that is there now, and waits for that, no longer than `patience`.
    fn finish(&self, patience: Duration) -> MirrorStatus {
        let mut board = self.0.board();
        board.finish = true;
        self.0.changed.notify_all();
        let end = Instant::now() + patience;
        while !board.ended {
            let left = end.saturating_duration_since(Instant::now());
            if left.is_zero() {
                break;
            }
            board = self.0.changed.wait_timeout(board, left).unwrap_or_else(PoisonError::into_inner).0;
        }
        drop(board);
        self.status()
    }
}

/// The life of the thread: looks, copies, waits for news or for the next attempt.
fn live(shared: &Shared, mut copyist: Copyist) {
    let mut retry = shared.patience.first_retry;
    loop {
        {
            let mut board = shared.board();
            if board.stop {
                break;
            }
            board.news = false;
            board.asked = Some(Instant::now());
        }
        let answered = |items: usize| {
            let mut board = shared.board();
            board.asked = Some(Instant::now());
            if !matches!(board.state, MirrorState::Failing { .. }) {
                board.state = MirrorState::Behind { items };
            }
            !board.stop
        };
        let outcome = copyist.look(&answered);
        let mut board = shared.board();
        board.asked = None;
        board.warning = copyist.warning().map(str::to_owned);
        let failed = match outcome {
            Outcome::Stopped => break,
            // What looks wrong may be what was being replaced just then.
            Outcome::Whole | Outcome::Unfit(_) if board.news => {
                if !matches!(board.state, MirrorState::Failing { .. }) {
                    board.state = MirrorState::Behind { items: 1 };
                }
                continue;
            }
            Outcome::Whole => {
                board.state = MirrorState::InStep;
                false
            }
            Outcome::Unfit(why) | Outcome::Failed(why) => {
                board.state = MirrorState::Failing { why };
                true
            }
        };
        let finish = board.finish;
        shared.tell(board);
        if finish {
            break;
        }
        if failed {
            wait(shared, Some(retry), |board| board.stop || board.finish);
            retry = (retry * 2).min(shared.patience.longest_retry);
        } else {
            retry = shared.patience.first_retry;
            wait(shared, None, |board| board.stop || board.finish || board.news);
        }
    }
    // The copy's lock is given back before anybody hears of the end.
    drop(copyist);
    shared.board().ended = true;
    shared.changed.notify_all();
}

/// Until something happens, or the time is over.
fn wait(shared: &Shared, time: Option<Duration>, happened: impl Fn(&Board) -> bool) {
    let end = time.map(|time| Instant::now() + time);
    let mut board = shared.board();
    while !happened(&board) {
        board = match end.map(|end| end.saturating_duration_since(Instant::now())) {
            Some(left) if left.is_zero() => return,
            Some(left) => shared.changed.wait_timeout(board, left).unwrap_or_else(PoisonError::into_inner).0,
            None => shared.changed.wait(board).unwrap_or_else(PoisonError::into_inner),
        };
    }
}

impl Session {
    /// Keeps a second copy of the session in the folder `mirrors`, which must be there and should lie on another disk,
    /// from now on as long as the session is open. The session must be open for writing. `tell` hears when the copy comes
    /// into step and when it fails, and must not block. A session has one mirror: a second wish changes nothing.
    pub fn mirror_to(
        &self,
        mirrors: &Path,
        patience: MirrorPatience,
        tell: impl Fn(&MirrorStatus) + Send + Sync + 'static,
    ) -> Result<(), SessionError> {
        drop(self.numbering()?);
        if self.mirror.get().is_none() {
            // Should another have been faster, this one ends at once.
            let _faster = self.mirror.set(Mirror::start(self.path(), mirrors, patience, Box::new(tell))?);
        }
        Ok(())
    }

    /// How the session's mirror stands; `None` if it has none.
    pub fn mirror(&self) -> Option<MirrorStatus> {
        self.mirror.get().map(Mirror::status)
    }

    /// Has the mirror take in everything that is stored now, waits no longer than `patience`, ends it and says how it then
    /// stands.
    pub fn finish_mirror(&self, patience: Duration) -> Option<MirrorStatus> {
        self.mirror.get().map(|mirror| mirror.finish(patience))
    }
}
