//! Pairing codes: eight digits on the daemon's terminal, which whoever reads them types into a browser. One is
//! open at a time, for some minutes, for one browser, and for a few wrong tries.

use std::time::{Duration, Instant};

/// How long one is open.
const LASTS: Duration = Duration::from_secs(10 * 60);
/// The code is void after so many wrong tries.
const TRIES: u32 = 5;

#[derive(Default)]
pub(super) struct Codes {
    open: Option<Code>,
}

struct Code {
    digits: String,
    end: Instant,
    wrong: u32,
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

    /// Opens the code of this number, instead of any other.
    pub(super) fn open(&mut self, number: u64, now: Instant) -> &str {
        let code = Code { digits: format!("{number:08}"), end: now + LASTS, wrong: 0 };
        &self.open.insert(code).digits
    }

    /// Tries a code; spaces and hyphens in it are for people.
    pub(super) fn enter(&mut self, given: &str, now: Instant) -> Verdict {
        let given: String = given.chars().filter(|c| !matches!(c, ' ' | '-')).collect();
        let Some(code) = self.open.as_mut().filter(|code| now < code.end) else {
            self.open = None;
            return Verdict::NoneOpen;
        };
        let right = blake3::hash(given.as_bytes()) == blake3::hash(code.digits.as_bytes());
        code.wrong += 1;
        if right || code.wrong >= TRIES {
            self.open = None;
        }
        if right { Verdict::Right } else { Verdict::Wrong }
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
    fn wrong_tries_and_time_close_it() {
        let (mut codes, now) = (Codes::default(), Instant::now());
        codes.open(42, now);
        for _ in 0..TRIES {
            assert_eq!(codes.enter("12345678", now), Verdict::Wrong);
        }
        assert_eq!(codes.enter("00000042", now), Verdict::NoneOpen, "right, but too late");
        codes.open(43, now);
        assert!(codes.is_open(now + LASTS - Duration::from_secs(1)));
        assert!(!codes.is_open(now + LASTS));
        assert_eq!(codes.enter("00000043", now + LASTS), Verdict::NoneOpen);
    }
}
