//! The files that the body holds: in its memory until the computer has them, on the card until they are deleted.

use super::datasets::{self, Entry, STORAGE};
use super::fault::Fault;
use std::collections::BTreeMap;
use std::sync::Arc;

/// What kind of file an object is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Kind {
    /// Canon's raw format; libgphoto2 stores such an object from memory under a name that ends in `.cr2`.
    Raw,
    /// EXIF JPEG.
    Jpeg,
}

impl Kind {
    /// PTP object format.
    pub(super) fn format(self) -> u32 {
        match self {
            Self::Raw => 0xb103,
            Self::Jpeg => 0x3801,
        }
    }

    fn suffix(self) -> &'static str {
        match self {
            Self::Raw => "CR2",
            Self::Jpeg => "JPG",
        }
    }
}

/// A file in the body.
pub(super) struct File {
    /// The frame that it belongs to; RAW and JPEG share it.
    frame: u32,
    kind: Kind,
    bytes: Arc<[u8]>,
    /// Size that it is announced with.
    announced: usize,
    on_card: bool,
    tail: Tail,
}

/// What becomes of the end of a file when it is downloaded.
enum Tail {
    /// It comes.
    Whole,
    /// So many bytes are missing, and asking for them is refused once.
    CutOnce(usize),
    /// So many bytes are missing and come as nothing for ever.
    Hollow(usize),
    /// They are asked for after a cut: refused this once.
    Refused,
}

impl File {
    /// A file of frame `frame`, spoilt by `fault` if that is one that spoils files.
    pub(super) fn new(frame: u32, kind: Kind, bytes: Arc<[u8]>, on_card: bool, fault: Option<Fault>) -> Self {
        let length = bytes.len();
        let mut file = Self { frame, kind, bytes, announced: length, on_card, tail: Tail::Whole };
        let without = |missing: u32| length.saturating_sub(missing as usize);
        match fault {
            Some(Fault::CutObject { missing }) => file.bytes = file.bytes[..without(missing)].into(),
            Some(Fault::ShortFile { missing }) => {
                file.bytes = file.bytes[..without(missing)].into();
                file.announced = file.bytes.len();
            }
            Some(Fault::CutDownload { missing }) => file.tail = Tail::CutOnce(length - without(missing)),
            Some(Fault::HollowObject { missing }) => file.tail = Tail::Hollow(length - without(missing)),
            _ => {}
        }
        file
    }

    /// At most `length` bytes from `from` on; nothing when the body refuses.
    fn part(&mut self, from: u32, length: u32) -> Option<Vec<u8>> {
        let (from, whole) = (from as usize, self.bytes.len());
        let to = from.saturating_add(length as usize).min(whole);
        let end = match self.tail {
            Tail::Refused => {
                self.tail = Tail::Whole;
                return None;
            }
            Tail::CutOnce(missing) if to > whole - missing => {
                self.tail = Tail::Refused;
                whole - missing
            }
            Tail::Hollow(missing) => to.min(whole - missing).max(from.min(whole)),
            _ if from >= whole && self.announced > whole => return None,
            _ => to,
        };
        Some(self.bytes.get(from..end).unwrap_or_default().to_vec())
    }

    fn name(&self) -> String {
        format!("IMG_{:04}.{}", (self.frame - 1) % 9999 + 1, self.kind.suffix())
    }
}

/// Handle of the folder DCIM on the card.
const DCIM: u32 = 0x9000_0000;
/// Handle of the folder DCIM/100CANON on the card.
const FOLDER: u32 = 0x9100_0000;
/// First handle of files on the card. Files in memory count from 1.
const ON_CARD: u32 = 0x9100_0001;
/// PTP object format of a folder.
const ASSOCIATION: u32 = 0x3001;

/// All files of the body.
#[derive(Default)]
pub(super) struct Objects {
    files: BTreeMap<u32, File>,
    taken: u32,
}

impl Objects {
    /// Takes a file in; gives its handle and the record that announces it.
    pub(super) fn insert(&mut self, file: File) -> (u32, Vec<u8>) {
        self.taken += 1;
        let handle = if file.on_card { ON_CARD + self.taken } else { self.taken };
        let (size, name) = (file.announced as u32, file.name());
        let record = if file.on_card {
            datasets::object_added(handle, file.kind.format(), size, FOLDER, &name)
        } else {
            datasets::transfer_requested(handle, file.kind.format(), size, &name)
        };
        self.files.insert(handle, file);
        (handle, record)
    }

    /// A part of a file. Outside: there is no such file; inside: the body refuses.
    pub(super) fn part(&mut self, handle: u32, from: u32, length: u32) -> Option<Option<Vec<u8>>> {
        Some(self.files.get_mut(&handle)?.part(from, length))
    }

    /// Takes a file out. Whether there was one.
    pub(super) fn remove(&mut self, handle: u32) -> bool {
        self.files.remove(&handle).is_some()
    }

    /// What lay in memory is lost.
    pub(super) fn clear_memory(&mut self) {
        self.files.retain(|_, file| file.on_card);
    }

    /// Files in memory.
    pub(super) fn in_memory(&self) -> usize {
        self.files.values().filter(|f| !f.on_card).count()
    }

    /// Files on the card.
    pub(super) fn on_card(&self) -> usize {
        self.files.len() - self.in_memory()
    }

    /// What the card holds, folders first.
    fn entries(&self) -> impl Iterator<Item = Entry> {
        let folder = |handle, parent, name: &str| Entry {
            handle,
            format: ASSOCIATION,
            size: 0,
            parent,
            name: name.into(),
        };
        let files = self.files.iter().filter(|(_, f)| f.on_card).map(|(handle, file)| Entry {
            handle: *handle,
            format: file.kind.format(),
            size: file.announced as u32,
            parent: FOLDER,
            name: file.name(),
        });
        [folder(DCIM, 0, "DCIM"), folder(FOLDER, DCIM, "100CANON")].into_iter().chain(files)
    }

    /// What lies directly in `parent`; 0 and !0 both stand for the root here.
    pub(super) fn children(&self, parent: u32) -> Vec<Entry> {
        let parent = if parent == u32::MAX { 0 } else { parent };
        self.entries().filter(|e| e.parent == parent).collect()
    }

    /// Handles of everything on the card, or of what lies directly in `parent` where that is not 0.
    pub(super) fn handles(&self, parent: u32) -> Vec<u32> {
        let handle = |entry: Entry| entry.handle;
        match parent {
            0 => self.entries().map(handle).collect(),
            parent => self.children(parent).into_iter().map(handle).collect(),
        }
    }

    /// One object of the card.
    pub(super) fn entry(&self, handle: u32) -> Option<Entry> {
        self.entries().find(|e| e.handle == handle)
    }

    /// Whether storage `storage` is the card's, or all.
    pub(super) fn is_card(storage: u32) -> bool {
        [STORAGE, u32::MAX].contains(&storage)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn file(fault: Option<Fault>) -> File {
        File::new(1, Kind::Raw, (0..10).collect(), false, fault)
    }

    #[test]
    fn a_cut_download_is_refused_its_end_once_and_whole_the_second_time() {
        let mut file = file(Some(Fault::CutDownload { missing: 3 }));
        assert_eq!(file.part(0, 5).unwrap(), [0, 1, 2, 3, 4]);
        assert_eq!(file.part(5, 5).unwrap(), [5, 6]);
        assert_eq!(file.part(7, 3), None);
        assert_eq!(file.part(0, 10).unwrap().len(), 10);
    }

    #[test]
    fn a_hollow_file_ends_in_nothing_for_ever_and_a_cut_one_in_a_refusal() {
        let mut hollow = file(Some(Fault::HollowObject { missing: 3 }));
        assert_eq!(hollow.part(0, 10).unwrap().len(), 7);
        assert!((0..5).all(|_| hollow.part(7, 3) == Some(Vec::new())));
        let mut cut = file(Some(Fault::CutObject { missing: 3 }));
        assert_eq!((cut.part(0, 10).unwrap().len(), cut.announced), (7, 10));
        assert_eq!(cut.part(7, 3), None);
        let mut whole = file(None);
        assert_eq!(whole.part(u32::MAX, u32::MAX), Some(Vec::new()));
    }

    #[test]
    fn the_card_keeps_its_files_when_the_memory_is_cleared() {
        let mut objects = Objects::default();
        let (memory, _) = objects.insert(file(None));
        let (card, _) = objects.insert(File::new(2, Kind::Jpeg, [1].into(), true, None));
        assert_eq!(objects.handles(0), [DCIM, FOLDER, card]);
        assert_eq!(objects.handles(FOLDER), [card]);
        assert_eq!(objects.entry(card).unwrap().name, "IMG_0002.JPG");
        objects.clear_memory();
        assert_eq!((objects.in_memory(), objects.on_card()), (0, 1));
        assert!(!objects.remove(memory) && objects.remove(card));
    }
}
