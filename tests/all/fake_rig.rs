//! A camera and a flash without wires, for tests of what drives them. The camera's files are real DNGs; the
//! flash lights a frame if and only if it was armed.

use std::sync::{Arc, Mutex};
use std::time::Duration;
use unlit::capture::{FlashKind, RigSource};
use unlit::codec::dng::{self, DngContent};
use unlit::pair::{Dial, Offered, Settings};
use unlit::photometry::{Cfa, LevelSource, Levels, Mosaic};
use unlit::raster::Image;
use unlit::rig::{
    Camera, CameraError, CameraInfo, Flash, FlashError, FlashShot, FlashStatus, LockReport, Shot, ShotFile,
    ShotTimes,
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
    /// No camera is plugged in.
    NoCamera,
}

#[derive(Default)]
struct Inside {
    trouble: Trouble,
    armed: Option<u32>,
    syncs: Vec<FlashShot>,
    releases: u32,
    log: Vec<&'static str>,
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
        Ok(settings())
    }

    fn offered(&mut self) -> Result<Offered, CameraError> {
        Ok(Offered {
            shutters: vec![Seconds(1.0 / 60.0), Seconds(1.0 / 125.0)],
            apertures: vec![FNumber(8.0), FNumber(11.0)],
            isos: vec![Iso(100.0), Iso(200.0)],
        })
    }

    fn set(&mut self, dial: Dial) -> Result<(), CameraError> {
        Err(CameraError::Refused { operation: format!("turn {dial:?}"), reason: "fake".into() })
    }

    fn lock(&mut self) -> Result<LockReport, CameraError> {
        Ok(LockReport::default())
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
        let tag = room.armed.take();
        let triggered = tag.is_some() && room.trouble != Trouble::NoContact;
        let fires_anyway = room.trouble == Trouble::FiresInTheDark && tag.is_none();
        let lit = (triggered && room.trouble != Trouble::Misfire) || fires_anyway;
        if room.trouble != Trouble::NoContact {
            room.syncs.push(FlashShot {
                number: release,
                triggered: triggered || fires_anyway,
                tag: tag.unwrap_or(0),
                energy_counts: lit.then_some(1000.0),
            });
        }
        let gain = if room.trouble == Trouble::Overexposed { 8.0 } else { 1.0 };
        let mut bytes = photo(if lit { gain } else { 0.0 }, release);
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

    fn syncs(&mut self, _patience: Duration) -> Result<Vec<FlashShot>, FlashError> {
        Ok(std::mem::take(&mut self.0.0.lock().unwrap().syncs))
    }
}

fn settings() -> Settings {
    Settings {
        make: Some("Fake".into()),
        model: Some("Fake 1".into()),
        shutter: Some(Seconds(1.0 / 125.0)),
        aperture: Some(FNumber(11.0)),
        iso: Some(Iso(100.0)),
        ..Settings::default()
    }
}

/// A textured wall in the room's light plus `flash` times the flash's light, with a little noise that
/// differs from frame to frame.
fn photo(flash: f64, frame: u32) -> Vec<u8> {
    let dn = Image::from_fn(192, 128, |x, y| {
        let hash = |seed: u64| {
            let mut h = (x as u64 / 2) << 32 ^ (y as u64 / 2) << 8 ^ seed;
            h = (h ^ (h >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
            h = (h ^ (h >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
            ((h ^ (h >> 31)) & 0xffff) as f64 / 65535.0
        };
        let wall = 0.3 + 0.3 * ((x as f64 / 17.0).sin() * (y as f64 / 13.0).cos()).abs() + 0.2 * hash(1);
        let noise = (hash(u64::from(frame) * 1000 + (x % 2 * 2 + y % 2) as u64) - 0.5) * 20.0;
        (2048.0 + wall * (1500.0 + 6000.0 * flash) + noise).clamp(0.0, 15300.0) as u16
    });
    let levels = Levels {
        black: [[2048.0; 2]; 2],
        saturation: [[15300.0; 2]; 2],
        black_source: LevelSource::FileTag,
        saturation_source: LevelSource::FileTag,
    };
    let mosaic = Mosaic { dn, cfa: Cfa::RGGB, levels };
    dng::encode(&DngContent { mosaic: &mosaic, settings: &settings(), masked_left: None }).unwrap()
}
