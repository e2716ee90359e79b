//! A textured wall as a small camera sees it: real DNGs for tests that need many frames quickly.

use std::collections::HashMap;
use std::sync::{Arc, Mutex};
use unlit::codec::dng::{self, DngContent};
use unlit::pair::{Exposure, Settings};
use unlit::photometry::{Cfa, LevelSource, Levels, Mosaic};
use unlit::raster::Image;
use unlit::session::store;
use unlit::studio::{Board, SyncContact, View};

/// What the sensor gave, by the file's digest: the number of the exposure and whether the flash lit it.
pub(crate) type Exposures = Arc<Mutex<HashMap<String, (u32, bool)>>>;

/// The wall before a simulated camera whose sync contact goes to a simulated flash board.
pub(crate) struct Wall {
    pub(crate) flash: Arc<Board>,
    pub(crate) taken: Exposures,
}

impl View for Wall {
    fn expose(&self, exposure: &Exposure) -> Vec<u8> {
        let lit = self.flash.close() > 0.0;
        let mut taken = self.taken.lock().unwrap();
        let number = taken.len() as u32;
        let bytes = photo(if lit { 1.0 } else { 0.0 }, number, *exposure);
        taken.insert(store::digest(&bytes), (number, lit));
        bytes
    }

    fn preview(&self) -> Vec<u8> {
        vec![0xff, 0xd8, 0xff, 0xd9]
    }
}

pub(crate) fn settings(dials: Exposure) -> Settings {
    Settings {
        make: Some("Fake".into()),
        model: Some("Fake 1".into()),
        shutter: Some(dials.shutter),
        aperture: Some(dials.aperture),
        iso: Some(dials.iso),
        ..Settings::default()
    }
}

/// A textured wall in the room's light plus `flash` times the flash's light, with a little noise that
/// differs from frame to frame.
pub(crate) fn photo(flash: f64, frame: u32, dials: Exposure) -> Vec<u8> {
    photo_in(1.0, flash, frame, dials)
}

/// The same in a room that is so many times as bright.
pub(crate) fn photo_in(lamps: f64, flash: f64, frame: u32, dials: Exposure) -> Vec<u8> {
    // Labels are rounded; shutters and apertures really move by thirds of a stop.
    let thirds = |stops: f64| (3.0 * stops).round() / 3.0;
    let gain = thirds((dials.iso.0 / 100.0).log2()) - thirds(2.0 * (dials.aperture.0 / 11.0).log2());
    let room = lamps * (gain + thirds((dials.shutter.0 * 125.0).log2())).exp2();
    let flash = flash * gain.exp2();
    let dn = Image::from_fn(192, 128, |x, y| {
        let hash = |seed: u64| {
            let mut h = (x as u64 / 2) << 32 ^ (y as u64 / 2) << 8 ^ seed;
            h = (h ^ (h >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
            h = (h ^ (h >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
            ((h ^ (h >> 31)) & 0xffff) as f64 / 65535.0
        };
        let wall = 0.3 + 0.3 * ((x as f64 / 17.0).sin() * (y as f64 / 13.0).cos()).abs() + 0.2 * hash(1);
        let noise = (hash(u64::from(frame) * 1000 + (x % 2 * 2 + y % 2) as u64) - 0.5) * 20.0;
        (2048.0 + wall * (1500.0 * room + 6000.0 * flash) + noise).clamp(0.0, 15300.0) as u16
    });
    let levels = Levels {
        black: [[2048.0; 2]; 2],
        saturation: [[15300.0; 2]; 2],
        black_source: LevelSource::FileTag,
        saturation_source: LevelSource::FileTag,
    };
    let mosaic = Mosaic { dn, cfa: Cfa::RGGB, levels };
    dng::encode(&DngContent { mosaic: &mosaic, settings: &settings(dials), masked_left: None }).unwrap()
}
