//! A camera and a flash without wires, for tests of what drives them. The camera's files are real DNGs; the
//! flash lights a frame if and only if it was armed.

use crate::wall::{photo, settings};
use std::sync::{Arc, Mutex};
use std::time::Duration;
use unlit::capture::{FlashKind, RigSource};
use unlit::pair::{Dial, Exposure, FlashSync, Offered, Settings, SyncSource};
use unlit::rig::{
    Camera, CameraError, CameraInfo, Closer, Flash, FlashError, FlashStatus, LockItem, LockReport, LockState,
    Shot, ShotFile, ShotTimes,
};
use unlit::units::{FNumber, Iso, Seconds};

/// What is wrong in the room.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) enum Trouble {
    /// Nothing.
    #[default]
    None,
    /// The flash is triggered and stays dark.
    Misfire,
    /// The sync contact never closes.
    NoContact,
    /// The flash fires although the gate is closed.
    FiresInTheDark,
    /// Far too much light.
    Overexposed,
    /// The camera delivers its n-th file, counted from 0, cut off.
    CutsFile(u32),
    /// The camera refuses its n-th release, counted from 0.
    Refuses(u32),
    /// The camera falls silent at its n-th release, counted from 0, and is well again once brought back.
    HangsAt(u32),
    /// The camera's driver panics at its n-th release, counted from 0.
    PanicsAt(u32),
    /// The camera does not come back from its n-th release, counted from 0, until the trouble is over.
    HoldsAt(u32),
    /// The camera takes every setting and changes none.
    Disobeys,
    /// Autofocus is on, and only the photographer can switch it off.
    Autofocus,
    /// No camera is plugged in.
    NoCamera,
}

#[derive(Default)]
struct Inside {
    trouble: Trouble,
    armed: Option<u32>,
    syncs: Vec<FlashSync>,
    releases: u32,
    dials: Option<Exposure>,
    log: Vec<&'static str>,
}

/// Where the dials stand at first.
pub(crate) const DIALS: Exposure =
    Exposure { shutter: Seconds(1.0 / 125.0), aperture: FNumber(11.0), iso: Iso(100.0) };

impl Inside {
    fn dials(&self) -> Exposure {
        self.dials.unwrap_or(DIALS)
    }
}

/// The room that camera and flash share; clones are the same room.
#[derive(Clone, Default)]
pub(crate) struct Room(Arc<Mutex<Inside>>);

impl Room {
    pub(crate) fn with(trouble: Trouble) -> Self {
        let room = Self::default();
        room.set(trouble);
        room
    }

    pub(crate) fn set(&self, trouble: Trouble) {
        let mut inside = self.0.lock().unwrap();
        inside.trouble = trouble;
        inside.releases = 0;
    }

    /// All is well again; releases are counted on, so that no frame comes twice.
    pub(crate) fn heal(&self) {
        self.0.lock().unwrap().trouble = Trouble::None;
    }

    /// Somebody turns the camera's dials.
    pub(crate) fn turn(&self, dials: Exposure) {
        self.0.lock().unwrap().dials = Some(dials);
    }

    /// What camera and flash were asked to do, in order.
    pub(crate) fn log(&self) -> Vec<&'static str> {
        self.0.lock().unwrap().log.clone()
    }

    pub(crate) fn is_armed(&self) -> bool {
        self.0.lock().unwrap().armed.is_some()
    }

    fn camera(&self) -> Result<Box<dyn Camera>, CameraError> {
        if self.0.lock().unwrap().trouble == Trouble::NoCamera {
            return Err(CameraError::NotFound { hint: " on any port".into() });
        }
        Ok(Box::new(FakeCamera(self.clone())))
    }

    /// Both devices, the flash behind its controller.
    pub(crate) fn rig(&self) -> RigSource {
        let (camera, flash) = (self.clone(), self.clone());
        RigSource {
            camera: Box::new(move |_| camera.camera()),
            cameras: Box::new(|| Ok(vec![])),
            flash: Box::new(move || Ok(FlashKind::Controller(Box::new(FakeFlash(flash.clone()))))),
        }
    }

    /// The camera, and a flash of the given other kind.
    pub(crate) fn rig_with(&self, flash: fn() -> FlashKind) -> RigSource {
        let camera = self.clone();
        RigSource {
            camera: Box::new(move |_| camera.camera()),
            cameras: Box::new(|| Ok(vec![])),
            flash: Box::new(move || Ok(flash())),
        }
    }

    /// For a flash that is switched by hand: whether it is on.
    pub(crate) fn switch_flash(&self, on: bool) {
        self.0.lock().unwrap().armed = on.then_some(0);
    }
}

struct FakeCamera(Room);

impl Camera for FakeCamera {
    fn info(&mut self) -> Result<CameraInfo, CameraError> {
        Ok(CameraInfo { model: "Fake 1".into(), port: "nowhere".into(), serial: None })
    }

    fn settings(&mut self) -> Result<Settings, CameraError> {
        Ok(settings(self.0.0.lock().unwrap().dials()))
    }

    fn offered(&mut self) -> Result<Offered, CameraError> {
        Ok(Offered {
            shutters: [30.0, 60.0, 125.0, 160.0, 200.0].map(|v| Seconds(1.0 / v)).into(),
            apertures: [4.0, 5.6, 6.3, 7.1, 8.0, 9.0, 10.0, 11.0, 13.0, 14.0, 16.0, 22.0].map(FNumber).into(),
            isos: [100.0, 125.0, 160.0, 200.0, 400.0].map(Iso).into(),
        })
    }

    fn set(&mut self, dial: Dial) -> Result<(), CameraError> {
        let mut room = self.0.0.lock().unwrap();
        if room.trouble != Trouble::Disobeys {
            let mut dials = room.dials();
            match dial {
                Dial::Shutter(value) => dials.shutter = value,
                Dial::Aperture(value) => dials.aperture = value,
                Dial::Iso(value) => dials.iso = value,
            }
            room.dials = Some(dials);
        }
        Ok(())
    }

    fn lock(&mut self) -> Result<LockReport, CameraError> {
        let focus = match self.0.0.lock().unwrap().trouble {
            Trouble::Autofocus => (LockState::Wrong, "Focus is automatic; switch the lens to MF."),
            _ => (LockState::Locked, "Focus is manual."),
        };
        let item = |name: &str, (state, sentence): (LockState, &str)| LockItem {
            name: name.into(),
            state,
            value: String::new(),
            sentence: sentence.into(),
        };
        let mirror = (LockState::Unreadable, "Check in the menu that mirror lock-up is off.");
        Ok(LockReport { items: vec![item("focus", focus), item("mirror_lock_up", mirror)], x_sync: None })
    }

    fn end_preview(&mut self) -> Result<(), CameraError> {
        self.0.0.lock().unwrap().log.push("end preview");
        Ok(())
    }

    fn recover(&mut self) -> Result<Vec<String>, CameraError> {
        let mut room = self.0.0.lock().unwrap();
        room.log.push("recover");
        if matches!(room.trouble, Trouble::HangsAt(_)) {
            room.trouble = Trouble::None;
        }
        Ok(vec!["opened anew".into()])
    }

    fn preview(&mut self) -> Result<Vec<u8>, CameraError> {
        Ok(vec![0xff, 0xd8, 0xff, 0xd9])
    }

    fn shoot(&mut self) -> Result<Shot, CameraError> {
        let mut room = self.0.0.lock().unwrap();
        room.log.push("shoot");
        let release = room.releases;
        room.releases += 1;
        if room.trouble == Trouble::Refuses(release) {
            return Err(CameraError::Refused { operation: "release".into(), reason: "mirror up".into() });
        }
        if room.trouble == Trouble::HangsAt(release) {
            let deadline = Duration::from_secs(10);
            return Err(CameraError::Deadline { operation: "take a picture".into(), deadline });
        }
        if room.trouble == Trouble::PanicsAt(release) {
            drop(room);
            panic!("the driver stumbled");
        }
        while room.trouble == Trouble::HoldsAt(release) {
            drop(room);
            std::thread::yield_now();
            room = self.0.0.lock().unwrap();
        }
        let tag = room.armed.take();
        let triggered = tag.is_some() && room.trouble != Trouble::NoContact;
        let fires_anyway = room.trouble == Trouble::FiresInTheDark && tag.is_none();
        let lit = (triggered && room.trouble != Trouble::Misfire) || fires_anyway;
        if room.trouble != Trouble::NoContact {
            room.syncs.push(FlashSync {
                number: release,
                source: SyncSource::Contact,
                triggered: triggered || fires_anyway,
                tag: tag.unwrap_or(0),
                at: None,
                energy_counts: if lit { 1000.0 } else { 1.0 },
                peak_counts: if lit { 600.0 } else { 0.0 },
                dark_counts: 12.0,
                lit_samples: if lit { 100 } else { 0 },
                clipped_samples: 0,
                bounces: 0,
            });
        }
        let gain = if room.trouble == Trouble::Overexposed { 8.0 } else { 1.0 };
        let mut bytes = photo(if lit { gain } else { 0.0 }, release, room.dials());
        if room.trouble == Trouble::CutsFile(release) {
            bytes.truncate(bytes.len() / 2);
        }
        let raw = ShotFile { name: "capt0000.dng".into(), bytes };
        Ok(Shot { raw, jpeg: None, times: ShotTimes::default() })
    }
}

struct FakeFlash(Room);

impl Flash for FakeFlash {
    fn status(&mut self) -> FlashStatus {
        FlashStatus { description: "Fake flash".into(), ready: true, words: "ready".into() }
    }

    fn arm(&mut self, tag: u32, _time_to_live: Duration) -> Result<(), FlashError> {
        let mut room = self.0.0.lock().unwrap();
        room.log.push("arm");
        room.armed = Some(tag);
        Ok(())
    }

    fn disarm(&mut self) -> Result<(), FlashError> {
        let mut room = self.0.0.lock().unwrap();
        room.log.push("disarm");
        room.armed = None;
        Ok(())
    }

    fn closer(&self) -> Option<Closer> {
        let room = self.0.clone();
        Some(Arc::new(move || FakeFlash(room.clone()).disarm()))
    }

    fn syncs(&mut self, _patience: Duration) -> Result<Vec<FlashSync>, FlashError> {
        Ok(std::mem::take(&mut self.0.0.lock().unwrap().syncs))
    }
}
