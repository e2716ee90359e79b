//! How copying ends, in words for people.

use super::copy::CopyError;
use std::path::Path;

/// How a look ended.
pub(super) enum Outcome {
    /// The copy holds everything.
    Whole,
    /// It holds everything but what should not be copied, and that is not the disk's fault.
    Unfit(String),
    /// A disk refused.
    Failed(String),
    /// Somebody wanted it to stop.
    Stopped,
}

impl From<CopyError> for Outcome {
    fn from(error: CopyError) -> Self {
        let refused = |path: &Path, error: &std::io::Error, advice| {
            Outcome::Failed(format!("{}: {error}; {advice}", path.display()))
        };
        match error {
            CopyError::Mirror(path, error) => refused(&path, &error, advice(&error)),
            CopyError::Source(path, error) => refused(&path, &error, "check the session's own disk"),
            CopyError::Altered(path) => Outcome::Unfit(format!(
                "{} is not what was stored, and was not copied; `unlit session verify` tells more",
                path.display()
            )),
            CopyError::ReadBack(path) => Outcome::Failed(format!(
                "{} read back otherwise than it was written; that disk cannot be trusted, take another",
                path.display()
            )),
            CopyError::Stopped => Outcome::Stopped,
        }
    }
}

fn advice(error: &std::io::Error) -> &'static str {
    match error.kind() {
        std::io::ErrorKind::StorageFull | std::io::ErrorKind::QuotaExceeded => {
            "the disk is full: make room on it, or start again with a mirror elsewhere"
        }
        std::io::ErrorKind::ReadOnlyFilesystem | std::io::ErrorKind::PermissionDenied => {
            "it cannot be written to: mount it writable, or give the right to write there"
        }
        std::io::ErrorKind::NotFound | std::io::ErrorKind::StaleNetworkFileHandle => {
            "is the disk plugged in and mounted?"
        }
        _ => "check the disk, its cable or the network",
    }
}

/// Why something was not copied.
pub(super) enum Unfit {
    /// A disk refused, or somebody wants it to stop.
    Error(CopyError),
    /// It should not be copied.
    Words(String),
}

impl Unfit {
    pub(super) fn differs(path: &Path) -> Self {
        let path = path.display();
        Self::Words(format!("{path} differs from the session's own and was left as it is; move it away"))
    }
}

impl From<CopyError> for Unfit {
    fn from(error: CopyError) -> Self {
        Self::Error(error)
    }
}

/// What one file's failure says that need not stop the others.
pub(super) fn told(done: Result<(), Unfit>) -> Result<Option<String>, CopyError> {
    match done {
        Ok(()) => Ok(None),
        Err(Unfit::Words(words)) => Ok(Some(words)),
        Err(Unfit::Error(error @ CopyError::Altered(_))) => match Outcome::from(error) {
            Outcome::Unfit(words) => Ok(Some(words)),
            _ => Ok(None),
        },
        Err(Unfit::Error(error)) => Err(error),
    }
}
