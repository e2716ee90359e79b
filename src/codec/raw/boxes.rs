//! A bounded walk over the boxes of a Canon CR3 (ISO 14496-12; Canon's own boxes inside `moov`).
//!
//! Takes a file's bytes, gives the TIFF blocks that hold its settings, and the bytes that the file must have: a
//! CR3 keeps its sensor data in the last box, whose length says where a whole file ends. Boxes that are not asked
//! for are stepped over; nothing is allocated.

/// Canon's box of metadata inside `moov`.
const CANON: [u8; 16] =
    [0x85, 0xc0, 0xb6, 0x87, 0x82, 0x0f, 0x11, 0xe0, 0x81, 0x11, 0xf4, 0xce, 0x46, 0x2b, 0x6a, 0x48];
/// More boxes than any camera writes at one level.
const MAX_BOXES: usize = 256;

/// The TIFF blocks of a CR3: the first directory, EXIF, and the maker's notes; those that are there and whole.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(in crate::codec) struct Blocks<'a> {
    pub(in crate::codec) main: Option<&'a [u8]>,
    pub(in crate::codec) exif: Option<&'a [u8]>,
    pub(in crate::codec) maker_notes: Option<&'a [u8]>,
}

/// Whether the bytes open like a CR3.
pub(in crate::codec) fn is_cr3(bytes: &[u8]) -> bool {
    bytes.get(4..12) == Some(b"ftypcrx ")
}

struct Box4<'a> {
    kind: [u8; 4],
    /// What is there of the content.
    content: &'a [u8],
    /// Whole length that the box claims, its header included.
    length: u64,
}

/// The boxes that begin inside `bytes`; a box that claims less than its own header ends the walk.
fn boxes(bytes: &[u8]) -> impl Iterator<Item = (u64, Box4<'_>)> {
    let mut at = 0u64;
    let next = move || {
        let rest = bytes.get(usize::try_from(at).ok()?..)?;
        let short = u32::from_be_bytes(rest.get(..4)?.try_into().ok()?);
        let kind = rest.get(4..8)?.try_into().ok()?;
        let (header, length) = match short {
            // The last box may run to the file's end without saying where that is.
            0 => (8, rest.len() as u64),
            1 => (16, u64::from_be_bytes(rest.get(8..16)?.try_into().ok()?)),
            _ => (8, u64::from(short)),
        };
        if length < header as u64 {
            return None;
        }
        let end = usize::try_from(length).unwrap_or(usize::MAX).min(rest.len());
        let content = rest.get(header..end).unwrap_or_default();
        let start = at;
        at = at.checked_add(length)?;
        Some((start, Box4 { kind, content, length }))
    };
    std::iter::from_fn(next).take(MAX_BOXES)
}

/// Bytes that the file must have for its boxes to be whole.
pub(super) fn needs(bytes: &[u8]) -> u64 {
    boxes(bytes).map(|(start, b)| start.saturating_add(b.length)).max().unwrap_or(8)
}

/// Whether there is a box of sensor data at all.
pub(super) fn has_data(bytes: &[u8]) -> bool {
    boxes(bytes).any(|(_, b)| &b.kind == b"mdat")
}

/// Finds the blocks that hold the settings.
pub(in crate::codec) fn blocks(bytes: &[u8]) -> Blocks<'_> {
    let mut found = Blocks::default();
    let inside =
        |content, kind: &[u8; 4]| boxes(content).find(|(_, b)| &b.kind == kind).map(|(_, b)| b.content);
    let Some(movie) = inside(bytes, b"moov") else { return found };
    let canon = boxes(movie)
        .filter(|(_, b)| &b.kind == b"uuid")
        .find_map(|(_, b)| b.content.strip_prefix(CANON.as_slice()));
    if let Some(canon) = canon {
        found.main = inside(canon, b"CMT1");
        found.exif = inside(canon, b"CMT2");
        found.maker_notes = inside(canon, b"CMT3");
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;

    fn a_box(kind: &[u8; 4], content: &[u8]) -> Vec<u8> {
        let mut bytes = (content.len() as u32 + 8).to_be_bytes().to_vec();
        bytes.extend(kind);
        bytes.extend(content);
        bytes
    }

    fn cr3() -> Vec<u8> {
        let canon = [CANON.as_slice(), &a_box(b"CMT1", b"one"), &a_box(b"CMT3", b"three")].concat();
        [
            a_box(b"ftyp", b"crx \0\0\0\x01"),
            a_box(b"moov", &a_box(b"uuid", &canon)),
            a_box(b"mdat", &[9; 100]),
        ]
        .concat()
    }

    #[test]
    fn blocks_are_found_where_canon_puts_them() {
        let file = cr3();
        assert!(is_cr3(&file) && has_data(&file));
        let found = blocks(&file);
        assert_eq!(
            (found.main, found.exif, found.maker_notes),
            (Some(&b"one"[..]), None, Some(&b"three"[..]))
        );
        assert_eq!(needs(&file), file.len() as u64);
    }

    #[test]
    fn a_cut_file_needs_what_its_last_box_claims() {
        let file = cr3();
        for length in file.len() - 100..file.len() {
            assert_eq!(needs(&file[..length]), file.len() as u64);
        }
    }

    #[test]
    fn boxes_that_lie_of_their_length_end_the_walk() {
        for length in [2u32, 7, u32::MAX] {
            let mut file = cr3();
            file[16..20].copy_from_slice(&length.to_be_bytes());
            let _ = (blocks(&file), needs(&file), has_data(&file));
        }
        let mut endless = a_box(b"mdat", &[0; 8]);
        endless[..4].copy_from_slice(&1u32.to_be_bytes());
        endless[8..16].copy_from_slice(&u64::MAX.to_be_bytes());
        assert_eq!(needs(&endless), u64::MAX);
    }
}
