//! `Idempotency-Key`: whoever asks for a shot again because no answer came gets the job of the first time.
//!
//! A key stands for one wish: path and body. What it stands for is the queue's business ([`crate::capture::Desk::once`]).

use super::problem::Problem;
use crate::jobs::Wish;
use axum::extract::FromRequestParts;
use axum::http::request::Parts;
use serde::Serialize;

/// Longest key in bytes.
const KEY_LIMIT: usize = 255;
/// The header's name.
const HEADER: &str = "idempotency-key";

/// The key of a request, if it has one, and the path that it is for.
pub(super) struct Key {
    key: Option<String>,
    path: String,
}

impl Key {
    /// The key with what is asked for.
    pub(super) fn with(self, body: &impl Serialize) -> Result<Option<Wish>, Problem> {
        let Some(key) = self.key else { return Ok(None) };
        let wish = serde_json::to_vec(&(self.path, body)).map_err(Problem::internal)?;
        Ok(Some(Wish { key, digest: blake3::hash(&wish).to_string() }))
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
