//! Keys under which jobs were asked for. A key stands for one wish and for the job that came of it, for a day, the newest
//! thousand of them.

use super::JobId;
use serde::{Deserialize, Serialize};
use std::collections::{HashSet, VecDeque};
use std::time::{SystemTime, UNIX_EPOCH};

/// Keys that are remembered.
const MOST: usize = 1000;
/// How long a key is remembered, seconds.
const LIFE: u64 = 24 * 3600;

/// One key.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub(super) struct Claim {
    /// As whoever asked chose it.
    pub(super) key: String,
    /// Digest of what was asked for.
    pub(super) wish: String,
    /// The job that came of it.
    pub(super) job: JobId,
    /// When, seconds since 1970.
    pub(super) at: u64,
}

/// The keys that are remembered, the oldest first.
#[derive(Debug, Default)]
pub(super) struct Claims(VecDeque<Claim>);

impl Claims {
    /// What this key stands for at this moment.
    pub(super) fn of(&mut self, key: &str, now: u64) -> Option<&Claim> {
        self.forget(now);
        self.0.iter().find(|claim| claim.key == key)
    }

    /// Remembers one more.
    pub(super) fn keep(&mut self, claim: Claim) {
        self.0.push_back(claim);
        while self.0.len() > MOST {
            self.0.pop_front();
        }
    }

    /// Forgets what is too old. A clock that was set back keeps keys for longer, not for ever.
    pub(super) fn forget(&mut self, now: u64) {
        self.0.retain(|claim| now.saturating_sub(claim.at) < LIFE);
    }

    /// Forgets what stands for a job that nobody knows.
    pub(super) fn forget_strangers(&mut self, known: impl Fn(JobId) -> bool) {
        self.0.retain(|claim| known(claim.job));
    }

    /// The jobs for which keys stand.
    pub(super) fn jobs(&self) -> HashSet<JobId> {
        self.0.iter().map(|claim| claim.job).collect()
    }

    pub(super) fn iter(&self) -> impl Iterator<Item = &Claim> {
        self.0.iter()
    }
}

/// Now. A clock before 1970 counts as 1970: keys are then remembered for longer.
pub(super) fn unix_seconds() -> u64 {
    SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |since| since.as_secs())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn claim(key: impl ToString, job: JobId, at: u64) -> Claim {
        Claim { key: key.to_string(), wish: "w".into(), job, at }
    }

    #[test]
    fn keys_are_forgotten_after_a_day_and_when_there_are_too_many() {
        let mut claims = Claims::default();
        claims.keep(claim("old", 1, 100));
        claims.keep(claim("new", 2, 100 + LIFE / 2));
        assert_eq!(claims.of("old", 99 + LIFE).map(|claim| claim.job), Some(1));
        assert_eq!(claims.of("old", 100 + LIFE), None, "a day is over");
        assert_eq!(claims.of("new", 0).map(|claim| claim.job), Some(2), "the clock was set back");
        for count in 0..MOST as u64 {
            claims.keep(claim(count, 3 + count, 100 + LIFE));
        }
        assert_eq!(claims.of("new", 100 + LIFE), None, "it was the oldest of too many");
        assert_eq!((claims.jobs().len(), claims.iter().count()), (MOST, MOST));
    }
}
