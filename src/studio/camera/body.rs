//! The state of the simulated body: properties, frames that wait in its memory, events not yet fetched.
//!
//! The body stands in M with manual focus, single drive and RAW alone, as the rig needs it; shutter, aperture
//! and sensitivity can be set. Frames go to the computer (there is no card).

use super::datasets::{self, u32s};
use super::dials;
use super::fault::{Fault, Late};
use crate::pair::Exposure;
use std::collections::BTreeMap;
use std::sync::Arc;
use std::time::Instant;

/// Property codes (Canon's, as in libgphoto2's ptp.h).
pub(super) mod prop {
    pub(crate) const APERTURE: u32 = 0xd101;
    pub(crate) const SHUTTER: u32 = 0xd102;
    pub(crate) const ISO: u32 = 0xd103;
    pub(crate) const MODE: u32 = 0xd105;
    pub(crate) const DRIVE: u32 = 0xd106;
    pub(crate) const FOCUS: u32 = 0xd108;
    pub(crate) const WHITE_BALANCE: u32 = 0xd109;
    pub(crate) const BATTERY: u32 = 0xd111;
    pub(crate) const POWER_OFF: u32 = 0xd114;
    pub(crate) const SHOTS_LEFT: u32 = 0xd11b;
    pub(crate) const TARGET: u32 = 0xd11c;
    pub(crate) const FORMAT: u32 = 0xd120;
    pub(crate) const FORMAT_CF: u32 = 0xd121;
    pub(crate) const FORMAT_SD: u32 = 0xd122;
    pub(crate) const MODE_DIAL: u32 = 0xd138;
    pub(crate) const NOISE_REDUCTION: u32 = 0xd178;
    pub(crate) const SERIAL: u32 = 0xd1af;
    pub(crate) const EVF_OUTPUT: u32 = 0xd1b0;
    pub(crate) const EVF_MODE: u32 = 0xd1b1;
    pub(crate) const LIGHTING_OPTIMIZER: u32 = 0xd1c1;
}

/// Frames that the body's memory takes.
const SHOTS_LEFT: u32 = 99;
/// Battery power that shows as "Low".
const BATTERY_LOW: u32 = 0;
/// `EVF_OUTPUT` bit that sends the viewfinder to the computer.
const EVF_TO_COMPUTER: u32 = 2;

/// Frames go to the card, where a body without a computer puts them.
const TARGET_CARD: u32 = 1;
/// Frames wait in memory for the computer.
const TARGET_COMPUTER: u32 = 4;

/// A property's value.
#[derive(Clone)]
enum Value {
    /// A number and the values it may take; an empty list: only the one it has.
    Number(u32, Vec<u32>),
    /// Text that only the body writes.
    Text(&'static str),
    /// ImageFormat's own encoding of RAW alone.
    RawOnly,
}

/// ImageFormat for RAW alone: one image of (16, type RAW, size L, compression RAW).
const RAW_ONLY: [u32; 5] = [1, 0x10, 6, 0, 4];

/// A file in the body's memory.
struct File {
    bytes: Arc<[u8]>,
    /// Size that it is announced with.
    announced: usize,
    /// The next download of its end lacks so many bytes.
    cut: usize,
}

impl File {
    fn new(bytes: Arc<[u8]>, fault: Option<Fault>) -> Self {
        let (length, mut file) = (bytes.len(), Self { announced: bytes.len(), bytes, cut: 0 });
        let without = |missing: u32| length.saturating_sub(missing as usize);
        match fault {
            Some(Fault::CutObject { missing }) => file.bytes = file.bytes[..without(missing)].into(),
            Some(Fault::ShortFile { missing }) => {
                file.bytes = file.bytes[..without(missing)].into();
                file.announced = file.bytes.len();
            }
            Some(Fault::CutDownload { missing }) => file.cut = (missing as usize).min(length),
            _ => {}
        }
        file
    }
}

/// When a late frame is due.
enum Due {
    /// The client that is awaited, counted from the first.
    Client(u64),
    /// The next release; whether it was pressed.
    Release(bool),
    At(Instant),
}

/// A frame that is not announced yet.
struct LateFrame {
    file: File,
    due: Due,
}

/// Why a property was not set.
#[derive(Debug, PartialEq)]
pub(super) enum SetError {
    /// There is no such property, or only the body writes it.
    Unknown,
    /// The value is not on its list.
    Value,
}

/// The body.
pub(super) struct Body {
    properties: BTreeMap<u32, Value>,
    files: BTreeMap<u32, File>,
    late: Vec<LateFrame>,
    /// The bytes of the frame before.
    last: Option<Arc<[u8]>>,
    events: Vec<u8>,
    next_object: u32,
    /// Clients that have connected since the start.
    clients: u64,
    /// A frame is being exposed, or its shot was never ended.
    exposing: bool,
    /// Busy until then, after the frame was announced.
    busy_until: Option<Instant>,
    /// The body says that it has no room for frames.
    full: bool,
    /// The body says that its battery is low.
    low: bool,
}

impl Body {
    /// 1/125 s, f/11, ISO 100.
    pub(super) fn new() -> Self {
        let dial = |code, positions: &[dials::Position]| {
            Value::Number(code, positions.iter().map(|(code, _)| *code).collect())
        };
        let fixed = |code| Value::Number(code, vec![code]);
        let properties = BTreeMap::from([
            (prop::APERTURE, dial(0x40, dials::APERTURE)),
            (prop::SHUTTER, dial(0x70, dials::SHUTTER)),
            (prop::ISO, dial(0x48, dials::ISO)),
            (prop::MODE, fixed(3)),
            (prop::MODE_DIAL, fixed(3)),
            (prop::DRIVE, fixed(0)),
            (prop::FOCUS, fixed(3)),
            (prop::WHITE_BALANCE, Value::Number(1, vec![1, 3, 5])),
            (prop::BATTERY, fixed(2)),
            (prop::POWER_OFF, Value::Number(0, vec![0, 60])),
            (prop::SHOTS_LEFT, fixed(SHOTS_LEFT)),
            (prop::TARGET, Value::Number(TARGET_CARD, vec![TARGET_CARD, TARGET_COMPUTER])),
            (prop::FORMAT, Value::RawOnly),
            (prop::FORMAT_CF, Value::RawOnly),
            (prop::FORMAT_SD, Value::RawOnly),
            (prop::NOISE_REDUCTION, fixed(0)),
            (prop::SERIAL, Value::Text(datasets::SERIAL)),
            (prop::EVF_OUTPUT, Value::Number(0, vec![0, 1, 2, 3])),
            (prop::EVF_MODE, Value::Number(1, vec![0, 1])),
            (prop::LIGHTING_OPTIMIZER, fixed(3)),
        ]);
        Self {
            properties,
            files: BTreeMap::new(),
            late: Vec::new(),
            last: None,
            events: Vec::new(),
            next_object: 1,
            clients: 0,
            exposing: false,
            busy_until: None,
            full: false,
            low: false,
        }
    }

    /// Codes of all properties.
    pub(super) fn properties(&self) -> Vec<u32> {
        self.properties.keys().copied().collect()
    }

    fn number(&self, property: u32) -> u32 {
        match self.properties.get(&property) {
            Some(Value::Number(..)) if property == prop::SHOTS_LEFT && self.full => 0,
            Some(Value::Number(..)) if property == prop::BATTERY && self.low => BATTERY_LOW,
            Some(Value::Number(value, _)) => *value,
            _ => 0,
        }
    }

    /// What the body shows of its faults.
    pub(super) fn show(&mut self, full: bool, low: bool) {
        let changed = self.low != low;
        (self.full, self.low) = (full, low);
        if changed {
            self.announce(prop::BATTERY);
        }
    }

    /// A new client: the former one is forgotten, with frames nobody fetched, events nobody read, live view, and
    /// where frames went. Frames that are still to be announced stay.
    pub(super) fn new_client(&mut self) {
        self.clients += 1;
        self.files.clear();
        self.exposing = false;
        self.busy_until = None;
        for (property, value) in [(prop::TARGET, TARGET_CARD), (prop::EVF_OUTPUT, 0)] {
            if let Some(Value::Number(now, _)) = self.properties.get_mut(&property) {
                *now = value;
            }
        }
        self.events.clear();
    }

    /// Queues every property with its list, as a client that turns events on must be told.
    pub(super) fn announce_all(&mut self) {
        self.events.clear();
        for property in self.properties() {
            self.announce(property);
            let list = match self.properties.get(&property) {
                Some(Value::Number(_, list)) => datasets::available(property, list.len(), &u32s(list)),
                Some(Value::RawOnly) => datasets::available(property, 1, &u32s(&RAW_ONLY)),
                Some(Value::Text(_)) | None => continue,
            };
            self.events.extend(list);
        }
        self.events.extend(datasets::status(self.exposing || self.busy_until.is_some()));
    }

    /// Queues one property's value; an unknown one is passed over, as the real body does.
    pub(super) fn announce(&mut self, property: u32) {
        let record = match self.properties.get(&property) {
            Some(Value::Number(..)) => datasets::value_changed(property, &u32s(&[self.number(property)])),
            Some(Value::RawOnly) => datasets::value_changed(property, &u32s(&RAW_ONLY)),
            Some(Value::Text(text)) => {
                let mut bytes = text.as_bytes().to_vec();
                bytes.resize((bytes.len() + 1).next_multiple_of(4), 0);
                datasets::value_changed(property, &bytes)
            }
            None => return,
        };
        self.events.extend(record);
    }

    /// Sets a property from the client; the change is announced.
    pub(super) fn set(&mut self, property: u32, value: u32) -> Result<(), SetError> {
        let Some(Value::Number(now, list)) = self.properties.get_mut(&property) else {
            return Err(SetError::Unknown);
        };
        if !list.contains(&value) {
            return Err(SetError::Value);
        }
        *now = value;
        self.announce(property);
        Ok(())
    }

    /// The events since the last call, ended as the library needs it.
    pub(super) fn take_events(&mut self) -> Vec<u8> {
        self.announce_what_is_due();
        if self.busy_until.is_some_and(|until| until <= Instant::now()) {
            self.finish_exposure();
        }
        let mut events = std::mem::take(&mut self.events);
        events.extend(datasets::terminator());
        events
    }

    /// Late frames whose time has come.
    fn announce_what_is_due(&mut self) {
        let (now, clients) = (Instant::now(), self.clients);
        let due = |late: &mut LateFrame| match late.due {
            Due::Client(number) => number <= clients,
            Due::Release(pressed) => pressed,
            Due::At(time) => time <= now,
        };
        for late in self.late.extract_if(.., due).collect::<Vec<_>>() {
            self.announce_file(late.file, false);
            if matches!(late.due, Due::At(_)) {
                self.finish_exposure();
            }
        }
    }

    /// Whether the viewfinder goes to the computer.
    pub(super) fn live(&self) -> bool {
        self.number(prop::EVF_OUTPUT) & EVF_TO_COMPUTER != 0
    }

    /// Whether frames go to the computer.
    pub(super) fn to_computer(&self) -> bool {
        self.number(prop::TARGET) == TARGET_COMPUTER
    }

    /// What the three dials show.
    pub(super) fn exposure(&self) -> Option<Exposure> {
        Some(Exposure {
            shutter: dials::shutter(self.number(prop::SHUTTER))?,
            aperture: dials::aperture(self.number(prop::APERTURE))?,
            iso: dials::iso(self.number(prop::ISO))?,
        })
    }

    /// Whether a release would be refused now.
    pub(super) fn busy(&mut self) -> bool {
        self.exposing || self.busy_until.is_some_and(|until| until > Instant::now())
    }

    /// Whether a frame was exposed before.
    pub(super) fn has_last_frame(&self) -> bool {
        self.last.is_some()
    }

    /// The shutter opens.
    pub(super) fn begin_exposure(&mut self) {
        self.busy_until = None;
        self.exposing = true;
        self.events.extend(datasets::status(true));
        for late in &mut self.late {
            if let Due::Release(pressed) = &mut late.due {
                *pressed = true;
            }
        }
        self.announce_what_is_due();
    }

    /// The frame is read out: it waits for the computer, as `fault` lets it. The body says that it is done only
    /// after it has offered the frame, else the library would take "done" for the frame before.
    pub(super) fn end_exposure(&mut self, bytes: Vec<u8>, fault: Option<Fault>) {
        let bytes: Arc<[u8]> = bytes.into();
        let shown = match (fault, &self.last) {
            (Some(Fault::RepeatedFrame), Some(last)) => Arc::clone(last),
            _ => Arc::clone(&bytes),
        };
        self.last = Some(bytes);
        let file = File::new(shown, fault);
        match fault {
            // Nothing is said of it, so the body stays busy for this client.
            Some(Fault::NeverAnnounced) => return,
            Some(Fault::LateObject(late)) => {
                let due = match late {
                    Late::NextClient => Due::Client(self.clients + 1),
                    Late::NextRelease => Due::Release(false),
                    Late::After(time) => Due::At(Instant::now() + time),
                };
                // Busy until it is announced, unless it waits for the next release.
                self.exposing = !matches!(due, Due::Release(_));
                self.late.push(LateFrame { file, due });
                return;
            }
            _ => {}
        }
        self.announce_file(file, fault == Some(Fault::DoubledObject));
        match fault {
            Some(Fault::SlowReady(time)) => {
                self.exposing = false;
                self.busy_until = Some(Instant::now() + time);
            }
            _ => self.finish_exposure(),
        }
    }

    fn announce_file(&mut self, file: File, twice: bool) {
        let number = self.next_object;
        self.next_object += 1;
        let name = format!("IMG_{:04}.CR2", (number - 1) % 9999 + 1);
        let record = datasets::transfer_requested(number, file.announced as u32, &name);
        self.events.extend(record.repeat(if twice { 2 } else { 1 }));
        self.files.insert(number, file);
    }

    /// The body is idle again.
    pub(super) fn finish_exposure(&mut self) {
        self.exposing = false;
        self.busy_until = None;
        self.events.extend(datasets::status(false));
    }

    /// At most `length` bytes of a waiting file, from `from` on.
    pub(super) fn part(&mut self, object: u32, from: u32, length: u32) -> Option<Vec<u8>> {
        let file = self.files.get_mut(&object)?;
        let from = (from as usize).min(file.bytes.len());
        let mut to = from.saturating_add(length as usize).min(file.bytes.len());
        if to == file.bytes.len() {
            to = to.saturating_sub(std::mem::take(&mut file.cut)).max(from);
        }
        Some(file.bytes[from..to].to_vec())
    }

    /// The computer has the file; its memory is free again.
    pub(super) fn forget(&mut self, object: u32) -> bool {
        self.files.remove(&object).is_some()
    }

    /// Files in memory, announced or not.
    pub(super) fn waiting(&self) -> usize {
        self.files.len() + self.late.len()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::units::{FNumber, Iso, Seconds};

    #[test]
    fn a_new_body_stands_at_a_125th_f_11_iso_100() {
        let exposure = Body::new().exposure().unwrap();
        assert_eq!(
            exposure,
            Exposure { shutter: Seconds(1.0 / 125.0), aperture: FNumber(11.0), iso: Iso(100.0) }
        );
    }

    #[test]
    fn only_what_is_on_a_dial_can_be_set() {
        let mut body = Body::new();
        assert_eq!(body.set(prop::SHUTTER, 0x71), Err(SetError::Value));
        assert_eq!(body.set(prop::SERIAL, 1), Err(SetError::Unknown));
        assert_eq!(body.set(0xd1ff, 1), Err(SetError::Unknown));
        body.set(prop::SHUTTER, 0x68).unwrap();
        assert_eq!(body.exposure().unwrap().shutter, Seconds(1.0 / 60.0));
        assert_eq!(body.take_events()[..12], u32s(&[16, 0xc189, prop::SHUTTER])[..]);
    }

    #[test]
    fn a_frame_is_offered_before_the_body_says_done() {
        let mut body = Body::new();
        body.begin_exposure();
        body.take_events();
        body.end_exposure(vec![7; 10], None);
        let events = body.take_events();
        assert_eq!(events[4..8], 0xc186_u32.to_le_bytes());
        assert_eq!(body.part(1, 0, 99).unwrap(), [7; 10]);
        assert!(body.forget(1) && !body.forget(1));
    }

    #[test]
    fn a_cut_download_is_whole_the_second_time() {
        let mut body = Body::new();
        body.begin_exposure();
        body.end_exposure((0..10).collect(), Some(Fault::CutDownload { missing: 3 }));
        assert_eq!(body.part(1, 0, 5).unwrap(), [0, 1, 2, 3, 4]);
        assert_eq!(body.part(1, 5, 5).unwrap(), [5, 6]);
        assert_eq!(body.part(1, 5, 5).unwrap(), [5, 6, 7, 8, 9]);
    }

    #[test]
    fn a_late_frame_waits_for_the_next_client() {
        let mut body = Body::new();
        body.new_client();
        body.begin_exposure();
        body.end_exposure(vec![1], Some(Fault::LateObject(Late::NextClient)));
        assert!(body.busy());
        body.take_events();
        assert_eq!((body.waiting(), body.part(1, 0, 1)), (1, None));
        body.new_client();
        assert!(!body.busy());
        body.take_events();
        assert_eq!(body.part(1, 0, 1).unwrap(), [1]);
    }
}
