//! Sidecars that lie beside a pair's originals: told from the record, so that they can be made again and are no originals.

use crate::codec::xmp;
use crate::pair::order::Slot;
use crate::pair::{FrameRecord, PairRecord};
use std::path::Path;

/// Names and contents of a pair's XMP sidecars, one for each frame.
pub(super) fn sidecars(record: &PairRecord) -> Vec<(String, String)> {
    let sidecar =
        |(slot, frame): (Slot, &FrameRecord)| (name_of(&frame.file), xmp::sidecar(record, &slot.to_string()));
    record.frames().map(sidecar).collect()
}

/// Whether a file beside an original is its sidecar, as Adobe's programs name it (`off.xmp`) or darktable does
/// (`off.cr2.xmp`).
pub(super) fn is_sidecar(name: &str, original: &str) -> bool {
    name == name_of(original) || name.strip_suffix(".xmp") == Some(original)
}

fn name_of(original: &str) -> String {
    Path::new(original).with_extension("xmp").to_string_lossy().into_owned()
}
