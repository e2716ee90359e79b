//! What the body tells about itself: PTP datasets (ISO 15740) and the records of Canon's GetEvent.
//!
//! A GetEvent answer is a row of records `u32 size, u32 type, payload`, ended by an empty record. Without
//! that terminator libgphoto2 loses the last record.

/// Operations that the body answers; libgphoto2 asks only for what is announced here.
pub(super) mod op {
    pub(crate) const GET_DEVICE_INFO: u16 = 0x1001;
    pub(crate) const OPEN_SESSION: u16 = 0x1002;
    pub(crate) const CLOSE_SESSION: u16 = 0x1003;
    pub(crate) const GET_STORAGE_IDS: u16 = 0x1004;
    pub(crate) const GET_STORAGE_INFO: u16 = 0x1005;
    pub(crate) const GET_OBJECT_HANDLES: u16 = 0x1007;
    pub(crate) const GET_OBJECT_INFO: u16 = 0x1008;
    pub(crate) const GET_OBJECT: u16 = 0x1009;
    pub(crate) const DELETE_OBJECT: u16 = 0x100b;
    pub(crate) const GET_PARTIAL_OBJECT: u16 = 0x101b;
    pub(crate) const EOS_GET_STORAGE_IDS: u16 = 0x9101;
    pub(crate) const EOS_GET_STORAGE_INFO: u16 = 0x9102;
    pub(crate) const EOS_GET_DEVICE_INFO: u16 = 0x9108;
    pub(crate) const EOS_GET_OBJECTS: u16 = 0x9109;
    pub(crate) const EOS_SET_PROPERTY: u16 = 0x9110;
    pub(crate) const EOS_SET_REMOTE_MODE: u16 = 0x9114;
    pub(crate) const EOS_SET_EVENT_MODE: u16 = 0x9115;
    pub(crate) const EOS_GET_EVENT: u16 = 0x9116;
    pub(crate) const EOS_TRANSFER_COMPLETE: u16 = 0x9117;
    pub(crate) const EOS_HOST_CAPACITY: u16 = 0x911a;
    pub(crate) const EOS_LOCK_UI: u16 = 0x911b;
    pub(crate) const EOS_UNLOCK_UI: u16 = 0x911c;
    pub(crate) const EOS_KEEP_ON: u16 = 0x911d;
    pub(crate) const EOS_REQUEST_PROPERTY: u16 = 0x9127;
    pub(crate) const EOS_RELEASE_ON: u16 = 0x9128;
    pub(crate) const EOS_RELEASE_OFF: u16 = 0x9129;
    pub(crate) const EOS_OLC_GROUPS: u16 = 0x913d;
    pub(crate) const EOS_VIEWFINDER: u16 = 0x9153;
    pub(crate) const EOS_END_VIEWFINDER: u16 = 0x9160;

    /// All of them, as DeviceInfo lists them.
    pub(crate) const ALL: &[u16] = &[
        GET_DEVICE_INFO,
        OPEN_SESSION,
        CLOSE_SESSION,
        GET_STORAGE_IDS,
        GET_STORAGE_INFO,
        GET_OBJECT_HANDLES,
        GET_OBJECT_INFO,
        GET_OBJECT,
        DELETE_OBJECT,
        GET_PARTIAL_OBJECT,
        EOS_GET_STORAGE_IDS,
        EOS_GET_STORAGE_INFO,
        EOS_GET_DEVICE_INFO,
        EOS_GET_OBJECTS,
        EOS_SET_PROPERTY,
        EOS_SET_REMOTE_MODE,
        EOS_SET_EVENT_MODE,
        EOS_GET_EVENT,
        EOS_TRANSFER_COMPLETE,
        EOS_HOST_CAPACITY,
        EOS_LOCK_UI,
        EOS_UNLOCK_UI,
        EOS_KEEP_ON,
        EOS_REQUEST_PROPERTY,
        EOS_RELEASE_ON,
        EOS_RELEASE_OFF,
        EOS_OLC_GROUPS,
        EOS_VIEWFINDER,
        EOS_END_VIEWFINDER,
    ];
}

/// Model name that the body gives.
pub(super) const MODEL: &str = "Canon EOS 5DS";
/// Serial number that the body gives; no such body was built.
pub(super) const SERIAL: &str = "000000000042";
/// Canon's vendor extension id, by which libgphoto2 takes the body for a Canon.
const CANON: u32 = 0xb;
/// The one card slot.
pub(super) const STORAGE: u32 = 0x0001_0001;

/// Grows a little-endian dataset.
#[derive(Default)]
struct Dataset(Vec<u8>);

impl Dataset {
    fn u16(&mut self, value: u16) -> &mut Self {
        self.0.extend(value.to_le_bytes());
        self
    }

    fn u32(&mut self, value: u32) -> &mut Self {
        self.0.extend(value.to_le_bytes());
        self
    }

    fn u64(&mut self, value: u64) -> &mut Self {
        self.0.extend(value.to_le_bytes());
        self
    }

    /// PTP array of 16-bit numbers: count, numbers.
    fn u16s(&mut self, values: &[u16]) -> &mut Self {
        self.0.extend(u32s(&[values.len() as u32]));
        values.iter().for_each(|v| self.0.extend(v.to_le_bytes()));
        self
    }

    /// PTP string: count of UCS-2 units with the closing zero, units; a lone 0 when empty.
    fn string(&mut self, text: &str) -> &mut Self {
        if text.is_empty() {
            self.0.push(0);
            return self;
        }
        let units: Vec<u16> = text.encode_utf16().take(254).chain([0]).collect();
        self.0.push(units.len() as u8);
        units.iter().for_each(|u| self.0.extend(u.to_le_bytes()));
        self
    }
}

/// The bytes of a row of 32-bit numbers.
pub(super) fn u32s(values: &[u32]) -> Vec<u8> {
    values.iter().flat_map(|v| v.to_le_bytes()).collect()
}

/// A PTP array of 32-bit numbers: count, numbers.
pub(super) fn array(values: &[u32]) -> Vec<u8> {
    let mut bytes = u32s(&[values.len() as u32]);
    bytes.extend(u32s(values));
    bytes
}

/// PTP DeviceInfo.
pub(super) fn device_info(serial: &str) -> Vec<u8> {
    let mut d = Dataset::default();
    d.u16(100).u32(CANON).u16(100).string("").u16(0);
    d.u16s(op::ALL).u16s(&[]).u16s(&[]).u16s(&[]).u16s(&[0x3801]);
    d.string("Canon Inc.").string(MODEL).string("3-1.1.2").string(serial);
    d.0
}

/// Canon's own device info: size, and arrays of events, properties and one more, whose meaning is not known
/// and whose content nobody reads; libgphoto2 takes an empty array for a broken answer.
pub(super) fn eos_device_info(properties: &[u32]) -> Vec<u8> {
    let events = array(&[0xc181, 0xc186, 0xc189, 0xc18a, 0xc18b]);
    let properties = array(properties);
    let rest = array(&[0, 1, 2, 4, 8]);
    let mut bytes = u32s(&[(4 + events.len() + properties.len() + rest.len()) as u32]);
    bytes.extend(events);
    bytes.extend(properties);
    bytes.extend(rest);
    bytes
}

/// Bytes that a file is thought to take on a card.
const FILE_BYTES: u64 = 60_000_000;

/// PTP StorageInfo of the slot, whose card has room for `left` of `room` files; without a card, of the empty slot.
pub(super) fn storage_info(card: Option<(u32, u32)>) -> Vec<u8> {
    let mut d = Dataset::default();
    match card {
        Some((room, left)) => {
            d.u16(4).u16(3).u16(0);
            d.u64(u64::from(room) * FILE_BYTES).u64(u64::from(left) * FILE_BYTES).u32(left);
            d.string("SD").string("EOS_DIGITAL");
        }
        None => {
            d.u16(4).u16(2).u16(0).u64(0).u64(0).u32(0).string("no card").string("");
        }
    }
    d.0
}

/// An object on the card.
#[derive(Debug)]
pub(super) struct Entry {
    /// Handle.
    pub(super) handle: u32,
    /// PTP object format.
    pub(super) format: u32,
    /// Bytes.
    pub(super) size: u32,
    /// Handle of the folder that it lies in; 0 for the root.
    pub(super) parent: u32,
    /// File name.
    pub(super) name: String,
}

/// When all files were made: the studio has no clock.
const DATE: &str = "20260101T120000";
/// The same in seconds since 1970.
const DATE_SECONDS: u32 = 1_767_268_800;

/// PTP ObjectInfo.
pub(super) fn object_info(entry: &Entry) -> Vec<u8> {
    let folder = u16::from(entry.format == 0x3001);
    let mut d = Dataset::default();
    d.u32(STORAGE).u16(entry.format as u16).u16(0).u32(entry.size);
    // No thumbnail, and its and the picture's sizes unknown.
    d.u16(0).u32(0).u32(0).u32(0).u32(0).u32(0).u32(0);
    d.u32(entry.parent).u16(folder).u32(0).u32(0);
    d.string(&entry.name).string(DATE).string(DATE).string("");
    d.0
}

/// Canon's list of objects: count, and an entry of 56 bytes each.
pub(super) fn object_list(entries: &[Entry]) -> Vec<u8> {
    let mut bytes = u32s(&[entries.len() as u32]);
    for entry in entries {
        let flags = if entry.format == 0x3001 { 0x10 } else { 0x20 };
        bytes.extend(u32s(&[56, entry.handle, STORAGE, entry.format, 0, flags, entry.size, entry.parent, 0]));
        let mut name = [0; 16];
        // The last byte stays the closing zero.
        name.iter_mut().take(15).zip(entry.name.bytes()).for_each(|(to, from)| *to = from);
        bytes.extend(name);
        bytes.extend(u32s(&[DATE_SECONDS]));
    }
    bytes
}

/// One GetEvent record.
fn record(kind: u32, payload: &[u8]) -> Vec<u8> {
    let mut bytes = u32s(&[8 + payload.len() as u32, kind]);
    bytes.extend(payload);
    bytes
}

/// The record that ends a GetEvent answer.
pub(super) fn terminator() -> Vec<u8> {
    record(0, &[])
}

/// PropValueChanged.
pub(super) fn value_changed(property: u32, value: &[u8]) -> Vec<u8> {
    let mut payload = u32s(&[property]);
    payload.extend(value);
    record(0xc189, &payload)
}

/// AvailList: the values that a property may be set to. `values` holds `count` of them, encoded.
pub(super) fn available(property: u32, count: usize, values: &[u8]) -> Vec<u8> {
    let mut payload = u32s(&[property, 3, count as u32]);
    payload.extend(values);
    record(0xc18a, &payload)
}

/// CameraStatus.
pub(super) fn status(busy: bool) -> Vec<u8> {
    record(0xc18b, &u32s(&[u32::from(busy)]))
}

/// A name with its closing zero, on a boundary of four bytes.
fn padded(name: &str) -> Vec<u8> {
    let mut bytes = name.as_bytes().to_vec();
    bytes.resize((bytes.len() + 1).next_multiple_of(4), 0);
    bytes
}

/// RequestObjectTransfer: a file waits in the body's memory for the computer.
pub(super) fn transfer_requested(object: u32, format: u32, size: u32, name: &str) -> Vec<u8> {
    let mut payload = u32s(&[object, format, 0, size, 0]);
    payload.extend(padded(name));
    record(0xc186, &payload)
}

/// ObjectAddedEx: a file lies on the card.
pub(super) fn object_added(object: u32, format: u32, size: u32, parent: u32, name: &str) -> Vec<u8> {
    let mut payload = u32s(&[object, STORAGE, format, 0, 0x20, size, parent, 0]);
    payload.extend(padded(name));
    record(0xc181, &payload)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn fields_of_a_transfer_request_stand_where_the_library_looks() {
        let record = transfer_requested(0x5001, 0xb103, 300_000, "IMG_0001.CR2");
        let word = |at: usize| u32::from_le_bytes(record[at..at + 4].try_into().unwrap());
        assert_eq!(word(0) as usize, record.len());
        assert_eq!((word(4), word(8), word(0xc), word(0x14)), (0xc186, 0x5001, 0xb103, 300_000));
        assert_eq!(&record[0x1c..0x29], b"IMG_0001.CR2\0");
    }

    #[test]
    fn fields_of_a_file_on_the_card_stand_where_the_library_looks() {
        let record = object_added(0x5001, 0xb103, 300_000, 0x77, "IMG_0001.CR2");
        let word = |at: usize| u32::from_le_bytes(record[at..at + 4].try_into().unwrap());
        assert_eq!((word(4), word(8), word(0xc), word(0x10)), (0xc181, 0x5001, STORAGE, 0xb103));
        assert_eq!((word(0x1c), word(0x20)), (300_000, 0x77));
        assert_eq!(&record[0x28..0x35], b"IMG_0001.CR2\0");
        let entry = Entry { handle: 1, format: 0x3001, size: 0, parent: 0, name: "DCIM".into() };
        assert_eq!(object_list(&[entry]).len(), 4 + 56);
    }

    #[test]
    fn fields_of_a_value_list_stand_where_the_library_looks() {
        let record = available(0xd103, 2, &u32s(&[0x48, 0x50]));
        let word = |at: usize| u32::from_le_bytes(record[at..at + 4].try_into().unwrap());
        assert_eq!([word(0), word(4), word(8), word(0xc), word(0x10)], [0x1c, 0xc18a, 0xd103, 3, 2]);
        assert_eq!([word(0x14), word(0x18)], [0x48, 0x50]);
        assert_eq!(terminator(), [8, 0, 0, 0, 0, 0, 0, 0]);
    }

    #[test]
    fn ptp_strings_count_their_closing_zero() {
        let mut d = Dataset::default();
        d.string("ab").string("");
        assert_eq!(d.0, [3, b'a', 0, b'b', 0, 0, 0, 0]);
    }
}
