//! `Idempotency-Key`: whoever asks for a shot again because no answer came gets the job of the first time.
//!
//! A key stands for one wish: path and body. The same wish under the same key is answered with the same job, however
//! often and however many ask at once; another wish under it is refused. A wish that was refused is not remembered, so
//! that it can be repeated. Keys live in memory, for a day, the newest thousand of them: after a restart of the daemon
//! no job of before is under way, and a script looks at the session's pairs before it asks again.

use super::problem::Problem;
use axum::extract::FromRequestParts;
use axum::http::StatusCode;
use axum::http::request::Parts;
use serde::Serialize;
use std::collections::{HashMap, VecDeque};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

/// Keys that are remembered.
const MOST: usize = 1000;
/// How long a key is remembered.
const LIFE: Duration = Duration::from_secs(24 * 3600);
/// Longest key in bytes.
const KEY_LIMIT: usize = 255;
/// The header's name.
const HEADER: &str = "idempotency-key";

/// Digest of a wish.
type Wish = [u8; 32];
/// A wish with its key, where it has one.
pub(super) type Asked = Option<(String, Wish)>;

/// What came of a wish.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Kept<T> {
    /// The thing itself.
    pub(super) made: T,
    /// Whether it was made before.
    pub(super) replayed: bool,
}

/// The key stands for another wish.
#[derive(Debug, PartialEq, Eq)]
pub(super) struct Reused;

impl From<Reused> for Problem {
    fn from(_: Reused) -> Self {
        let words =
            "this Idempotency-Key came with another path or body before; give each wish a key of its own";
        Problem::new(StatusCode::UNPROCESSABLE_ENTITY, "idempotency_key_reused", words)
    }
}

struct Entry<T> {
    wish: Wish,
    since: Instant,
    /// Held while it is made, so that others who ask meanwhile wait for it.
    made: Arc<Mutex<Option<T>>>,
}

struct Book<T> {
    entries: HashMap<String, Entry<T>>,
    /// The same keys, the oldest first.
    order: VecDeque<String>,
}

/// The keys that are remembered, each with what came of it.
pub(super) struct Keys<T>(Mutex<Book<T>>);

impl<T> Default for Keys<T> {
    fn default() -> Self {
        Self(Mutex::new(Book { entries: HashMap::new(), order: VecDeque::new() }))
    }
}

impl<T: Clone> Keys<T> {
    /// What `make` makes of this wish, or made of it before under the same key.
    pub(super) fn once<E: From<Reused>>(
        &self,
        key: &str,
        wish: Wish,
        now: Instant,
        make: impl FnOnce() -> Result<T, E>,
    ) -> Result<Kept<T>, E> {
        let place = self.place(key, wish, now)?;
        let mut place = place.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(made) = &*place {
            return Ok(Kept { made: made.clone(), replayed: true });
        }
        let made = make()?;
        *place = Some(made.clone());
        Ok(Kept { made, replayed: false })
    }

    fn place(&self, key: &str, wish: Wish, now: Instant) -> Result<Arc<Mutex<Option<T>>>, Reused> {
        let mut book = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        book.forget(now);
        if let Some(entry) = book.entries.get(key) {
            return if entry.wish == wish { Ok(entry.made.clone()) } else { Err(Reused) };
        }
        let made = Arc::default();
        book.entries.insert(key.to_owned(), Entry { wish, since: now, made: Arc::clone(&made) });
        book.order.push_back(key.to_owned());
        Ok(made)
    }
}

impl<T> Book<T> {
    /// Forgets what is too old, and the oldest where one more would be too many.
    fn forget(&mut self, now: Instant) {
        while let Some(oldest) = self.order.front() {
            let old = |entry: &Entry<T>| now.saturating_duration_since(entry.since) >= LIFE;
            if self.order.len() < MOST && !self.entries.get(oldest).is_none_or(old) {
                return;
            }
            self.entries.remove(oldest);
            self.order.pop_front();
        }
    }
}

/// The key of a request, if it has one, and the path that it is for.
pub(super) struct Key {
    key: Option<String>,
    path: String,
}

impl Key {
    /// The key with what is asked for.
    pub(super) fn with(self, body: &impl Serialize) -> Result<Asked, Problem> {
        let Some(key) = self.key else { return Ok(None) };
        let wish = serde_json::to_vec(&(self.path, body)).map_err(Problem::internal)?;
        Ok(Some((key, blake3::hash(&wish).into())))
    }
}

impl<S: Send + Sync> FromRequestParts<S> for Key {
    type Rejection = Problem;

    async fn from_request_parts(parts: &mut Parts, _state: &S) -> Result<Self, Problem> {
        let mut keys = parts.headers.get_all(HEADER).iter();
        let key = match (keys.next(), keys.next()) {
            (None, _) => None,
            (Some(key), None) => match key.to_str() {
                Ok(key) if (1..=KEY_LIMIT).contains(&key.len()) => Some(key.to_owned()),
                _ => return Err(bad_key()),
            },
            (Some(_), Some(_)) => return Err(bad_key()),
        };
        Ok(Self { key, path: parts.uri.path().to_owned() })
    }
}

fn bad_key() -> Problem {
    let words = format!("give one Idempotency-Key of 1 to {KEY_LIMIT} visible ASCII characters, a UUID say");
    Problem::bad_request("idempotency_key_invalid", words)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::atomic::{AtomicU32, Ordering};

    #[derive(Debug, PartialEq, Eq)]
    enum No {
        Reused,
        Full,
    }

    impl From<Reused> for No {
        fn from(_: Reused) -> Self {
            No::Reused
        }
    }

    const WISH: Wish = [1; 32];

    #[test]
    fn the_same_wish_is_made_once_and_another_under_its_key_is_refused() {
        let (keys, now) = (Keys::default(), Instant::now());
        let made = keys.once("a", WISH, now, || Ok::<_, No>(7)).unwrap();
        assert_eq!(made, Kept { made: 7, replayed: false });
        let again = keys.once("a", WISH, now, || -> Result<_, No> { panic!("made twice") }).unwrap();
        assert_eq!(again, Kept { made: 7, replayed: true });
        assert_eq!(keys.once("a", [2; 32], now, || Ok(8)), Err(No::Reused));
        assert!(!keys.once("b", [2; 32], now, || Ok::<_, No>(8)).unwrap().replayed);
    }

    #[test]
    fn a_wish_that_was_refused_can_be_repeated_under_its_key() {
        let (keys, now) = (Keys::default(), Instant::now());
        assert_eq!(keys.once("a", WISH, now, || Err(No::Full)), Err(No::Full));
        assert_eq!(keys.once("a", WISH, now, || Ok::<_, No>(7)).unwrap(), Kept { made: 7, replayed: false });
    }

    #[test]
    fn many_at_once_get_the_one_that_was_made() {
        let (keys, made, now) = (Keys::default(), AtomicU32::new(0), Instant::now());
        let start = std::sync::Barrier::new(8);
        let all: Vec<_> = std::thread::scope(|scope| {
            let ask = || {
                start.wait();
                keys.once("a", WISH, now, || Ok::<_, No>(made.fetch_add(1, Ordering::SeqCst))).unwrap()
            };
            let asking: Vec<_> = (0..8).map(|_| scope.spawn(ask)).collect();
            asking.into_iter().map(|one| one.join().unwrap()).collect()
        });
        assert_eq!(made.load(Ordering::SeqCst), 1);
        assert!(all.iter().all(|kept| kept.made == 0));
        assert_eq!(all.iter().filter(|kept| !kept.replayed).count(), 1);
    }

    #[test]
    fn keys_are_forgotten_after_a_day_and_when_there_are_too_many() {
        let (keys, now) = (Keys::default(), Instant::now());
        let ask = |key: &str, at: Instant| keys.once(key, WISH, at, || Ok::<_, No>(0)).unwrap().replayed;
        assert!(!ask("old", now) && ask("old", now + LIFE / 2));
        assert!(!ask("old", now + LIFE), "a day is over");
        for count in 0..MOST {
            assert!(!ask(&format!("{count}"), now + LIFE));
        }
        assert!(ask(&format!("{}", MOST - 1), now + LIFE));
        assert!(keys.0.lock().unwrap().entries.len() <= MOST);
        assert!(!ask("old", now + LIFE), "it was the oldest of too many");
    }
}
