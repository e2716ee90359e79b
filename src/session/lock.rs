//! Who works with a folder: a lock of the kernel's, and beside it in words who holds it.
//!
//! The lock alone decides (flock, 2): it goes with its process, however that ends. What the file says only informs, and
//! is believed only as long as the process that wrote it lives.

use super::{SessionError, utc_now};
use serde::{Deserialize, Serialize};
use std::fmt;
use std::fs::{File, OpenOptions, TryLockError};
use std::io::{Read, Write};
use std::path::Path;

/// Longest account that is read; a file that was put there may be of any length.
const LONGEST: u64 = 4096;

/// Whether others may read meanwhile.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Access {
    Alone,
    Shared,
}

/// The program that holds a lock alone.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Holder {
    /// Its process.
    pub pid: u32,
    /// What it is (`unlit serve`).
    pub program: String,
    /// The machine on which it runs.
    pub host: String,
    /// Since when it has had the lock, UTC.
    pub since: String,
    /// When its process began, in the kernel's ticks: a later process of the same number is another.
    #[serde(default)]
    pub started: Option<u64>,
}

impl fmt::Display for Holder {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} (process {} on {}, since {})", self.program, self.pid, self.host, self.since)
    }
}

impl Holder {
    fn here() -> Self {
        let pid = std::process::id();
        Self { pid, program: program(), host: host(), since: utc_now(), started: started(pid) }
    }

    /// Whether that process may still be there; of another machine's nobody knows.
    fn lives(&self) -> bool {
        self.host != host() || self.started == started(self.pid)
    }
}

/// The program and its command; the rest of the command line is nobody's business.
fn program() -> String {
    let mut words = std::env::args();
    let path = words.next().unwrap_or_default();
    let name = Path::new(&path).file_name().map(|n| n.to_string_lossy().into_owned()).unwrap_or(path);
    match words.next().filter(|word| !word.starts_with('-')) {
        Some(command) => format!("{name} {command}"),
        None => name,
    }
}

fn host() -> String {
    rustix::system::uname().nodename().to_string_lossy().into_owned()
}

/// When a process began (proc(5), the 22nd field of `stat`); `None` when it is gone.
fn started(pid: u32) -> Option<u64> {
    let stat = std::fs::read_to_string(format!("/proc/{pid}/stat")).ok()?;
    // The second field is the name in parentheses, which may hold anything.
    let (_, after_name) = stat.rsplit_once(')')?;
    after_name.split_whitespace().nth(19)?.parse().ok()
}

/// A lock, held as long as this lives.
#[derive(Debug)]
pub struct Lock {
    file: File,
    alone: bool,
}

impl Drop for Lock {
    fn drop(&mut self) {
        if self.alone {
            // Whoever finds words that nobody took back looks whether their process lives.
            let _ = self.file.set_len(0);
        }
    }
}

/// Why a lock could not be had.
#[derive(Debug)]
pub(super) enum Refused {
    /// Somebody has it; who, if that is known.
    Held(Option<Box<Holder>>),
    /// The system refused.
    Io(std::io::Error),
}

impl Lock {
    /// Locks with this file, which is made if it is not there.
    pub(super) fn take(file: &Path, access: Access) -> Result<Self, Refused> {
        let writing = || OpenOptions::new().create(true).append(true).read(true).open(file);
        let opened = match access {
            Access::Alone => writing(),
            // A reader may have no right to write; an older session may have no lock file yet.
            Access::Shared => File::open(file).or_else(|_| writing()),
        };
        let mut lock = opened.map_err(Refused::Io)?;
        let taken = match access {
            Access::Alone => lock.try_lock(),
            Access::Shared => lock.try_lock_shared(),
        };
        match taken {
            Ok(()) => {}
            Err(TryLockError::WouldBlock) => return Err(Refused::Held(holder(&mut lock))),
            Err(TryLockError::Error(error)) => return Err(Refused::Io(error)),
        }
        let alone = access == Access::Alone;
        if alone && let Err(error) = sign(&mut lock) {
            // The lock holds without it; a disk that is full will be told of by what matters more.
            tracing::warn!("{}: {error}; others will not read who has it", file.display());
        }
        Ok(Self { file: lock, alone })
    }

    /// Gives a shared lock back before its time.
    pub(super) fn release(&self) -> std::io::Result<()> {
        self.file.unlock()
    }

    /// Locks a folder of sessions for one daemon: `FOLDER/.unlit/lock`.
    pub fn of_folder(folder: &Path) -> Result<Self, SessionError> {
        let own = folder.join(".unlit");
        std::fs::create_dir_all(&own).map_err(SessionError::io(&own))?;
        let file = own.join("lock");
        Self::take(&file, Access::Alone).map_err(|refused| match refused {
            Refused::Held(holder) => SessionError::FolderLocked { path: folder.to_owned(), holder },
            Refused::Io(source) => SessionError::Io { path: file, source },
        })
    }

    /// Locks a session: `SESSION/.lock`.
    pub(super) fn of_session(session: &Path, access: Access) -> Result<Self, SessionError> {
        let file = session.join(super::LOCK);
        Self::take(&file, access).map_err(|refused| match refused {
            Refused::Held(holder) => SessionError::Locked { path: session.to_owned(), holder },
            Refused::Io(source) => SessionError::Io { path: file, source },
        })
    }
}

fn sign(lock: &mut File) -> std::io::Result<()> {
    lock.set_len(0)?;
    let mut words = serde_json::to_string(&Holder::here()).map_err(std::io::Error::other)?;
    words.push('\n');
    lock.write_all(words.as_bytes())
}

/// Who says in the file that he has the lock, if he can still have it.
fn holder(lock: &mut File) -> Option<Box<Holder>> {
    let mut words = String::new();
    lock.take(LONGEST).read_to_string(&mut words).ok()?;
    serde_json::from_str::<Holder>(&words).ok().filter(Holder::lives).map(Box::new)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn held(refused: Result<Lock, Refused>) -> Option<Box<Holder>> {
        match refused {
            Err(Refused::Held(holder)) => holder,
            other => panic!("{other:?}"),
        }
    }

    #[test]
    fn who_has_the_lock_is_named_and_a_dead_process_is_not() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("lock");
        let first = Lock::take(&file, Access::Alone).unwrap();
        let named = held(Lock::take(&file, Access::Shared)).unwrap();
        assert_eq!((named.pid, &named.host), (std::process::id(), &host()));
        assert!(named.started.is_some(), "{named}");
        drop(first);
        assert_eq!(std::fs::metadata(&file).unwrap().len(), 0);

        // A reader holds the lock, and the file still tells of a writer that was killed.
        for (pid, started) in [(u32::MAX, Some(7)), (named.pid, Some(7)), (named.pid, None)] {
            let stale = Holder { pid, started, ..(*named).clone() };
            std::fs::write(&file, serde_json::to_vec(&stale).unwrap()).unwrap();
            let reader = Lock::take(&file, Access::Shared).unwrap();
            assert_eq!(held(Lock::take(&file, Access::Alone)), None, "{stale}");
            drop(reader);
        }
        for nonsense in ["", "{", "\u{0}", &"x".repeat(9000)] {
            std::fs::write(&file, nonsense).unwrap();
            let reader = Lock::take(&file, Access::Shared).unwrap();
            assert_eq!(held(Lock::take(&file, Access::Alone)), None);
            drop(reader);
        }
        drop(Lock::take(&file, Access::Alone).unwrap());
    }
}
