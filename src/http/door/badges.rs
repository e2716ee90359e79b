//! Cookies' values: a number, the time of their end, and a code that only this token makes. The daemon keeps none
//! of them, so that a restart puts nobody out; those that left are remembered until they would have ended.

use super::token::{hex, random};
use std::collections::HashMap;
use std::sync::{Mutex, PoisonError};
use std::time::Duration;

/// How long one is good.
pub(super) const LASTS: Duration = Duration::from_secs(30 * 24 * 3600);

pub(super) struct Badges {
    key: [u8; 32],
    /// Those that left, and when each would have ended (Unix seconds).
    left: Mutex<HashMap<String, u64>>,
}

impl Badges {
    pub(super) fn new(key: [u8; 32]) -> Self {
        Self { key, left: Mutex::default() }
    }

    pub(super) fn issue(&self, now: u64) -> std::io::Result<String> {
        let said = format!("{}.{}", hex(&random::<16>()?), now + LASTS.as_secs());
        let code = self.code(&said).to_hex();
        Ok(format!("{said}.{code}"))
    }

    pub(super) fn check(&self, badge: &str, now: u64) -> bool {
        self.end(badge).is_some_and(|end| now < end) && !self.left().contains_key(badge)
    }

    pub(super) fn revoke(&self, badge: &str, now: u64) {
        let Some(end) = self.end(badge) else { return };
        let mut left = self.left();
        left.retain(|_, end| now < *end);
        left.insert(badge.to_owned(), end);
    }

    /// When a badge of ours ends.
    fn end(&self, badge: &str) -> Option<u64> {
        let (said, code) = badge.rsplit_once('.')?;
        let genuine = blake3::Hash::from_hex(code).ok()? == self.code(said);
        genuine.then(|| said.rsplit_once('.')?.1.parse().ok()).flatten()
    }

    fn code(&self, said: &str) -> blake3::Hash {
        blake3::keyed_hash(&self.key, said.as_bytes())
    }

    fn left(&self) -> std::sync::MutexGuard<'_, HashMap<String, u64>> {
        self.left.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const NOW: u64 = 1_800_000_000;

    #[test]
    fn a_badge_is_good_until_its_end_and_after_a_restart() {
        let badge = Badges::new([7; 32]).issue(NOW).unwrap();
        let restarted = Badges::new([7; 32]);
        assert!(restarted.check(&badge, NOW));
        assert!(restarted.check(&badge, NOW + LASTS.as_secs() - 1));
        assert!(!restarted.check(&badge, NOW + LASTS.as_secs()));
        assert!(!Badges::new([8; 32]).check(&badge, NOW), "another token's");
    }

    #[test]
    fn nothing_of_a_badge_can_be_changed() {
        let badges = Badges::new([7; 32]);
        let badge = badges.issue(NOW).unwrap();
        for at in 0..badge.len() {
            let mut bytes = badge.clone().into_bytes();
            bytes[at] = if bytes[at] == b'1' { b'2' } else { b'1' };
            assert!(!badges.check(&String::from_utf8(bytes).unwrap(), NOW), "byte {at}");
        }
        for other in ["", ".", "..", &badge[1..], &format!("{badge}0")] {
            assert!(!badges.check(other, NOW), "{other:?}");
        }
    }

    #[test]
    fn who_left_stays_out_and_is_forgotten_when_due() {
        let badges = Badges::new([7; 32]);
        let (gone, kept) = (badges.issue(NOW).unwrap(), badges.issue(NOW).unwrap());
        badges.revoke(&gone, NOW);
        badges.revoke("nonsense", NOW);
        assert!(!badges.check(&gone, NOW) && badges.check(&kept, NOW));
        let later = NOW + LASTS.as_secs();
        badges.revoke(&badges.issue(later).unwrap(), later);
        assert_eq!(badges.left().len(), 1);
    }
}
