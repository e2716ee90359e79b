//! Tickets: one request to one path, soon. They stand in an address where no header can be set, and addresses end
//! up in logs and histories: there they are worth nothing any more.

use std::collections::HashMap;
use std::time::{Duration, Instant};

/// How long one is good.
pub(super) const LASTS: Duration = Duration::from_secs(30);
/// So many may be open.
const MOST: usize = 1000;

#[derive(Default)]
pub(super) struct Tickets {
    /// By their digests: how long a search takes tells nothing of the tickets.
    open: HashMap<blake3::Hash, (String, Instant)>,
}

impl Tickets {
    /// Keeps a ticket for `path`; false when too many are open.
    pub(super) fn keep(&mut self, secret: &str, path: &str, now: Instant) -> bool {
        self.open.retain(|_, (_, end)| now < *end);
        let room = self.open.len() < MOST;
        if room {
            self.open.insert(blake3::hash(secret.as_bytes()), (path.to_owned(), now + LASTS));
        }
        room
    }

    /// Whether it is good for `path`; it is used up by being shown, wherever that was.
    pub(super) fn redeem(&mut self, secret: &str, path: &str, now: Instant) -> bool {
        let found = self.open.remove(&blake3::hash(secret.as_bytes()));
        found.is_some_and(|(own, end)| own == path && now < end)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_ticket_is_good_once_for_its_path_and_its_time() {
        let (mut tickets, now) = (Tickets::default(), Instant::now());
        assert!(tickets.keep("a", "/x", now) && tickets.keep("b", "/x", now) && tickets.keep("c", "/x", now));
        assert!(tickets.redeem("a", "/x", now + LASTS - Duration::from_millis(1)));
        assert!(!tickets.redeem("a", "/x", now), "replayed");
        assert!(!tickets.redeem("b", "/y", now), "for another path");
        assert!(!tickets.redeem("b", "/x", now), "used up by that");
        assert!(!tickets.redeem("c", "/x", now + LASTS), "too late");
        assert!(!tickets.redeem("d", "/x", now), "never given");
    }

    #[test]
    fn there_is_an_end_to_open_tickets_and_old_ones_make_room() {
        let (mut tickets, now) = (Tickets::default(), Instant::now());
        assert!((0..MOST).all(|n| tickets.keep(&n.to_string(), "/x", now)));
        assert!(!tickets.keep("more", "/x", now));
        assert!(tickets.keep("more", "/x", now + LASTS));
        assert_eq!(tickets.open.len(), 1);
    }
}
