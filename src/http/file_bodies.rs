//! What goes over the wire about a session's files.

use crate::http::links;
use crate::session::{FileKind, SessionFile};
use serde::Serialize;
use std::time::UNIX_EPOCH;
use utoipa::ToSchema;

/// A file of a session.
#[derive(Serialize, ToSchema)]
pub(super) struct FileBody {
    /// By which it is asked for; stays the same as long as the session has this file.
    #[schema(example = "42c32f4604e022021d62e539359532cb")]
    id: String,
    /// Path inside the session folder, for people.
    #[schema(example = "session.json")]
    name: String,
    /// `original`, `record`, `calibration`, `scene`, `derived` or `result`.
    #[schema(value_type = String, example = "record")]
    kind: FileKind,
    /// Length in bytes.
    bytes: u64,
    /// When it was written, seconds since 1970.
    modified: f64,
    /// BLAKE3 as it was written down when the file was stored, hexadecimal; absent where none was.
    blake3: Option<String>,
    /// Where to fetch it.
    url: String,
}

impl FileBody {
    pub(super) fn new(session: &str, file: SessionFile) -> Self {
        Self {
            url: links::file(session, &file.path),
            id: file.id,
            name: file.path,
            kind: file.kind,
            bytes: file.bytes,
            modified: file.modified.duration_since(UNIX_EPOCH).map_or(0.0, |since| since.as_secs_f64()),
            blake3: file.blake3,
        }
    }
}
