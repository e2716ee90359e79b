//! Pairing codes: eight digits on the daemon's terminal, which whoever reads them types into a browser. One is
//! open at a time, for some minutes and for one browser.
//!
//! Wrong tries do not close it: a guess is as bad against one code as against the next, and a stranger could keep
//! the owner out by guessing. How many guesses there are is `rate`'s business.

use std::time::{Duration, Instant};

/// How long one is open.
const LASTS: Duration = Duration::from_secs(10 * 60);

#[derive(Default)]
pub(super) struct Codes {
    open: Option<Code>,
}

struct Code {
    digits: String,
    end: Instant,
}

#[derive(Debug, PartialEq, Eq)]
pub(super) enum Verdict {
    Right,
    Wrong,
    /// There is no code that could be right.
    NoneOpen,
}

impl Codes {
    pub(super) fn is_open(&self, now: Instant) -> bool {
        self.open.as_ref().is_some_and(|code| now < code.end)
    }

    /// Opens the code of this number, instead of any other; its digits.
    pub(super) fn open(&mut self, number: u64, now: Instant) -> String {
        let digits = format!("{number:08}");
        self.open = Some(Code { digits: digits.clone(), end: now + LASTS });
        digits
    }

    /// Tries a code; spaces and hyphens in it are for people.
    pub(super) fn enter(&mut self, given: &str, now: Instant) -> Verdict {
        let given: String = given.chars().filter(|c| !matches!(c, ' ' | '-')).collect();
        let Some(code) = self.open.as_ref().filter(|code| now < code.end) else {
            return Verdict::NoneOpen;
        };
        if blake3::hash(given.as_bytes()) != blake3::hash(code.digits.as_bytes()) {
            return Verdict::Wrong;
        }
        self.open = None;
        Verdict::Right
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_code_is_good_once() {
        let (mut codes, now) = (Codes::default(), Instant::now());
        assert_eq!(codes.enter("00000042", now), Verdict::NoneOpen);
        assert_eq!(codes.open(42, now), "00000042");
        assert_eq!(codes.enter("42", now), Verdict::Wrong);
        assert_eq!(codes.enter("0000 0042", now), Verdict::Right);
        assert_eq!(codes.enter("00000042", now), Verdict::NoneOpen);
    }

    #[test]
    fn time_closes_it_and_wrong_tries_do_not() {
        let (mut codes, now) = (Codes::default(), Instant::now());
        codes.open(42, now);
        for number in 100..200 {
            assert_eq!(codes.enter(&format!("{number:08}"), now), Verdict::Wrong);
        }
        assert_eq!(codes.enter("00000042", now), Verdict::Right, "nobody can guess it away");
        codes.open(43, now);
        assert!(codes.is_open(now + LASTS - Duration::from_secs(1)));
        assert!(!codes.is_open(now + LASTS));
        assert_eq!(codes.enter("00000043", now + LASTS), Verdict::NoneOpen);
    }
}
