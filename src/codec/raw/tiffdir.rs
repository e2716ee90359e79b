//! A bounded walk over the directories of a TIFF-like raw file (TIFF 6.0 section 2, DNG 1.4 chapter 2).
//!
//! Decoders trust what a file says of itself; this walk does not. It visits every directory that a
//! decoder would visit, refuses circles and swarms of them, and keeps the entries whose values lie inside
//! the file. Takes bytes, gives tags; allocates in proportion to the directories, never to what they claim.

use std::collections::{HashSet, VecDeque};

/// More directories than any camera writes: EXIF, GPS, interoperability, maker's notes, previews.
const MAX_DIRECTORIES: usize = 96;
/// More entries than any camera writes into one directory.
const MAX_ENTRIES: usize = 4000;
/// More strips or tiles than a frame of 400 MP in tiles of 64 x 64.
const MAX_VALUES: usize = 200_000;

/// Tags that lead to further directories: SubIFDs, EXIF, and the three makers' own that decoders follow.
const LEADING_TAGS: [u16; 5] = [0x014a, 0x8769, 0xf000, 0x8290, 0xfe00];
const MAKER_NOTE: u16 = 0x927c;

/// Why the walk ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(in crate::codec) enum Fault {
    /// A directory lies past the file's end; the file would have to be at least this long.
    Cut { needs: u64 },
    /// Directories that no camera writes.
    Hostile(&'static str),
}

/// One entry whose value lies inside the file.
#[derive(Debug)]
struct Entry<'a> {
    tag: u16,
    kind: u16,
    data: &'a [u8],
}

/// One directory's entries.
#[derive(Debug)]
pub(in crate::codec) struct Directory<'a> {
    little: bool,
    entries: Vec<Entry<'a>>,
}

/// All directories of a file, the first one first; those of the maker's notes apart, whose tags are the maker's own.
#[derive(Debug)]
pub(in crate::codec) struct Tiff<'a> {
    pub(super) little: bool,
    pub(in crate::codec) directories: Vec<Directory<'a>>,
    pub(in crate::codec) maker_notes: Vec<Directory<'a>>,
}

struct Step<'a> {
    base: &'a [u8],
    offset: usize,
    little: bool,
    inside_maker_note: bool,
}

fn u16_at(bytes: &[u8], at: usize, little: bool) -> Option<u16> {
    let two = bytes.get(at..at.checked_add(2)?)?.try_into().ok()?;
    Some(if little { u16::from_le_bytes(two) } else { u16::from_be_bytes(two) })
}

fn u32_at(bytes: &[u8], at: usize, little: bool) -> Option<u32> {
    let four = bytes.get(at..at.checked_add(4)?)?.try_into().ok()?;
    Some(if little { u32::from_le_bytes(four) } else { u32::from_be_bytes(four) })
}

/// How TIFF files open, and the files of three makers that are TIFF but for their mark: Olympus (ORF), Panasonic
/// (RW2).
const OPENINGS: [&[u8]; 6] = [b"II*\0", b"MM\0*", b"IIRO", b"IIRS", b"MMOR", b"IIU\0"];

/// Whether the bytes open like a TIFF file.
pub(in crate::codec) fn is_tiff(bytes: &[u8]) -> bool {
    OPENINGS.iter().any(|opening| bytes.starts_with(opening))
}

/// Walks all directories of `bytes`, which [`is_tiff`]; a fault in any of them is one of the file.
pub(super) fn walk(bytes: &[u8]) -> Result<Tiff<'_>, Fault> {
    match survey(bytes) {
        (tiff, None) => Ok(tiff),
        (_, Some(fault)) => Err(fault),
    }
}

/// Walks as far as there are directories to be read: those found, and what ended the walk early.
pub(in crate::codec) fn survey(bytes: &[u8]) -> (Tiff<'_>, Option<Fault>) {
    let little = bytes.starts_with(b"II");
    let mut tiff = Tiff { little, directories: Vec::new(), maker_notes: Vec::new() };
    let Some(first) = u32_at(bytes, 4, little) else {
        return (tiff, Some(Fault::Cut { needs: 8 }));
    };
    let first = Step { base: bytes, offset: first as usize, little, inside_maker_note: false };
    let mut steps = VecDeque::from([first]);
    let mut seen = HashSet::new();
    let mut fault = None;
    while let Some(step) = steps.pop_front() {
        let place = (step.base.as_ptr() as usize).wrapping_add(step.offset);
        if !seen.insert(place) {
            fault = fault.or(Some(Fault::Hostile("its directories lead round in a circle")));
            break;
        }
        if seen.len() > MAX_DIRECTORIES {
            fault = fault.or(Some(Fault::Hostile("it has more directories than any camera writes")));
            break;
        }
        match read_directory(&step, &mut steps) {
            Ok(directory) if step.inside_maker_note => tiff.maker_notes.push(directory),
            Ok(directory) => tiff.directories.push(directory),
            // A maker's notes may hold anything; whatever is no directory there leads nowhere.
            Err(_) if step.inside_maker_note => {}
            Err(found) => fault = fault.or(Some(found)),
        }
    }
    (tiff, fault)
}

fn read_directory<'a>(step: &Step<'a>, steps: &mut VecDeque<Step<'a>>) -> Result<Directory<'a>, Fault> {
    let &Step { base, offset, little, inside_maker_note } = step;
    let count = usize::from(
        u16_at(base, offset, little).ok_or(Fault::Cut { needs: (offset as u64).saturating_add(2) })?,
    );
    if count > MAX_ENTRIES {
        return Err(Fault::Hostile("a directory has more entries than any camera writes"));
    }
    let end = offset + 2 + count * 12;
    let Some(next) = u32_at(base, end, little) else {
        return Err(Fault::Cut { needs: end as u64 + 4 });
    };
    let mut entries = Vec::with_capacity(count);
    for at in (0..count).map(|i| offset + 2 + i * 12) {
        if let Some(entry) = read_entry(base, at, little) {
            entries.push(entry);
        }
    }
    let directory = Directory { little, entries };
    if next != 0 && !inside_maker_note {
        steps.push_back(Step { base, offset: next as usize, little, inside_maker_note });
    }
    for tag in LEADING_TAGS {
        let targets = directory.unsigned(tag).unwrap_or_default();
        if targets.len() > MAX_DIRECTORIES {
            return Err(Fault::Hostile("it has more directories than any camera writes"));
        }
        steps.extend(targets.into_iter().map(|target| Step {
            base,
            offset: target as usize,
            little,
            inside_maker_note,
        }));
    }
    if let Some(note) = directory.entries.iter().find(|e| e.tag == MAKER_NOTE) {
        steps.push_back(maker_note(base, note.data, little));
    }
    Ok(directory)
}

/// Where the directory of a maker's notes starts: Nikon's have a TIFF header of their own, some repeat the
/// byte order, the others start at once.
fn maker_note<'a>(base: &'a [u8], note: &'a [u8], little: bool) -> Step<'a> {
    let start = (note.as_ptr() as usize).wrapping_sub(base.as_ptr() as usize);
    if note.starts_with(b"Nikon\0\x02") && note.len() > 18 {
        let base = &note[10..];
        return Step { base, offset: 8, little: base.starts_with(b"II"), inside_maker_note: true };
    }
    let (offset, little) = match note.get(..2) {
        Some(b"II") => (start + 2, true),
        Some(b"MM") => (start + 2, false),
        _ => (start, little),
    };
    Step { base, offset, little, inside_maker_note: true }
}

/// The twelve bytes at `at` as an entry, unless its value lies outside the file.
fn read_entry(base: &[u8], at: usize, little: bool) -> Option<Entry<'_>> {
    let tag = u16_at(base, at, little)?;
    let kind = u16_at(base, at + 2, little)?;
    let length = (u32_at(base, at + 4, little)? as usize).checked_mul(size_of_kind(kind))?;
    let from = if length <= 4 { at + 8 } else { u32_at(base, at + 8, little)? as usize };
    Some(Entry { tag, kind, data: base.get(from..from.checked_add(length)?)? })
}

fn size_of_kind(kind: u16) -> usize {
    match kind {
        3 | 8 => 2,
        4 | 9 | 11 | 13 => 4,
        5 | 10 | 12 => 8,
        _ => 1,
    }
}

impl Directory<'_> {
    /// The bytes of an ASCII tag up to its first NUL.
    pub(in crate::codec) fn ascii(&self, tag: u16) -> Option<&[u8]> {
        let entry = self.entries.iter().find(|e| e.tag == tag && e.kind == 2)?;
        entry.data.split(|&b| b == 0).find(|line| !line.is_empty())
    }

    /// The values of a BYTE, SHORT or LONG tag, unsigned or signed (as their bits); `None` when absent, of another
    /// type, or endless.
    pub(in crate::codec) fn unsigned(&self, tag: u16) -> Option<Vec<u64>> {
        let entry = self.entries.iter().find(|e| e.tag == tag)?;
        let size = size_of_kind(entry.kind);
        if entry.data.len() / size > MAX_VALUES {
            return None;
        }
        let little = self.little;
        let read = |chunk: &[u8]| match entry.kind {
            1 | 7 => chunk.first().map(|&b| u64::from(b)),
            3 | 8 => u16_at(chunk, 0, little).map(u64::from),
            4 | 9 | 13 => u32_at(chunk, 0, little).map(u64::from),
            _ => None,
        };
        entry.data.chunks_exact(size).map(read).collect()
    }

    /// The values of a number tag, rationals included; `None` when absent or not finite.
    pub(in crate::codec) fn numbers(&self, tag: u16) -> Option<Vec<f64>> {
        let entry = self.entries.iter().find(|e| e.tag == tag)?;
        if entry.kind != 5 && entry.kind != 10 {
            return Some(self.unsigned(tag)?.into_iter().map(|v| v as f64).collect());
        }
        if entry.data.len() / 8 > MAX_VALUES {
            return None;
        }
        let part = |chunk: &[u8], at: usize| {
            let raw = u32_at(chunk, at, self.little)?;
            Some(if entry.kind == 10 { f64::from(raw as i32) } else { f64::from(raw) })
        };
        let values: Option<Vec<f64>> =
            entry.data.chunks_exact(8).map(|c| Some(part(c, 0)? / part(c, 4)?)).collect();
        values.filter(|v| v.iter().all(|x| x.is_finite()))
    }

    /// The first value of a BYTE, SHORT or LONG tag.
    pub(super) fn one(&self, tag: u16) -> Option<u64> {
        self.unsigned(tag)?.first().copied()
    }

    /// Whether the tag is there at all.
    pub(super) fn has(&self, tag: u16) -> bool {
        self.entries.iter().any(|e| e.tag == tag)
    }

    /// Strips or tiles as (offset, length) pairs; `None` if the directory has none.
    pub(super) fn segments(&self) -> Option<Vec<(u64, u64)>> {
        let (offsets, lengths) = match (self.unsigned(tag::STRIP_OFFSETS), self.unsigned(tag::TILE_OFFSETS)) {
            (Some(offsets), _) => (offsets, self.unsigned(tag::STRIP_BYTE_COUNTS)?),
            (None, Some(offsets)) => (offsets, self.unsigned(tag::TILE_BYTE_COUNTS)?),
            (None, None) => return None,
        };
        (offsets.len() == lengths.len()).then(|| offsets.into_iter().zip(lengths).collect())
    }
}

/// Tag numbers of TIFF 6.0, TIFF/EP, DNG 1.4 and Canon's CR2.
pub(super) mod tag {
    pub(in super::super) const NEW_SUBFILE_TYPE: u16 = 254;
    pub(in super::super) const IMAGE_WIDTH: u16 = 256;
    pub(in super::super) const IMAGE_LENGTH: u16 = 257;
    pub(in super::super) const BITS_PER_SAMPLE: u16 = 258;
    pub(in super::super) const COMPRESSION: u16 = 259;
    pub(in super::super) const PHOTOMETRIC: u16 = 262;
    pub(in super::super) const STRIP_OFFSETS: u16 = 273;
    pub(in super::super) const SAMPLES_PER_PIXEL: u16 = 277;
    pub(in super::super) const ROWS_PER_STRIP: u16 = 278;
    pub(in super::super) const STRIP_BYTE_COUNTS: u16 = 279;
    pub(in super::super) const TILE_WIDTH: u16 = 322;
    pub(in super::super) const TILE_LENGTH: u16 = 323;
    pub(in super::super) const TILE_OFFSETS: u16 = 324;
    pub(in super::super) const TILE_BYTE_COUNTS: u16 = 325;
    pub(in super::super) const CFA_REPEAT: u16 = 33421;
    pub(in super::super) const CFA_PATTERN: u16 = 33422;
    pub(in super::super) const DNG_VERSION: u16 = 50706;
    pub(in super::super) const CFA_LAYOUT: u16 = 50711;
    pub(in super::super) const LINEARIZATION: u16 = 50712;
    pub(in super::super) const BLACK_REPEAT: u16 = 50713;
    pub(in super::super) const BLACK_LEVEL: u16 = 50714;
    pub(in super::super) const WHITE_LEVEL: u16 = 50717;
    pub(in super::super) const COLOR_MATRIX_1: u16 = 50721;
    pub(in super::super) const COLOR_MATRIX_2: u16 = 50722;
    pub(in super::super) const ILLUMINANT_1: u16 = 50778;
    pub(in super::super) const ILLUMINANT_2: u16 = 50779;
    pub(in super::super) const ACTIVE_AREA: u16 = 50829;
    pub(in super::super) const MASKED_AREAS: u16 = 50830;
    pub(in super::super) const CR2_SLICES: u16 = 50752;
}

#[cfg(test)]
mod tests {
    use super::*;

    fn one_entry(tag: u16, kind: u16, count: u32, value: u32, next: u32) -> Vec<u8> {
        let mut file = b"II*\0\x08\0\0\0\x01\0".to_vec();
        file.extend(tag.to_le_bytes());
        file.extend(kind.to_le_bytes());
        file.extend(count.to_le_bytes());
        file.extend(value.to_le_bytes());
        file.extend(next.to_le_bytes());
        file
    }

    #[test]
    fn a_value_is_read_from_its_entry() {
        let file = one_entry(256, 4, 1, 600, 0);
        assert_eq!(walk(&file).unwrap().directories[0].one(256), Some(600));
    }

    #[test]
    fn a_chain_that_bites_its_tail_is_refused() {
        let file = one_entry(256, 4, 1, 600, 8);
        assert!(matches!(walk(&file), Err(Fault::Hostile(_))));
    }

    #[test]
    fn a_sub_directory_that_is_its_own_parent_is_refused() {
        let file = one_entry(0x014a, 4, 1, 8, 0);
        assert!(matches!(walk(&file), Err(Fault::Hostile(_))));
    }

    #[test]
    fn a_directory_past_the_end_is_a_cut_file() {
        let file = one_entry(256, 4, 1, 600, 5000);
        assert_eq!(walk(&file).unwrap_err(), Fault::Cut { needs: 5002 });
    }

    #[test]
    fn a_value_that_claims_gigabytes_is_left_out() {
        let file = one_entry(273, 4, u32::MAX, 8, 0);
        assert!(!walk(&file).unwrap().directories[0].has(273));
    }
}
