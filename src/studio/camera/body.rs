//! The state of the simulated body: properties, files that it holds, events not yet fetched.

use super::datasets;
use super::fault::{Fault, Late};
use super::objects::{File, Kind, Objects};
use super::options::{BodyOptions, Files, Focus, Mode};
use super::properties::{Properties, SetError, TARGET_CARD, TARGET_COMPUTER, prop};
use crate::pair::Exposure;
use std::sync::Arc;
use std::time::{Duration, Instant};

/// Battery power that shows as "Low".
const BATTERY_LOW: u32 = 0;
/// Bit of [`prop::EVF_OUTPUT`] that sends the viewfinder to the computer.
const EVF_TO_COMPUTER: u32 = 2;

/// When a late frame is due.
enum Due {
    /// The client that is awaited, counted from the first.
    Client(u64),
    /// The next release; whether it was pressed.
    Release(bool),
    /// This moment.
    At(Instant),
}

/// A frame that is not announced yet.
struct LateFrame {
    files: Vec<File>,
    due: Due,
}

/// The body.
pub(super) struct Body {
    properties: Properties,
    jpeg_first: bool,
    /// Files that the card takes; none without a card.
    card_room: Option<u32>,
    objects: Objects,
    late: Vec<LateFrame>,
    /// The files of the frame before.
    last: Vec<(Kind, Arc<[u8]>)>,
    events: Vec<u8>,
    /// Frames exposed since the start.
    frames: u32,
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
    pub(super) fn new(options: &BodyOptions) -> Self {
        Self {
            properties: Properties::new(options),
            jpeg_first: options.jpeg_first,
            card_room: options.card_room,
            objects: Objects::default(),
            late: Vec::new(),
            last: Vec::new(),
            events: Vec::new(),
            frames: 0,
            clients: 0,
            exposing: false,
            busy_until: None,
            full: false,
            low: false,
        }
    }

    /// Codes of all properties.
    pub(super) fn properties(&self) -> Vec<u32> {
        self.properties.codes()
    }

    /// The files that it holds.
    pub(super) fn objects(&mut self) -> &mut Objects {
        &mut self.objects
    }

    /// Files that the card takes, and how many of them still fit; nothing without a card.
    pub(super) fn card(&self) -> Option<(u32, u32)> {
        self.card_room.map(|room| (room, room.saturating_sub(self.objects.on_card() as u32)))
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
    /// where frames went. Frames that are still to be announced stay, and so does what is on the card.
    pub(super) fn new_client(&mut self) {
        self.clients += 1;
        self.objects.clear_memory();
        self.exposing = false;
        self.busy_until = None;
        self.properties.write(prop::TARGET, TARGET_CARD);
        self.properties.write(prop::EVF_OUTPUT, 0);
        self.events.clear();
    }

    /// Queues every property with its list, as a client that turns events on must be told.
    pub(super) fn announce_all(&mut self) {
        self.events.clear();
        for property in self.properties() {
            self.announce(property);
        }
        self.events.extend(datasets::status(self.exposing || self.busy_until.is_some()));
    }

    /// Queues one property's value and list.
    pub(super) fn announce(&mut self, property: u32) {
        let instead = match property {
            prop::SHOTS_LEFT if self.full => Some(0),
            prop::SHOTS_LEFT if !self.to_computer() => Some(self.card().map_or(0, |(_, left)| left)),
            prop::BATTERY if self.low => Some(BATTERY_LOW),
            prop::SHUTTER_COUNT => Some(self.frames),
            _ => None,
        };
        self.events.extend(self.properties.records(property, instead));
    }

    /// Sets a property from the client; what changed is announced.
    pub(super) fn set(&mut self, property: u32, value: &[u8]) -> Result<(), SetError> {
        let changed = self.properties.set(property, value)?;
        changed.into_iter().for_each(|property| self.announce(property));
        Ok(())
    }

    /// The photographer turns the mode dial.
    pub(super) fn turn_mode_dial(&mut self, mode: Mode) {
        self.properties.turn_mode_dial(mode).into_iter().for_each(|property| self.announce(property));
    }

    /// The photographer moves the switch on the lens.
    pub(super) fn switch_focus(&mut self, focus: Focus) {
        self.properties.switch_focus(focus);
        self.announce(prop::FOCUS);
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
            self.announce_files(late.files, false);
            if matches!(late.due, Due::At(_)) {
                self.finish_exposure();
            }
        }
    }

    /// Whether the viewfinder goes to the computer.
    pub(super) fn live(&self) -> bool {
        self.properties.number(prop::EVF_OUTPUT).is_some_and(|out| out & EVF_TO_COMPUTER != 0)
    }

    /// Whether frames go to the computer.
    pub(super) fn to_computer(&self) -> bool {
        self.properties.number(prop::TARGET) == Some(TARGET_COMPUTER)
    }

    /// What the next frame is exposed with.
    pub(super) fn exposure(&self) -> Option<Exposure> {
        self.properties.exposure()
    }

    /// How long after the release the shutter opens.
    pub(super) fn delay(&self) -> Duration {
        self.properties.delay()
    }

    /// The files that a frame becomes, in the order in which they are announced.
    pub(super) fn kinds(&self) -> Vec<Kind> {
        match self.properties.files() {
            Files::Raw => vec![Kind::Raw],
            Files::Jpeg => vec![Kind::Jpeg],
            Files::RawAndJpeg if self.jpeg_first => vec![Kind::Jpeg, Kind::Raw],
            Files::RawAndJpeg => vec![Kind::Raw, Kind::Jpeg],
        }
    }

    /// Whether a release would be refused now.
    pub(super) fn busy(&self) -> bool {
        self.exposing || self.busy_until.is_some_and(|until| until > Instant::now())
    }

    /// Whether a frame was exposed before.
    pub(super) fn has_last_frame(&self) -> bool {
        !self.last.is_empty()
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

    /// The frame is read out: its files wait for the computer or lie on the card, as `fault` lets them. The body says
    /// that it is done only after it has offered them, else the library would take "done" for the frame before.
    pub(super) fn end_exposure(&mut self, files: Vec<(Kind, Arc<[u8]>)>, fault: Option<Fault>) {
        self.frames += 1;
        let shown = match fault {
            Some(Fault::RepeatedFrame) => self.last.clone(),
            _ => files.clone(),
        };
        self.last = files;
        let (number, on_card) = (self.frames, !self.to_computer());
        // One file is enough to spoil a frame.
        let mut spoilt = fault;
        let mut file = |(kind, bytes)| File::new(number, kind, bytes, on_card, spoilt.take());
        let files: Vec<File> = shown.into_iter().map(&mut file).collect();
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
                self.late.push(LateFrame { files, due });
                return;
            }
            _ => {}
        }
        self.announce_files(files, fault == Some(Fault::DoubledObject));
        match fault {
            Some(Fault::SlowReady(time)) => {
                self.exposing = false;
                self.busy_until = Some(Instant::now() + time);
            }
            _ => self.finish_exposure(),
        }
    }

    fn announce_files(&mut self, files: Vec<File>, twice: bool) {
        for file in files {
            let (_, record) = self.objects.insert(file);
            self.events.extend(record.repeat(if twice { 2 } else { 1 }));
        }
        self.announce(prop::SHOTS_LEFT);
    }

    /// The body is idle again.
    pub(super) fn finish_exposure(&mut self) {
        self.exposing = false;
        self.busy_until = None;
        self.events.extend(datasets::status(false));
    }

    /// Files in memory, announced or not.
    pub(super) fn waiting(&self) -> usize {
        self.objects.in_memory() + self.late.iter().map(|late| late.files.len()).sum::<usize>()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn body() -> Body {
        let mut body = Body::new(&BodyOptions::default());
        body.new_client();
        body.set(prop::TARGET, &TARGET_COMPUTER.to_le_bytes()).unwrap();
        body.take_events();
        body
    }

    fn raw(bytes: &[u8]) -> Vec<(Kind, Arc<[u8]>)> {
        vec![(Kind::Raw, bytes.into())]
    }

    #[test]
    fn a_frame_is_offered_before_the_body_says_done() {
        let mut body = body();
        body.begin_exposure();
        body.take_events();
        body.end_exposure(raw(&[7; 10]), None);
        let events = body.take_events();
        assert_eq!(events[4..8], 0xc186_u32.to_le_bytes());
        assert_eq!(body.objects().part(1, 0, 99), Some(Some(vec![7; 10])));
        assert!(body.objects().remove(1) && !body.busy());
    }

    #[test]
    fn a_late_frame_waits_for_the_next_client() {
        let mut body = body();
        body.begin_exposure();
        body.end_exposure(raw(&[1]), Some(Fault::LateObject(Late::NextClient)));
        body.take_events();
        assert!(body.busy());
        assert_eq!((body.waiting(), body.objects().part(1, 0, 1)), (1, None));
        body.new_client();
        assert!(!body.busy());
        body.take_events();
        assert_eq!(body.objects().part(1, 0, 1), Some(Some(vec![1])));
    }

    #[test]
    fn the_battery_tells_when_it_is_low_and_when_it_is_not() {
        let mut body = body();
        body.show(false, true);
        let low = datasets::value_changed(prop::BATTERY, &BATTERY_LOW.to_le_bytes());
        assert!(body.take_events().starts_with(&low));
        body.show(false, true);
        assert_eq!(body.take_events(), datasets::terminator());
    }
}
