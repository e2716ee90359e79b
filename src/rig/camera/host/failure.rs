//! What a failed call of the library means for whoever asked: sorted by error code, and by the library's own log
//! where the code says no more than "unspecified".

use crate::rig::camera::protocol::Trouble;
use gphoto2::error::ErrorKind;

/// A failed request.
#[derive(Debug)]
pub(super) struct Failure {
    pub(super) trouble: Trouble,
    pub(super) reason: String,
}

/// What a request of the host comes to.
pub(super) type Answer<T> = Result<T, Failure>;

/// Words in the library's messages that tell more than its code. The hexadecimal ones are PTP response codes
/// (ISO 15740) and Canon's own, which the library prints when it has no words for them.
const WORDS: &[(&str, Trouble)] = &[
    ("auto-focus failed", Trouble::NoFocus),
    ("no focus", Trouble::NoFocus),
    ("out of focus", Trouble::NoFocus),
    ("0x8d01", Trouble::NoFocus),
    ("no more memory on card", Trouble::CardFull),
    ("card read-only", Trouble::CardFull),
    ("memorycard ran full", Trouble::CardFull),
    ("store full", Trouble::CardFull),
    ("store not available", Trouble::CardFull),
    ("0x200c", Trouble::CardFull),
    ("0x2013", Trouble::CardFull),
    ("battery", Trouble::BatteryLow),
    ("0xa101", Trouble::BatteryLow),
];

impl Failure {
    pub(super) fn new(trouble: Trouble, reason: impl Into<String>) -> Self {
        Self { trouble, reason: reason.into() }
    }

    pub(super) fn refused(reason: impl Into<String>) -> Self {
        Self::new(Trouble::Refused, reason)
    }

    /// Adds what the library logged meanwhile, and heeds its words.
    pub(super) fn explained_by(self, log: &str) -> Self {
        let reason = if log.is_empty() { self.reason } else { format!("{} ({log})", self.reason) };
        let trouble = match self.trouble {
            Trouble::Lost | Trouble::Refused => said_in(&reason).unwrap_or(self.trouble),
            told => told,
        };
        Self { trouble, reason }
    }

    /// Once the shutter has been released, "busy" must not lead to another release.
    pub(super) fn after_release(self) -> Self {
        match self.trouble {
            Trouble::Busy => Self { trouble: Trouble::Lost, ..self },
            _ => self,
        }
    }
}

fn said_in(reason: &str) -> Option<Trouble> {
    let reason = reason.to_lowercase();
    WORDS.iter().find(|(word, _)| reason.contains(word)).map(|(_, trouble)| *trouble)
}

impl From<gphoto2::Error> for Failure {
    fn from(error: gphoto2::Error) -> Self {
        let trouble = match error.kind() {
            ErrorKind::CameraBusy => Trouble::Busy,
            ErrorKind::IoUsbClaim | ErrorKind::IoLock => Trouble::Claimed,
            ErrorKind::IoUsbFind | ErrorKind::ModelNotFound | ErrorKind::UnknownPort => Trouble::NotFound,
            ErrorKind::Timeout => Trouble::Silent,
            ErrorKind::NoSpace | ErrorKind::NoMemory => Trouble::CardFull,
            ErrorKind::BadParameters | ErrorKind::NotSupported | ErrorKind::CameraError => Trouble::Refused,
            _ => Trouble::Lost,
        };
        Self { trouble, reason: error.to_string() }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_librarys_words_tell_more_than_its_code() {
        let vague = || Failure::new(Trouble::Lost, "Unspecified error");
        let explained = |log: &str| vague().explained_by(log).trouble;
        assert_eq!(explained("Canon EOS Auto-Focus failed, could not capture."), Trouble::NoFocus);
        assert_eq!(explained("Canon EOS Full-Press failed (0x200c: PTP Store Full)"), Trouble::CardFull);
        assert_eq!(explained("PTP_RC 0xa101"), Trouble::BatteryLow);
        assert_eq!(explained("whatever"), Trouble::Lost);
        assert_eq!(vague().explained_by("").reason, "Unspecified error");
    }

    #[test]
    fn what_is_known_exactly_is_not_guessed_from_words() {
        let busy = Failure::new(Trouble::Busy, "I/O in progress").explained_by("battery info unknown");
        assert_eq!(busy.trouble, Trouble::Busy);
        assert_eq!(busy.after_release().trouble, Trouble::Lost, "no second release for one request");
    }
}
