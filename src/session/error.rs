//! What can go wrong with a session folder.

use super::Holder;
use std::path::{Path, PathBuf};

/// Why a session could not be made, opened, read or added to.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum SessionError {
    /// The disk refused.
    #[error("{path}: {source}; {}", advice(source))]
    Io {
        /// File or folder.
        path: PathBuf,
        /// The system's own word.
        source: std::io::Error,
    },
    /// A folder that holds something else.
    #[error("{path} is there already and not empty; give a new folder's name for the session")]
    NotEmpty {
        /// The folder.
        path: PathBuf,
    },
    /// No session lives there.
    #[error("{path} is no session (no session.json in it); make one with `unlit new {path}`")]
    NotASession {
        /// The folder.
        path: PathBuf,
    },
    /// Another program works with the session.
    #[error("session {path} is in use by {}", in_use(holder.as_deref()))]
    Locked {
        /// The session.
        path: PathBuf,
        /// Who has it; `None` when nobody says so, as readers do not.
        holder: Option<Box<Holder>>,
    },
    /// Another daemon has the folder of sessions.
    #[error(
        "the sessions folder {path} is in use by {}, or give this one a folder of its own with --sessions",
        in_use(holder.as_deref())
    )]
    FolderLocked {
        /// The folder.
        path: PathBuf,
        /// Who has it, if that is known.
        holder: Option<Box<Holder>>,
    },
    /// A second copy in the same place.
    #[error(
        "the mirror {path} lies inside the sessions folder: a second copy belongs on another disk, give a folder there"
    )]
    MirrorInside {
        /// The mirror.
        path: PathBuf,
    },
    /// The session was opened for reading.
    #[error("session {path} is open for reading only, so that nothing can be added")]
    ReadOnly {
        /// The session.
        path: PathBuf,
    },
    /// Written by a later version.
    #[error(
        "session {path} has layout version {found}, this program knows up to {known}; use a newer `unlit`"
    )]
    TooNew {
        /// The session.
        path: PathBuf,
        /// Version in session.json.
        found: u32,
        /// Newest version known.
        known: u32,
    },
    /// A file of the session does not hold what it should.
    #[error("{path} is damaged: {why}; restore it from a backup, or move its folder out of the session")]
    Damaged {
        /// The file.
        path: PathBuf,
        /// What is wrong.
        why: String,
    },
    /// The disk is full, or nearly.
    #[error(
        "the disk of {path} has {} MB left, and {} MB must be free before a pair (64 of them stay so): make room, or go on in a session on another disk",
        free >> 20, (needed + (1 << 20) - 1) >> 20
    )]
    NoRoom {
        /// The session.
        path: PathBuf,
        /// Bytes that may still be written.
        free: u64,
        /// Bytes that must be free for a pair.
        needed: u64,
    },
    /// A pair of that name with other photographs is there.
    #[error(
        "a pair named {name} with other photographs is already in the session (pair {number}); rename the new files or import them into a session of their own"
    )]
    DuplicateName {
        /// The name.
        name: String,
        /// The pair that has it.
        number: u32,
    },
    /// No such pair.
    #[error("session {path} has no pair {number}; only a pair that is there can be shot again")]
    NoSuchPair {
        /// The session.
        path: PathBuf,
        /// The pair.
        number: u32,
    },
    /// A pair that is good.
    #[error(
        "pair {number} was accepted, and only a rejected pair can be shot again under its number; take a new pair from the same stop instead"
    )]
    PairAccepted {
        /// The pair.
        number: u32,
    },
    /// The pair's name cannot name a file.
    #[error("{name:?} cannot name a pair: 1 to 200 bytes, no slash, not beginning with a dot")]
    BadName {
        /// The name.
        name: String,
    },
}

impl SessionError {
    /// For `map_err`: an I/O error together with the path it happened at.
    pub(super) fn io(path: &Path) -> impl FnOnce(std::io::Error) -> SessionError + use<> {
        let path = path.to_owned();
        move |source| SessionError::Io { path, source }
    }
}

/// Who it is, and what to do.
fn in_use(holder: Option<&Holder>) -> String {
    match holder {
        Some(holder) => format!("{holder}; work through that one, or end it first"),
        None => "another program; close the other `unlit` first".into(),
    }
}

/// What to do when the disk refused.
pub(crate) fn advice(source: &std::io::Error) -> &'static str {
    use std::io::ErrorKind;
    match source.kind() {
        ErrorKind::NotFound => "check the path, and that its disk is there",
        ErrorKind::PermissionDenied => "check who may read and write it",
        ErrorKind::ReadOnlyFilesystem => "the disk may only be read: make it writable, or use another",
        ErrorKind::StorageFull | ErrorKind::QuotaExceeded => "make room on that disk, or use another",
        ErrorKind::IsADirectory => "that is a folder: give a file",
        ErrorKind::NotADirectory => "a part of that path is a file: check the path",
        _ => "check that the disk is there and sound",
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::io::{Error, ErrorKind};

    #[test]
    fn each_refusal_of_the_disk_says_what_to_do_about_that_one() {
        let said = |kind: ErrorKind| {
            SessionError::Io { path: "pairs/0001".into(), source: Error::from(kind) }.to_string()
        };
        assert!(said(ErrorKind::NotFound).ends_with("check the path, and that its disk is there"));
        assert!(said(ErrorKind::StorageFull).contains("make room"));
        assert!(said(ErrorKind::ReadOnlyFilesystem).contains("make it writable"));
        assert!(said(ErrorKind::PermissionDenied).contains("who may"));
        let other = said(ErrorKind::Other);
        assert!(other.starts_with("pairs/0001") && other.ends_with("sound"), "{other}");
    }
}
