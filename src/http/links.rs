//! Where things are fetched.

use crate::session::file_id;

/// Percent-encodes all but what RFC 3986 leaves unreserved.
pub(super) fn path_segment(text: &str) -> String {
    text.bytes().fold(String::new(), |mut out, byte| {
        match byte {
            b'a'..=b'z' | b'A'..=b'Z' | b'0'..=b'9' | b'-' | b'.' | b'_' | b'~' => out.push(char::from(byte)),
            _ => out.push_str(&format!("%{byte:02X}")),
        }
        out
    })
}

/// A session.
pub(super) fn session(name: &str) -> String {
    format!("/api/v1/sessions/{}", path_segment(name))
}

/// The session's file at `path` inside it.
pub(super) fn file(session_name: &str, path: &str) -> String {
    format!("{}/files/{}", session(session_name), file_id(path))
}

/// A pair.
pub(super) fn pair(session_name: &str, number: u32) -> String {
    format!("{}/pairs/{number}", session(session_name))
}

/// A small picture of a pair, of these contents. Browsers keep it for good, so its address changes with them.
pub(super) fn thumbnail(session_name: &str, number: u32, picture: &str, blake3: &str) -> String {
    format!("{}/{picture}/thumbnail.jpg?of={}", pair(session_name, number), making(blake3))
}

/// What a picture's address says of the contents of its frame.
pub(super) fn making(blake3: &str) -> String {
    blake3.chars().take(16).collect()
}

/// A job.
pub(super) fn job(id: u64) -> String {
    format!("/api/v1/jobs/{id}")
}
