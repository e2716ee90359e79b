//! What can go wrong with a picture or mesh file, told so that the user knows which file to mend.

use std::path::{Path, PathBuf};

/// A picture or mesh file that could not be read or written.
#[derive(Debug, thiserror::Error)]
pub enum AssetError {
    /// The file system refused.
    #[error("cannot {action} {}: {source}", path.display())]
    Io {
        /// "read" or "write".
        action: &'static str,
        /// The file.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// The bytes are not what the format asks for.
    #[error("{} is not a readable {format} file: {reason}", path.display())]
    Malformed {
        /// The file.
        path: PathBuf,
        /// Name of the format.
        format: &'static str,
        /// What is wrong and, where known, in which line.
        reason: String,
    },
    /// A sound file of the wrong kind.
    #[error("{} holds {found}, but {expected} is needed here", path.display())]
    Unsuitable {
        /// The file.
        path: PathBuf,
        /// What is needed.
        expected: String,
        /// What the file holds.
        found: String,
    },
    /// An encoder refused the values given to it.
    #[error("cannot write {}: {reason}", path.display())]
    Unwritable {
        /// The file that was to be written.
        path: PathBuf,
        /// Why.
        reason: String,
    },
}

impl AssetError {
    pub(crate) fn reading(path: &Path) -> impl FnOnce(std::io::Error) -> Self + '_ {
        move |source| Self::Io { action: "read", path: path.into(), source }
    }

    pub(crate) fn writing(path: &Path) -> impl FnOnce(std::io::Error) -> Self + '_ {
        move |source| Self::Io { action: "write", path: path.into(), source }
    }
}

/// Largest picture that is read: 2^28 pixels, so that a hostile header cannot ask for all memory.
pub(crate) const MAX_PIXELS: usize = 1 << 28;
