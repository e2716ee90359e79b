//! What a session's own files tell of what is to be copied.

use super::copy::{CopyError, bytes_of, source};
use crate::session::Entry;
use serde_json::Value;
use std::collections::BTreeMap;
use std::path::Path;

/// Every file of which a record tells with its length and BLAKE3, wherever in it that stands.
pub(super) fn files_of(record: &Value) -> BTreeMap<String, (u64, String)> {
    let mut found = BTreeMap::new();
    match record {
        Value::Object(fields) => {
            let text = |key: &str| fields.get(key).and_then(Value::as_str);
            let bytes = fields.get("bytes").and_then(Value::as_u64);
            if let (Some(file), Some(bytes), Some(digest)) = (text("file"), bytes, text("blake3")) {
                found.insert(file.to_owned(), (bytes, digest.to_owned()));
            }
            found.extend(fields.values().flat_map(files_of));
        }
        Value::Array(items) => found.extend(items.iter().flat_map(files_of)),
        _ => {}
    }
    found
}

/// The journal's whole lines; one that is being written does not count.
pub(super) fn whole_lines(path: &Path) -> Result<Vec<u8>, CopyError> {
    let mut bytes = bytes_of(path).map_err(source(path))?.unwrap_or_default();
    bytes.truncate(bytes.iter().rposition(|&b| b == b'\n').map_or(0, |end| end + 1));
    Ok(bytes)
}

pub(super) fn entries(lines: &[u8]) -> Vec<Entry> {
    // What cannot be read says nothing of files; `verify` tells of it.
    lines.split(|&b| b == b'\n').filter_map(|line| serde_json::from_slice(line).ok()).collect()
}
